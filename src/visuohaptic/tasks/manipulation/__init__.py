"""Tasks of arm and gripper: squeeze, complete by touch, classify, grasp, open a crown cap."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
