"""State of an imported mesh: merged vertices, disconnected parts, holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from .local_remesh import mesh_edges


@dataclass(frozen=True, slots=True, eq=False)
class MeshState:
    """A merged mesh and its defects."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    dropped_faces: int  #: degenerate or duplicate
    patches: int  #: disconnected parts
    loose_faces: int  #: triangles outside the main part
    loose_place: tuple[float, ...]  #: centre of the largest disconnected part, or empty
    branching_edges: int  #: edges with three or more triangles
    turned: int  #: edges whose two triangles have opposite orientations
    loops: tuple[np.ndarray, ...]  #: boundary loops of the main part, vertex indices in order

    @property
    def defects(self) -> list[str]:
        """Descriptions of the defects, for display."""
        found = []
        if self.dropped_faces:
            found.append(f"{self.dropped_faces} degenerate or doubled triangles dropped")
        if self.loose_faces:
            place = ", ".join(f"{value:.4g}" for value in self.loose_place)
            found.append(
                f"{self.patches - 1} loose patches of {self.loose_faces} triangles, the largest at ({place})"
            )
        if self.branching_edges:
            found.append(f"{self.branching_edges} edges with more than two triangles")
        if self.turned:
            found.append(f"{self.turned} edges where the outside changes sides")
        return found


def inspect_mesh(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], where: str = "mesh"
) -> MeshState:
    """Merge vertices, remove degenerate triangles, keep the main part, and list the defects.

    Parameters
    ----------
    vertices
        Vertices of the imported mesh, scaled to metres.
    faces
        Its triangles, of any quality and orientation.
    where
        Name of the mesh, for messages.

    Raises
    ------
    InputError
        Fewer than four triangles have a nonzero area.
    """
    vertices, faces, dropped = _merged(vertices, faces)
    if len(faces) < 4:
        raise InputError(where, f"has {len(faces)} triangles with an area, expected at least 4", field="mesh")
    sides = vertices[faces[:, [1, 2]]] - vertices[faces[:, [0, 0]]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    number = face_parts(faces)
    size = np.bincount(number, area)
    # Parts of the wall may be disconnected along a seam; small parts are patches.
    main = size >= 0.05 * size.max()
    keep = main[number]
    place: tuple[float, ...] = ()
    if not keep.all():
        largest = int(np.argmax(np.where(main, 0.0, size)))
        place = tuple(float(value) for value in vertices[faces[number == largest]].mean(axis=(0, 1)))
    patches, loose = len(size) if not main.all() else 1, int((~keep).sum())
    used, faces = np.unique(faces[keep], return_inverse=True)
    faces, vertices = faces.reshape(-1, 3), vertices[used]
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    branching = int((mesh_edges(faces)[2] > 2).sum())
    repeated = np.unique(directed[:, 0] * len(vertices) + directed[:, 1], return_counts=True)[1]
    return MeshState(
        vertices,
        faces,
        dropped,
        patches,
        loose,
        place,
        branching,
        int((repeated > 1).sum()),
        boundary_loops(faces),
    )


def face_parts(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f"]:
    """Index of the connected part, from 0, of each face; parts share no vertex.

    Parameters
    ----------
    faces
        Triangles, at least one.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(faces.max()) + 1
    pairs = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.unique(label, return_inverse=True)[1].reshape(-1)


def _merged(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    used = vertices[faces.ravel()]
    low = used.min(axis=0)
    grid = max(float(np.ptp(used, axis=0).max()) * 1e-6, 1e-12)
    # Used vertices are within 2e6 cells, whose index fits 21 bits; unused ones may be anywhere.
    cell = np.round((vertices - low) / grid) + 1
    cell[~((cell >= 1) & (cell < 2**21)).all(axis=1)] = 0
    cell = cell.astype(np.int64)
    _, first, number = np.unique(
        (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2], return_index=True, return_inverse=True
    )
    faces, vertices = number.reshape(-1)[faces], vertices[first]
    near = _joined(vertices, faces, grid)  # on both sides of a border between cells
    faces, before = near[faces], len(faces)
    sides = vertices[faces[:, [1, 2, 0]]] - vertices[faces]
    longest = np.einsum("fij,fij->fi", sides, sides).max(axis=1)
    doubled = np.linalg.norm(np.cross(sides[:, 0], -sides[:, 2]), axis=1)
    faces = faces[doubled > 1e-5 * np.maximum(longest, 1e-300)]
    if len(faces):
        a, b, c = np.sort(faces, axis=1).T
        _, pair = np.unique(a * len(vertices) + b, return_inverse=True)
        _, once = np.unique(pair * len(vertices) + c, return_index=True)
        faces = faces[np.sort(once)]
    return vertices, faces, before - len(faces)


def _joined(vertices: np.ndarray, faces: np.ndarray, distance: float) -> Int[np.ndarray, "v"]:
    """One vertex for each chain of vertices that are closer than a distance."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    used = np.unique(faces)
    pairs = used[cKDTree(vertices[used]).query_pairs(distance, output_type="ndarray")]
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(vertices), len(vertices)))
    _, first, label = np.unique(
        connected_components(graph, directed=False)[1], return_index=True, return_inverse=True
    )
    return first[label.reshape(-1)]


def boundary_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Edges with a triangle on one side only, in the direction of that triangle.

    Parameters
    ----------
    faces
        Triangles.
    """
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = directed.min(axis=1), directed.max(axis=1)
    _, inverse, times = np.unique(
        low * (faces.max(initial=0) + 1) + high, return_inverse=True, return_counts=True
    )
    return directed[times[inverse] == 1]


def boundary_loops(faces: Int[np.ndarray, "f 3"]) -> tuple[np.ndarray, ...]:
    """Closed chains of edges with a triangle on one side only.

    Parameters
    ----------
    faces
        Triangles.

    Returns
    -------
    tuple of arrays
        Vertex indices of each loop, in order.
    """
    after: dict[int, list[int]] = {}
    for a, b in boundary_edges(faces).tolist():
        after.setdefault(a, []).append(b)
    loops = []
    while after:
        start = next(iter(after))
        chain, here = [start], start
        while here in after:
            there = after[here].pop()
            if not after[here]:
                del after[here]
            if there == start:
                break
            chain.append(there)
            here = there
        loops.append(np.array(chain, dtype=np.int64))
    return tuple(loops)
