"""What a robot does with its senses, written against the protocols of :mod:`visuohaptic.robots` only."""

from .explore import Exploration, ExploreSettings, ExploreStep, explore_obstacle

__all__ = ["Exploration", "ExploreSettings", "ExploreStep", "explore_obstacle"]
