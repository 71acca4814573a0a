"""Variants sampled from a class: a low-discrepancy sequence over its ranges; invalid shapes are skipped; and the one of a measured outline."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core import InputError, check_numbers, within
from .container import ContainerDescription
from .mesher import mesh_container
from .wall_profile import WallProfile

#: Compared heights, as fractions of the object's height: the foot and the closure are not part of the shape.
FRACTIONS = np.linspace(0.05, 0.9, 20)

#: Maximum number of points of the sequence tried for one variant.
ATTEMPTS = 16
#: Length of the sequence: scipy's generator has 30 bits, more than any class needs.
MAX_VARIANTS = 2**20


def draw_variants(container: ContainerDescription, count: int, seed: int) -> list[ContainerDescription]:
    """Containers distributed evenly over the ranges of a class (Sobol sequence, shifted by the seed).

    Parameters
    ----------
    container
        Class, with ranges.
    count
        Number of variants; variant k does not depend on it.
    seed
        Seed of the shift.
    """
    return [draw_variant(container, index, seed) for index in range(count)]


def draw_variant(container: ContainerDescription, index: int, seed: int) -> ContainerDescription:
    """One member of a class; the same number and seed always give the same one.

    Parameters
    ----------
    container
        Class, with ranges; without ranges it is returned itself.
    index
        Number of the variant, from 0.
    seed
        Seed of the shift of the Sobol sequence.

    Raises
    ------
    InputError
        A number out of range, or no valid shape near this point of the sequence.
    """
    from scipy.stats import qmc

    check_numbers(f"class {container.name}", within(0, MAX_VARIANTS - 1), variant=index)
    names = container.free_parameters
    if not names:
        return container.middle()
    for attempt in range(ATTEMPTS):
        # Each retry has its own shift: variants do not change when another is skipped. A
        # shift instead of scipy's scrambling keeps a seed's variants the same in all versions of scipy.
        shift = np.random.default_rng([seed, attempt]).random(len(names))
        sobol = qmc.Sobol(len(names), scramble=False)
        if index:
            sobol.fast_forward(index)
        found = container.at((sobol.random(1)[0] + shift) % 1.0)
        try:
            WallProfile.of(found)
        except InputError as error:
            problem = error
            continue
        return found
    raise InputError(
        f"class {container.name}",
        f"no variant {index} has a valid shape; the last: {problem}",
        remedy="narrow the ranges",
    )


def container_outline(description: ContainerDescription, around: int = 32) -> Float[np.ndarray, "k 2"]:
    """Radius and height [m] of the rings of a round container, from the bottom up.

    Parameters
    ----------
    description
        The container.
    around
        Number of vertices of a ring.
    """
    container = mesh_container(description, around=around)
    points = container.mesh.vertices_m[np.unique(container.mesh.faces)]
    heights = np.unique(points[:, 2].round(6))
    radius = [np.hypot(*points[np.abs(points[:, 2] - z) < 2e-6, :2].T).max() for z in heights]
    return np.column_stack([radius, heights])


def axis_ratio(description: ContainerDescription) -> float:
    """Ratio of the widths along y and x that fits the side of a container best, by least squares over its height; 1 if its foot is round.

    Parameters
    ----------
    description
        The container.
    """
    if description.base.radius_y is None:
        return 1.0
    container = mesh_container(description, around=32)
    points = container.mesh.vertices_m[np.unique(container.mesh.faces)]
    height_m, ring = np.unique(points[:, 2].round(6), return_inverse=True)
    half_m = np.zeros((2, len(height_m)))
    for axis in range(2):
        np.maximum.at(half_m[axis], ring, np.abs(points[:, axis]))
    x, y = (np.interp(FRACTIONS * height_m[-1], height_m, half) for half in half_m)
    return float(x @ y / (x @ x))


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
