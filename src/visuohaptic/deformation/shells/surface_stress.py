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
    (p, q), (r, s) = sides
    inverse = np.array([[s, -q], [-r, p]]) / (p * s - q * r)
    before = _product(turns, inverse)
    half = 0.5 * np.broadcast_to(np.asarray(mesh.thickness_m), len(faces))
    law = plane_stress(material)
    area = np.linalg.norm(area_vectors(mesh.vertices_m, faces), axis=1) * np.asarray(mesh.fraction)
    corners = faces.ravel()
    whole = np.bincount(corners, np.repeat(area, 3), count)
    out = np.zeros(points_m.shape[:-1])
    for points, found in zip(points_m.reshape(-1, count, 3), out.reshape(-1, count), strict=True):
        sides, turns = _frames(points, faces)
        gradient = _product(sides, inverse)
        turned = np.swapaxes(gradient, 0, 1)
        membrane = 0.5 * (_product(turned, gradient) - np.eye(2)[..., None])
        # Both curvatures in the coordinates of the undeformed triangle; those of the deformed one are
        # ``turns sides^-1``, and ``sides^-1 gradient`` is the inverse of the undeformed sides.
        bent = _product(_product(turned, turns), inverse) - before
        curvature = 0.5 * (bent + np.swapaxes(bent, 0, 1))
        worst = np.zeros(len(faces))
        for side in (half, -half):
            strain = membrane + side * curvature
            xx, yy, xy = law @ np.stack([strain[0, 0], strain[1, 1], 2 * strain[0, 1]])
            worst = np.maximum(worst, np.sqrt(xx**2 - xx * yy + yy**2 + 3 * xy**2))
        sums = np.bincount(corners, np.repeat(area * worst, 3), count)
        np.divide(sums, whole, out=found, where=whole > 0)
    return out


def _frames(
    points: Float[np.ndarray, "v 3"], faces: np.ndarray
) -> tuple[Float[np.ndarray, "2 2 f"], Float[np.ndarray, "2 2 f"]]:
    """Two sides of each triangle in its plane (columns), and the change of the normals along them."""
    a, b, c = points.T[:, faces.T].swapaxes(0, 1)
    first, second = b - a, c - a
    x = first / np.sqrt(np.sum(first**2, axis=0))
    z = np.cross(first, second, axis=0)
    z /= np.sqrt(np.sum(z**2, axis=0))
    plane = np.stack([x, np.cross(z, x, axis=0)])
    u, v, w = vertex_normals(points, faces).T[:, faces.T].swapaxes(0, 1)
    sides, turns = np.stack([first, second], axis=1), np.stack([v - u, w - u], axis=1)
    return _product(plane, sides), _product(plane, turns)


def _product(a: Float[np.ndarray, "i j f"], b: Float[np.ndarray, "j k f"]) -> Float[np.ndarray, "i k f"]:
    """Matrix product of each face; faces come last, so that every operation runs over all of them."""
    out: np.ndarray = sum(a[:, j, None] * b[j] for j in range(len(b)))
    return out
