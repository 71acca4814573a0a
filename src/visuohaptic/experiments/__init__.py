"""Plots, annotated frames and the report: what a run leaves for people to look at."""

from .annotation import FrameNotes, annotated_frame, gradient_image, primitive_outline
from .plots import (
    COLOURS,
    ForceRun,
    MapObject,
    error_budget,
    floor_map,
    force_against_truth,
    force_over_time,
    pressure_profile,
)
from .report import Report
from .tables import estimate_text, primitive_text, tag_rows, tag_text

__all__ = [
    "COLOURS",
    "ForceRun",
    "FrameNotes",
    "MapObject",
    "Report",
    "annotated_frame",
    "error_budget",
    "estimate_text",
    "floor_map",
    "force_against_truth",
    "force_over_time",
    "gradient_image",
    "pressure_profile",
    "primitive_outline",
    "primitive_text",
    "tag_rows",
    "tag_text",
]
