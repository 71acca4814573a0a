"""Pixels only: contours along lines, templates and tags, points that flow, homographies (Alt 2016, Sec. 2.3)."""

from .contour import (
    PIXEL_PX,
    SHARED_NOISE,
    SHARED_POINTS,
    Contour,
    ContourSettings,
    ContourTracker,
    PointReason,
)
from .detector import Detection, DetectorSettings, detect_templates
from .esm import Alignment, EsmSettings, align
from .esm_template import EsmTemplate
from .flow import FlowSettings, FlowStep, PointTracker
from .homography import (
    PlaneMotion,
    RobustHomography,
    apply_homography,
    compose_homography,
    decompose_homography,
    estimate_homography,
    estimate_homography_robust,
    facing_motions,
)
from .lines import ConstraintLines
from .plane_pose import PlanePose, estimate_plane_poses
from .stripe import StripeModel
from .template import Template, TemplateQuality, load_templates, template_quality
from .template_tracker import TemplatePose, TemplateTracker, TrackerSettings

__all__ = [
    "PIXEL_PX",
    "SHARED_NOISE",
    "SHARED_POINTS",
    "Alignment",
    "ConstraintLines",
    "Contour",
    "ContourSettings",
    "ContourTracker",
    "Detection",
    "DetectorSettings",
    "EsmSettings",
    "EsmTemplate",
    "FlowSettings",
    "FlowStep",
    "PlaneMotion",
    "PlanePose",
    "PointReason",
    "PointTracker",
    "RobustHomography",
    "StripeModel",
    "Template",
    "TemplatePose",
    "TemplateQuality",
    "TemplateTracker",
    "TrackerSettings",
    "align",
    "apply_homography",
    "compose_homography",
    "decompose_homography",
    "detect_templates",
    "estimate_homography",
    "estimate_homography_robust",
    "estimate_plane_poses",
    "facing_motions",
    "load_templates",
    "template_quality",
]
