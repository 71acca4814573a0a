"""Stereo matching: disparity by comparing small windows of surface points of two cameras.

A projected or natural texture is represented by a label of surface points. A window of the left image matches the right image
at a disparity where both cameras see the same points; behind curved glass they seldom do, beside a nearer object the right
camera does not see them (stereo shadow, on the left of the object), and across an edge the nearer surface dominates.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["match"]

#: Windows of 3 x 3 px at 320 px match as those of 7 x 7 to 9 x 9 at 848 px.
_RADIUS = 1
#: Fraction of a window that has to match: below a half the match would be ambiguous.
_ENOUGH = 0.5
#: Points of neighbouring pixels that are farther apart than this many pixels' pitch lie on different surfaces.
_TORN = 6.0


@njit(cache=True)
def _sample(left, right, v, u, x, focal, offset):
    """Weight in 0-1 of a left pixel matched between right pixels x and x + 1; the place between goes to ``offset``.

    The weight falls with the distance of the left point from the line through the two right points, in units of the
    pitch of pixels there.
    """
    if x < 0 or x + 1 >= right.shape[1]:
        return 0.0
    ax = right[v, x, 0]
    ay = right[v, x, 1]
    az = right[v, x, 2]
    bx = right[v, x + 1, 0] - ax
    by = right[v, x + 1, 1] - ay
    bz = right[v, x + 1, 2] - az
    px = left[v, u, 0] - ax
    py = left[v, u, 1] - ay
    pz = left[v, u, 2] - az
    pitch = left[v, u, 3] / focal
    length = bx * bx + by * by + bz * bz
    if not (0.0 < length < (_TORN * pitch) ** 2):
        return 0.0
    s = (px * bx + py * by + pz * bz) / length
    # Half a pixel on both sides: rows and columns of a window lie between disparities.
    if not (-0.5 <= s <= 1.5):
        return 0.0
    rx = px - s * bx
    ry = py - s * by
    rz = pz - s * bz
    offset[0] = s
    return np.exp(-(rx * rx + ry * ry + rz * rz) / (pitch * pitch))


@njit(cache=True)
def _window(left, right, v, u, disparity, focal, offset):
    """Matched fraction of the window and its mean disparity [px] at a whole disparity."""
    total = 0.0
    mean = 0.0
    for dv in range(-_RADIUS, _RADIUS + 1):
        for du in range(-_RADIUS, _RADIUS + 1):
            y = v + dv
            x = u + du
            if y < 0 or y >= left.shape[0] or x < 0 or x >= left.shape[1]:
                continue
            weight = _sample(left, right, y, x, x - disparity, focal, offset)
            total += weight
            mean += weight * (disparity - offset[0])
    return total / (2 * _RADIUS + 1) ** 2, mean / max(total, 1e-9)


@njit(cache=True)
def _match(left, right, near, focal, baseline, disparities, quality):
    """Best window of every pixel; ``near`` is the smallest depth that is sought [m]."""
    offset = np.zeros(1)
    for v in range(left.shape[0]):
        for u in range(left.shape[1]):
            disparities[v, u] = np.nan
            quality[v, u] = 0.0
            # Where the surface point itself is seen by both eyes is tried first.
            if np.isfinite(left[v, u, 3]):
                expected = int(np.ceil(focal * baseline / left[v, u, 3]))
                share, disparity = _window(left, right, v, u, expected, focal, offset)
                if share > 0.95:
                    disparities[v, u] = disparity
                    quality[v, u] = share
                    continue
            for trial in range(4, int(focal * baseline / near) + 2):
                share, disparity = _window(left, right, v, u, trial, focal, offset)
                if share > quality[v, u]:
                    quality[v, u] = share
                    disparities[v, u] = disparity
            if quality[v, u] < _ENOUGH:
                disparities[v, u] = np.nan


def match(
    left: np.ndarray, right: np.ndarray, focal_px: float, baseline_m: float, near_m: float = 0.2
) -> tuple[np.ndarray, np.ndarray]:
    """Disparity [px], NaN where nothing matches, and the matched fraction of the window.

    Parameters
    ----------
    left
        What each pixel sees: the point in the world and its depth along the optical axis, (rows, columns, 4) [m].
    right
        The same points of the right eye, (rows, columns, 3) [m].
    """
    disparities = np.empty(left.shape[:2])
    quality = np.empty(left.shape[:2])
    _match(left, right, near_m, focal_px, baseline_m, disparities, quality)
    return disparities, quality
