"""Stiffness maps with a standard deviation from the spread of wall and material.

The wall dominates: with ``k ~ t^p`` and p about 2, a wall that is known to 10 % leaves 20 % in k. The
exponent is not taken from a rule: the map is computed a second time with a wall 2 % thicker.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ...core.objects import StiffnessMap
from ..nonlinear.contents import Contents, closed_compliance
from ..shapes.mesher import ShellObject
from ..shells.laminate import Laminate
from ..shells.shell import ShellMesh, ShellModel
from ..shells.shell_material import IsotropicMaterial
from ..shells.stiffness_map import DualTips, dual_tip_map, opposing_points

__all__ = ["object_map", "object_stiffness"]

#: Relative step of the differences.
STEP = 0.02


def object_map(
    container: ShellObject, contents: Contents | None = None, *, band: bool = True
) -> StiffnessMap:
    """Stiffness of every vertex of an object, with its standard deviation.

    Parameters
    ----------
    container
        Parametric or imported container.
    contents
        Open by default.
    band
        False leaves the second factorisation out; sigma is NaN.

    Returns
    -------
    StiffnessMap
        Infinite where both tips are on what is held, NaN where there is nothing opposite.

    Examples
    --------
    >>> from visuohaptic.deformation.shapes import load_object
    >>> stiffness = object_map(load_object("cup", around=32))
    >>> value, sigma = stiffness.stiffness_N_per_m, stiffness.stiffness_sigma_N_per_m
    >>> finite = np.isfinite(value)
    >>> bool((value[finite] > 0).all()), bool((sigma[finite] > 0).all())
    (True, True)
    """
    tips = opposing_points(container.mesh, axis_point_m=container.axis_point_m)
    stiffness, sigma = object_stiffness(container, tips, contents, band=band)
    return StiffnessMap(container.mesh.vertices_m, container.surface_faces, stiffness, sigma)


def object_stiffness(
    container: ShellObject, tips: DualTips, contents: Contents | None = None, *, band: bool = True
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Stiffness of some pinches and its standard deviation [N/m].

    Parameters
    ----------
    container
        Parametric or imported container.
    tips
        Pairs of opposing contacts on it, see :func:`.opposing_points`.
    contents
        What is enclosed; open by default.
    band
        False leaves the second factorisation out; sigma is NaN.

    Returns
    -------
    tuple
        Stiffness and standard deviation of the m pairs [N/m]; infinite where both tips are held, NaN where nothing
        is opposite.
    """
    stiffness = _stiffness(container, container.material, 1.0, tips, contents)
    if not band:
        return stiffness, np.full_like(stiffness, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        thicker = _stiffness(container, container.material, 1 + STEP, tips, contents)
        by_wall = np.log(thicker / stiffness) / np.log1p(STEP)
        by_modulus = np.ones_like(stiffness)
        if contents is not None and contents.closed:
            stiffer = container.material.stiffer(1 + STEP)
            by_modulus = np.log(_stiffness(container, stiffer, 1.0, tips, contents) / stiffness) / np.log1p(
                STEP
            )
        relative = np.hypot(by_wall * container.wall_spread, by_modulus * container.youngs_modulus_spread)
        sigma = stiffness * relative
    return stiffness, np.where(np.isfinite(stiffness), sigma, np.nan)


def _stiffness(
    container: ShellObject,
    constants: IsotropicMaterial | Laminate,
    thicker: float,
    tips: DualTips,
    contents: Contents | None,
) -> Float[np.ndarray, "m"]:
    mesh = container.mesh
    if thicker != 1.0:
        mesh = ShellMesh(mesh.vertices_m, mesh.faces, np.asarray(mesh.thickness_m) * thicker, mesh.fraction)
    model = ShellModel(mesh, constants, container.fixed, springs=container.springs)
    stiffness = dual_tip_map(model, tips)
    if contents is None or not contents.closed:
        return stiffness
    with np.errstate(divide="ignore"):
        return 2.0 / closed_compliance(container, model, tips, 2.0 / stiffness, [contents])[0]


def nearest_value(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    values: Float[np.ndarray, "v"],
    point_m: Float[np.ndarray, "3"],
) -> tuple[float, Float[np.ndarray, "3"]]:
    """A map at the surface point nearest to a point, and that point.

    Between vertices the compliance is linear: it is finite where the wall is held.
    """
    # No point of a face is nearer than its centre less its radius, and none needs to be farther than a corner.
    corners = vertices_m[faces]
    centre = corners.mean(axis=1, keepdims=True)
    radius = np.linalg.norm(corners - centre, axis=2).max(axis=1)
    nearest = np.linalg.norm(corners - point_m, axis=2).min()
    some = faces[np.linalg.norm(centre[:, 0] - point_m, axis=1) - radius <= nearest]
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for face in some:
        fraction = _nearest_in_triangle(vertices_m[face], point_m)
        place = fraction @ vertices_m[face]
        away = float(np.linalg.norm(place - point_m))
        if best is None or away < best[0]:
            best = away, fraction, face
    assert best is not None
    _, fraction, face = best
    with np.errstate(divide="ignore"):
        compliance = 1.0 / values[face]
        value = float(
            1.0 / np.sum(np.where(fraction > 0, fraction * compliance, 0.0))
        )  # infinite on the held base
    return value, fraction @ vertices_m[face]


def _nearest_in_triangle(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    edge_1, edge_2 = corners[1] - corners[0], corners[2] - corners[0]
    gram = np.array([[edge_1 @ edge_1, edge_1 @ edge_2], [edge_1 @ edge_2, edge_2 @ edge_2]])
    u, v = np.linalg.solve(gram, np.array([edge_1 @ (point - corners[0]), edge_2 @ (point - corners[0])]))
    fraction = np.array([1 - u - v, u, v])
    if (fraction >= 0).all():
        return fraction
    best, found = np.inf, fraction
    for i, j in ((0, 1), (1, 2), (2, 0)):
        side = corners[j] - corners[i]
        t = float(np.clip((point - corners[i]) @ side / (side @ side), 0.0, 1.0))
        away = float(np.linalg.norm(corners[i] + t * side - point))
        if away < best:
            best, found = away, np.zeros(3)
            found[i], found[j] = 1 - t, t
    return found
