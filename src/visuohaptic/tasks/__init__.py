"""What a robot does with its senses, written against the protocols of :mod:`visuohaptic.robots` only."""

from .classify import Classification, SqueezeClassifier, classify_by_squeezing
from .complete import CompletionByTouch, complete_by_touch
from .crown_cap import open_crown_cap
from .crown_cap_records import CapOpening, CapSettings
from .explore import Exploration, ExploreSettings, ExploreStep, explore_obstacle
from .grasp import GraspAndLift, GraspPlan, grasp_and_lift
from .hand import Hand, Place
from .machine import Machine, Rule, replay
from .map_by_touch import MapSettings, TouchMapping, map_by_touch
from .squeeze import SqueezeCurve, SqueezeSettings, Squeezing
from .trace import Ending, Step, Trace

__all__ = [
    "CapOpening",
    "CapSettings",
    "Classification",
    "CompletionByTouch",
    "Ending",
    "Exploration",
    "ExploreSettings",
    "ExploreStep",
    "GraspAndLift",
    "GraspPlan",
    "Hand",
    "Machine",
    "MapSettings",
    "Place",
    "Rule",
    "SqueezeClassifier",
    "SqueezeCurve",
    "SqueezeSettings",
    "Squeezing",
    "Step",
    "TouchMapping",
    "Trace",
    "classify_by_squeezing",
    "complete_by_touch",
    "explore_obstacle",
    "grasp_and_lift",
    "map_by_touch",
    "open_crown_cap",
    "replay",
]
