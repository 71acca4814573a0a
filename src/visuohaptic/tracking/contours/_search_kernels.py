"""Compiled kernels of the search: edge strength along the lines, and exact chain optimisation.

``lines``: K constraint lines, ``n`` samples of one pixel along each, ``N`` search
positions per line. Every function has a plain NumPy reference implementation in the tests.
"""

# mypy: disable-error-code="no-untyped-def, assignment"
# Kernels are typed by numba at the call; their arrays are described in the docstrings.
from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from .._solve_kernels import median

#: Cost of a position outside the search range; large compared with any energy, small enough for float32.
FORBIDDEN = np.float32(1e4)
#: Number of samples that the smoothed derivative needs beyond both ends of a profile [px].
MARGIN = 3
#: Spacing of the five samples across a line (px).
ACROSS_PX = 2.0
#: Gradients up to this multiple of their median are texture, not edges that are crossed: those of a random texture are
#: Rayleigh distributed, so that 2^(-2.5^2) of them, one sample in 76, exceeds it.
TEXTURE = 2.5


@kernel(fastmath=True, nogil=True)
def edge_strength(grey, origin, direction, first, count, polarity, strength):
    """|grad G * i| on every line at ``first[k] + j``, j < count; zero where the polarity is wrong.

    G is the binomial filter (1 4 6 4 1)/16 along the line and the mean of five
    samples across it. The gradient has components along and across the line,
    so that an edge that crosses the lines steeply keeps its strength.

    Parameters
    ----------
    grey
        Grey image.
    origin, direction
        Origins (x, y) [px] and unit directions of K lines, (K, 2).
    first
        First sample on each line [px], (K,).
    count
        Number of samples on each line, 1 px apart.
    polarity
        +1 brighter at larger t, -1 darker, 0 either.
    strength
        Filled, (K, count).
    """
    rows, columns = grey.shape
    n = count + 2 * MARGIN
    along = np.empty(n, np.float32)
    across = np.empty(n, np.float32)
    for k in range(origin.shape[0]):
        dx, dy = direction[k, 0], direction[k, 1]
        x = origin[k, 0] + (first[k] - MARGIN) * dx + 0.5
        y = origin[k, 1] + (first[k] - MARGIN) * dy + 0.5
        ax, ay = -dy * ACROSS_PX, dx * ACROSS_PX
        x_end, y_end = x + n * dx, y + n * dy
        inside = (
            min(x, x_end) > 5.0
            and min(y, y_end) > 5.0
            and max(x, x_end) < columns - 5.0
            and max(y, y_end) < rows - 5.0
        )
        if inside:
            for j in range(n):
                px, py = x + j * dx, y + j * dy
                a = np.float32(grey[int(py - 2 * ay), int(px - 2 * ax)])
                b = np.float32(grey[int(py - ay), int(px - ax)])
                c = np.float32(grey[int(py), int(px)])
                d = np.float32(grey[int(py + ay), int(px + ax)])
                e = np.float32(grey[int(py + 2 * ay), int(px + 2 * ax)])
                along[j] = a + b + c + d + e
                across[j] = (d - b) + np.float32(2.0) * (e - a)
        else:
            for j in range(n):
                total = np.float32(0.0)
                slope = np.float32(0.0)
                for i in range(-2, 3):
                    row = min(max(int(np.floor(y + j * dy + i * ay)), 0), rows - 1)
                    column = min(max(int(np.floor(x + j * dx + i * ax)), 0), columns - 1)
                    value = np.float32(grey[row, column])
                    total += value
                    slope += np.float32(i) * value
                along[j] = total
                across[j] = slope
        for j in range(count):
            g = (
                (along[j + 6] - along[j])
                + np.float32(4.0) * (along[j + 5] - along[j + 1])
                + np.float32(5.0) * (along[j + 4] - along[j + 2])
            ) * np.float32(1.0 / 160.0)
            h = (
                across[j + 1]
                + across[j + 5]
                + np.float32(4.0) * (across[j + 2] + across[j + 4])
                + np.float32(6.0) * across[j + 3]
            ) * np.float32(1.0 / (160.0 * ACROSS_PX))
            size = np.sqrt(g * g + h * h)
            # An edge along the line (a side of an object) is not part of the contour.
            facing = abs(g) if polarity == 0 else polarity * g
            strength[k, j] = size if facing > np.float32(0.35) * size else np.float32(-1.0) * size


@kernel(fastmath=True, nogil=True)
def chain_minimum(cost, first, step, direction, weight, free, index):
    """Exact minimum of sum cost[k, j_k] + weight |u_{k-1} - 2 u_k + u_{k+1}|^2.

    ``u_k = (first[k] + step j_k) direction[k]``. The state is the pair of neighbouring
    positions. For given u_k and u_{k+1}, the smoothness is a single square in t_{k-1} plus a
    constant, so that the innermost loop is one multiply-add and one minimum per state.
    Up to ``free`` points at either end may be missing: they cost nothing and continue the line of the others.
    Writes the minimiser to ``index``; returns the minimum.

    Parameters
    ----------
    cost
        Cost of each position of each point, (K, n).
    first, step
        First position of each point (K,), and the distance between positions [px].
    direction
        Unit directions of the lines, (K, 2).
    weight
        Weight of the squared second differences.
    free
        Largest number of missing points at either end; two points at least remain.
    index
        Filled with the minimiser, (K,).
    """
    lines, n = cost.shape
    if lines == 1:
        index[0] = 0
        for c in range(1, n):
            if cost[0, c] < cost[0, index[0]]:
                index[0] = c
        return np.float64(cost[0, index[0]])
    padded = (n + 3) // 4 * 4
    best = np.empty((lines, n, padded), np.float32)  # [k, position on k, position on k - 1]
    best[:, :, n:] = 3e38
    for c in range(n):
        for b in range(n):
            best[1, c, b] = cost[0, b] + cost[1, c]
    low = np.empty(n, np.float32)
    behind = np.empty(padded, np.float32)
    ahead = np.empty(n, np.float32)
    w = np.float32(weight)
    root = np.float32(np.sqrt(weight))
    for k in range(2, lines):
        d01 = direction[k - 2, 0] * direction[k - 1, 0] + direction[k - 2, 1] * direction[k - 1, 1]
        d12 = direction[k, 0] * direction[k - 1, 0] + direction[k, 1] * direction[k - 1, 1]
        d02 = direction[k - 2, 0] * direction[k, 0] + direction[k - 2, 1] * direction[k, 1]
        # |u''|^2 = (t_a - 2 d01 t_b + d02 t_c)^2 + (terms without t_a)
        rbb = np.float32(4.0 * (1.0 - d01 * d01))
        rcc = np.float32(1.0 - d02 * d02)
        rbc = np.float32(4.0 * (d01 * d02 - d12))
        for a in range(padded):
            behind[a] = root * np.float32(first[k - 2] + step * a)
        for c in range(n):
            ahead[c] = first[k] + step * c
        turn = root * np.float32(d02)
        for b in range(n):
            tb = np.float32(first[k - 1] + step * b)
            back = root * np.float32(2.0 * d01) * tb
            low[:] = np.float32(3e38)
            f = best[k - 1, b]
            # Four positions at once: one load and one store of the states for four.
            for a in range(0, padded, 4):
                f0, f1, f2, f3 = f[a], f[a + 1], f[a + 2], f[a + 3]
                t0, t1 = behind[a] - back, behind[a + 1] - back
                t2, t3 = behind[a + 2] - back, behind[a + 3] - back
                for c in range(n):
                    x = turn * ahead[c]
                    e0, e1, e2, e3 = t0 + x, t1 + x, t2 + x, t3 + x
                    low[c] = min(
                        min(low[c], min(f0 + e0 * e0, f1 + e1 * e1)), min(f2 + e2 * e2, f3 + e3 * e3)
                    )
            for c in range(n):
                rest = rbb * tb * tb + rcc * ahead[c] * ahead[c] + rbc * tb * ahead[c]
                best[k, c, b] = low[c] + (w * rest + cost[k, c])
        if k <= free + 1:
            for c in range(n):
                for b in range(n):
                    best[k, c, b] = min(best[k, c, b], cost[k - 1, b] + cost[k, c])
    energy = np.float32(3e38)
    begin, end = 0, lines - 1
    for k in range(max(lines - 1 - free, 1), lines):
        for c in range(n):
            for b in range(n):
                if best[k, c, b] < energy:
                    energy = best[k, c, b]
                    end = k
                    index[k] = c
                    index[k - 1] = b
    for k in range(end, 1, -1):
        if k <= free + 1 and best[k, index[k], index[k - 1]] >= cost[k - 1, index[k - 1]] + cost[k, index[k]]:
            begin = k - 1
            break
        tb = first[k - 1] + step * index[k - 1]
        tc = first[k] + step * index[k]
        d01 = direction[k - 2, 0] * direction[k - 1, 0] + direction[k - 2, 1] * direction[k - 1, 1]
        d02 = direction[k - 2, 0] * direction[k, 0] + direction[k - 2, 1] * direction[k, 1]
        x = np.float32(tc * d02 - 2.0 * tb * d01)
        lowest = np.float32(3e38)
        for a in range(n):
            e = np.float32(first[k - 2] + step * a) + x
            value = best[k - 1, index[k - 1], a] + w * e * e
            if value < lowest:
                lowest = value
                index[k - 2] = a
    for k in range(begin - 1, -1, -1):
        ahead_px = 2.0 * (first[k + 1] + step * index[k + 1]) - first[k + 2] - step * index[k + 2]
        index[k] = min(max(int(round((ahead_px - first[k]) / step)), 0), n - 1)
    for k in range(end + 1, lines):
        ahead_px = 2.0 * (first[k - 1] + step * index[k - 1]) - first[k - 2] - step * index[k - 2]
        index[k] = min(max(int(round((ahead_px - first[k]) / step)), 0), n - 1)
    return np.float64(energy)


@kernel(fastmath=True, nogil=True)
def energy_terms(strength, first, start, stop, stride, cap, jump_scale, floor, texture, w_edge, w_jump, cost):
    """Edge and jump term of Eq. (3.6) at every ``stride``-th sample, forbidden outside the range.

    The edge term uses the strongest sample in a cell of ``stride``, so that no edge is missed at half the density.
    The jump term is integrated from the reference contour (t = 0), or from
    the adjacent end of the profile: the difference is the same for all positions.

    Parameters
    ----------
    strength
        Edge strength at samples 1 px apart, (K, m).
    first
        First sample on each line [px], (K,).
    start, stop
        Allowed range of each line [px], (K,).
    stride
        Samples per position.
    cap, floor
        Saturation limit of the edge strength, and its noise level.
    jump_scale
        Contrast of a full edge [grey levels].
    texture
        Largest edge strength of a surface without an edge, which does not count as a jump.
    w_edge, w_jump
        Weights of both terms.
    cost
        Filled, (K, n).
    """
    lines, count = strength.shape
    n = cost.shape[1]
    half = stride // 2
    passed = np.empty(count, np.float32)
    for k in range(lines):
        total = np.float32(0.0)
        for j in range(count):
            size = abs(strength[k, j])
            size = size - floor if size > texture else np.float32(0.0)
            total += size
            passed[j] = total - np.float32(0.5) * size
        zero = min(max(int(np.floor(-first[k] + 0.5)), 0), count - 1)
        for i in range(n):
            j = i * stride
            t = first[k] + j
            if t < start[k] or t > stop[k]:
                cost[k, i] = FORBIDDEN
                continue
            edge = np.float32(0.0)
            for m in range(max(j - half, 0), min(j + half + 1, count)):
                edge = max(edge, strength[k, m])
            jump = abs(passed[j] - passed[zero]) / jump_scale
            cost[k, i] = -w_edge * min(edge, cap) / cap + w_jump * jump


@kernel(fastmath=True, nogil=True)
def search(
    grey, origin, direction, start, stop, first, n, stride, polarity,
    cap, jump_scale, floor, w_edge, w_jump, weight, free, refinements,
):  # fmt: skip
    """Global optimum over the search positions ``first[k] + stride j``, j < n.

    Returns the positions (at the strongest sample of the chosen cell), their edge
    strength, the energy, and the limit of the edge strength. A limit
    of zero is replaced by the mean of the strongest samples; the limit is then set
    to the mean over the solution, ``refinements`` times.

    Parameters
    ----------
    grey, origin, direction
        As in :func:`edge_strength`.
    start, stop
        Allowed range of each line [px], (K,).
    first, n, stride
        First position of each point (K,), number of positions, and their spacing [px].
    polarity
        +1 brighter at larger t, -1 darker, 0 either.
    cap, floor
        Saturation limit of the edge strength (0: from the image), and its noise level.
    jump_scale
        Contrast of a full edge [grey levels].
    w_edge, w_jump, weight
        Weights of edge, jump and smoothness.
    free
        Largest number of missing points at either end.
    refinements
        How many times the limit is set to the mean over the solution.
    """
    lines = origin.shape[0]
    count = stride * (n - 1) + 1
    strength = np.empty((lines, count), np.float32)
    edge_strength(grey, origin, direction, first, count, polarity, strength)
    if cap <= 0.0:
        total = 0.0
        for k in range(lines):
            top = np.float32(0.0)
            for j in range(count):
                top = max(top, strength[k, j])
            total += top
        cap = total / lines
    size, work = np.empty(lines * count, np.float32), np.empty(lines * count, np.float32)
    for k in range(lines):
        for j in range(count):
            size[k * count + j] = abs(strength[k, j])
    texture = max(TEXTURE * median(size, len(size), work), floor)
    cap = max(cap, 2.0 * floor, 1e-3)
    cost = np.empty((lines, n), np.float32)
    index = np.zeros(lines, np.int64)
    position = np.empty(lines)
    found = np.empty(lines)
    energy = 0.0
    for turn in range(refinements + 1):
        scale = jump_scale if jump_scale > 0.0 else 4.0 * cap
        energy_terms(
            strength, first, start, stop, stride, np.float32(cap), np.float32(scale), np.float32(floor),
            np.float32(texture), np.float32(w_edge), np.float32(w_jump), cost,
        )  # fmt: skip
        energy = chain_minimum(cost, first, float(stride), direction, weight, free, index)
        total = 0.0
        for k in range(lines):
            middle = index[k] * stride
            best = middle
            for j in range(max(middle - stride // 2, 0), min(middle + stride // 2 + 1, count)):
                if strength[k, j] > strength[k, best]:
                    best = j
            position[k] = first[k] + best
            found[k] = max(strength[k, best], np.float32(0.0))
            total += found[k]
        if turn < refinements:
            cap = max(total / lines, 2.0 * floor, 1e-3)
    return position, found, energy, cap
