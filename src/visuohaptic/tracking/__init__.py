"""Pixels only: contours along lines, templates and tags, points that flow, homographies (Alt 2016, Sec. 2.3)."""

from .contour import SHARED_NOISE, SHARED_POINTS, Contour, ContourSettings, ContourTracker, PointReason
from .lines import ConstraintLines
from .stripe import StripeModel

__all__ = [
    "SHARED_NOISE",
    "SHARED_POINTS",
    "ConstraintLines",
    "Contour",
    "ContourSettings",
    "ContourTracker",
    "PointReason",
    "StripeModel",
]
