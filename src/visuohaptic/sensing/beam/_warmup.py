"""Loads or compiles the kernels of the rod."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Bend a rod."""
    from .mechanics import Beam
    from .rod import bend_rod

    bend_rod(Beam(), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.5, 1.0]))
