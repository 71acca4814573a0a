"""Stiffness features from force-deformation curves: i, I and II of every place (Alt 2016, Sec. 6.1.6).

A curve takes a hundred times what a linear stiffness takes, so curves are computed on a coarser
mesh, or at a few heights. What they say is how a coefficient departs from the linear stiffness of
the same point and mesh; this departure is put between the heights and on the finer mesh, where the
linear stiffness itself is exact at each place. On smooth walls the departure varies slowly along the
height; where grooves snap through it does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from .contents import Contents
from .features import (
    HEIGHTS,
    NOMINAL_N,
    SIDES,
    LOW_m,
    StiffnessFeatures,
    curve_coefficients,
    feature_locations,
    linear_features,
)
from .grasp_curve import DEFORMATIONS_m, PinchPlane
from .mesher import ShellObject
from .symmetric_part import detect_symmetry

__all__ = ["nonlinear_features"]

#: Of Newton's method for one curve: three times what most need. A wall that snaps through again and
#: again gets the coefficients of what was reached.
MOST_ITERATIONS = 100


def nonlinear_features(
    thing: ShellObject,
    contents: Contents | None = None,
    *,
    deformation_m: Sequence[float] = DEFORMATIONS_m,
    heights: Sequence[int] | None = None,
    fill_in: bool = False,
    coarse: ShellObject | None = None,
) -> StiffnessFeatures:
    """Features from force-deformation curves under large deformation.

    Parameters
    ----------
    thing
        The object.
    contents
        Open by default.
    deformation_m
        Mean deformations of both tips; a curve ends earlier where the walls touch. Where linear
        elasticity asks for more than the nominal 50 N at 3 mm, all are less in the same proportion.
    heights
        Of 1 .. 16, where curves are computed; all by default.
    fill_in
        Put the departure from the linear stiffness between these heights; NaN there otherwise.
    coarse
        The same object with a coarser mesh, for the curves.
    """
    chosen = list(range(1, HEIGHTS + 1)) if heights is None else sorted(set(heights))
    if not chosen or not 1 <= chosen[0] <= chosen[-1] <= HEIGHTS:
        raise InputError("nonlinear_features", f"found {heights}, expected 1 to {HEIGHTS}", field="heights")
    linear = linear_features(thing, contents)
    body = thing if coarse is None else coarse
    points, corners, weights = feature_locations(body)
    nearest = np.take_along_axis(corners, weights.argmax(axis=2)[..., None], axis=2)[..., 0]
    departure = np.full((HEIGHTS, len(SIDES), 3), np.nan)
    at_m, reached = np.full((2, HEIGHTS, len(SIDES)), np.nan)
    round_ = detect_symmetry(body).round
    for axis in range(1 if round_ else 2):
        plane = PinchPlane(body, axis * np.pi / 2, one_way=True)
        for height in chosen:
            row, column = height - 1, 2 * axis
            vertex = int(nearest[row, column])
            if not plane.can_pinch(vertex):
                continue
            found, share = _departure(plane, vertex, deformation_m, contents)
            departure[row, column : column + 2] = found
            reached[row, column : column + 2] = share
            at_m[row, column : column + 2] = body.mesh.vertices_m[vertex, 2]
    if round_:
        for grid in (departure, at_m, reached):
            grid[:, 2:] = grid[:, :2]
    if fill_in:
        departure = _between(departure, at_m, points[..., 2])
    # II has the unit of stiffness by deformation: it goes with the linear stiffness as well.
    return StiffnessFeatures(linear.values[..., :1] * departure, linear.points_m, reached)


def _departure(
    plane: PinchPlane, vertex: int, deformation_m: Sequence[float], contents: Contents | None
) -> tuple[Float[np.ndarray, "2 3"], float]:
    """i, I, II of both tips by the linear stiffness of the same mesh, and how far the curve got."""
    out = np.full((2, 3), np.nan)
    compliance = plane.linear(vertex, contents)
    share = min(1.0, NOMINAL_N * float(compliance.mean()) / LOW_m)
    curve = plane.curve(
        vertex,
        deformation_m=[share * value for value in deformation_m],
        contents=contents,
        most_iterations=MOST_ITERATIONS,
    )
    if not len(curve.force_N):
        return out, 0.0
    for row, own, linear in zip(out, (curve.first_m, curve.second_m), compliance, strict=True):
        row[:] = np.array(curve_coefficients(own, curve.force_N)) * linear
    return out, float(curve.deformation_m[-1] / (share * deformation_m[-1]))


def _between(
    departure: Float[np.ndarray, "16 4 3"],
    at_m: Float[np.ndarray, "16 4"],
    level_m: Float[np.ndarray, "16 4"],
) -> Float[np.ndarray, "16 4 3"]:
    from scipy.interpolate import PchipInterpolator

    out = departure.copy()
    for side in range(departure.shape[1]):
        for k in range(departure.shape[2]):
            known: Int[np.ndarray, "_"] = np.flatnonzero(np.isfinite(departure[:, side, k]))
            if not len(known):
                continue
            places, first = np.unique(at_m[known, side], return_index=True)
            values = departure[known[first], side, k]
            if len(places) == 1:
                out[:, side, k] = values[0]
                continue
            level = np.clip(level_m[:, side], places[0], places[-1])
            out[:, side, k] = PchipInterpolator(places, values)(level)
    return out
