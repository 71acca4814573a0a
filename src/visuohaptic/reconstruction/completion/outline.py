"""Outline of an upright, nearly round object: radius over height, measured on a mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..mesh import SurfaceMesh

__all__ = ["axial_part", "measured_outline"]

#: Minimum z component of the unit normal of a wall face: fusion closes the lower edge of a label.
MIN_NORMAL_Z = -0.3
#: Faces below this height belong to the table [m].
TABLE_M = 0.004
#: Height of a slice [m], and minimum number of vertices in it.
SLICE_M, MIN_POINTS = 0.008, 6
#: Vertices within this distance of the top may belong to the lid, not the wall [m].
LID_M = 0.003


def axial_part(surface: SurfaceMesh, axis_m: Float[np.ndarray, "2"], reach_m: float) -> SurfaceMesh:
    """Walls and lid of the object around an upright axis, above the table.

    Parameters
    ----------
    surface
        Mesh in a frame whose z = 0 is the table.
    axis_m
        x, y of the axis [m].
    reach_m
        Maximum distance of a face from the axis [m].
    """
    middle = surface.vertices_m[surface.faces].mean(axis=1)
    chosen = (np.hypot(*(middle[:, :2] - axis_m).T) < reach_m) & (middle[:, 2] > TABLE_M)
    return surface.submesh(np.flatnonzero(chosen & (surface.face_normals[:, 2] > MIN_NORMAL_Z)))


def measured_outline(
    mesh: SurfaceMesh, axis_m: Float[np.ndarray, "2"], reach_m: float
) -> Float[np.ndarray, "k 2"]:
    """Median radius of horizontal slices, from the table to the top.

    Parameters
    ----------
    mesh
        Mesh in a frame whose z = 0 is the table.
    axis_m
        x, y of the axis [m].
    reach_m
        Maximum radius [m].

    Returns
    -------
    (k, 2) array
        Radius and height [m], ascending; slices with fewer than 6 vertices are omitted.
    """
    points = mesh.vertices_m[np.unique(mesh.faces)]
    rho = np.hypot(*(points[:, :2] - axis_m).T)
    points, rho = points[rho < reach_m], rho[rho < reach_m]
    top = float(np.quantile(points[:, 2], 0.999))
    rows = []
    for z in np.arange(0.5 * SLICE_M, top, SLICE_M):
        near = (np.abs(points[:, 2] - z) < 0.5 * SLICE_M) & (points[:, 2] < top - LID_M)
        if np.count_nonzero(near) >= MIN_POINTS:
            rows.append((float(np.median(rho[near])), float(z)))
    if len(rows) < 3:
        return np.array([[0.03, 0.0], [0.03, top]])
    outline = np.array(rows)
    return np.vstack([[outline[0, 0], 0.0], outline, [outline[-1, 0], top]])
