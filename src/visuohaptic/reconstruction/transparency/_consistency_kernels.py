"""Which rays of a view other views confirm or contradict, shadows of the projector, and counts in space."""

from __future__ import annotations

import numpy as np
from numba import prange

from ...core.kernels import kernel

__all__ = ["classify", "count_rays", "projector_shadow", "tile_rays"]

UNKNOWN, CLEAN, CONTRADICTED, DROPPED = 0, 1, 2, 3


@kernel(inline="always")
def _sigma(z, numbers):
    device = numbers[1] + numbers[0] * (z - numbers[2]) * (z - numbers[2])
    return np.sqrt(device * device + numbers[3] * numbers[3])


@kernel
def _votes(x, y, z, depths, motions, fx, fy, cx, cy, numbers, width):
    """(agreeing, seeing through): views that have a surface at the point, and views that look past it."""
    views, rows, columns = depths.shape
    half = np.float32(0.5)
    agree, through = 0, 0
    for k in range(views):
        m = motions[k]
        there = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if there <= np.float32(0.05):
            continue
        u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / there + cx + half
        v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / there + cy + half
        if not (u >= 1 and v >= 1 and u < columns - 1 and v < rows - 1):
            continue
        i, j = int(v), int(u)
        tolerance = width * _sigma(there, numbers)
        seen = depths[k, i, j]
        if abs(seen - there) <= tolerance:
            agree += 1
        elif seen > there:
            # Next to an edge the rounding of the pixel decides: all four neighbours must look past it too.
            past = there + tolerance
            if (
                depths[k, i - 1, j] > past
                and depths[k, i + 1, j] > past
                and depths[k, i, j - 1] > past
                and depths[k, i, j + 1] > past
            ):
                through += 1
    return agree, through


@kernel(parallel=True)
def classify(depth, depths, motions, warped, fx, fy, cx, cy, numbers, width, limit, predicted, label):  # fmt: skip
    """Label each pixel of a view by what other views say about its ray.

    Without a depth in this view a pixel with a prediction is ``DROPPED``.

    Parameters
    ----------
    depth
        Depth image (h, w) [m].
    depths
        Depth images of the other views (n, h, w) [m].
    motions
        ``T_other_this`` (n, 3, 4).
    warped
        Depths of the other views in this one (n, h, w) [m].
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    numbers
        Quadratic, constant and offset coefficient of the depth noise, and sigma of tracking.
    width
        Number of standard deviations within which depths agree.
    limit
        Depth up to which each ray is evidence (h, w) [m], filled.
    predicted
        Depth of the opaque surface (h, w) [m], 0 unknown, filled.
    label
        Label of each pixel (h, w), filled.
    """
    rows, columns = depth.shape
    views = len(depths)
    infinite = np.float32(np.inf)
    for i in prange(rows):
        sorted_m = np.empty(views, np.float32)
        for j in range(columns):
            label[i, j], limit[i, j], predicted[i, j] = UNKNOWN, np.float32(0), np.float32(0)
            z = depth[i, j]
            valid = z > np.float32(0)
            sx, sy = (np.float32(j) - cx) / fx, (np.float32(i) - cy) / fy
            through = 0
            agree = 0
            if valid:
                agree, through = _votes(sx * z, sy * z, z, depths, motions, fx, fy, cx, cy, numbers, width)
                if agree >= 2 and agree >= through:
                    label[i, j], limit[i, j], predicted[i, j] = CLEAN, z, z
                    continue
            count = 0
            for k in range(views):
                w = warped[k, i, j]
                if w < infinite:
                    at = count
                    while at > 0 and sorted_m[at - 1] > w:
                        sorted_m[at] = sorted_m[at - 1]
                        at -= 1
                    sorted_m[at] = w
                    count += 1
            first = 0
            while first + 2 < count:
                start = sorted_m[first]
                reach = np.float32(2) * width * _sigma(start, numbers)
                last, total = first, np.float32(0)
                while last < count and sorted_m[last] - start <= reach:
                    total += sorted_m[last]
                    last += 1
                if last - first >= 3:
                    d = total / np.float32(last - first)
                    for_d, past_d = _votes(sx * d, sy * d, d, depths, motions, fx, fy, cx, cy, numbers, width)
                    if for_d >= 3 and 2 * past_d <= for_d:
                        predicted[i, j] = d
                        break
                first += 1
            d = predicted[i, j]
            if not valid:
                if d > np.float32(0):
                    label[i, j], limit[i, j] = DROPPED, d
                continue
            if d > np.float32(0):
                if abs(d - z) <= width * _sigma(d, numbers):
                    label[i, j], limit[i, j] = CLEAN, min(z, d)
                elif z > d or through >= 2:
                    label[i, j], limit[i, j] = CONTRADICTED, d
            elif through >= 3 and through >= 3 * agree:
                label[i, j], limit[i, j] = CONTRADICTED, z


@kernel
def projector_shadow(predicted, focal_baseline, slack, shadow):
    """Where the projector's light does not reach the predicted surface: another point of the row is before it.

    The projector is at +x for a positive ``focal_baseline`` [px m]: column u of depth z is lit through its column
    u - focal_baseline / z, and an occluder lies on the projector's side of what it hides.

    Parameters
    ----------
    predicted
        Depth of the expected surface (h, w) [m], 0 unknown.
    focal_baseline
        Focal length times baseline of the projector [px m].
    slack
        Tolerance of the comparison [px].
    shadow
        Result (h, w), filled.
    """
    rows, columns = predicted.shape
    for i in range(rows):
        front = np.inf
        for step in range(columns):
            j = columns - 1 - step if focal_baseline > 0 else step
            z = predicted[i, j]
            if not z > 0:
                continue
            lit = j - focal_baseline / z
            if focal_baseline < 0:
                lit = -lit
            if lit > front - slack + 1.0:
                shadow[i, j] = 1
            front = min(front, lit)


@kernel
def tile_rays(label, limit, edge, bad, known, unknown, nearest):
    """Per tile of the image: whether it has bad, known or unknown rays, and the smallest depth up to which a ray is evidence.

    Parameters
    ----------
    label, limit
        Labels and depth limits [m] of the pixels (h, w).
    edge
        Edge of a tile [px].
    bad, known, unknown, nearest
        Results of each tile, filled.
    """
    rows, columns = label.shape
    for a in range(bad.shape[0]):
        for b in range(bad.shape[1]):
            nearest[a, b] = np.float32(np.inf)
            bad[a, b] = known[a, b] = unknown[a, b] = 0
            for i in range(a * edge, min(rows, (a + 1) * edge)):
                for j in range(b * edge, min(columns, (b + 1) * edge)):
                    if label[i, j] == UNKNOWN:
                        unknown[a, b] = 1
                        continue
                    known[a, b] = 1
                    nearest[a, b] = min(nearest[a, b], limit[i, j])
                    if label[i, j] != CLEAN:
                        bad[a, b] = 1


@kernel(parallel=True)
def count_rays(label, limit, margin, edge, bad, known, unknown, nearest, motion, fx, fy, cx, cy, low, voxel, brick, contradicted, dropped, clean, clean_brick):  # fmt: skip
    """Count for every voxel the rays that pass it before they end, by label.

    Bricks of ``brick``^3 voxels whose whole projection is clean are counted once, in ``clean_brick``.

    Parameters
    ----------
    label, limit
        Labels and depth limits [m] of the pixels (h, w).
    margin
        Depth before the end of a ray that does not count [m].
    edge
        Edge of a tile [px].
    bad, known, unknown, nearest
        Summary of each tile, from :func:`tile_rays`.
    motion
        ``T_camera_world`` (3, 4).
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    low, voxel
        Lowest corner (3) and edge of a voxel [m].
    brick
        Edge of a brick [voxels].
    contradicted, dropped, clean
        Counts of each voxel (x, y, z) uint16, changed.
    clean_brick
        Counts of the bricks of which all rays are clean, changed.
    """
    rows, columns = label.shape
    bx, by, bz = clean_brick.shape
    half = np.float32(0.5)
    size = np.float32(voxel * brick)
    for a in prange(bx):
        for b in range(by):
            for c in range(bz):
                u0, u1, v0, v1 = np.float32(1e9), np.float32(-1e9), np.float32(1e9), np.float32(-1e9)
                z0, z1 = np.float32(1e9), np.float32(-1e9)
                for corner in range(8):
                    x = low[0] + size * np.float32(a + (corner & 1))
                    y = low[1] + size * np.float32(b + ((corner >> 1) & 1))
                    w = low[2] + size * np.float32(c + (corner >> 2))
                    z = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] * w + motion[2, 3]
                    z0, z1 = min(z0, z), max(z1, z)
                    if z <= np.float32(0.05):
                        continue
                    u = fx * (motion[0, 0] * x + motion[0, 1] * y + motion[0, 2] * w + motion[0, 3]) / z + cx
                    v = fy * (motion[1, 0] * x + motion[1, 1] * y + motion[1, 2] * w + motion[1, 3]) / z + cy
                    u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                if z0 <= np.float32(0.05) or u1 < 0 or v1 < 0 or u0 > columns - 1 or v0 > rows - 1:
                    continue
                inside = u0 >= 0 and v0 >= 0 and u1 <= columns - 1 and v1 <= rows - 1
                any_known, any_bad, any_unknown = False, False, False
                shortest = np.float32(np.inf)
                for p in range(max(int(v0), 0) // edge, min(int(v1), rows - 1) // edge + 1):
                    for q in range(max(int(u0), 0) // edge, min(int(u1), columns - 1) // edge + 1):
                        any_known |= known[p, q] == 1
                        any_bad |= bad[p, q] == 1
                        any_unknown |= unknown[p, q] == 1
                        shortest = min(shortest, nearest[p, q])
                if not any_known:
                    continue
                if inside and not any_bad and not any_unknown and z1 < shortest - margin:
                    clean_brick[a, b, c] += np.uint16(1)
                    continue
                for i in range(a * brick, min((a + 1) * brick, clean.shape[0])):
                    x = low[0] + np.float32(voxel) * (np.float32(i) + half)
                    for j in range(b * brick, min((b + 1) * brick, clean.shape[1])):
                        y = low[1] + np.float32(voxel) * (np.float32(j) + half)
                        px = motion[0, 0] * x + motion[0, 1] * y + motion[0, 3]
                        py = motion[1, 0] * x + motion[1, 1] * y + motion[1, 3]
                        pz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 3]
                        for k in range(c * brick, min((c + 1) * brick, clean.shape[2])):
                            w = low[2] + np.float32(voxel) * (np.float32(k) + half)
                            z = pz + motion[2, 2] * w
                            inverse = np.float32(1) / z
                            u = fx * (px + motion[0, 2] * w) * inverse + cx + half
                            v = fy * (py + motion[1, 2] * w) * inverse + cy + half
                            if not (u >= 0 and v >= 0 and u < columns and v < rows):
                                continue
                            what = label[int(v), int(u)]
                            if what == UNKNOWN or z > limit[int(v), int(u)] - margin:
                                continue
                            if what == CLEAN:
                                clean[i, j, k] += np.uint16(1)
                            elif what == CONTRADICTED:
                                contradicted[i, j, k] += np.uint16(1)
                            else:
                                dropped[i, j, k] += np.uint16(1)
