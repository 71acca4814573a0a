"""Hits of a laser on a convex outline, by intersecting its beams: not from the library."""

from __future__ import annotations

import math

import numpy as np

__all__ = ["VIEWS_M", "box", "cylinder", "scans"]

#: Positions of the laser on both sides of the path, before objects at the origin [m]; noise of a range [m].
VIEWS_M = np.column_stack([np.full(7, -0.9), np.linspace(-0.45, 0.45, 7)])
RANGE_M = 0.01


def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.asarray(p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0])


def scans(outline_m: np.ndarray, rng: np.random.Generator, step_rad: float = 0.0123) -> np.ndarray:
    """Hits of the beams from all views on a convex outline, with the noise of their ranges."""
    a, b = outline_m, np.roll(outline_m, -1, axis=0)
    hits = []
    for view in VIEWS_M:
        angles = np.arange(-0.6, 1.2, step_rad) + rng.uniform(-0.5, 0.5) * step_rad - 0.3
        beams = np.array([(math.cos(angle), math.sin(angle)) for angle in angles])
        with np.errstate(divide="ignore", invalid="ignore"):
            turned = cross(beams[:, None], b - a)
            reach = cross(a - view, b - a) / turned
            along = cross(a - view, beams[:, None]) / turned
        nearest = np.where((along >= 0.0) & (along <= 1.0) & (reach > 0.0), reach, np.inf).min(axis=1)
        seen = np.isfinite(nearest)
        read = nearest[seen] + RANGE_M * rng.standard_normal(np.count_nonzero(seen))
        hits.append(view + read[:, None] * beams[seen])
    return np.concatenate(hits)


def box(width_m: float, depth_m: float, yaw_rad: float) -> np.ndarray:
    own = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * (depth_m, width_m)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return own @ np.array([[c, s], [-s, c]])


def cylinder(radius_m: float) -> np.ndarray:
    angle = np.arange(64) * math.pi / 32
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
