"""From images to forces, shapes and motion: foam, primitives, events, haptic tags (Alt 2016, chapter 3 and 4.1)."""

from ..objects.tags import merge_tags
from .ego_motion import EgoMotionFilter, EgoMotionSettings
from .events import ContactEvents, DeflectionEvents, EventSettings
from .floor_motion import FloorTracker, fit_planar_motion
from .object_motion import ObjectMotion, ObjectTracker
from .obstacle_mask import FloorMixture, MixtureSettings, Obstacle, ObstacleDetector
from .primitives import (
    PrimitiveCandidate,
    PrimitiveFit,
    PrimitiveSettings,
    fit_contact,
    fit_primitive,
    primitive_distance_m,
    score_primitive,
)
from .push import Phases, PushRecord, StopLimits, StopReason, find_phases, record_push, stop_reason
from .scene import SceneReading, SceneTracker
from .tag import TagSettings, predictive_interval, tag_from_push
from .tag_file import tag_from_dict, tag_to_dict

__all__ = [
    "ContactEvents",
    "DeflectionEvents",
    "EgoMotionFilter",
    "EgoMotionSettings",
    "EventSettings",
    "FloorMixture",
    "FloorTracker",
    "MixtureSettings",
    "ObjectMotion",
    "ObjectTracker",
    "Obstacle",
    "ObstacleDetector",
    "Phases",
    "PrimitiveCandidate",
    "PrimitiveFit",
    "PrimitiveSettings",
    "PushRecord",
    "SceneReading",
    "SceneTracker",
    "StopLimits",
    "StopReason",
    "TagSettings",
    "find_phases",
    "fit_contact",
    "fit_planar_motion",
    "fit_primitive",
    "merge_tags",
    "predictive_interval",
    "primitive_distance_m",
    "record_push",
    "score_primitive",
    "stop_reason",
    "tag_from_dict",
    "tag_from_push",
    "tag_to_dict",
]
