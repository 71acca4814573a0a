"""Scanned objects with a hidden part, as seen by a camera on one side, and probes that touch them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["HIDDEN", "PartlySeen", "distance_to_mesh", "mesh_files", "partly_seen", "probe_mesh"]

#: What is hidden: the back of one camera, or the middle 46 % of the height.
HIDDEN = ("back", "middle")
#: Edges of faces are at most this long, so that the rim of what is seen is sharp [m].
_EDGE_M = 0.004


@dataclass(frozen=True, slots=True)
class PartlySeen:
    """An object on the table, partly visible."""

    name: str
    mesh: Any  #: ``trimesh.Trimesh``, whole, z up, foot at z = 0
    vertices_m: np.ndarray  #: of the visible part, (v, 3), as fused: with noise
    faces: np.ndarray  #: of the visible part, (f, 3)
    hidden_m: np.ndarray  #: points (h, 3) of the outer surface that are not seen


def mesh_files(folder: Path) -> list[Path]:
    """Meshes with faces below a folder, in order of name."""
    return sorted(path for end in ("obj", "stl", "dae") for path in folder.rglob(f"*.{end}"))


def partly_seen(
    path: Path, rng: np.random.Generator, hidden: str = "back", noise_m: float = 0.0003
) -> PartlySeen:
    """A mesh file whose back is hidden from a camera 15 to 40 degrees above the table, or whose middle is hidden."""
    import trimesh

    whole = trimesh.load(path, force="mesh")
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    low, high = whole.bounds
    whole.apply_translation([*(-0.5 * (low + high)[:2]), -low[2]])
    vertices, faces = trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, _EDGE_M, max_iter=12)
    fine = trimesh.Trimesh(vertices, faces)
    seen = _facing(fine, whole, rng) if hidden == "back" else _ends(fine)
    part = fine.submesh([np.flatnonzero(seen)], append=True, repair=False)
    noisy = part.vertices + noise_m * rng.standard_normal(len(part.vertices))[:, None] * part.vertex_normals
    truth = _outside(fine, whole, ~seen, rng)
    return PartlySeen(path.stem, whole, np.asarray(noisy), np.asarray(part.faces), truth)


def _facing(fine: Any, whole: Any, rng: np.random.Generator) -> np.ndarray:
    """Faces that a camera sees from 0.6 m at a random side."""
    turn, rise = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(15, 40))
    eye = 0.6 * np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    path = eye - fine.triangles_center
    seen = ~_blocked(whole, fine.triangles_center + 1e-4 * fine.face_normals, path)
    facing: np.ndarray = seen & ((path * fine.face_normals).sum(axis=1) > 0.1 * np.linalg.norm(path, axis=1))
    return facing


def _ends(fine: Any) -> np.ndarray:
    """Faces of the lowest and highest 27 % of the height."""
    fraction = fine.triangles_center[:, 2] / fine.bounds[1, 2]
    ends: np.ndarray = (fraction < 0.27) | (fraction > 0.73)
    return ends


def _outside(
    fine: Any, whole: Any, hidden: np.ndarray, rng: np.random.Generator, count: int = 1500
) -> np.ndarray:
    """Points of outward hidden faces, except those under the object."""
    free = ~_blocked(whole, fine.triangles_center + 1e-4 * fine.face_normals, fine.face_normals)
    outside = hidden & free & (fine.face_normals[:, 2] > -0.7) & (fine.triangles_center[:, 2] > 0.004)
    area = np.where(outside, fine.area_faces, 0)
    face = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkd->nd", weights, fine.triangles[face])


def _blocked(mesh: Any, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return np.asarray(mesh.ray.intersects_any(origins, directions))


def probe_mesh(mesh: Any, start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray | None:
    """First intersection of a point moving from start to end with a mesh; None if there is none."""
    way = end_m - start_m
    length = float(np.linalg.norm(way))
    points, _, _ = mesh.ray.intersects_location(start_m[None], way[None] / length, multiple_hits=True)
    along = (points - start_m) @ way / length
    ahead = along[(along > 0) & (along <= length)]
    return start_m + ahead.min() * way / length if len(ahead) else None


def distance_to_mesh(points_m: np.ndarray, vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance of points (n, 3) from a mesh of small triangles: the nearest of the twelve whose centres are nearest."""
    import trimesh

    corners = vertices_m[faces]
    count = min(12, len(corners))
    _, near = cKDTree(corners.mean(axis=1)).query(points_m, k=count)
    near = np.asarray(near).reshape(len(points_m), count)
    many = np.repeat(points_m, count, axis=0)
    closest = trimesh.triangles.closest_point(corners[near.ravel()], many)
    return np.linalg.norm(closest - many, axis=1).reshape(-1, count).min(axis=1)
