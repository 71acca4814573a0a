"""Force and shape from the deflection of a strip of foam (Alt 2016, Sec. 3.2 and 3.3)."""

from .boundary import BOUNDARIES, Boundary, Tension, calibrate_tension
from .calibration import FoamCalibration, calibrate_foam
from .curve import StressCurve
from .hysteresis import HysteresisState
from .material import FoamMaterial
from .profile import ContactRegion, FoamReading, read_profile
from .records import PlateRecord, StrainStress, read_plate, read_strain_stress
from .section import section_material, sensitivity

__all__ = [
    "BOUNDARIES",
    "Boundary",
    "ContactRegion",
    "FoamCalibration",
    "FoamMaterial",
    "FoamReading",
    "HysteresisState",
    "PlateRecord",
    "StrainStress",
    "StressCurve",
    "Tension",
    "calibrate_foam",
    "calibrate_tension",
    "read_plate",
    "read_profile",
    "read_strain_stress",
    "section_material",
    "sensitivity",
]
