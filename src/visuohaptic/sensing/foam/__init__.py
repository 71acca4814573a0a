"""Force, pressure and shape from a strip of foam that a camera watches (Alt 2016, Sec. 3.2 and 3.3)."""

from .boundary import BOUNDARIES, Boundary, Tension, calibrate_tension
from .calibration import FoamCalibration, calibrate_foam
from .config import FoamSensorConfig, FoamSetup
from .curve import StressCurve
from .finger import FingerReading, FingerSensor, load_sensor
from .finger_optics import FingerPosition, finger_pose
from .geometry import StripGeometry
from .hysteresis import HysteresisLaw, HysteresisState, identify_hysteresis
from .material import FoamMaterial
from .optics import ObservedStrip
from .profile import ContactRegion, FoamReading, read_profile
from .records import PlateRecord, StrainStress, read_plate, read_strain_stress
from .section import section_material, sensitivity
from .sensor import FoamSensor
from .stripe_view import stripe_masks, train_stripe
from .zero import DriftSettings, ZeroReference, ZeroWatch

__all__ = [
    "BOUNDARIES",
    "Boundary",
    "ContactRegion",
    "DriftSettings",
    "FingerPosition",
    "FingerReading",
    "FingerSensor",
    "FoamCalibration",
    "FoamMaterial",
    "FoamReading",
    "FoamSensor",
    "FoamSensorConfig",
    "FoamSetup",
    "HysteresisLaw",
    "HysteresisState",
    "ObservedStrip",
    "PlateRecord",
    "StrainStress",
    "StressCurve",
    "StripGeometry",
    "Tension",
    "ZeroReference",
    "ZeroWatch",
    "calibrate_foam",
    "calibrate_tension",
    "finger_pose",
    "identify_hysteresis",
    "load_sensor",
    "read_plate",
    "read_profile",
    "read_strain_stress",
    "section_material",
    "sensitivity",
    "stripe_masks",
    "train_stripe",
]
