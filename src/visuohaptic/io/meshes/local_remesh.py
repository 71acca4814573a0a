"""Local remeshing of triangle meshes for computation: simplification, refinement, removal of slivers.

Every step is local and processes many edges at once that share no triangle. Edges are collapsed if the planes
of the replaced triangles are preserved (quadric error, Garland and Heckbert 1997), split along the curve
given by the vertex normals (PN triangles, Vlachos et al. 2001), and flipped where the surface is flat, so
that grooves, rims and creases are preserved.

Symbols: v vertices, f triangles, e edges. Edges are sorted pairs of vertices.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import POSITIVE, check_numbers
from ...core.geometry import area_vectors, vertex_normals
from . import _collapse_kernels as kernels

#: Minimum angle of a crease [rad]. A cylindrical wall with at least 12 facets is smooth.
CREASE_rad = np.radians(31.0)
#: Maximum number of flip passes; each flips at least one edge, and the largest angles only decrease.
MAX_PASSES = 60

_Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def mesh_edges(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "f 3"], Int[np.ndarray, "e"]]:
    """Edges of a mesh.

    Parameters
    ----------
    faces
        Triangles.

    Returns
    -------
    tuple
        Edges, the index of the edge opposite to each corner of each triangle, and the number of triangles at each edge.
    """
    count = int(faces.max()) + 1
    sides = faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    key, inverse, times = np.unique(
        sides.min(axis=1) * count + sides.max(axis=1), return_inverse=True, return_counts=True
    )
    return np.stack([key // count, key % count], axis=1), inverse.reshape(-1, 3), times


def largest_angles(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f"]:
    """Largest angle of each triangle [rad].

    Parameters
    ----------
    vertices
        Vertices in any unit.
    faces
        Triangles.
    """
    corner = vertices[faces]
    square = np.stack(
        [np.einsum("fi,fi->f", d, d) for d in (corner[:, (k + 2) % 3] - corner[:, (k + 1) % 3] for k in range(3))],
        axis=1,
    )  # fmt: skip
    a, b, c = np.sort(square, axis=1).T
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = (a + b - c) / (2 * np.sqrt(a * b))
    return np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1, 1))


def orient_faces(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """Orient triangles consistently with their neighbours.

    Parameters
    ----------
    faces
        Triangles; every edge has at most two of them.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    _edges, opposite, times = mesh_edges(faces)
    inner = times == 2
    order = np.argsort(opposite.ravel(), kind="stable")
    pair = order[inner[opposite.ravel()[order]]].reshape(-1, 2)
    corner = pair % 3
    first = faces[pair // 3, (corner + 1) % 3]  # start vertex of the edge in each triangle
    agrees = first[:, 0] != first[:, 1]
    pair = pair // 3
    # Neighbours by edge type: 1 if the orientations agree, 2 if one has to be reversed.
    graph = coo_array((np.where(agrees, 1, 2), pair.T), shape=(len(faces), len(faces))).tocsr()
    graph = graph + graph.T
    out = faces.copy()
    seen = np.zeros(len(faces), dtype=bool)
    turn = np.zeros(len(faces), dtype=bool)
    for start in range(len(faces)):
        if seen[start]:
            continue
        found, before = breadth_first_order(graph, start, directed=False)
        seen[found] = True
        rest = found[1:]
        kind = np.asarray(graph[rest, before[rest]]).ravel() == 2
        for face, parent, other in zip(rest.tolist(), before[rest].tolist(), kind.tolist(), strict=True):
            turn[face] = turn[parent] ^ other
        if turn[found].mean() > 0.5:
            turn[found] ^= True
    out[turn] = out[turn][:, ::-1]
    return out


def split_edges(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    length: float,
    still: Bool[np.ndarray, "v"] | None = None,
) -> _Mesh:
    """Halve long edges, placing midpoints on the curved surface given by the normals.

    Parameters
    ----------
    vertices
        Vertices in any unit.
    faces
        Consistently oriented triangles.
    length
        Edges longer than this are split, in the unit of the vertices.
    still
        Vertices; edges of triangles that have only these are not split, unless another triangle shares the edge. None by default.
    """
    still = np.zeros(len(vertices), dtype=bool) if still is None else still
    for _ in range(16):
        edges, opposite, _times = mesh_edges(faces)
        size = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
        rest = np.ones(len(edges), dtype=bool)
        rest[opposite[~still[faces].all(axis=1)]] = False
        size[rest] = 0.0
        # Split the longest side of each triangle, so that the halves are better shaped than the whole.
        chosen = np.zeros(len(edges), dtype=bool)
        longest = opposite[np.arange(len(faces)), size[opposite].argmax(axis=1)]
        chosen[longest[size[longest] > length]] = True
        if not chosen.any():
            break
        number = np.full(len(edges), -1)
        number[chosen] = len(vertices) + np.arange(int(chosen.sum()))
        vertices = np.concatenate([vertices, _middles(vertices, faces, edges[chosen], still)])
        still = np.concatenate([still, still[edges[chosen]].all(axis=1)])
        faces = _divided(vertices, faces, number[opposite])
    return vertices, faces


def _middles(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, still: Bool[np.ndarray, "v"]
) -> Float[np.ndarray, "e 3"]:
    """Midpoints of edges; on an arc if the surface is smooth at both ends.

    Triangles that are still have no say in the normals, and an edge of their border bends within their plane.
    """
    free = ~still[faces].all(axis=1)
    normal, smooth = _smooth_normals(vertices, faces[free])
    bow, curved = _bow(vertices, edges, normal, smooth)
    if not free.all():
        flat = area_vectors(vertices, faces[~free]).sum(axis=0)
        flat /= np.linalg.norm(flat)
        level = normal - (normal @ flat)[:, None] * flat
        level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-300)
        border = still[edges].all(axis=1)
        bow[border] = _bow(vertices, edges[border], level, smooth)[0]
    # At an open border, the normals determine how far the edge bends, but not in which plane.
    return vertices[edges].mean(axis=1) - np.where(curved[:, None], bow, 0.0)


def _smooth_normals(
    vertices: np.ndarray, faces: np.ndarray
) -> tuple[Float[np.ndarray, "v 3"], Bool[np.ndarray, "v"]]:
    """Normal of each vertex, and whether those of its triangles differ from it by less than a crease.

    Triangles are weighted by their areas, at a border by their angles: there the areas would turn the normal towards that end
    of an edge of the border where two triangles of a quadrilateral meet.
    """
    area = area_vectors(vertices, faces)
    unit = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-300)
    normal = vertex_normals(vertices, faces)
    edges, _opposite, times = mesh_edges(faces)
    side = vertices[np.roll(faces, -1, axis=1)] - vertices[faces]
    side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-np.einsum("fki,fki->fk", side, np.roll(side, 1, axis=1)), -1, 1))
    turned = np.zeros((len(vertices), 3))
    np.add.at(turned, faces, angle[..., None] * unit[:, None])
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300)
    border = edges[times == 1]
    normal[border] = turned[border]
    apart = np.zeros(len(vertices))
    np.maximum.at(apart, faces, np.arccos(np.clip(np.einsum("fki,fi->fk", normal[faces], unit), -1, 1)))
    return normal, apart < CREASE_rad


def _bow(
    vertices: np.ndarray,
    edges: Int[np.ndarray, "e 2"],
    normal: Float[np.ndarray, "v 3"],
    smooth: Bool[np.ndarray, "v"],
) -> tuple[Float[np.ndarray, "e 3"], Bool[np.ndarray, "e"]]:
    """Midpoints of edges, as seen from the arc that the normals of their ends describe; and whether the surface is smooth there."""
    a, b = edges.T
    across = vertices[b] - vertices[a]
    bow = np.einsum("ei,ei->e", across, normal[a])[:, None] * normal[a]
    bow -= np.einsum("ei,ei->e", across, normal[b])[:, None] * normal[b]
    return bow / 8, smooth[edges].all(axis=1)


def _divided(vertices: np.ndarray, faces: np.ndarray, middle: Int[np.ndarray, "f 3"]) -> np.ndarray:
    """Triangles with one, two or three halved sides; ``middle`` is the new vertex opposite to each corner, or -1."""
    split = middle >= 0
    count = split.sum(axis=1)
    out = [faces[count == 0]]
    for number, alone in ((1, True), (2, False)):
        some = np.flatnonzero(count == number)
        # Rotated so that the side that differs is opposite to corner 0.
        first = np.argmax(split[some] == alone, axis=1)
        turn = (first[:, None] + np.arange(3)) % 3
        corner, mid = faces[some[:, None], turn], middle[some[:, None], turn]
        p, q, r = corner.T
        if number == 1:
            m = mid[:, 0]
            out += [np.stack([p, q, m], axis=1), np.stack([p, m, r], axis=1)]
        else:
            s, t = mid[:, 1], mid[:, 2]  # on r-p and p-q
            out.append(np.stack([p, t, s], axis=1))
            shorter = np.linalg.norm(vertices[q] - vertices[s], axis=1) < np.linalg.norm(
                vertices[r] - vertices[t], axis=1
            )
            one = np.where(shorter[:, None], np.stack([q, s, t], axis=1), np.stack([q, r, t], axis=1))
            two = np.where(shorter[:, None], np.stack([q, r, s], axis=1), np.stack([t, r, s], axis=1))
            out += [one, two]
    p, q, r = faces[count == 3].T
    a, b, c = middle[count == 3].T
    out += [np.stack(some, axis=1) for some in ((p, c, b), (c, q, a), (b, a, r), (a, b, c))]
    return np.concatenate(out)


def flip_edges(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], tolerance: float
) -> Int[np.ndarray, "f 3"]:
    """Flip edges shared by two triangles if that reduces their largest angle.

    Parameters
    ----------
    vertices
        As in :func:`largest_angles`.
    faces
        Consistently oriented triangles.
    tolerance
        Maximum distance between the two diagonals, in the unit of the vertices: how far the surface may move. Where it is
        smooth, the new diagonal may instead be closer than the old one to the curved surface given by the normals.
    """
    faces = faces.copy()
    surface = _smooth_normals(vertices, faces)
    for _ in range(MAX_PASSES):
        edges, opposite, times = mesh_edges(faces)
        flat = opposite.ravel()
        order = np.argsort(flat, kind="stable")
        pair = order[(times == 2)[flat[order]]].reshape(-1, 2)
        one, two = (pair // 3).T
        a, b = faces[one, (pair[:, 0] + 1) % 3], faces[one, (pair[:, 0] + 2) % 3]
        c, d = faces[one, pair[:, 0] % 3], faces[two, pair[:, 1] % 3]
        first, second = np.stack([c, a, d], axis=1), np.stack([c, d, b], axis=1)
        before = largest_angles(vertices, faces)
        worst = np.maximum(before[one], before[two])
        some = np.flatnonzero((worst > np.pi / 2) & (c != d))
        gain = np.zeros(len(pair))
        gain[some] = worst[some] - np.maximum(
            largest_angles(vertices, first[some]), largest_angles(vertices, second[some])
        )
        good = gain > 1e-3
        some = np.flatnonzero(good)
        # Of both together: the normal of a triangle without height is noise.
        normal = sum(area_vectors(vertices, faces[side[some]]) for side in (one, two))
        old, new = (np.stack(ends, axis=1)[some] for ends in ((a, b), (c, d)))
        good[some] = _is_close(vertices, old, new, tolerance, surface)
        for side in (first[some], second[some]):
            good[some] &= np.einsum("ei,ei->e", normal, area_vectors(vertices, side)) > 0
        count = len(vertices)
        known = edges[:, 0] * count + edges[:, 1]
        good[some] &= ~np.isin(np.minimum(c, d)[some] * count + np.maximum(c, d)[some], known)
        gain = np.where(good, gain, 0.0)
        most = np.zeros(len(faces))
        np.maximum.at(most, one, gain)
        np.maximum.at(most, two, gain)
        chosen = np.flatnonzero(good & (gain >= most[one]) & (gain >= most[two]))
        # Equal gains share a triangle, and two simultaneous flips could create the same edge: keep one of each.
        chosen = chosen[_alone(np.stack([one, two], axis=1)[chosen], len(faces))]
        diagonal = np.stack([c, d], axis=1)[chosen]
        _, unique = np.unique(np.sort(diagonal, axis=1), axis=0, return_index=True)
        chosen = chosen[unique]
        if not len(chosen):
            break
        faces[one[chosen]], faces[two[chosen]] = first[chosen], second[chosen]
    return faces


def _is_close(
    vertices: np.ndarray,
    old: Int[np.ndarray, "n 2"],
    new: Int[np.ndarray, "n 2"],
    tolerance: float,
    surface: tuple[Float[np.ndarray, "v 3"], Bool[np.ndarray, "v"]],
) -> Bool[np.ndarray, "n"]:
    """Whether new edges are within the tolerance of old ones, or on a smooth surface closer to its curve than those."""
    first, second = (vertices[edge[:, 1]] - vertices[edge[:, 0]] for edge in (old, new))
    cross = np.cross(first, second)
    away = np.abs(np.einsum("ei,ei->e", cross, vertices[new[:, 0]] - vertices[old[:, 0]]))
    before, smooth = _bow(vertices, old, *surface)
    after, also = _bow(vertices, new, *surface)
    closer = smooth & also & (np.linalg.norm(after, axis=1) < np.linalg.norm(before, axis=1))
    return closer | (away <= tolerance * np.linalg.norm(cross, axis=1))


def _alone(members: Int[np.ndarray, "n k"], count: int) -> Bool[np.ndarray, "n"]:
    """Rows that are the first to contain each of their members."""
    first = np.full(count, len(members))
    rows = np.arange(len(members))
    for column in members.T:
        np.minimum.at(first, column, rows)
    return (first[members] == rows[:, None]).all(axis=1)


def collapse_edges(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], length: float, tolerance: float
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"], float]:
    """Collapse short edges as far as the surface allows, the shortest first.

    Parameters
    ----------
    vertices, faces
        As in :func:`split_edges`.
    length
        Shorter edges are collapsed; none becomes longer than 4/3 of it, in the unit of the vertices.
    tolerance
        Maximum root mean square distance of a vertex from the planes that it replaces, in the same unit.

    Returns
    -------
    tuple
        Vertices, triangles, and the largest of those distances.

    Raises
    ------
    InputError
        The length is not positive.
    """
    check_numbers("collapse_edges", POSITIVE, length=length)
    quadric, border = _quadrics(vertices, faces)
    vertices, faces = np.array(vertices, dtype=float), np.array(faces, dtype=np.int64)
    size = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    # Geometric steps of a quarter: within each step, edges are processed in the order of the triangles.
    steps = max(1, int(np.ceil(np.log(length / max(float(size.min()), 1e-3 * length)) / np.log(1.25))))
    moved = 0.0
    for bound in length * 1.25 ** -np.arange(steps - 1, -1, -1.0):
        moved = max(moved, kernels.collapse_short(vertices, faces, quadric, border, bound, length, tolerance))
        faces = faces[faces[:, 0] >= 0]
    used, number = np.unique(faces, return_inverse=True)
    return vertices[used], number.reshape(-1, 3), moved


def _quadrics(
    vertices: np.ndarray, faces: np.ndarray
) -> tuple[Float[np.ndarray, "v 11"], Bool[np.ndarray, "v"]]:
    """Error quadric of each vertex: sum of squared distances from adjacent planes, ``p A p + 2 b p + c``, and weight.

    Columns are the upper triangle of A row by row, b, c, and the weight, an area. At a border, a plane perpendicular
    to the triangle is added, which preserves the outline.
    """
    area = area_vectors(vertices, faces)
    size = np.linalg.norm(area, axis=1)
    edges, opposite, times = mesh_edges(faces)
    face, corner = np.nonzero(times[opposite] == 1)
    ends = edges[opposite[face, corner]]
    along = vertices[ends[:, 1]] - vertices[ends[:, 0]]
    across = np.cross(along, area[face])
    planes = [(np.repeat(area, 3, axis=0), faces.ravel(), np.repeat(size, 3) / 3)]
    planes += [(across, ends[:, k], np.einsum("ei,ei->e", along, along) / 2) for k in range(2)]
    out = np.zeros((11, len(vertices)))
    for normal, vertex, share in planes:
        unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        away = -np.einsum("ni,ni->n", unit, vertices[vertex])
        x, y, z = unit.T
        terms = (x * x, x * y, x * z, y * y, y * z, z * z, away * x, away * y, away * z, away**2, 1.0)
        for row, term in enumerate(terms):
            out[row] += np.bincount(vertex, share * term, len(vertices))
    border = np.zeros(len(vertices), dtype=bool)
    border[ends] = True
    return out.T.copy(), border
