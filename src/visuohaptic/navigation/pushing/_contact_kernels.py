"""Contacts between the rim of a round platform and an outline: their positions and motion.

Lengths in metres, angles in radians; an outline is dilated by its corner radius.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Maximum number of simultaneous contacts between rim and outline.
MAX_CONTACTS = 4


@kernel
def features(outline, round_m, x, y, yaw, cx, cy, radius, reach, out):
    """Points where the rim of a disc is locally nearest to the outline, within ``reach``.

    Every local minimum of the distance is one: the foot of a perpendicular
    inside an edge, or a corner between two edges. Rows of ``out``:
    normal into the object (2), contact point from the object's reference
    point (2), gap, and 1 for an edge. Returns their number and the smallest gap.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    # Centre of the disc in the object's frame.
    px = c * (cx - x) + s * (cy - y)
    py = -s * (cx - x) + c * (cy - y)
    m = outline.shape[0]
    found, least = 0, np.inf
    for i in range(m):
        ax, ay = outline[i, 0], outline[i, 1]
        nx, ny = px - ax, py - ay
        j = i + 1 if i + 1 < m else 0
        h = i - 1 if i > 0 else m - 1
        ex, ey = outline[j, 0] - ax, outline[j, 1] - ay
        ahead = nx * ex + ny * ey
        length2 = ex * ex + ey * ey
        behind = nx * (outline[h, 0] - ax) + ny * (outline[h, 1] - ay)
        if m > 1 and ahead > 0.0 and ahead < length2:
            fraction = ahead / length2
            qx, qy = ax + fraction * ex, ay + fraction * ey
            edge = 1.0
        elif m == 1 or (ahead <= 0.0 and behind <= 0.0):
            qx, qy = ax, ay
            edge = 0.0
        else:
            continue
        nx, ny = px - qx, py - qy
        distance = np.sqrt(nx * nx + ny * ny)
        # If the disc's centre is inside an outline with three or more corners, there is no outer normal.
        gap = distance - round_m - radius
        least = min(least, gap)
        if gap > reach or distance < 1e-9:
            continue
        nx, ny = nx / distance, ny / distance
        qx, qy = qx + round_m * nx, qy + round_m * ny
        at = found
        if found == MAX_CONTACTS:
            at = 0
            for k in range(1, found):
                if out[k, 4] > out[at, 4]:
                    at = k
            if out[at, 4] <= gap:
                continue
        else:
            found += 1
        out[at, 0], out[at, 1] = -(c * nx - s * ny), -(s * nx + c * ny)
        out[at, 2], out[at, 3] = c * qx - s * qy, s * qx + c * qy
        out[at, 4], out[at, 5] = gap, edge
    return found, least


@kernel
def advance(contacts, count, shift_x, shift_y, dx, dy, turn, reach):
    """Gaps after the disc has moved by ``shift`` and the object by (dx, dy, turn); returns the smallest."""
    least = np.inf
    c, s = np.cos(turn), np.sin(turn)
    for k in range(count):
        nx, ny, qx, qy = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        # From the centre of the disc to the contact point of the object, before and after.
        away = reach + contacts[k, 4]
        bx = away * nx - shift_x + dx + (c - 1.0) * qx - s * qy
        by = away * ny - shift_y + dy + s * qx + (c - 1.0) * qy
        if contacts[k, 5] > 0.5:
            contacts[k, 4] = (c * nx - s * ny) * bx + (s * nx + c * ny) * by - reach
        else:
            contacts[k, 4] = np.sqrt(bx * bx + by * by) - reach
        least = min(least, contacts[k, 4])
    return least
