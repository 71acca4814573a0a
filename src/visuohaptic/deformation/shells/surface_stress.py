"""Stress at the two faces of a deformed wall, from its deformed shape.

Membrane strain is that of each flat triangle; bending is the change of curvature, from the change of the vertex
normals across a triangle. Both are of first order in the size of the triangles. Under a point force the stress is
unbounded: the result is a mean over the triangles around each vertex, a patch about as wide as two cells.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.geometry import area_vectors, vertex_normals
from .laminate import Laminate
from .shell import ShellMesh, plane_stress
from .shell_material import IsotropicMaterial


def surface_stress(
    mesh: ShellMesh, material: IsotropicMaterial | Laminate, points_m: Float[np.ndarray, "*n v 3"]
) -> Float[np.ndarray, "*n v"]:
    """Von Mises stress at the vertices [Pa], the larger of both faces of the wall; NaN for a laminate.

    Parameters
    ----------
    mesh
        Undeformed mesh.
    material
        Material of the whole wall, linear elastic. Plies have individual failure modes, which von Mises does not describe.
    points_m
        Deformed vertices [m], of one state or several.
    """
    if isinstance(material, Laminate):
        return np.full(points_m.shape[:-1], np.nan)
    faces, count = mesh.faces, len(mesh.vertices_m)
    sides, turns = _frames(mesh.vertices_m, faces)
    inverse = np.linalg.inv(sides)
    before = turns @ inverse
    half = 0.5 * np.broadcast_to(np.asarray(mesh.thickness_m), len(faces))[:, None, None]
    law = plane_stress(material)
    area = np.linalg.norm(area_vectors(mesh.vertices_m, faces), axis=1) * np.asarray(mesh.fraction)
    corners = faces.ravel()
    whole = np.bincount(corners, np.repeat(area, 3), count)
    out = np.zeros(points_m.shape[:-1])
    for points, found in zip(points_m.reshape(-1, count, 3), out.reshape(-1, count), strict=True):
        sides, turns = _frames(points, faces)
        gradient = sides @ inverse
        turned = np.swapaxes(gradient, 1, 2)
        membrane = 0.5 * (turned @ gradient - np.eye(2))
        # Both curvatures in the coordinates of the undeformed triangle; those of the deformed one are
        # ``turns sides^-1``, and ``sides^-1 gradient`` is the inverse of the undeformed sides.
        bent = turned @ turns @ inverse - before
        curvature = 0.5 * (bent + np.swapaxes(bent, 1, 2))
        worst = np.zeros(len(faces))
        for side in (half, -half):
            strain = membrane + side * curvature
            xx, yy, xy = (np.stack([strain[:, 0, 0], strain[:, 1, 1], 2 * strain[:, 0, 1]], axis=1) @ law).T
            worst = np.maximum(worst, np.sqrt(xx**2 - xx * yy + yy**2 + 3 * xy**2))
        sums = np.bincount(corners, np.repeat(area * worst, 3), count)
        np.divide(sums, whole, out=found, where=whole > 0)
    return out


def _frames(
    points: Float[np.ndarray, "v 3"], faces: np.ndarray
) -> tuple[Float[np.ndarray, "f 2 2"], Float[np.ndarray, "f 2 2"]]:
    """Two sides of each triangle in its plane (columns), and the change of the normals along them."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    first, second = b - a, c - a
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    z = np.cross(first, second)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    plane = np.stack([x, np.cross(z, x)], axis=1)
    normal = vertex_normals(points, faces)[faces]
    sides = np.stack([first, second], axis=2)
    turns = np.stack([normal[:, 1] - normal[:, 0], normal[:, 2] - normal[:, 0]], axis=2)
    return plane @ sides, plane @ turns
