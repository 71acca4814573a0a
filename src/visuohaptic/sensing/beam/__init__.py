"""Six axes of force and moment from templates on a bending rod (Alt 2016, Sec. 3.2 and 3.4)."""

from .calibration import BeamCalibration, calibrate_beam
from .config import BeamSensorConfig, load_beam, save_beam
from .correction import Correction, prior_correction
from .estimate import BeamEstimate, estimate_wrench
from .mechanics import Beam, compliance, plane_inverse, shortening, stress_ratio
from .observation import RelativePoses, SectionMotion, TemplatePose, relative_poses, section_motion
from .records import LoadRecord, read_loads, read_template_poses, write_template_poses
from .reference import SteadyReference
from .rod import RodShape, bend_rod, rod_from_base
from .sensor import BeamReading, BeamSensor, BeamSetup
from .tracked import TrackedBeam, TrackedReading
from .zero import BeamDriftSettings, BeamZero, BeamZeroWatch

__all__ = [
    "Beam",
    "BeamCalibration",
    "BeamDriftSettings",
    "BeamEstimate",
    "BeamReading",
    "BeamSensor",
    "BeamSensorConfig",
    "BeamSetup",
    "BeamZero",
    "BeamZeroWatch",
    "Correction",
    "LoadRecord",
    "RelativePoses",
    "RodShape",
    "SectionMotion",
    "SteadyReference",
    "TemplatePose",
    "TrackedBeam",
    "TrackedReading",
    "bend_rod",
    "calibrate_beam",
    "compliance",
    "estimate_wrench",
    "load_beam",
    "plane_inverse",
    "prior_correction",
    "read_loads",
    "read_template_poses",
    "relative_poses",
    "rod_from_base",
    "save_beam",
    "section_motion",
    "shortening",
    "stress_ratio",
    "write_template_poses",
]
