"""What a robot knows of objects, and the measurements that this knowledge is made of."""

from .laser import LaserScan
from .measurement import Contact, ErrorBudget, Event, EventKind, ForceProfile, Motion, Reason, Wrench
from .model import (
    Appearance,
    Estimate,
    Geometry,
    HapticTag,
    Material,
    Primitive,
    PrimitiveKind,
    Provenance,
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
    "ForceProfile",
    "Geometry",
    "HapticTag",
    "LaserScan",
    "Material",
    "Motion",
    "Primitive",
    "PrimitiveKind",
    "Provenance",
    "Reason",
    "StiffnessMap",
    "VisuoHapticObject",
    "Wrench",
]
