"""Classification of every ray of a view by comparison with other views."""

from __future__ import annotations

import numpy as np
from numba import prange

from ...core.kernels import kernel
from ._view_kernels import project_row

UNKNOWN, SAME, FAR, NEAR, DROPPED = 0, 1, 2, 3, 4


@kernel
def _votes(x, y, z, sigma, depths, sigmas, motions, fx, fy, cx, cy, width):
    """Numbers of views (agreeing, looking through, nearer, empty): with a surface at the point, with one beyond it, with
    another one in front of it, without a reading there."""
    views, rows, columns = depths.shape
    half = np.float32(0.5)
    agree, through, nearer, lost = 0, 0, 0, 0
    for k in range(views):
        m = motions[k]
        there = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if there <= np.float32(0.05):
            continue
        inverse = np.float32(1) / there
        u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) * inverse + cx + half
        v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) * inverse + cy + half
        if not (u >= 1 and v >= 1 and u < columns - 1 and v < rows - 1):
            continue
        i, j = int(v), int(u)
        seen = depths[k, i, j]
        if not seen > 0:
            lost += 1
            continue
        square = width * width * (sigmas[k, i, j] * sigmas[k, i, j] + sigma * sigma)
        if (seen - there) * (seen - there) <= square:
            agree += 1
        elif seen > there:
            # At an edge the rounded pixel is ambiguous: require all four neighbours to be beyond the point.
            past = there + np.sqrt(square)
            if (
                depths[k, i - 1, j] > past
                and depths[k, i + 1, j] > past
                and depths[k, i, j - 1] > past
                and depths[k, i, j + 1] > past
            ):
                through += 1
        else:
            nearer += 1
    return agree, through, nearer, lost


@kernel
def _look_up_row(image, u, v, found):
    """Fill the values of an image at the pixels of a row."""
    for j in range(found.size):
        found[j] = image[np.uint32(v[j]), np.uint32(u[j])]


@kernel
def _compare_row(there, seen, spread, sigma, width, agree, nearer, lost, past):
    """Count a view that agrees with each point of a row, sees another in front of it, or has no reading there.

    ``past`` is the depth beyond which the view looks through the point; infinite where it does not.
    """
    infinite, zero = np.float32(np.inf), np.float32(0)
    for j in range(there.size):
        gap = seen[j] - there[j]
        square = width * width * (spread[j] * spread[j] + sigma[j] * sigma[j])
        inside, read = there[j] > zero, seen[j] > zero
        same = gap * gap <= square
        agree[j] += np.int32(1) if same else np.int32(0)
        nearer[j] += np.int32(1) if inside & read & (not same) & (gap < zero) else np.int32(0)
        lost[j] += np.int32(1) if inside & (not read) else np.int32(0)
        past[j] = there[j] + np.sqrt(square) if read & (not same) & (gap > zero) else infinite


@kernel
def _look_through_row(depth, u, v, past, through):
    """Count a view that looks through each point of a row: at an edge the pixel is ambiguous, so all four neighbours have to."""
    for j in range(past.size):
        limit = past[j]
        if limit < np.float32(np.inf):
            a, b = v[j], u[j]
            if (
                depth[a - 1, b] > limit
                and depth[a + 1, b] > limit
                and depth[a, b - 1] > limit
                and depth[a, b + 1] > limit
            ):
                through[j] += 1


@kernel(parallel=True)
def read_rays(depth, sigma, depths, sigmas, motions, warped, fx, fy, cx, cy, width, deepest, tracking, quorum, predicted, votes, empty, reading):  # fmt: skip
    """Classify the reading of each pixel of a view against the surface that other views see on its ray.

    Parameters
    ----------
    depth, sigma
        Depth image (h, w) and its standard deviations [m].
    depths, sigmas
        Depth images and standard deviations of the other views (n, h, w) [m].
    motions
        ``T_other_this`` (n, 3, 4).
    warped
        Depths of the other views reprojected into this one (n, h, w) [m].
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    width
        Number of standard deviations within which depths agree.
    deepest, tracking
        Standard deviation of a depth of 1 m due to the camera, which grows with the squared depth, and due to the poses [m].
    quorum
        Minimum number of views that see a surface.
    predicted
        Depth of the opaque surface (h, w) [m], filled; 0: unknown.
    votes
        Number of views that agree with it (h, w), filled.
    empty
        Number of views without a reading at it (h, w), filled.
    reading
        Reading (h, w), filled: 0 unknown, 1 the same, 2 farther, 3 nearer, 4 none.
    """
    rows, columns = depth.shape
    views = len(depths)
    infinite = np.float32(np.inf)
    for i in prange(rows):
        sorted_m = np.empty(views, np.float32)
        agrees, throughs, nearers, losts = (
            np.zeros(columns, np.int32), np.zeros(columns, np.int32), np.zeros(columns, np.int32), np.zeros(columns, np.int32)
        )  # fmt: skip
        across, there, seen, spread, past = (
            np.empty(columns, np.float32), np.empty(columns, np.float32), np.empty(columns, np.float32),
            np.empty(columns, np.float32), np.empty(columns, np.float32)
        )  # fmt: skip
        u, v = np.empty(columns, np.int32), np.empty(columns, np.int32)
        for j in range(columns):
            across[j] = (np.float32(j) - cx) / fx
        down = (np.float32(i) - cy) / fy
        for k in range(views):
            project_row(motions[k], across, down, depth[i], fx, fy, cx, cy, rows, columns, 1, u, v, there)
            _look_up_row(depths[k], u, v, seen)
            _look_up_row(sigmas[k], u, v, spread)
            _compare_row(there, seen, spread, sigma[i], width, agrees, nearers, losts, past)
            _look_through_row(depths[k], u, v, past, throughs)
        for j in range(columns):
            reading[i, j], predicted[i, j], votes[i, j], empty[i, j] = UNKNOWN, np.float32(0), 0, 0
            z, s = depth[i, j], sigma[i, j]
            valid = z > np.float32(0)
            sx, sy = (np.float32(j) - cx) / fx, (np.float32(i) - cy) / fy
            agree, through, nearer, lost = agrees[j], throughs[j], nearers[j], losts[j]
            if valid and agree >= 2 and through + nearer == 0:
                reading[i, j], predicted[i, j], votes[i, j], empty[i, j] = SAME, z, agree, lost
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
            while first + quorum <= count:
                start = sorted_m[first]
                expected = np.sqrt((deepest * start * start) ** 2 + tracking * tracking)
                reach = np.float32(2) * width * expected
                last, total = first, np.float32(0)
                while last < count and sorted_m[last] - start <= reach:
                    total += sorted_m[last]
                    last += 1
                if last - first >= quorum:
                    d = total / np.float32(last - first)
                    for_d, past_d, _, lost_d = _votes(
                        sx * d, sy * d, d, expected, depths, sigmas, motions, fx, fy, cx, cy, width
                    )
                    # A nearer surface may only occlude the point in that view: of two surfaces, take the one more views see.
                    if for_d >= max(quorum, agree + 1) and 2 * past_d <= for_d:
                        predicted[i, j], votes[i, j], empty[i, j] = d, for_d, lost_d
                        break
                first += 1
            d = predicted[i, j]
            tolerance = width * np.sqrt(s * s + (deepest * d * d) ** 2 + tracking * tracking)
            if agree >= 2 and agree >= through and (d == np.float32(0) or abs(d - z) <= tolerance):
                reading[i, j], predicted[i, j], votes[i, j], empty[i, j] = SAME, z, agree, lost
            elif d > np.float32(0):
                if not valid:
                    reading[i, j] = DROPPED
                elif abs(d - z) <= tolerance:
                    reading[i, j], predicted[i, j] = SAME, min(z, d)
                elif z > d:
                    reading[i, j] = FAR
                elif through >= 2:
                    reading[i, j] = NEAR
                else:
                    predicted[i, j], votes[i, j] = np.float32(0), 0
            elif through >= 3 and through >= 3 * agree:
                reading[i, j], predicted[i, j], votes[i, j], empty[i, j] = NEAR, z, through, lost


@kernel
def projector_shadow(predicted, focal_baseline, slack, shadow):
    """Mask of pixels whose predicted surface is in the shadow of the projector, occluded by another point of the row.

    The projector is at +x for a positive ``focal_baseline`` [px m]: column u of depth z is lit through its column
    u - focal_baseline / z, and an occluder lies on the projector's side of the point that it occludes.

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
