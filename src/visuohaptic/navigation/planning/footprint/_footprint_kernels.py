"""Kernels for a polygonal robot on a grid: swept outlines against occupied cells, and paths over (place, heading).

Lengths are in cells; points are (x, y), and cell (row, column) covers ``column..column + 1`` by ``row..row + 1``.
``counts`` has the number of occupied cells before each column of a row, so that a run of cells is tested in one step.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ..search._travel_kernels import FAR

#: Rounding tolerance of coordinates: a robot that touches the border of a cell does not collide [cells].
SLACK = 1e-6
#: Maximum angle of one part of a turn, about 3 degrees.
TURN_STEP = 0.05


@kernel
def hull_runs(points):
    """Cells whose interior overlaps the convex hull of points: row, first column, column after the last."""
    n = len(points)
    low, high = np.inf, -np.inf
    for i in range(n):
        low, high = min(low, points[i, 1]), max(high, points[i, 1])
    top = int(math.floor(low + SLACK))
    rows = max(int(math.ceil(high - SLACK)) - top, 0)
    runs = np.zeros((rows, 3), np.int64)
    for k in range(rows):
        y0, y1 = float(top + k), top + k + 1.0
        first, last = np.inf, -np.inf
        # The hull in a strip extends as far as the segments between any two points.
        for i in range(n):
            for j in range(i, n):
                ax, ay, bx, by = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
                if ay > by:
                    ax, ay, bx, by = bx, by, ax, ay
                if by < y0 or ay > y1:
                    continue
                if by - ay > 0.0:
                    slope = (bx - ax) / (by - ay)
                    if by > y1:
                        bx = ax + slope * (y1 - ay)
                    if ay < y0:
                        ax = ax + slope * (y0 - ay)
                first, last = min(first, ax, bx), max(last, ax, bx)
        runs[k, 0] = top + k
        runs[k, 1], runs[k, 2] = int(math.floor(first + SLACK)), int(math.ceil(last - SLACK))
    return runs


@kernel
def runs_clear(counts, runs, first, end, column, row):
    """Whether runs ``first..end``, shifted by whole cells, are inside the map and contain no occupied cell."""
    rows, columns = counts.shape
    for k in range(first, end):
        r, a, b = runs[k, 0] + row, runs[k, 1] + column, runs[k, 2] + column
        if r < 0 or r >= rows or a < 0 or b >= columns or counts[r, b] != counts[r, a]:
            return False
    return True


@kernel
def turned(outline, x, y, angle, grow):
    """The outline at a pose, scaled about its origin."""
    c, s = grow * math.cos(angle), grow * math.sin(angle)
    placed = np.empty_like(outline)
    for i in range(len(outline)):
        placed[i, 0] = x + c * outline[i, 0] - s * outline[i, 1]
        placed[i, 1] = y + s * outline[i, 0] + c * outline[i, 1]
    return placed


@kernel
def hull_clear(counts, one, other):
    """Whether the convex hull of two outlines overlaps no occupied cell."""
    n = len(one)
    points = np.empty((2 * n, 2))
    for i in range(n):
        points[i, 0], points[i, 1] = one[i, 0], one[i, 1]
        points[n + i, 0], points[n + i, 1] = other[i, 0], other[i, 1]
    runs = hull_runs(points)
    return runs_clear(counts, runs, 0, len(runs), 0, 0)


@kernel
def turn_clear(counts, outline, x, y, begin, end):
    """Whether a turn on the spot, in the direction of the sign of ``end - begin``, sweeps no occupied cell.

    Corners move on arcs: scaled by 1 / cos(half of a part's angle), their chord is a tangent of the arc.
    """
    parts = max(1, int(math.ceil(abs(end - begin) / TURN_STEP)))
    part = (end - begin) / parts
    grow = 1.0 / math.cos(0.5 * part)
    for k in range(parts):
        a = begin + k * part
        if not hull_clear(counts, turned(outline, x, y, a, grow), turned(outline, x, y, a + part, grow)):
            return False
    return True


@kernel
def shorter_turn(begin, end):
    """Angle of the shorter turn between two headings, in [-pi, pi)."""
    return (end - begin + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def poses_clear(counts, outline, path, begin, end):
    """Whether a robot that starts at a heading drives along a path, turning the shorter way at its corners, and ends at one.

    NaN: any heading. At nearly half a turn both directions must be free.
    """
    heading = begin
    for k in range(len(path)):
        x, y = path[k, 0], path[k, 1]
        last = k + 1 == len(path)
        following = end if last else math.atan2(path[k + 1, 1] - y, path[k + 1, 0] - x)
        if not math.isnan(heading) and not math.isnan(following):
            turn = shorter_turn(heading, following)
            if not turn_clear(counts, outline, x, y, heading, heading + turn):
                return False
            if abs(turn) > 3.1 and not turn_clear(
                counts, outline, x, y, heading, heading + turn - math.copysign(2.0 * math.pi, turn)
            ):
                return False
        if last:
            break
        heading = following
        before = turned(outline, x, y, heading, 1.0)
        if not hull_clear(counts, before, turned(outline, path[k + 1, 0], path[k + 1, 1], heading, 1.0)):
            return False
    return True


@kernel
def free_drive(counts, outline, x, y, heading, limit):
    """Length up to ``limit`` that a robot can drive straight ahead, in steps of half a cell; negative if it does not fit."""
    at = turned(outline, x, y, heading, 1.0)
    if not hull_clear(counts, at, at):
        return -1.0
    length = 0.0
    while length < limit:
        ahead = min(length + 0.5, limit)
        after = turned(outline, x + ahead * math.cos(heading), y + ahead * math.sin(heading), heading, 1.0)
        if not hull_clear(counts, at, after):
            break
        at, length = after, ahead
    return length


@kernel
def _queue(heap, used, key, state):
    """Add an entry to a binary heap with ``used`` entries; returns the heap, a larger copy where it was full."""
    if used == len(heap):
        larger = np.empty((2 * used, 2), np.int64)
        for i in range(used):
            larger[i, 0], larger[i, 1] = heap[i, 0], heap[i, 1]
        heap = larger
    at = used
    while at > 0:
        above = (at - 1) // 2
        if heap[above, 0] <= key:
            break
        heap[at, 0], heap[at, 1] = heap[above, 0], heap[above, 1]
        at = above
    heap[at, 0], heap[at, 1] = key, state
    return heap


@kernel
def _unqueue(heap, used):
    """Remove the first of ``used`` entries of a binary heap."""
    key, state = heap[used - 1, 0], heap[used - 1, 1]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= used - 1:
            break
        if below + 1 < used - 1 and heap[below + 1, 0] < heap[below, 0]:
            below += 1
        if heap[below, 0] >= key:
            break
        heap[at, 0], heap[at, 1] = heap[below, 0], heap[below, 1]
        at = below
    heap[at, 0], heap[at, 1] = key, state


@kernel
def lattice_path(
    counts, outline, price, to_go, moves, angles, runs, starts, place, seeds, seed_costs, goal, turn_price,
):  # fmt: skip
    """A* over (node, heading): steps forwards along a heading and turns to the next one, each with its swept outline.

    Parameters
    ----------
    counts, outline
        Occupied cells before each column; corners of the robot at heading 0 [cells].
    price
        Cost per unit of length at each node of the lattice; 0 where the robot's centre cannot be.
    to_go
        Estimated cost from each node to the goal, without turns; :data:`FAR` where there is no way.
    moves, angles
        Steps (column, row) of each heading [nodes], and the headings [rad].
    runs, starts
        Cells swept by the step of each heading and by the turn from each to the next, from the node's cell.
    place
        x, y of the first node, and distance of nodes, whole cells [cells].
    seeds, seed_costs
        Start states (node * headings + heading) and their costs.
    goal
        x, y [cells], heading at the goal [rad] (NaN: any), and the distance from which it is approached straight [cells].
    turn_price
        Cost of a turn by one radian.

    Returns
    -------
    The states of the path from its end to its start, empty without one.
    """
    rows, columns = price.shape
    count = len(angles)
    spent = np.full(rows * columns * count, FAR, np.int32)
    parent = np.full(rows * columns * count, -1, np.int32)
    heap = np.empty((1024, 2), np.int64)
    used = 0
    for i in range(len(seeds)):
        spent[seeds[i]] = seed_costs[i]
        heap = _queue(heap, used, seed_costs[i] + to_go[seeds[i] // count], seeds[i])
        used += 1
    ends = np.empty((2, 2))
    while used > 0:
        key, state = heap[0, 0], heap[0, 1]
        _unqueue(heap, used)
        used -= 1
        node, heading = state // count, state % count
        cost = int(spent[state])
        if key > cost + to_go[node]:
            continue
        row, column = node // columns, node % columns
        x, y = place[0] + column * place[2], place[1] + row * place[2]
        gap = math.hypot(goal[0] - x, goal[1] - y)
        ahead = angles[heading]
        if gap > 1e-9:
            ahead = math.atan2(goal[1] - y, goal[0] - x)
        if gap <= goal[3] and abs(shorter_turn(angles[heading], ahead)) < 0.5:
            ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1] = x, y, goal[0], goal[1]
            if poses_clear(counts, outline, ends[0 if gap > 1e-9 else 1 :], angles[heading], goal[2]):
                path = np.empty(spent.size, np.int64)
                length = 0
                while state >= 0:
                    path[length] = state
                    length += 1
                    state = parent[state]
                return path[:length].copy()
        for k in range(3):  # ahead, and a turn to either side
            if k == 0:
                r, c = row + moves[heading, 1], column + moves[heading, 0]
                if r < 0 or c < 0 or r >= rows or c >= columns or price[r, c] <= 0.0:
                    continue
                onto, other, swept = r * columns + c, heading, heading
                mean = 0.5 * (price[row, column] + price[r, c])
                new = cost + int(math.hypot(moves[heading, 0], moves[heading, 1]) * mean + 0.5)
            else:
                onto, other = node, (heading + (1 if k == 1 else count - 1)) % count
                swept = count + (heading if k == 1 else other)
                new = cost + int(abs(shorter_turn(angles[heading], angles[other])) * turn_price + 0.5)
            following = onto * count + other
            if new >= spent[following] or to_go[onto] >= FAR:
                continue
            at_column = int(math.floor(place[0])) + column * int(place[2])
            at_row = int(math.floor(place[1])) + row * int(place[2])
            if not runs_clear(counts, runs, starts[swept], starts[swept + 1], at_column, at_row):
                continue
            parent[following], spent[following] = state, new
            heap = _queue(heap, used, new + to_go[onto], following)
            used += 1
    return np.empty(0, np.int64)
