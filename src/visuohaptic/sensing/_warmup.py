"""Runs the kernels of the primitives and of the obstacle mask once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Fit all primitives to the impression of a cylinder."""
    from . import _mixture_kernels  # noqa: F401  declares its types: importing compiles it
    from .primitives import fit_primitive

    radius_m, depth_m = 0.06, 0.006
    s_m = np.linspace(-0.06, 0.06, 41)
    delta_m = np.maximum(depth_m - radius_m + np.sqrt(np.maximum(radius_m**2 - s_m**2, 0.0)), 1e-5)
    points_m = np.column_stack([0.04 - delta_m, s_m])
    fit_primitive(points_m, np.full(len(s_m), 1e-5), delta_m=delta_m)
