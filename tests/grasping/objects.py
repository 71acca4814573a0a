"""Objects of known shape and stiffness."""

from __future__ import annotations

import numpy as np

from visuohaptic.core import StiffnessMap
from visuohaptic.deformation.shapes import ContainerDescription, ShellObject, mesh_container, tube_mesh


def tube_map(radius_m: float, height_m: float, stiffness: float, around: int = 96) -> StiffnessMap:
    """A round tube with one stiffness everywhere, exactly known."""
    along = max(2, round(height_m / (2 * np.pi * radius_m / around)))
    mesh = tube_mesh(radius_m, height_m, 1e-3, around=around, along=along, crossed=False)
    count = len(mesh.vertices_m)
    return StiffnessMap(mesh.vertices_m, mesh.faces, np.full(count, stiffness), np.zeros(count))


def box_map(half_m: float, height_m: float, stiffness: float, cells: int = 40) -> StiffnessMap:
    """Two parallel square plates, x = -half and x = +half, facing away from each other."""
    side = np.linspace(-height_m / 2, height_m / 2, cells + 1)
    y, z = (part.ravel() for part in np.meshgrid(side, side + height_m / 2))
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    d, c = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    points = np.concatenate([np.stack([np.full_like(y, s * half_m), y, z], 1) for s in (1, -1)])
    faces = np.concatenate([faces, faces[:, ::-1] + len(y)])
    count = len(points)
    return StiffnessMap(points, faces, np.full(count, stiffness), np.zeros(count))


def container(around: int = 32, even: bool = False, **changes: object) -> ShellObject:
    """A tube of 35 mm radius and 200 mm height, open above."""
    document: dict[str, object] = {
        "base": {"radius": "35 mm"},
        "sections": [{"height": "200 mm"}],
        "wall": "0.5 mm",
        "material": "PET",
        **changes,
    }
    return mesh_container(ContainerDescription.model_validate(document), around=around, even=even)
