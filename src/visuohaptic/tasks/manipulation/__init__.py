"""Tasks of arm and gripper: squeeze, complete by touch, classify, grasp, open a crown cap."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
