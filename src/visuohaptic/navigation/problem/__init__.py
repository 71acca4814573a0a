"""What is planned: robot, movable objects, costs of a push, node types, and the resulting plan (Alt 2016, Sec. 4.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
