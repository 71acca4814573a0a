"""Conversion of a fitted outline to a contact primitive: kind, parameters, covariance (Alt 2016, Sec. 3.3.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import Primitive, PrimitiveKind, wrap_angle
from .contact_outline import OutlineFit
from .outline_hypotheses import Impression

#: Standard deviation of the end of a segment that is beyond the strip [m].
UNSEEN_END_SIGMA_M = 0.1
#: Standard deviation of the direction of an untouched edge of a corner: uniform over the possible directions [rad].
UNSEEN_EDGE_SIGMA_RAD = 0.4


def outline_kind(fit: OutlineFit, impression: Impression) -> tuple[PrimitiveKind, tuple[bool, bool]]:
    """Kind of a fitted outline, and which of its two ends or edges are observed.

    A face with one tip is the segment of a box if it extends beyond the end of
    the strip; if the foam detaches from it before, it is one edge of a corner.

    Parameters
    ----------
    fit
        Fitted outline.
    impression
        Measured contour.

    Returns
    -------
    kind : PrimitiveKind
    observed : tuple of bool
        Segment: left and right end observed; corner: left and right edge touched.
    """
    name = fit.hypothesis.name
    cut_left, cut_right = impression.cut
    if name == "line":
        return PrimitiveKind.LINE, (False, False)
    if name == "circle":
        return PrimitiveKind.CIRCLE, (True, True)
    if name == "two_tips":
        return PrimitiveKind.SEGMENT, (True, True)
    if name == "tip_left":
        runs_out = cut_right and fit.ends_m[1] >= impression.u_m[-1]
        return (PrimitiveKind.SEGMENT, (True, False)) if runs_out else (PrimitiveKind.CORNER, (False, True))
    if name == "tip_right":
        runs_out = cut_left and fit.ends_m[0] <= impression.u_m[0]
        return (PrimitiveKind.SEGMENT, (False, True)) if runs_out else (PrimitiveKind.CORNER, (True, False))
    if name == "point":
        return PrimitiveKind.CORNER, (False, False)
    tip = fit.theta[0]
    return PrimitiveKind.CORNER, (fit.ends_m[0] < tip - 1e-6, fit.ends_m[1] > tip + 1e-6)


def outline_primitive(
    kind: PrimitiveKind, fit: OutlineFit, impression: Impression, frame: Float[np.ndarray, "2 2"]
) -> Primitive:
    """Primitive in the frame of the points, with its covariance; its score is set to 0.

    Parameters
    ----------
    kind
        From :func:`outline_kind`.
    fit
        Fitted outline.
    impression
        Measured contour.
    frame
        Unit vectors of u and v in the frame of the points, as rows.
    """
    observed = outline_kind(fit, impression)[1]
    build = _builder(kind, fit, impression, _Axes(frame), observed)
    parameters = build(fit.theta)
    jacobian = np.zeros((len(parameters), len(fit.theta)))
    for j in fit.hypothesis.free:
        step = np.zeros(len(fit.theta))
        step[j] = 1e-6
        difference = build(fit.theta + step) - build(fit.theta - step)
        if kind in (PrimitiveKind.LINE, PrimitiveKind.CORNER):
            difference[2:] = wrap_angle(difference[2:])
        jacobian[:, j] = difference / 2e-6
    covariance = jacobian @ fit.covariance @ jacobian.T
    if kind == PrimitiveKind.CORNER and fit.hypothesis.name != "corner":
        unseen = [0.0 if seen else UNSEEN_EDGE_SIGMA_RAD**2 for seen in observed]
        covariance[np.diag_indices_from(covariance)] += [0.0, 0.0, *unseen]
    if kind == PrimitiveKind.SEGMENT:
        along = _direction(_Axes(frame).angle(1.0, fit.theta[1]))
        for index, seen in enumerate(observed):
            if not seen:
                block = slice(2 * index, 2 * index + 2)
                covariance[block, block] += UNSEEN_END_SIGMA_M**2 * np.outer(along, along)
    return Primitive(kind, parameters, 0.5 * (covariance + covariance.T), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Axes:
    """Conversion of coordinates (u, v) to the frame of the points."""

    frame: Float[np.ndarray, "2 2"]

    def place(self, u: float, v: float) -> np.ndarray:
        return u * self.frame[0] + v * self.frame[1]

    def angle(self, du: float, dv: float) -> float:
        x, y = self.place(du, dv)
        return float(np.arctan2(y, x))


def _builder(
    kind: PrimitiveKind, fit: OutlineFit, impression: Impression, axes: _Axes, observed: tuple[bool, bool]
) -> Callable[[np.ndarray], np.ndarray]:
    """Function that computes the parameters of a primitive from those of its outline."""
    place, angle = axes.place, axes.angle
    first, last = impression.u_m[0], impression.u_m[-1]
    if kind == PrimitiveKind.LINE:
        centre = 0.5 * (max(fit.ends_m[0], first) + min(fit.ends_m[1], last))
        return lambda t: np.array([*place(centre, t[0] + t[1] * centre), angle(1.0, t[1])])
    if kind == PrimitiveKind.CIRCLE:
        return lambda t: np.array([*place(t[0], t[1] - np.exp(t[2])), np.exp(t[2])])
    if kind == PrimitiveKind.CORNER:
        return _corner_builder(fit.hypothesis.name, place, angle)

    def segment(t: np.ndarray) -> np.ndarray:
        left, right = t[2] if observed[0] else first, t[3] if observed[1] else last
        return np.array([*place(left, t[0] + t[1] * left), *place(right, t[0] + t[1] * right)])

    return segment


def _direction(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def _corner_builder(
    name: str, place: Callable[[float, float], np.ndarray], angle: Callable[[float, float], float]
) -> Callable[[np.ndarray], np.ndarray]:
    """Builder of tip and edge directions of a corner; an untouched edge is assumed perpendicular to the other."""
    if name == "corner":
        return lambda t: np.array([*place(t[0], t[1]), angle(-1.0, -t[2]), angle(1.0, -t[3])])
    if name == "point":
        return lambda t: np.array([*place(t[0], t[1]), angle(-1.0, -1.0), angle(1.0, -1.0)])
    if name == "tip_left":  # face to the right of the tip, direction (1, m); the other edge (-(-m), -1)
        return lambda t: np.array([*place(t[2], t[0] + t[1] * t[2]), angle(t[1], -1.0), angle(1.0, t[1])])
    return lambda t: np.array([*place(t[3], t[0] + t[1] * t[3]), angle(-1.0, -t[1]), angle(-t[1], -1.0)])
