"""From lines to a raw graph: junction cells of one decision are merged into one node, and lines are extended to it.

Works only on the slots of ``_line_kernels`` and copies no paths: an edge is defined by its two slots and
its line, and :func:`edge_paths` writes the cells of all edges on request.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ._line_kernels import BITS
from ._path_kernels import cost, longer


@kernel(error_model="numpy")
def gather_junctions(
    cell: np.ndarray,
    masks: np.ndarray,
    keys: np.ndarray,
    links: np.ndarray,
    widest: np.ndarray,
    columns: int,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Leader of each slot, the next slot on the path to it (-1 for leaders), and that path's measures.

    In descending order of keys, a node absorbs the junction cells that are linked to
    it through others, up to a distance of its own clearance (at least the adjacent cells).
    Measures (slots, 3): length [m], cost [s], clearance [m].

    Parameters
    ----------
    cell, masks, keys, links
        The slots: flat cell, linked neighbours, clearance and links; see the module.
    widest
        Slots with three or more links by descending key; among equal keys the first cell leads.
    columns
        Number of columns of the map.
    resolution_m
        Edge length of a cell [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    owner = np.full(len(cell), -1, np.int32)
    parent = np.full(len(cell), -1, np.int32)
    to_leader = np.zeros((len(cell), 3))
    queue = np.empty(len(cell) + 1, np.int32)
    for slot in range(len(cell)):
        to_leader[slot, 2] = keys[slot]
        owner[slot] = slot
        if BITS[masks[slot]] < 3:
            continue
        for j in range(8):
            other = -2 - links[slot, j]
            if other >= 0 and BITS[masks[other]] >= 3:
                owner[slot] = -1  # it may belong to another leader
                break
    for leader in widest:
        if owner[leader] >= 0:
            continue
        owner[leader] = leader
        row, column = cell[leader] // columns, cell[leader] % columns
        reach = max(float(keys[leader]) / resolution_m, 1.5)
        queue[0] = leader
        head, tail = 0, 1
        while head < tail:
            here = queue[head]
            head += 1
            for j in range(8):
                other = -2 - links[here, j]
                if other < 0 or owner[other] >= 0 or BITS[masks[other]] < 3:
                    continue
                r, c = cell[other] // columns, cell[other] % columns
                if (r - row) ** 2 + (c - column) ** 2 > reach * reach:
                    continue
                owner[other] = leader
                parent[other] = here
                length, seconds = _step(keys[here], keys[other], j, resolution_m, speeds)
                to_leader[other, 0] = to_leader[here, 0] + length
                to_leader[other, 1] = to_leader[here, 1] + seconds
                to_leader[other, 2] = min(to_leader[here, 2], float(keys[other]))
                queue[tail] = other
                tail += 1
    return owner, parent, to_leader


@kernel(error_model="numpy")
def _step(
    here: float, there: float, direction: int, resolution_m: float, speeds: np.ndarray
) -> tuple[float, float]:
    """Length [m] and cost [s] of a step between neighbouring cells with these distances."""
    length = resolution_m * (math.sqrt(2.0) if direction & 1 else 1.0)
    return length, 0.5 * length * (cost(here, speeds) + cost(there, speeds))


@kernel(error_model="numpy")
def join_lines(
    distance: np.ndarray,
    cell: np.ndarray,
    masks: np.ndarray,
    keys: np.ndarray,
    links: np.ndarray,
    owner: np.ndarray,
    parent: np.ndarray,
    to_leader: np.ndarray,
    table: np.ndarray,
    measured: np.ndarray,
    rings: np.ndarray,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Cells of the nodes (n,), their clearance, ends of the edges (m, 2), their measures (m, 3), and pieces (m, 4).

    Last are n and m: the arrays are longer, and the caller shortens them, since a slice takes long to compile. A piece consists of first and last slot, and start and stop of the inner cells in the lines' path;
    the slots of a ring are -1.

    Parameters
    ----------
    distance
        Clearance of each cell [m], (rows, columns) float32.
    cell, masks, keys, links
        The slots: flat cell, linked neighbours, clearance and links; see the module.
    owner, parent, to_leader
        From :func:`gather_junctions`.
    table
        The lines, see the module.
    table, measured
        The lines: first and last cell and index in ``path``; length, cost and clearance.
    rings
        Lines that are rings, by ascending cell.
    resolution_m
        Edge length of a cell [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    # Every edge uses two links; the arrays have exactly this size, because first access to memory is slow.
    taken = 0
    for slot in range(len(cell)):
        taken += BITS[masks[slot]]
    room = taken // 2 + len(rings) + 1
    ends = np.empty((room, 2), np.int32)
    measures = np.empty((room, 3))
    pieces = np.empty((room, 4), np.int32)
    flat_distance = distance.ravel()
    edges = 0
    for first in range(len(cell)):
        for j in range(8):
            link = links[first, j]
            if link == -1 or (link >= 0 and link & 1):
                continue  # no line, or extended from its other end
            if link >= 0:
                line = link >> 1
                last = table[line, 4]
                pieces[edges, 2], pieces[edges, 3] = table[line, 2] + 1, table[line, 3] - 1
                length, seconds, clearance = measured[line, 0], measured[line, 1], measured[line, 2]
            else:
                last = -2 - link
                if cell[last] < cell[first] or parent[last] == first or parent[first] == last:
                    continue
                pieces[edges, 2], pieces[edges, 3] = 0, 0
                length, seconds = _step(keys[first], keys[last], j, resolution_m, speeds)
                clearance = min(float(keys[first]), float(keys[last]))
            pieces[edges, 0], pieces[edges, 1] = first, last
            ends[edges, 0], ends[edges, 1] = owner[first], owner[last]
            measures[edges, 0] = length + to_leader[first, 0] + to_leader[last, 0]
            measures[edges, 1] = seconds + to_leader[first, 1] + to_leader[last, 1]
            measures[edges, 2] = min(clearance, min(to_leader[first, 2], to_leader[last, 2]))
            edges += 1
    # Nodes in the order of their cells; ``number`` maps a leader to its node.
    nodes = np.empty(len(cell) + len(rings), np.int32)
    clear = np.empty(len(cell) + len(rings), np.float32)
    number = np.empty(len(cell), np.int32)
    n, k = 0, 0
    joined = edges
    for position in range(len(cell) + 1):
        slot = position if position < len(cell) else -1
        if slot >= 0 and owner[slot] != slot:
            continue
        while k < len(rings) and (slot < 0 or table[rings[k], 1] < cell[slot]):
            line = rings[k]
            nodes[n], clear[n] = table[line, 1], flat_distance[table[line, 1]]
            pieces[edges, 0], pieces[edges, 1] = -1, -1
            pieces[edges, 2], pieces[edges, 3] = table[line, 2], table[line, 3]
            for side in range(3):
                measures[edges, side] = measured[line, side]
            ends[edges, 0] = ends[edges, 1] = n
            edges += 1
            n += 1
            k += 1
        if slot >= 0:
            nodes[n], clear[n] = cell[slot], keys[slot]
            number[slot] = n
            n += 1
    for edge in range(joined):
        ends[edge, 0], ends[edge, 1] = number[ends[edge, 0]], number[ends[edge, 1]]
    return nodes, clear, ends, measures, pieces, n, edges


@kernel(error_model="numpy")
def edge_paths(
    edge_start: np.ndarray,
    halves: np.ndarray,
    pieces: np.ndarray,
    cell: np.ndarray,
    parent: np.ndarray,
    path: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Cells (flat) of edges from node to node, in CSR form, and their number: the array is longer.

    Edge e consists of the half-edges ``halves[edge_start[e] : edge_start[e + 1]]`` of the raw graph, 2 r for piece r
    in its own direction, 2 r + 1 for piece r reversed.

    Parameters
    ----------
    edge_start, halves
        Half-edges of each edge in CSR form.
    pieces
        Edges of the raw graph, from :func:`join_lines`.
    cell
        Flat cell of each slot.
    parent
        From :func:`gather_junctions`.
    path
        Concatenated cells (flat) of all lines.
    """
    count = len(edge_start) - 1
    start = np.zeros(count + 1, np.int32)
    out = np.empty(4096, np.int32)
    size = 0
    for edge in range(count):
        begin = size
        for k in range(edge_start[edge], edge_start[edge + 1]):
            piece = pieces[halves[k] >> 1]
            inner = piece[3] - piece[2]
            room = size + inner
            for side in range(2):
                here = piece[side]
                while here != -1:
                    room += 1
                    here = parent[here]
            while room > len(out):
                out = longer(out)
            if size > begin:
                size -= 1  # the common cell of two pieces
            low = size
            here = piece[0]
            while here != -1:
                out[size] = cell[here]
                size += 1
                here = parent[here]
            _reverse(out, low, size)
            for position in range(piece[2], piece[3]):
                out[size] = path[position]
                size += 1
            here = piece[1]
            while here != -1:
                out[size] = cell[here]
                size += 1
                here = parent[here]
            if halves[k] & 1:
                _reverse(out, low, size)
        start[edge + 1] = size
    return start, out, size


@kernel(error_model="numpy")
def _reverse(path: np.ndarray, begin: int, end: int) -> None:
    low, high = begin, end - 1
    while low < high:
        path[low], path[high] = path[high], path[low]
        low += 1
        high -= 1
