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
    mesh: ShellMesh, material: IsotropicMaterial | Laminate, points_m: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "v"]:
    """Von Mises stress at the vertices [Pa], the larger of both faces of the wall; NaN for a laminate.

    Parameters
    ----------
    mesh
        Undeformed mesh.
    material
        Material of the whole wall, linear elastic. Plies have individual failure modes, which von Mises does not describe.
    points_m
        Deformed vertices [m].
    """
    if isinstance(material, Laminate):
        return np.full(len(mesh.vertices_m), np.nan)
    faces = mesh.faces
    rest, turned = _frames(mesh.vertices_m, faces), _frames(points_m, faces)
    inverse = np.linalg.inv(rest[0])
    gradient = turned[0] @ inverse
    membrane = 0.5 * (np.swapaxes(gradient, 1, 2) @ gradient - np.eye(2))
    # Both curvatures in the coordinates of the undeformed triangle.
    bent = np.swapaxes(gradient, 1, 2) @ turned[1] @ np.linalg.inv(turned[0]) @ gradient - rest[1] @ inverse
    curvature = 0.5 * (bent + np.swapaxes(bent, 1, 2))
    half = 0.5 * np.broadcast_to(np.asarray(mesh.thickness_m), len(faces))[:, None, None]
    law = plane_stress(material)
    worst = np.zeros(len(faces))
    for side in (half, -half):
        strain = membrane + side * curvature
        xx, yy, xy = (np.stack([strain[:, 0, 0], strain[:, 1, 1], 2 * strain[:, 0, 1]], axis=1) @ law).T
        worst = np.maximum(worst, np.sqrt(xx**2 - xx * yy + yy**2 + 3 * xy**2))
    area = np.linalg.norm(area_vectors(mesh.vertices_m, faces), axis=1) * np.asarray(mesh.fraction)
    corners, count = faces.ravel(), len(mesh.vertices_m)
    sums = np.bincount(corners, np.repeat(area * worst, 3), count)
    whole = np.bincount(corners, np.repeat(area, 3), count)
    return np.divide(sums, whole, out=np.zeros(count), where=whole > 0)


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
