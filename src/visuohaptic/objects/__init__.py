"""What a robot knows of objects, and the measurements that this knowledge is made of."""

from .laser import LaserScan
from .measurement import Contact, ErrorBudget, Event, EventKind, ForceProfile, Motion, Reason, Wrench
from .model import (
    Appearance,
    Estimate,
    Evidence,
    FeatureVector,
    Geometry,
    HapticTag,
    Material,
    ObjectPart,
    Primitive,
    PrimitiveKind,
    Provenance,
    Sighting,
    StateModel,
    StiffnessMap,
    VisuoHapticObject,
)

__all__ = [
    "Appearance",
    "Contact",
    "ErrorBudget",
    "Estimate",
    "Event",
    "EventKind",
    "Evidence",
    "FeatureVector",
    "ForceProfile",
    "Geometry",
    "HapticTag",
    "LaserScan",
    "Material",
    "Motion",
    "ObjectPart",
    "Primitive",
    "PrimitiveKind",
    "Provenance",
    "Reason",
    "Sighting",
    "StateModel",
    "StiffnessMap",
    "VisuoHapticObject",
    "Wrench",
]
