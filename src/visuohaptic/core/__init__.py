"""The language of the house: measurements, objects, errors, files, geometry and what a robot must offer."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
