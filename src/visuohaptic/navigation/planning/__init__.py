"""Navigation among movable obstacles (NAMO): plans with pushes or detours, joint graph, policies, replanning, path following (Alt 2016, Sec. 4.4)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
