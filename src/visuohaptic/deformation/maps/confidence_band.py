"""Stiffness maps with a standard deviation, from the uncertainty of wall thickness and material.

The wall thickness dominates: with ``k ~ t^p`` and p about 2, an uncertainty of 10 % in thickness causes 20 % in k. The
exponent is computed, not assumed: the map is computed a second time with a wall 2 % thicker.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from ...core.objects import StiffnessMap
from ..nonlinear.contents import Contents, closed_compliance
from ..shapes.mesher import ShellObject
from ..shells.shell import ShellMesh
from ..shells.stiffness_map import DualTips, dual_tip_map, opposing_points

#: Relative step of the finite differences.
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
        False skips the second factorisation; sigma is NaN.

    Returns
    -------
    StiffnessMap
        Infinite where both tips are on fixed vertices, NaN where there is no opposite wall.

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
    """Stiffness of selected pinches and its standard deviation [N/m].

    Parameters
    ----------
    container
        Parametric or imported container.
    tips
        Pairs of opposing contacts on it, see :func:`.opposing_points`.
    contents
        Contents; open by default.
    band
        False skips the second factorisation; sigma is NaN.

    Returns
    -------
    tuple
        Stiffness and standard deviation of the m pairs [N/m]; infinite where both tips are fixed, NaN where there is
        no opposite wall.
    """
    return stiffness_band(container, lambda body: _stiffness(body, tips, contents), contents, band=band)


def stiffness_band(
    container: ShellObject,
    stiffness_of: Callable[[ShellObject], Float[np.ndarray, "m"]],
    contents: Contents | None = None,
    *,
    band: bool = True,
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Stiffness and its standard deviation, from the same object with a thicker wall and, if it is closed, a stiffer material.

    Parameters
    ----------
    container
        Parametric or imported container.
    stiffness_of
        Returns the stiffness of m pinches of an object [N/m].
    contents
        Contents; open by default.
    band
        False skips the other objects; sigma is NaN.

    Returns
    -------
    tuple
        Stiffness and standard deviation [N/m]; NaN where the stiffness is not finite.
    """
    stiffness = stiffness_of(container)
    if not band:
        return stiffness, np.full_like(stiffness, np.nan)

    def exponent(body: ShellObject) -> Float[np.ndarray, "m"]:
        return np.log(stiffness_of(body) / stiffness) / np.log1p(STEP)

    mesh = container.mesh
    wall = ShellMesh(mesh.vertices_m, mesh.faces, np.asarray(mesh.thickness_m) * (1 + STEP), mesh.fraction)
    with np.errstate(invalid="ignore", divide="ignore"):
        by_wall, by_modulus = exponent(replace(container, mesh=wall)), np.ones_like(stiffness)
        if contents is not None and contents.closed:
            by_modulus = exponent(replace(container, material=container.material.stiffer(1 + STEP)))
        relative = np.hypot(by_wall * container.wall_spread, by_modulus * container.youngs_modulus_spread)
        sigma = stiffness * relative
    return stiffness, np.where(np.isfinite(stiffness), sigma, np.nan)


def _stiffness(container: ShellObject, tips: DualTips, contents: Contents | None) -> Float[np.ndarray, "m"]:
    model = container.model()
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
    """Map value at the surface point nearest to a point, and that surface point.

    Between vertices the compliance is interpolated linearly: it is finite where the wall is fixed.

    Parameters
    ----------
    vertices_m
        Vertices of the surface [m], (v, 3).
    faces
        Their triangles, (f, 3).
    values
        Stiffness at the vertices, infinite where the wall is fixed, (v,).
    point_m
        Position [m], (3,).
    """
    corners = vertices_m[faces]
    fraction = _nearest_in_triangles(corners, point_m)
    places = np.einsum("fk,fki->fi", fraction, corners)
    best = int(np.argmin(np.linalg.norm(places - point_m, axis=1)))
    share = fraction[best]
    with np.errstate(divide="ignore"):
        compliance = 1.0 / values[faces[best]]
        value = float(1.0 / np.sum(np.where(share > 0, share * compliance, 0.0)))  # infinite on a fixed base
    return value, places[best]


def barycentric(
    corners: Float[np.ndarray, "f 3 3"], points: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f 3"]:
    """Barycentric weights of the projection of a point onto the plane of each triangle.

    Parameters
    ----------
    corners, points
        Triangles, and one point per triangle or one for all.
    """
    sides, away = corners[:, 1:] - corners[:, :1], points - corners[:, 0]
    (ee, ef), (_, ff) = np.moveaxis(np.einsum("fai,fbi->fab", sides, sides), 0, -1)
    ge, gf = np.einsum("fai,fi->af", sides, away)
    low = np.maximum(ee * ff - ef * ef, 1e-300)
    v, w = (ff * ge - ef * gf) / low, (ee * gf - ef * ge) / low
    return np.column_stack([1 - v - w, v, w])


def _nearest_in_triangles(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Barycentric weights of the nearest point of each triangle, which is its projection or on an edge."""
    found = barycentric(corners, point)
    nearest = np.where((found >= 0).all(axis=1), 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        side, away = corners[:, j] - corners[:, i], point - corners[:, i]
        t = np.clip(np.einsum("fi,fi->f", away, side) / np.einsum("fi,fi->f", side, side), 0.0, 1.0)
        distance = np.linalg.norm(away - t[:, None] * side, axis=1)
        closer = distance < nearest
        found[closer] = np.outer(1 - t, np.eye(3)[i])[closer] + np.outer(t, np.eye(3)[j])[closer]
        nearest = np.minimum(nearest, distance)
    return found
