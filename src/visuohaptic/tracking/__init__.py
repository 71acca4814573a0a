"""Pixels only: contours that are followed from frame to frame along constraint lines."""

from .contour import Contour, ContourSettings, ContourTracker, PointReason
from .lines import ConstraintLines
from .stripe import StripeModel

__all__ = ["ConstraintLines", "Contour", "ContourSettings", "ContourTracker", "PointReason", "StripeModel"]
