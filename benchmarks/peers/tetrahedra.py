"""The published baseline: a wall filled with linear tetrahedra (Alt 2016, Secs. 2.2.5, 6.1.1, 6.1.3).

Kept for comparison only. A linear tetrahedron has constant strain and cannot bend: one layer of
them over a thin wall is several times too stiff, by a factor that depends on the orientation of its diagonals;
therefore maps of round objects are not uniform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from visuohaptic.core import InputError
from visuohaptic.deformation.shells import Factor, IsotropicMaterial, ShellMesh, factorise, front_tree

__all__ = ["SolidMesh", "linear_tetrahedra", "wall_tetrahedra"]


@dataclass(frozen=True, slots=True, eq=False)
class SolidMesh:
    """A wall as tetrahedra; with ``layers`` layers each shell vertex becomes ``layers + 1`` nodes."""

    points_m: Float[np.ndarray, "n 3"]
    tetrahedra: Int[np.ndarray, "e 4"]
    layers: int

    def through(self, vertex: int) -> Int[np.ndarray, " layers+1"]:
        """The nodes through the wall at one vertex of the shell, from inside out."""
        return vertex * (self.layers + 1) + np.arange(self.layers + 1)


def wall_tetrahedra(mesh: ShellMesh, layers: int = 1) -> SolidMesh:
    """Grow a mid-surface to both sides by half its thickness and cut each prism into three.

    Raises
    ------
    InputError
        The wall is thicker than it is curved: the offset turns a tetrahedron inside out.
    """
    if np.any(np.asarray(mesh.fraction) != 1):
        raise InputError("wall_tetrahedra", "the mesh has crossed cells", remedy="make it with crossed=False")
    points, faces = mesh.vertices_m, np.asarray(mesh.faces)
    area = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    normal = np.zeros_like(points)
    wall, weight = np.zeros(len(points)), np.zeros(len(points))
    size = np.linalg.norm(area, axis=1)
    for k in range(3):
        np.add.at(normal, faces[:, k], area)
        np.add.at(wall, faces[:, k], size * np.asarray(mesh.thickness_m))
        np.add.at(weight, faces[:, k], size)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    half = 0.5 * wall / np.maximum(weight, 1e-300)
    steps = np.linspace(-1, 1, layers + 1)
    nodes = points[:, None] + (half[:, None] * steps)[:, :, None] * normal[:, None]
    # Corners in the order of their numbers: neighbours then agree on the diagonal of a shared side.
    ordered = np.sort(faces, axis=1)
    a, b, c = faces.T
    odd = (b - a) * (c - b) * (c - a) < 0
    cells = []
    for layer in range(layers):
        a, b, c = (ordered[:, k] * (layers + 1) + layer for k in range(3))
        for cell in ((a, b, c, c + 1), (a, b, c + 1, b + 1), (a, b + 1, c + 1, a + 1)):
            stacked = np.stack(cell, axis=1)
            stacked[odd] = stacked[odd][:, [1, 0, 2, 3]]
            cells.append(stacked)
    tetrahedra = np.concatenate(cells)
    flat = nodes.reshape(-1, 3)
    edges = flat[tetrahedra[:, 1:]] - flat[tetrahedra[:, :1]]
    volume = np.linalg.det(edges)
    if not (volume > 0).all():
        place = ", ".join(f"{value:.4g}" for value in flat[tetrahedra[np.argmin(volume), 0]])
        raise InputError(
            "wall_tetrahedra", f"the wall folds over itself at ({place}) m", remedy="take a thinner wall"
        )
    return SolidMesh(flat, tetrahedra, layers)


def linear_tetrahedra(
    solid: SolidMesh,
    material: IsotropicMaterial | str,
    fixed: Bool[np.ndarray, " n"],
) -> Factor:
    """Factored stiffness, three degrees of freedom per node; ``fixed`` nodes do not move."""
    from visuohaptic.deformation.shells._front_kernels import constrain

    lame, shear = IsotropicMaterial.of(material).lame_Pa
    corners = solid.points_m[solid.tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(edges) / 6
    slopes = np.empty((len(edges), 4, 3))
    slopes[:, 1:] = np.linalg.inv(edges).transpose(0, 2, 1)
    slopes[:, 0] = -slopes[:, 1:].sum(axis=1)
    # K_ab = V (lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I), the gradient form of (2.4) at rest.
    outer = np.einsum("eai,ebj->eaibj", slopes, slopes)
    dot = np.einsum("eai,ebi->eab", slopes, slopes)
    matrices = lame * outer + shear * outer.transpose(0, 1, 4, 3, 2)
    matrices += shear * np.einsum("eab,ij->eaibj", dot, np.eye(3))
    matrices = np.ascontiguousarray((volume[:, None, None, None, None] * matrices).reshape(-1, 12, 12))
    held = np.repeat(np.asarray(fixed, dtype=bool)[:, None], 3, axis=1)
    constrain(matrices, solid.tetrahedra, held)
    tree = front_tree(solid.points_m, solid.tetrahedra)
    return factorise(tree, matrices, held.astype(float))
