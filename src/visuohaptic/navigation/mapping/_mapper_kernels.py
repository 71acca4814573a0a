"""Kernels of the occupancy mapper: ray casting into a grid, and matching of scan points with the points of a grid.

Grid coordinates: cell (i, j) covers rows i..i+1 and columns j..j+1. All
lengths are in cells.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel


@kernel
def add_beams(log_odds, stamp, number, start_row, start_column, ends, hits, hit, miss, bound):
    """Add one scan to the log-odds, in place; each cell changes once per scan, and hits take precedence.

    ``ends`` (n, 2): end points of the beams (row, column); ``hits``: whether there was
    an echo; ``stamp``: int32 grid with the number of the last scan that
    changed a cell.

    Parameters
    ----------
    log_odds
        The map, (rows, columns).
    stamp
        Number of the last scan that changed each cell, (rows, columns) int32.
    number
        Number of this scan.
    start_row, start_column
        Position of the scanner [cells].
    ends
        End points of the beams (row, column) [cells], (n, 2).
    hits
        Whether a beam had an echo (n,).
    hit, miss
        Log-odds increments of cells where a beam ends and of cells that it passes.
    bound
        Maximum magnitude of the log-odds.
    """
    rows, columns = log_odds.shape
    for beam in range(len(ends)):
        if hits[beam]:
            i, j = int(math.floor(ends[beam, 0])), int(math.floor(ends[beam, 1]))
            if 0 <= i < rows and 0 <= j < columns and stamp[i, j] != number:
                stamp[i, j] = number
                log_odds[i, j] = min(log_odds[i, j] + hit, bound)
    for beam in range(len(ends)):
        dr, dc = ends[beam, 0] - start_row, ends[beam, 1] - start_column
        i, j = int(math.floor(start_row)), int(math.floor(start_column))
        step_i, step_j = (1 if dr > 0 else -1), (1 if dc > 0 else -1)
        per_i = abs(1.0 / dr) if dr != 0.0 else np.inf
        per_j = abs(1.0 / dc) if dc != 0.0 else np.inf
        next_i = (i + (1 if dr > 0 else 0) - start_row) / dr if dr != 0.0 else np.inf
        next_j = (j + (1 if dc > 0 else 0) - start_column) / dc if dc != 0.0 else np.inf
        last_i, last_j = int(math.floor(ends[beam, 0])), int(math.floor(ends[beam, 1]))
        passed = 0.0
        while passed < 1.0 and 0 <= i < rows and 0 <= j < columns:
            if i == last_i and j == last_j:
                break
            if stamp[i, j] != number:
                stamp[i, j] = number
                log_odds[i, j] = max(log_odds[i, j] + miss, -bound)
            if next_i < next_j:
                passed = next_i
                next_i += per_i
                i += step_i
            else:
                passed = next_j
                next_j += per_j
                j += step_j


@kernel
def correlate(field, points, rows, columns, cosines, sines):
    """Mean of ``field`` at the points, for every shift and rotation: (rotations, rows, columns).

    ``points`` (n, 2) as (row, column) about the centre of rotation; ``rows`` and
    ``columns`` are the candidate positions of that centre in the grid.

    Parameters
    ----------
    field
        Score of each cell, (rows, columns).
    points
        Hits (row, column) about the centre of rotation [cells], (n, 2).
    rows, columns
        Candidate positions of that centre [cells].
    cosines, sines
        Cosines and sines of the candidate rotations.
    """
    high, wide = field.shape
    result = np.zeros((len(cosines), len(rows), len(columns)), dtype=np.float32)
    for turn in range(len(cosines)):
        c, s = cosines[turn], sines[turn]
        for point in range(len(points)):
            r = c * points[point, 0] + s * points[point, 1]
            q = c * points[point, 1] - s * points[point, 0]
            for a in range(len(rows)):
                i = int(math.floor(r + rows[a]))
                if i < 0 or i >= high:
                    continue
                for b in range(len(columns)):
                    j = int(math.floor(q + columns[b]))
                    if 0 <= j < wide:
                        result[turn, a, b] += field[i, j]
        for a in range(len(rows)):
            for b in range(len(columns)):
                result[turn, a, b] /= len(points)
    return result


@kernel
def nearest_lines(mean_row, mean_column, count, points, reach):
    """For every point the nearest mean of a cell and the normal of the means around it.

    ``mean_row``, ``mean_column``: mean position of the hits in a cell where
    ``count`` > 0. Returns (n, 5): row and column of the mean, normal (row,
    column), and a weight: 0 without a mean within reach, -1 where the means do not form a line.

    Parameters
    ----------
    mean_row, mean_column
        Mean position of the hits in each cell [cells], (rows, columns).
    count
        Number of hits in each cell.
    points
        Hits (row, column) [cells], (n, 2).
    reach
        Search radius for means [cells].
    """
    rows, columns = count.shape
    result = np.zeros((len(points), 5))
    for p in range(len(points)):
        i, j = int(math.floor(points[p, 0])), int(math.floor(points[p, 1]))
        if i < reach or j < reach or i >= rows - reach or j >= columns - reach:
            continue
        best = 1e18
        bi, bj = -1, -1
        for a in range(i - reach, i + reach + 1):
            for b in range(j - reach, j + reach + 1):
                if count[a, b] > 0:
                    d = (mean_row[a, b] - points[p, 0]) ** 2 + (mean_column[a, b] - points[p, 1]) ** 2
                    if d < best:
                        best, bi, bj = d, a, b
        if bi < 2 or bj < 2 or bi >= rows - 2 or bj >= columns - 2:
            continue
        result[p, 4] = -1.0
        n, sr, sc, srr, scc, src = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for a in range(bi - 2, bi + 3):
            for b in range(bj - 2, bj + 3):
                if count[a, b] > 0:
                    r, c = mean_row[a, b] - bi, mean_column[a, b] - bj
                    n += 1.0
                    sr += r
                    sc += c
                    srr += r * r
                    scc += c * c
                    src += r * c
        if n < 3.0:
            continue
        vrr, vcc, vrc = srr / n - (sr / n) ** 2, scc / n - (sc / n) ** 2, src / n - sr * sc / n**2
        middle, half = 0.5 * (vrr + vcc), math.sqrt(0.25 * (vrr - vcc) ** 2 + vrc**2)
        small, large = max(middle - half, 0.0), middle + half
        # A line: long in one direction and thin in the other.
        if large < 0.3 or small > 0.25 * large:
            continue
        angle = 0.5 * math.atan2(2.0 * vrc, vrr - vcc) + 0.5 * math.pi
        result[p, 0], result[p, 1] = mean_row[bi, bj], mean_column[bi, bj]
        result[p, 2], result[p, 3] = math.cos(angle), math.sin(angle)
        result[p, 4] = 1.0 - small / large
    return result
