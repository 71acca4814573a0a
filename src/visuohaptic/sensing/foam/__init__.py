"""Force, pressure and shape from a strip of foam that a camera watches (Alt 2016, Sec. 3.2 and 3.3)."""

from .boundary import BOUNDARIES, Boundary
from .config import FoamSensorConfig, FoamSetup
from .finger import FingerReading, FingerSensor
from .geometry import StripGeometry
from .hysteresis import HysteresisState
from .material import FoamMaterial
from .profile import ContactRegion, FoamReading, read_profile
from .sensor import FoamSensor
from .zero import DriftSettings, ZeroReference, ZeroWatch

__all__ = [
    "BOUNDARIES",
    "Boundary",
    "ContactRegion",
    "DriftSettings",
    "FingerReading",
    "FingerSensor",
    "FoamMaterial",
    "FoamReading",
    "FoamSensor",
    "FoamSensorConfig",
    "FoamSetup",
    "HysteresisState",
    "StripGeometry",
    "ZeroReference",
    "ZeroWatch",
    "read_profile",
]
