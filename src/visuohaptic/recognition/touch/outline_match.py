"""Variant of a container class whose outline is closest to a measured one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...deformation import ContainerDescription, draw_variants, mesh_container

#: Compared heights, as fractions of the object's height: the foot and the closure are not part of the shape.
FRACTIONS = np.linspace(0.05, 0.9, 20)


def container_outline(description: ContainerDescription, around: int = 32) -> Float[np.ndarray, "k 2"]:
    """Radius and height [m] of the rings of a round container, from the bottom up.

    Parameters
    ----------
    description
        The container.
    around
        Number of vertices of a ring.
    """
    thing = mesh_container(description, around=around)
    points = thing.mesh.vertices_m[np.unique(thing.mesh.faces)]
    heights = np.unique(points[:, 2].round(6))
    radius = [np.hypot(*points[np.abs(points[:, 2] - z) < 2e-6, :2].T).max() for z in heights]
    return np.column_stack([radius, heights])


def nearest_variant(
    base: ContainerDescription, outline_m: Float[np.ndarray, "k 2"], *, count: int = 24
) -> ContainerDescription:
    """Variant whose radii and height fit a measured outline best, by least squares.

    Parameters
    ----------
    base
        Description of the class.
    outline_m
        Radius and height [m], from the bottom up.
    count
        Number of variants that are compared.
    """
    measured = np.interp(FRACTIONS, outline_m[:, 1] / outline_m[-1, 1], outline_m[:, 0])

    def residual(variant: ContainerDescription) -> float:
        profile = container_outline(variant, 16)
        radius = np.interp(FRACTIONS, profile[:, 1] / profile[-1, 1], profile[:, 0])
        return float(np.sum((radius - measured) ** 2)) + (profile[-1, 1] - outline_m[-1, 1]) ** 2

    return min(draw_variants(base, count, 0), key=residual)
