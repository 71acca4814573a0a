"""Triangle meshes: normals and areas, welding, sampling, PLY files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core import InputError, finite_array
from ..core.geometry import area_vectors, vertex_normals
from ..io.meshes.ply import PlyMesh, read_ply, write_ply


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Vertices and triangles, counter-clockwise from outside.

    Examples
    --------
    >>> corners_m = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    >>> triangle = SurfaceMesh(corners_m, np.array([[0, 1, 2]]))
    >>> triangle.face_normals.tolist(), round(float(triangle.face_areas_m2[0]), 6)
    ([[0.0, 0.0, 1.0]], 0.005)
    """

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    colors: UInt8[np.ndarray, "v 3"] | None = None  #: red, green, blue

    def __post_init__(self) -> None:
        vertices = finite_array("SurfaceMesh", self.vertices_m, None, 3, field="vertices_m", least=0)
        faces = np.asarray(self.faces, dtype=np.int64).reshape(-1, 3)
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise InputError(
                "SurfaceMesh",
                f"found indices {faces.min()} to {faces.max()}, expected below {len(vertices)}",
                field="faces",
            )
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "faces", faces)

    @classmethod
    def load(cls, path: Path | str) -> SurfaceMesh:
        """Read a PLY file.

        Parameters
        ----------
        path
            PLY file, text or binary, in metres.

        Raises
        ------
        InputError
            The file is missing, damaged or has no triangles.
        """
        found = read_ply(path)
        if not len(found.faces):
            raise InputError(path, f"has {len(found.vertices_m)} points and no triangles, expected a surface")
        return cls(found.vertices_m, found.faces, found.colors)

    def save(self, path: Path | str) -> None:
        """Write a binary PLY file.

        Parameters
        ----------
        path
            File to write.
        """
        write_ply(path, PlyMesh(self.vertices_m, self.faces, self.colors))

    @property
    def face_normals(self) -> Float[np.ndarray, "f 3"]:
        """Unit normals; zero for triangles without area."""
        normals = area_vectors(self.vertices_m, self.faces)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)

    @property
    def face_areas_m2(self) -> Float[np.ndarray, "f"]:
        """Area of each triangle [m2]."""
        return np.linalg.norm(area_vectors(self.vertices_m, self.faces), axis=1)

    @property
    def vertex_normals(self) -> Float[np.ndarray, "v 3"]:
        """Area-weighted unit normals; zero for vertices without triangles."""
        return vertex_normals(self.vertices_m, self.faces)

    def welded(self, tolerance_m: float = 1e-7) -> SurfaceMesh:
        """The mesh with coincident vertices merged and degenerate triangles removed.

        Parameters
        ----------
        tolerance_m
            Edge of the grid cells within which vertices are merged [m].
        """
        keys = np.rint(self.vertices_m / tolerance_m).astype(np.int64)
        _, first, where = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        faces = where.reshape(-1)[self.faces]
        whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        colors = None if self.colors is None else self.colors[first]
        return SurfaceMesh(self.vertices_m[first], faces[whole], colors)

    def submesh(self, kept: Int[np.ndarray, "k"]) -> SurfaceMesh:
        """Selected triangles and the vertices that they use.

        Parameters
        ----------
        kept
            Indices (k) of the triangles.
        """
        used, faces = np.unique(self.faces[kept], return_inverse=True)
        colors = None if self.colors is None else self.colors[used]
        return SurfaceMesh(self.vertices_m[used], faces.reshape(-1, 3), colors)

    def joined(self, other: SurfaceMesh) -> SurfaceMesh:
        """Concatenate two meshes; vertices are not merged.

        Parameters
        ----------
        other
            Mesh to append.
        """
        colors = None
        if self.colors is not None and other.colors is not None:
            colors = np.concatenate([self.colors, other.colors])
        return SurfaceMesh(
            np.concatenate([self.vertices_m, other.vertices_m]),
            np.concatenate([self.faces, other.faces + len(self.vertices_m)]),
            colors,
        )

    def sampled(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "count 3"], Int[np.ndarray, "count"]]:
        """Points spread uniformly over the area, and the triangle of each.

        Parameters
        ----------
        count
            Number of points.
        rng
            Source of randomness.

        Raises
        ------
        InputError
            The mesh has no area.
        """
        areas = self.face_areas_m2
        if not areas.sum() > 0:
            raise InputError("SurfaceMesh.sampled", "the mesh has no area")
        chosen = rng.choice(len(areas), size=count, p=areas / areas.sum())
        a, b = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        corners = self.vertices_m[self.faces[chosen]]
        points = (1 - a) * corners[:, 0] + a * (1 - b) * corners[:, 1] + a * b * corners[:, 2]
        return points, chosen
