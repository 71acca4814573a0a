"""Navigation among movable obstacles: plan, push, look, plan again."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
