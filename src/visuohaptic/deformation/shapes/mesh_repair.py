"""Suitability of imported triangles for a shell model, and local repair on the original surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.geometry import vertex_normals
from ...core.measurement import normal_sigmas
from ...io.meshes.local_remesh import (
    collapse_edges,
    flip_edges,
    largest_angles,
    mesh_edges,
    orient_faces,
    split_edges,
)
from ...io.meshes.mesh_state import MeshState, boundary_loops, face_parts

#: Requirements on triangles: their number, largest angle, and number of edges around. The error of a triangle is
#: bounded by its largest angle, not by its smallest (Babuska and Aziz 1976). On a tube, right-angled needles
#: of 4 degrees are within 2.3 % of the Fourier series, obtuse ones of 150 degrees have errors up to 19 %, of 164 degrees 80 %.
MAX_FACES, LARGEST_DEGREES, EDGES_ROUND = 50_000, 150.0, 64
#: A single triangle may be larger, up to half a square whose sides are those edges. The fan of a flat lid, of needles as long as
#: its radius, makes a carton 6 % too soft below it.
DIAGONAL = np.sqrt(2.0)
#: Fractions of the height above the lowest vertex up to which an unchanged mesh is clamped: the first with
#: vertices in every sector around the foot. A clamped chamfer of 1 mm makes a tub a fifth stiffer; scans are uneven.
FOOT_FRACTIONS, FOOT_SECTORS = (0.002, 0.01), 12
#: A boundary loop is a mouth if it is this close to an end of the mesh, and this wide, as fractions of the mesh.
MOUTH_BELOW, MOUTH_WIDTH = 0.05, 0.2
#: A wall that is displaced by this fraction of its thickness is 0.4 % stiffer: waves of amplitude a add ``t a^2 / 2`` to
#: the second moment ``t^3 / 12`` of a strip.
MOVED_FRACTION = 0.025
#: Edges of divided triangles are at most this many heights over :data:`EDGES_ROUND`. With 8, a box is 4 % too soft below its lid; with
#: 6, arcs that were halved too often make waves of 18 um.
SHALLOW = 7.0
#: Factor by which the residual of ``_noise`` exceeds the noise of a vertex with six neighbours.
RESIDUAL = 1.36


def clamped_foot(vertices: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, "v"]:
    """Clamped vertices of an unchanged mesh: the lowest five-hundredth of the height.

    If these do not surround the foot, as in an uneven scan, the lowest hundredth.

    Parameters
    ----------
    vertices
        Vertices of the mesh [m], z up.
    """
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    foot: Bool[np.ndarray, "v"] = np.zeros(len(vertices), dtype=bool)
    for fraction in FOOT_FRACTIONS:
        foot = vertices[:, 2] <= low + fraction * (high - low)
        away = vertices[foot, :2] - 0.5 * (vertices[foot, :2].min(axis=0) + vertices[foot, :2].max(axis=0))
        turns = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)
        if len(np.unique(np.floor(FOOT_SECTORS * turns))) >= FOOT_SECTORS:
            break
    return foot


def why_not_as_it_is(state: MeshState) -> str:
    """The first reason why the triangles cannot be used unchanged, or an empty string.

    Number, shape, and size are those of the load-bearing triangles. One with three clamped corners does
    not deform, whatever its shape (the fan of a flat foot); for these only the orientation matters, for the volume.

    Parameters
    ----------
    state
        The imported mesh, scaled to metres.
    """
    vertices, faces = state.vertices, _loaded(state)
    if (parts := _parts(state)) > 1:
        return f"{parts} disconnected parts"
    if state.branching_edges or state.turned:
        return f"{state.branching_edges + state.turned} non-manifold or inconsistently oriented edges"
    if len(faces) > MAX_FACES:
        return f"{len(faces)} triangles, expected at most {MAX_FACES}"
    for loop in _holes(state):
        middle = ", ".join(f"{value:.4g}" for value in vertices[loop].mean(axis=0))
        return f"a hole of {len(loop)} edges in the wall at ({middle}) m"
    largest = np.degrees(largest_angles(vertices, faces))
    if float(np.percentile(largest, 98)) > LARGEST_DEGREES:
        worst = ", ".join(f"{value:.4g}" for value in vertices[faces[int(np.argmax(largest))]].mean(axis=0))
        return f"obtuse triangles with angles up to {largest.max():.4g} degrees, the worst at ({worst}) m"
    if (size := _usual_length(vertices, faces)) > _round_m(vertices) / EDGES_ROUND:
        return f"triangles of {1e3 * size:.2g} mm, too coarse"
    return ""


def large_faces(state: MeshState) -> int:
    """Number of load-bearing triangles that are too coarse among others that are not, like the fan of a flat lid.

    Parameters
    ----------
    state
        The imported mesh, scaled to metres.
    """
    limit = DIAGONAL * _round_m(state.vertices) / EDGES_ROUND
    return int((face_lengths(state.vertices, _loaded(state)) > limit).sum())


def repair_mesh(state: MeshState, thickness_m: float, around: int) -> tuple[MeshState, list[str]]:
    """Make the triangles suitable for a shell by local changes that preserve the surface.

    Orientations are made consistent, small holes closed, coarse triangles divided, slivers flipped or collapsed, and
    too many triangles simplified. Unconnected parts, and edges of more than two triangles, remain.

    Parameters
    ----------
    state
        The imported mesh, scaled to metres.
    thickness_m
        Thickness of its wall: the surface moves by at most a fortieth of it, or by twice the noise of a scan.
    around
        Edges around the wall of a simplified mesh.

    Returns
    -------
    tuple
        The mesh, and a description of the changes for display.
    """
    fine = not why_not_as_it_is(state)  # but for single triangles: its wall is not made coarser for them
    notes: list[str] = []
    if state.branching_edges or _parts(state) > 1:
        return state, notes
    vertices, faces = state.vertices, state.faces
    if state.turned:
        faces = orient_faces(faces)
        state = replace(_state(state, vertices, faces), turned=0)
    holes = _holes(state)
    if holes:
        vertices, faces = _filled(vertices, faces, holes)
        notes.append(f"{len(holes)} holes of up to {max(map(len, holes))} edges closed")
    tolerance, length = MOVED_FRACTION * thickness_m, _round_m(vertices) / around
    # On a shallow wall, a dent reaches from the foot to the lid.
    limit = min(_round_m(vertices), SHALLOW * float(np.ptp(vertices[:, 2]))) / EDGES_ROUND
    moved, before = 0.0, len(faces)
    state = _state(state, vertices, faces)
    bound = (
        float(np.hypot(tolerance, 2 * _noise(vertices, faces))) if len(_loaded(state)) > MAX_FACES else 0.0
    )
    while len(_loaded(state)) > MAX_FACES and bound < thickness_m:
        vertices, faces, more = collapse_edges(vertices, faces, length, bound)
        moved, bound = max(moved, more), 2 * bound
        state = _state(state, vertices, faces)
    if large_faces(state):
        vertices, faces = split_edges(vertices, faces, DIAGONAL * limit, clamped_foot(vertices))
        state = _state(state, vertices, faces)
    if not fine and _usual_length(vertices, _loaded(state)) > limit:
        vertices, faces = split_edges(vertices, faces, limit, clamped_foot(vertices))
        # The halves of long triangles may be too narrow: collapse these.
        vertices, faces, _ = collapse_edges(vertices, faces, 0.75 * limit, 2 * tolerance)
    faces = flip_edges(vertices, faces, tolerance)
    state = _state(state, vertices, faces)
    if not fine and "obtuse" in why_not_as_it_is(state):
        vertices, faces, more = collapse_edges(vertices, faces, length, tolerance)
        moved = max(moved, more)
        state = _state(state, vertices, flip_edges(vertices, faces, tolerance))
    notes.append(f"repaired: {before} triangles became {len(state.faces)}")
    if moved:
        notes.append(
            f"the surface moved by up to {1e6 * moved:.2g} um, the stiffness by up to "
            f"{600 * (moved / thickness_m) ** 2:.2g} %"
        )
    return state, notes


def _state(state: MeshState, vertices: np.ndarray, faces: np.ndarray) -> MeshState:
    return replace(state, vertices=vertices, faces=faces, loops=boundary_loops(faces))


def _loaded(state: MeshState) -> Int[np.ndarray, "n 3"]:
    """Load-bearing triangles."""
    return state.faces[~clamped_foot(state.vertices)[state.faces].all(axis=1)]


def _parts(state: MeshState) -> int:
    """Number of unconnected load-bearing parts; the clamped foot connects parts."""
    loaded = ~clamped_foot(state.vertices)[state.faces].all(axis=1)
    return len(np.unique(face_parts(state.faces)[loaded]))


def _round_m(vertices: np.ndarray) -> float:
    """Approximate circumference of the wall [m]."""
    return np.pi * float(np.ptp(vertices[:, :2], axis=0).mean())


def _usual_length(vertices: np.ndarray, faces: np.ndarray) -> float:
    """90 % quantile of the lengths of triangles [m]."""
    return float(np.percentile(face_lengths(vertices, faces), 90))


def face_lengths(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f"]:
    """Second longest side of each triangle [m]: the longest one of half a quadrilateral is its diagonal.

    Parameters
    ----------
    vertices, faces
        The mesh [m].
    """
    sides = np.linalg.norm(vertices[faces[:, [1, 2, 0]]] - vertices[faces], axis=2)
    return np.asarray(np.median(sides, axis=1))


def _holes(state: MeshState) -> list[Int[np.ndarray, "l"]]:
    """Boundary loops that are neither a mouth nor an open foot."""
    low, high = state.vertices.min(axis=0), state.vertices.max(axis=0)
    margin = MOUTH_BELOW * (high[2] - low[2])
    found = []
    for loop in state.loops:
        z = state.vertices[loop, 2]
        at_end = z.min() > high[2] - margin or z.max() < low[2] + margin
        wide = np.ptp(state.vertices[loop, :2], axis=0).max() > MOUTH_WIDTH * (high - low)[:2].max()
        if not (at_end and wide):
            found.append(loop)
    return found


def _filled(
    vertices: np.ndarray, faces: np.ndarray, holes: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Fill holes with fans that continue the curvature of the wall around them."""
    normal = vertex_normals(vertices, faces)
    for loop in holes:
        edge, side = vertices[loop], normal[loop]
        middle = edge.mean(axis=0)
        # The tangent planes of an arc intersect at twice the arc's height above its chord.
        gram = side.T @ side / len(loop) + 1e-3 * np.eye(3)
        peak = np.einsum("li,li->l", side, edge - middle) @ side / len(loop)
        vertices = np.concatenate([vertices, [middle + 0.5 * np.linalg.solve(gram, peak)]])
        apex = np.full(len(loop), len(vertices) - 1)
        # Triangles are on the left of their boundary.
        faces = np.concatenate([faces, np.stack([np.roll(loop, -1), loop, apex], axis=1)])
    return vertices, faces


def _noise(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Standard deviation of the noise of a scan along the normals [m].

    A vertex differs from the mean of its neighbours by curvature and noise; its difference in excess of that of its neighbours
    is noise alone.
    """
    edges, _opposite, _times = mesh_edges(faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    degree = np.maximum(np.bincount(both[:, 0], minlength=len(vertices)), 1)

    def around(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(both[:, 0], column[both[:, 1]], len(vertices)) for column in values.T]
        return np.stack(sums, axis=1) / degree[:, None]

    bow = np.einsum("vi,vi->v", vertex_normals(vertices, faces), around(vertices) - vertices)
    left = bow - around(bow[:, None])[:, 0]
    return float(np.median(np.abs(left - np.median(left))) / normal_sigmas(0.5) / RESIDUAL)
