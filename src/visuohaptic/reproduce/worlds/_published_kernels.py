"""Kernel of the published detector: error rays through a volume (Alt 2016, Sec. 5.2)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...core.kernels import kernel


@kernel(parallel=True)
def cast_rays(origin, ends, weights, low, voxel, slabs, volume):
    """Add a weight to every voxel from the camera to the end of each ray; one slab per thread.

    Parameters
    ----------
    origin
        Centre of the camera (3) in the world [m].
    ends
        Ends of the rays (n, 3) in the world [m].
    weights
        Weight of each ray (n).
    low
        Lowest corner of the volume (3) [m].
    voxel
        Edge of a voxel [m].
    slabs
        Number of slabs into which the volume is divided.
    volume
        Sums (x, y, z) float32, updated in place.
    """
    nx, ny, nz = volume.shape
    for slab in prange(slabs):
        first, last = nx * slab // slabs, nx * (slab + 1) // slabs
        p, d, step, crossing, per = np.empty(3), np.empty(3), np.empty(3, np.int64), np.empty(3), np.empty(3)
        cell = np.empty(3, np.int64)
        least, most = np.empty(3), np.empty(3)
        least[0], least[1], least[2] = first, 0.0, 0.0
        most[0], most[1], most[2] = last, ny, nz
        for r in range(len(ends)):
            enter, leave = 0.0, 1.0
            for axis in range(3):
                p[axis] = (origin[axis] - low[axis]) / voxel
                d[axis] = (ends[r, axis] - origin[axis]) / voxel
                if abs(d[axis]) < 1e-12:
                    if not least[axis] <= p[axis] < most[axis]:
                        enter = 2.0
                    continue
                a, b = (least[axis] - p[axis]) / d[axis], (most[axis] - p[axis]) / d[axis]
                enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
            if enter >= leave:
                continue
            for axis in range(3):
                at = p[axis] + (enter + 1e-9) * d[axis]
                cell[axis] = min(max(int(math.floor(at)), int(least[axis])), int(most[axis]) - 1)
                if abs(d[axis]) < 1e-12:
                    step[axis], crossing[axis], per[axis] = 0, np.inf, np.inf
                    continue
                step[axis] = 1 if d[axis] > 0 else -1
                border = cell[axis] + (1 if d[axis] > 0 else 0)
                crossing[axis] = (border - p[axis]) / d[axis]
                per[axis] = abs(1.0 / d[axis])
            while True:
                volume[cell[0], cell[1], cell[2]] += weights[r]
                axis = 0
                if crossing[1] < crossing[axis]:
                    axis = 1
                if crossing[2] < crossing[axis]:
                    axis = 2
                if crossing[axis] >= leave:
                    break
                cell[axis] += step[axis]
                crossing[axis] += per[axis]
                if cell[axis] < least[axis] or cell[axis] >= most[axis]:
                    break
