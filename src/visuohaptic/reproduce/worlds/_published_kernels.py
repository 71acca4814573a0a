"""Kernels of the published detector: moments of the background model, error score, error rays (Alt 2016, 5.2)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...core.kernels import kernel


@kernel(parallel=True)
def view_moments(warped, quadratic, constant, offset, tracking, weight, min_views, mean, sigma, score):  # fmt: skip
    """Mean, sigma' and reliability of each pixel, Eq. (5.3); ``sigma`` has the bias correction n / (n - 1).

    Parameters
    ----------
    warped
        Depths of the other views in this one (n, h, w) [m].
    quadratic, constant, offset, tracking
        Coefficients of the depth noise, see
        :class:`~visuohaptic.reconstruction.fusion.depth_noise.DepthNoise`.
    weight
        Weight w of the Hellinger distance.
    min_views
        Minimum number of views of a pixel.
    mean, sigma, score
        Mean depth [m], standard deviation [m] and reliability (h, w), filled.
    """
    views, rows, columns = warped.shape
    infinite = np.float32(np.inf)
    for i in prange(rows):
        count = np.zeros(columns, np.float32)
        shift = np.zeros(columns, np.float32)
        total = np.zeros(columns, np.float32)
        squares = np.zeros(columns, np.float32)
        for k in range(views):
            for j in range(columns):
                depth = warped[k, i, j]
                if depth < infinite:
                    if count[j] == np.float32(0):
                        shift[j] = depth
                    difference = depth - shift[j]
                    count[j] += np.float32(1)
                    total[j] += difference
                    squares[j] += difference * difference
        for j in range(columns):
            n = count[j]
            if n < min_views:
                mean[i, j], sigma[i, j], score[i, j] = np.float32(np.nan), np.float32(0), np.float32(0)
                continue
            middle = total[j] / n
            depth = shift[j] + middle
            variance = max((squares[j] - n * middle * middle) / (n - np.float32(1)), np.float32(0))
            device = constant + quadratic * (depth - offset) ** 2
            expected2 = device * device + tracking * tracking
            mean[i, j] = depth
            if variance <= expected2:
                sigma[i, j], score[i, j] = math.sqrt(expected2), np.float32(1)
                continue
            ratio = math.sqrt(expected2 * variance)
            overlap = math.sqrt(np.float32(2) * ratio / (expected2 + variance))
            sigma[i, j] = math.sqrt(variance)
            score[i, j] = max(np.float32(0), np.float32(1) - weight * (np.float32(1) - overlap))


@kernel(parallel=True)
def error_score(depth, mean, sigma, reliable, motions, theta, min_seen, fx, fy, cx, cy, error):  # fmt: skip
    """Error score of each pixel, Eq. (5.4) with the sign corrected.

    Parameters
    ----------
    depth
        Depth image (h, w) [m].
    mean, sigma, reliable
        Background model (h, w): mean depth [m], standard deviation [m], reliability.
    motions
        ``T_other_this`` (n, 3, 4).
    theta
        Threshold on the error function; smaller values score zero.
    min_seen
        Minimum number of other views whose field of view contains the observed point.
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    error
        Scores (h, w), filled.
    """
    rows, columns = depth.shape
    # erf(x) > theta only beyond this many sigma: an early exit for most pixels.
    least = 0.0
    while math.erf(least / math.sqrt(2.0)) < theta:
        least += 0.01
    least -= 0.01
    for i in prange(rows):
        for j in range(columns):
            error[i, j] = np.float32(0)
            z = depth[i, j]
            if not (z > 0.0) or reliable[i, j] <= np.float32(0):
                continue
            far = abs(z - mean[i, j])
            if far <= least * sigma[i, j]:
                continue
            p = (math.erf(far / (math.sqrt(2.0) * sigma[i, j])) - theta) / (1.0 - theta)
            if p <= 0.0:
                continue
            x, y = z * (j - cx) / fx, z * (i - cy) / fy
            seen = 0
            for k in range(len(motions)):
                m = motions[k]
                depth_there = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                if depth_there <= 0.05:
                    continue
                u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth_there + cx
                v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth_there + cy
                if 0.0 <= u <= columns - 1 and 0.0 <= v <= rows - 1:
                    seen += 1
            if seen >= min_seen:
                error[i, j] = np.float32(p * reliable[i, j])


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
