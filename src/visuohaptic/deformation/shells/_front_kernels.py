"""Kernels of the ordering and of the multifrontal factor (:mod:`.ordering`, :mod:`.factor`)."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def split(
    nodes: np.ndarray,
    label: np.ndarray,
    mark: int,
    points: np.ndarray,
    middle: np.ndarray,
    extent: np.ndarray,
    starts: np.ndarray,
    neighbours: np.ndarray,
    side: np.ndarray,
) -> bool:
    """Bisect a part with the smallest separator among cuts across x, y and z.

    ``label[n] == mark`` for the part's nodes; ``middle`` and ``extent`` (3,) are median and size of the part.
    Fills ``side`` (0 below, 1 above, 2 separator) for
    them and returns whether a cut was found.
    """
    count = nodes.size
    best = np.inf
    chosen = np.zeros(count, dtype=np.int8)
    trial = np.zeros(count, dtype=np.int8)
    found = False
    for axis in range(3):
        if extent[axis] <= 0:
            continue
        # Nodes of a row of a structured mesh share a coordinate up to rounding: never cut through a row.
        for sign in (-1.0, 1.0):
            limit = middle[axis] + sign * 1e-7 * extent[axis]
            below = 0
            for i in range(count):
                side[nodes[i]] = 0 if points[nodes[i], axis] < limit else 1
                below += side[nodes[i]] == 0
            if below == 0 or below == count:
                continue
            for upper in range(2):
                separator = 0
                for i in range(count):
                    node = nodes[i]
                    trial[i] = side[node]
                    if side[node] != upper:
                        continue
                    for j in range(starts[node], starts[node + 1]):
                        other = neighbours[j]
                        if label[other] == mark and side[other] != upper:
                            trial[i] = 2
                            separator += 1
                            break
                small = min(below - (upper == 0) * separator, count - below - (upper == 1) * separator)
                cost = (separator + 1.0) * (1.0 + 0.5 * abs(count - separator - 2 * small) / count)
                if small > 0 and cost < best:
                    best, found = cost, True
                    for i in range(count):
                        chosen[i] = trial[i]
    for i in range(count):
        side[nodes[i]] = chosen[i]
    return found


@kernel
def borders(
    order: np.ndarray, first: np.ndarray, starts: np.ndarray, neighbours: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Border nodes of every front, as positions in the elimination order (unsorted), and each front's parent."""
    fronts = first.size - 1
    place = np.empty(order.size, dtype=np.int64)
    owner = np.empty(order.size, dtype=np.int64)
    for f in range(fronts):
        for i in range(first[f], first[f + 1]):
            place[order[i]] = i
            owner[i] = f
    parent = np.full(fronts, -1, dtype=np.int64)
    child = np.full(fronts, -1, dtype=np.int64)
    sibling = np.full(fronts, -1, dtype=np.int64)
    seen = np.full(order.size, -1, dtype=np.int64)
    offset = np.zeros(fronts + 1, dtype=np.int64)
    found = np.empty(max(64, 8 * order.size), dtype=np.int64)
    used = 0
    for f in range(fronts):
        begin = used
        end = first[f + 1]
        if used + order.size > found.size:
            grown = np.empty(2 * found.size + order.size, dtype=np.int64)
            for i in range(used):
                grown[i] = found[i]
            found = grown
        for i in range(first[f], end):
            node = order[i]
            for j in range(starts[node], starts[node + 1]):
                other = place[neighbours[j]]
                if other >= end and seen[other] != f:
                    seen[other] = f
                    found[used] = other
                    used += 1
        c = child[f]
        while c >= 0:
            for j in range(offset[c], offset[c + 1]):
                other = found[j]
                if other >= end and seen[other] != f:
                    seen[other] = f
                    found[used] = other
                    used += 1
            c = sibling[c]
        offset[f + 1] = used
        if used > begin:
            nearest = found[begin]
            for j in range(begin, used):
                nearest = min(nearest, found[j])
            p = owner[nearest]
            parent[f] = p
            sibling[f] = child[p]
            child[p] = f
    return place, owner, parent, offset, found[:used].copy()


@kernel
def local_places(
    items: np.ndarray,
    item_front: np.ndarray,
    first: np.ndarray,
    offset: np.ndarray,
    border: np.ndarray,
    total: int,
) -> np.ndarray:
    """Local index of each of the positions in ``items`` (k, m) among pivots and border of its front.

    Items must come sorted by ``item_front``; a position of -1 stays -1.
    """
    out = np.full(items.shape, -1, dtype=np.int64)
    where = np.full(total, -1, dtype=np.int64)
    last = -1
    for k in range(items.shape[0]):
        f = item_front[k]
        if f != last:
            pivots = first[f + 1] - first[f]
            for j in range(pivots):
                where[first[f] + j] = j
            for j in range(offset[f], offset[f + 1]):
                where[border[j]] = pivots + j - offset[f]
            last = f
        for m in range(items.shape[1]):
            if items[k, m] >= 0:
                out[k, m] = where[items[k, m]]
    return out


@kernel
def add_blocks(
    f11: np.ndarray,
    f21: np.ndarray,
    f22: np.ndarray,
    f12: np.ndarray,
    block: np.ndarray,
    places: np.ndarray,
    size: int,
    full: bool,
) -> None:
    """Add an array whose rows belong to local nodes ``places`` (``size`` rows each) to a front; all transposed.

    Transposed, the blocks of a front are in the order of C, whatever their size. The array belongs to an element, or
    to a child front (extend-add). Only the lower triangle, with whole nodes on the diagonal, when not ``full``: a
    child's places ascend, so nothing is read above the nodes on the diagonal of its update, and what is
    above the diagonal inside these is never used.
    """
    split_at = f11.shape[0]
    for b in range(places.size):
        column = places[b] * size
        inside = column < split_at
        if not inside:
            column -= split_at
        above, under = (f11, f21) if inside else (f12, f22)
        for a in range(places.size):
            row = places[a] * size
            if places[a] < places[b] and not full:
                continue
            if row < split_at:
                for j in range(size):
                    for i in range(size):
                        above[column + j, row + i] += block[size * b + j, size * a + i]
            else:
                row -= split_at
                for j in range(size):
                    for i in range(size):
                        under[column + j, row + i] += block[size * b + j, size * a + i]


@kernel
def add_elements(
    f11: np.ndarray,
    f21: np.ndarray,
    f22: np.ndarray,
    f12: np.ndarray,
    matrices: np.ndarray,
    elements: np.ndarray,
    places: np.ndarray,
    size: int,
    full: bool,
) -> None:
    """:func:`add_blocks` for several elements, whose matrices are not transposed."""
    for k in range(elements.size):
        add_blocks(f11, f21, f22, f12, matrices[elements[k]].T, places[k], size, full)


@kernel
def add_rows(
    top: np.ndarray,
    bottom: np.ndarray,
    values: np.ndarray,
    places: np.ndarray,
    columns: np.ndarray,
    size: int,
) -> None:
    """Add a child's right-hand sides (rows by local nodes ``places``) to pivots and border; all transposed."""
    split_at = top.shape[1]
    for q in range(values.shape[0]):
        column = columns[q]
        for a in range(places.size):
            for i in range(size):
                row = places[a] * size + i
                if row < split_at:
                    top[column, row] += values[q, size * a + i]
                else:
                    bottom[column, row - split_at] += values[q, size * a + i]


@kernel
def constrain(matrices: np.ndarray, faces: np.ndarray, fixed: np.ndarray) -> None:
    """Zero the rows and columns of fixed degrees of freedom in element matrices (e, s k, s k), in place."""
    corners = faces.shape[1]
    size = fixed.shape[1]
    for e in range(faces.shape[0]):
        for a in range(corners):
            for i in range(size):
                if fixed[faces[e, a], i]:
                    row = size * a + i
                    for q in range(corners * size):
                        matrices[e, row, q] = 0.0
                        matrices[e, q, row] = 0.0
