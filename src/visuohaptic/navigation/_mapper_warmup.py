"""Runs the kernels of the mapper once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Map a small round room from three scans."""
    from ..objects.laser import LaserScan
    from .mapper import OccupancyMapper

    mapper = OccupancyMapper()
    for number in range(4):
        scan = LaserScan(0.1 * number, np.full(120, 1.5), -np.pi, np.pi / 60)
        mapper.add(scan, (0.2 * number, 0.0, 0.0))
