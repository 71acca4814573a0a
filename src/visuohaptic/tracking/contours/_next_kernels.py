"""Compiled search for a second edge close beyond each point of a contour: that of a body in front of it.

The pixels beyond an edge belong to one surface only up to the next edge. A gap of floor of some pixels between foam and a body
has two edges; one blurred step fits neither.
"""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ._fit_kernels import BLUR, CURVE, NEXT, NEXT_STEP, SLOPE, T, above, frame

#: Prior odds against a second edge, at any of the places, and neighbours on each side that have it in common.
_RARE, _BESIDE = math.log(100.0), 2
#: Spacing of the places that are tried [px], and how often it is halved.
_EVERY, _HALVED = 0.5, 3
#: Blurs of a single edge that are tried: that of the contour, and softer ones by this factor each.
_BLURS, _SOFTER = 4, 1.5
#: Pixels of the surface behind the first edge that are included [px].
_BEHIND = 3


@kernel(nogil=True)
def _profile(grey, origin, direction, half, state, near, length, place, level):
    """Fill the mean position and grey level of the pixels of one point, by distance from its edge; returns their number, 0 where
    they leave the image."""
    flat, pu, pv, slope, curve, nv, tu = frame(origin, direction, state[T], state[SLOPE], state[CURVE])
    rows, columns = grey.shape
    size_u, size_v = (columns, rows) if flat else (rows, columns)
    reach = half * abs(tu)
    u_first, u_last = int(math.floor(pu - reach)) + 1, int(math.floor(pu + reach))
    gap, run = int(math.ceil(near * state[BLUR] / abs(nv))), int(math.ceil(length / abs(nv)))
    behind = gap + int(math.ceil(_BEHIND / abs(nv)))
    bend = abs(slope) * reach + 0.5 * abs(curve) * reach * reach
    far = max(gap + run, behind)
    if u_first < 0 or u_last >= size_u or pv - bend - far < 1 or pv + bend + far > size_v - 2:
        return 0
    count, forward = min(behind + gap + run, len(place)), 1 if nv > 0.0 else -1
    for j in range(count):
        place[j], level[j] = 0.0, 0.0
    lanes = u_last - u_first + 1
    for u in range(u_first, u_last + 1):
        ve = pv + (u - pu) * (slope + 0.5 * curve * (u - pu))
        v = int(math.floor(ve)) + (1 - behind if nv > 0.0 else behind)
        for j in range(count):
            place[j] += (v - ve) * nv / lanes
            level[j] += (grey[v, u] if flat else grey[u, v]) / lanes
            v += forward
    return count


@kernel(nogil=True)
def _without(basis, known, vector, count):
    """Subtract the first ``known`` orthonormal vectors of the basis from a vector; returns its squared length."""
    total = 0.0
    for i in range(known):
        part = 0.0
        for j in range(count):
            part += basis[i, j] * vector[j]
        for j in range(count):
            vector[j] -= part * basis[i, j]
    for j in range(count):
        total += vector[j] ** 2
    return total


@kernel(nogil=True)
def _single(place, level, count, at, blur, basis):
    """Sum of squared residuals of a single edge near a place, left in ``level``; fills an orthonormal basis of its levels,
    shift and blur."""
    for j in range(count):
        x = (place[j] - at) / blur
        basis[0, j], basis[1, j], basis[2, j] = 1.0, above(x), math.exp(-0.5 * x * x)
        basis[3, j] = x * basis[2, j]
    for i in range(4):
        size = math.sqrt(max(_without(basis, i, basis[i], count), 1e-12))
        for j in range(count):
            basis[i, j] /= size
    return _without(basis, 4, level, count)


@kernel(nogil=True)
def _best_next(place, level, count, blur, nearest, noise, basis, found):
    """Place and step of the most likely second edge of one profile, and its log-likelihood ratio against one edge at either
    place."""
    work = level[:count].copy()
    alone = _single(place, level, count, 0.0, blur, basis)
    found[0], found[1], found[2] = 0.0, 0.0, 0.0
    first, last, gain = nearest, place[count - 1] - 1.0, 0.0
    step, at, tries = _EVERY, first, int((last - first) / _EVERY) + 1
    for halving in range(_HALVED + 1):
        middle = found[0]
        for m in range(tries if halving == 0 else 2):
            at = first + m * _EVERY if halving == 0 else middle + (2 * m - 1) * step
            if at < first or at > last:
                continue
            for j in range(count):
                basis[4, j] = above((place[j] - at) / blur)
            size, along = _without(basis, 4, basis[4], count), 0.0
            for j in range(count):
                along += basis[4, j] * level[j]
            if size > 1e-3 and along * along / size > gain:
                gain = along * along / size
                found[0], found[1] = at, along / size
        step *= 0.5
    floor, left = noise * count, alone - gain
    # One edge of any blur, at either place.
    wide, single = blur, np.empty(count)
    for _softer in range(_BLURS):
        for i in range(2):
            single[:] = work
            alone = min(alone, _single(place, single, count, found[0] if i else 0.0, wide, basis))
        wide *= _SOFTER
    found[2] = 0.5 * count * math.log(max(alone, floor) / max(left, floor)) - math.log(max(tries, 1))


@kernel(nogil=True)
def next_edges(grey, origin, direction, half, state, near, length, noise_var, min_contrast, tested, found):
    """Find a second edge beyond each point, and write its distance and step to ``state``; neighbours have it in common.

    The means over the pixels at the same distance from the edge count as independent.

    Parameters
    ----------
    grey, origin, direction, half, state
        As in :func:`~visuohaptic.tracking.contours._refine_kernels.refine`.
    near, length
        Distance of the plateaus from the edge [blurs], within which two edges merge into one, and their length [px].
    noise_var
        Variance of one pixel [grey levels^2].
    min_contrast
        Smallest step of an edge [grey levels].
    tested
        Points that are searched, (n,).
    found
        Distance [px], step [grey levels] and log-likelihood ratio of the second edge of each point; updated, (n, 3).
    """
    n = len(state)
    place, level, basis = np.empty(64), np.empty(64), np.empty((5, 64))
    for k in range(n):
        if tested[k]:
            found[k, 2] = -math.inf
            count = _profile(grey, origin[k], direction[k], half[k], state[k], near, length, place, level)
            if count > 6:
                lanes = max(2.0 * half[k], 1.0)
                blur = state[k, BLUR]
                _best_next(place, level, count, blur, near * blur, noise_var / lanes, basis, found[k])
    for k in range(n):
        odds = -_RARE
        for j in range(max(k - _BESIDE, 0), min(k + _BESIDE + 1, n)):
            odds += max(found[j, 2], -_RARE)
        there = odds > 0.0 and found[k, 2] > 0.0 and abs(found[k, 1]) >= min_contrast
        state[k, NEXT], state[k, NEXT_STEP] = found[k, 0], found[k, 1] if there else 0.0
