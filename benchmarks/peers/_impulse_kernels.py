"""The loop of Algorithm 2 (Alt 2016)."""

from __future__ import annotations

import numpy as np

from visuohaptic.core import kernel
from visuohaptic.navigation.pushing._contact_kernels import features


@kernel
def impulse_push(outline, round_m, centroid, ratio, radius, contact_range, path, start, trace, contact):
    """Fill ``trace`` (k x 3 poses) and ``contact`` (k x 2); returns the last row with contact, or -1.

    ``ratio`` is the moment of inertia by the mass [m^2].
    """
    x, y, yaw = start[0], start[1], start[2]
    near = np.zeros((4, 6))
    last = -1
    for j in range(path.shape[0]):
        # A path sampled at 2 cm would jump into the object: approach contact in fractions of the range.
        before = j - 1 if j > 0 else 0
        way = np.hypot(path[j, 0] - path[before, 0], path[j, 1] - path[before, 1])
        parts = max(1, int(np.ceil(way / (0.5 * contact_range))))
        for part in range(1, parts + 1):
            fraction = part / parts
            cx = path[before, 0] + fraction * (path[j, 0] - path[before, 0])
            cy = path[before, 1] + fraction * (path[j, 1] - path[before, 1])
            count, _ = features(outline, round_m, x, y, yaw, cx, cy, radius, contact_range, near)
            if count == 0:
                continue
            best = 0
            for k in range(1, count):
                if near[k, 4] < near[best, 4]:
                    best = k
            last = j
            nx, ny, gap = near[best, 0], near[best, 1], near[best, 4]
            c, s = np.cos(yaw), np.sin(yaw)
            mx, my = c * centroid[0] - s * centroid[1], s * centroid[0] + c * centroid[1]
            lever_x, lever_y = near[best, 2] - mx, near[best, 3] - my
            moment = lever_x * ny - lever_y * nx
            impulse = (contact_range - gap) / (1.0 + moment * moment / ratio)
            contact[j, 0], contact[j, 1] = x + near[best, 2], y + near[best, 3]
            turn = impulse * moment / ratio
            # The centroid moves, the reference point turns about it.
            px, py = x + mx + impulse * nx, y + my + impulse * ny
            yaw += turn
            c, s = np.cos(yaw), np.sin(yaw)
            x = px - (c * centroid[0] - s * centroid[1])
            y = py - (s * centroid[0] + c * centroid[1])
        trace[j, 0], trace[j, 1], trace[j, 2] = x, y, yaw
    return last
