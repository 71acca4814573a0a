"""Stiffness features from force-deformation curves: i, I and II at every location (Alt 2016, Sec. 6.1.6).

A curve takes a hundred times as long as a linear stiffness, so curves are computed on a coarser
mesh, or at a few heights. From each curve, the deviation of a coefficient from the linear stiffness of
the same point and mesh is computed; this deviation is interpolated between the heights and to the finer mesh, where the
linear stiffness itself is exact at each location. On smooth walls the deviation varies slowly with
height; where grooves snap through it does not.

Coefficients that depend on the mesh are marked: where a curve ends early, the wall snaps through, or a
parabola does not fit the curve, coefficients are not valid, and the reason is given.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...core.errors import InputError
from ...core.objects import HEIGHTS, NOMINAL_N, SIDES, LOW_m
from ..nonlinear.contents import Contents
from ..shapes import ShellObject, is_round
from .features import (
    HELD,
    NOTHING_OPPOSITE,
    StiffnessFeatures,
    curve_coefficients,
    feature_locations,
    linear_features,
)
from .grasp_curves import DEFORMATIONS_m, GraspCurve, PinchPlane

#: Maximum Newton iterations for one curve: three times what most curves need. A wall that snaps through repeatedly
#: gets the coefficients of the part that was computed.
MAX_ITERATIONS = 100
#: RMS distance between curve and fitted parabola, relative to the RMS force, above which II is not meaningful.
MAX_RESIDUAL = 0.2
#: Distance in cells of the curves' mesh to a fixed boundary, below which II depends on the mesh.
MIN_CELLS = 2.0
#: Reason where no curve was requested.
NO_CURVE = "no curve was computed here"


def nonlinear_features(
    container: ShellObject,
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
    container
        The object.
    contents
        Open by default.
    deformation_m
        Mean deformations of both tips; a curve ends earlier at self-contact. Where linear
        elasticity predicts more than the nominal 50 N at 3 mm, all are reduced in the same proportion.
    heights
        Heights out of 1 .. 16 at which curves are computed; all by default.
    fill_in
        Interpolate the deviation from the linear stiffness between these heights; NaN there otherwise.
    coarse
        The same object with a coarser mesh, for the curves. Its vertices are pinched, so it needs vertices
        at the heights of the features, as with ``mesh_container(..., levels=16)``.
    """
    chosen = list(range(1, HEIGHTS + 1)) if heights is None else sorted(set(heights))
    if not chosen or not 1 <= chosen[0] <= chosen[-1] <= HEIGHTS:
        raise InputError("nonlinear_features", f"found {heights}, expected 1 to {HEIGHTS}", field="heights")
    linear = linear_features(container, contents)
    body = container if coarse is None else coarse
    points, corners, weights = feature_locations(body)
    nearest = np.take_along_axis(corners, weights.argmax(axis=2)[..., None], axis=2)[..., 0]
    departure = np.full((HEIGHTS, len(SIDES), 3), np.nan)
    at_m, reached = np.full((2, HEIGHTS, len(SIDES)), np.nan)
    valid = np.zeros(departure.shape, dtype=bool)
    reason = np.full((HEIGHTS, len(SIDES)), NO_CURVE, dtype=object)
    close = _close_to_an_end(body)
    round_ = is_round(body)
    for axis in range(1 if round_ else 2):
        plane = PinchPlane(body, axis * np.pi / 2, one_way=True)
        for height in chosen:
            row, column = height - 1, 2 * axis
            both = slice(column, column + 2)
            vertex = int(nearest[row, column])
            if not plane.can_pinch(vertex):
                reason[row, both] = HELD if body.fixed[vertex] else NOTHING_OPPOSITE
                continue
            departure[row, both], reached[row, both], valid[row, both], reason[row, both] = _departure(
                plane, vertex, deformation_m, contents
            )
            if valid[row, column, 2] and close[vertex]:
                valid[row, both, 2], reason[row, both] = False, close[vertex]
            at_m[row, both] = body.mesh.vertices_m[vertex, 2]
    if round_:
        for grid in (departure, at_m, reached, valid, reason):
            grid[:, 2:] = grid[:, :2]
    if fill_in:
        departure, valid, reason = _between(departure, at_m, points[..., 2], valid, reason)
    # II has the unit of stiffness per deformation: it also scales with the linear stiffness.
    values = linear.values[..., :1] * departure
    return StiffnessFeatures(
        values, linear.points_m, valid & np.isfinite(values), reason.astype(np.str_), reached
    )


def _close_to_an_end(body: ShellObject) -> Shaped[np.ndarray, "v"]:
    """For each vertex, the fixed boundary within two cells of it, or an empty string.

    The stiffness increases steeply there, and cells as large as the distance to the foot do not resolve this.
    """
    points, faces = body.mesh.vertices_m, body.surface_faces
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    reach = MIN_CELLS * float(np.sqrt(np.median(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))))
    low, high = points[faces, 2].min(), points[faces, 2].max()
    out = np.full(len(points), "", dtype=object)
    out[points[:, 2] < low + reach] = "within two cells of the foot: II is that of the mesh"
    used = np.unique(faces)
    away = np.linalg.norm(points[used, :2] - np.array(body.axis_point_m), axis=1)
    top = points[used, 2] > high - 0.01 * (high - low)
    if away[top].min() < 0.3 * away[top].max():
        out[points[:, 2] > high - reach] = "within two cells of the cap: II is that of the mesh"
    return out


def _departure(
    plane: PinchPlane, vertex: int, deformation_m: Sequence[float], contents: Contents | None
) -> tuple[Float[np.ndarray, "2 3"], float, Bool[np.ndarray, "3"], str]:
    """i, I, II of both tips relative to the linear stiffness of the same mesh; range of the curve; validity."""
    out = np.full((2, 3), np.nan)
    compliance = plane.linear(vertex, contents)
    fraction = min(1.0, NOMINAL_N * float(compliance.mean()) / LOW_m)
    steps_m = [fraction * value for value in deformation_m]
    curve = plane.curve(vertex, deformation_m=steps_m, contents=contents, max_iterations=MAX_ITERATIONS)
    if not len(curve.force_N):
        return out, 0.0, np.zeros(3, dtype=bool), curve.reason
    for row, own, linear in zip(out, (curve.first_m, curve.second_m), compliance, strict=True):
        row[:] = np.array(curve_coefficients(own, curve.force_N)) * linear
    got = float(curve.deformation_m[-1] / steps_m[-1])
    return out, got, *_judged(curve, np.array(steps_m), got)


def _judged(
    curve: GraspCurve, wanted_m: Float[np.ndarray, "k"], got: float
) -> tuple[Bool[np.ndarray, "3"], str]:
    """Which of i, I, II are valid, and the reason if one is not."""
    if len(curve.force_N) < len(wanted_m):
        # i is fitted to the deformations up to 3 mm, I and II to all.
        low = wanted_m[wanted_m <= LOW_m * (1 + 1e-9)]
        enough = bool(len(low)) and len(curve.force_N) >= len(low)
        return np.array([enough, False, False]), f"the curve ends at {100 * got:.0f} %: {curve.reason}"
    force = np.r_[0.0, curve.force_N]
    if not curve.stable.all() or (np.diff(force) <= 0).any():
        return np.array([True, True, False]), "the wall snaps through: II depends on the mesh"
    d = np.r_[0.0, curve.deformation_m]
    terms = np.stack([d, d * d], axis=1)
    rest = force - terms @ np.linalg.lstsq(terms, force, rcond=None)[0]
    residual = float(np.linalg.norm(rest) / np.linalg.norm(force))
    if residual > MAX_RESIDUAL:
        return np.array([True, True, False]), f"the curve is {100 * residual:.0f} % from a parabola"
    return np.ones(3, dtype=bool), ""


def _between(
    departure: Float[np.ndarray, "16 4 3"],
    at_m: Float[np.ndarray, "16 4"],
    level_m: Float[np.ndarray, "16 4"],
    valid: Bool[np.ndarray, "16 4 3"],
    reason: Shaped[np.ndarray, "16 4"],
) -> tuple[Float[np.ndarray, "16 4 3"], Bool[np.ndarray, "16 4 3"], Shaped[np.ndarray, "16 4"]]:
    """Deviations of the curves at all levels; interpolated values are valid where both curves are valid."""
    from scipy.interpolate import PchipInterpolator

    out, sure, why = departure.copy(), valid.copy(), reason.copy()
    for side in range(departure.shape[1]):
        for k in range(departure.shape[2]):
            known: Int[np.ndarray, "_"] = np.flatnonzero(np.isfinite(departure[:, side, k]))
            if not len(known):
                continue
            places, first = np.unique(at_m[known, side], return_index=True)
            rows = known[first]
            values = departure[rows, side, k]
            level = np.clip(level_m[:, side], places[0], places[-1])
            out[:, side, k] = values[0] if len(places) == 1 else PchipInterpolator(places, values)(level)
            above = np.clip(np.searchsorted(places, level), 0, len(places) - 1)
            below = np.maximum(above - 1, 0)
            for row in np.setdiff1d(np.arange(len(out)), known):
                pair = rows[[below[row], above[row]]]
                sure[row, side, k] = valid[pair, side, k].all()
                reasons = [str(reason[other, side]) for other in pair if reason[other, side]]
                why[row, side] = f"between two curves, of which: {reasons[0]}" if reasons else ""
    return out, sure, why
