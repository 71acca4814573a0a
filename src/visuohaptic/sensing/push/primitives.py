"""Geometric primitives from the impression that an object leaves in a foam (Alt 2016, Sec. 3.3.3).

A wall is a line, the face of a small box a segment, the edge of a box or a
table leg a corner, a bin or bottle a circle. Each is fitted together with the
flanks of the foam (:mod:`.contact_outline`) by maximum likelihood, and the
data choose between them.

What differs from the text: the contact interval is estimated and not assumed,
the residual is taken along the deflection (where the noise is), and the choice
is by likelihood with a price per parameter (BIC); the score (3.11) remains as
the test that a primitive is good enough to be reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...core.geometry import wrap_angle
from ...core.measurement import Contact
from ...core.objects import Primitive, PrimitiveKind
from .contact_outline import FlankPrior, OutlineFit, Profile, fit_outline, hypotheses

__all__ = [
    "PrimitiveCandidate",
    "PrimitiveFit",
    "PrimitiveSettings",
    "fit_contact",
    "fit_primitive",
    "primitive_distance_m",
    "score_primitive",
]

#: Standard deviation of a segment's end that lies beyond the strip [m].
UNSEEN_END_SIGMA_M = 0.1
#: Standard deviation of a corner's edge that does not touch: uniform over what may hide there [rad].
UNSEEN_EDGE_SIGMA_RAD = 0.4


@dataclass(frozen=True, slots=True)
class PrimitiveSettings:
    """How primitives are fitted and chosen."""

    flanks: FlankPrior = field(default_factory=FlankPrior)
    score_sigma_m: float = 0.0005  #: sigma_2 of Eq. (3.11)
    min_score: float = 0.5
    min_points: int = 5  #: fewer points decide nothing
    choice: Literal["likelihood", "score"] = "likelihood"  #: "score" is the rule as printed
    press_direction: tuple[float, float] = (-1.0, 0.0)  #: unit vector of the deflection, frame of the points


@dataclass(frozen=True, slots=True, eq=False)
class PrimitiveCandidate:
    """One kind, fitted as well as it can be."""

    primitive: Primitive
    criterion: float  #: Bayesian information criterion, smaller is better; differences count
    touched: Bool[np.ndarray, "K"]  #: points that lie on the object, in the order of the input
    observed: tuple[bool, bool]  #: segment: left and right end seen; corner: left and right edge touched
    reduced_chi2: float  #: of the touched points
    flank_length_m: float  #: deflection by slope where the flanks begin: a property of the foam


@dataclass(frozen=True, slots=True, eq=False)
class PrimitiveFit:
    """Result of :func:`fit_primitive`."""

    best: Primitive | None  #: None: nothing fits well enough, or too few points
    candidates: tuple[PrimitiveCandidate, ...]  #: best first; one per kind
    margin: float  #: criterion of the second kind less that of the first; above about 6 is decided

    def candidate(self, kind: PrimitiveKind) -> PrimitiveCandidate:
        """The candidate of a kind."""
        for candidate in self.candidates:
            if candidate.primitive.kind == kind:
                return candidate
        known = ", ".join(str(c.primitive.kind) for c in self.candidates) or "none"
        raise InputError("kind", f"found {kind}, expected one that was fitted: {known}")


def primitive_distance_m(primitive: Primitive, points_m: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K"]:
    """Distance of points from the nearest point of a primitive, d_M of Eq. (3.11) [m]."""
    points = np.asarray(points_m, dtype=float)
    p = primitive.parameters

    def from_ray(origin: np.ndarray, direction: np.ndarray, low: float, high: float) -> np.ndarray:
        along = np.clip((points - origin) @ direction, low, high)
        nearest = origin + along[:, None] * direction
        return np.linalg.norm(points - nearest, axis=1)

    if primitive.kind == PrimitiveKind.CIRCLE:
        return np.abs(np.linalg.norm(points - p[:2], axis=1) - p[2])
    if primitive.kind == PrimitiveKind.LINE:
        return from_ray(p[:2], _direction(p[2]), -np.inf, np.inf)
    if primitive.kind == PrimitiveKind.SEGMENT:
        along = p[2:] - p[:2]
        length = float(np.hypot(*along))
        return from_ray(p[:2], along / max(length, 1e-12), 0.0, length)
    return np.minimum(
        from_ray(p[:2], _direction(p[2]), 0.0, np.inf), from_ray(p[:2], _direction(p[3]), 0.0, np.inf)
    )


def score_primitive(primitive: Primitive, points_m: Float[np.ndarray, "N 2"], sigma_2_m: float) -> float:
    """S_p of Eq. (3.11) over the deformation set; a point is confirmed within three sigma_2."""
    return _score(primitive_distance_m(primitive, points_m), sigma_2_m)


def _score(distance: np.ndarray, sigma_2_m: float) -> float:
    if len(distance) == 0:
        return 0.0
    confirmed = float(np.mean(distance <= 3.0 * sigma_2_m))
    return float(np.exp(-np.mean(distance**2) / sigma_2_m**2) * confirmed)


def fit_contact(contact: Contact, settings: PrimitiveSettings | None = None) -> PrimitiveFit:
    """:func:`fit_primitive` on the points of a measured contact region."""
    return fit_primitive(
        contact.points_foam_m, contact.point_sigma_m, delta_m=contact.delta_m, settings=settings
    )


def fit_primitive(
    points_m: Float[np.ndarray, "K 2"],
    sigma_m: Float[np.ndarray, "K"],
    *,
    delta_m: Float[np.ndarray, "K"] | None = None,
    contact_mask: Bool[np.ndarray, "K"] | None = None,
    settings: PrimitiveSettings | None = None,
) -> PrimitiveFit:
    """Fit line, segment, corner and circle to a contact, and choose.

    Parameters
    ----------
    points_m
        Front contour inside one contact region, flanks included [m].
    sigma_m
        Standard deviation of each point along its deflection [m].
    delta_m
        Deflection of each point [m]. Without it the strip is taken as
        straight and at rest where the region ends.
    contact_mask
        Points to use; the others are ignored.
    settings
        Foam's flanks, score and choice.

    Returns
    -------
    PrimitiveFit
        ``best`` is None when no candidate scores more than ``min_score``.

    Raises
    ------
    InputError
        Shapes that do not agree, values that are not finite, sigma <= 0.

    Examples
    --------
    >>> import numpy as np
    >>> y = np.linspace(-0.1, 0.1, 60)
    >>> points = np.column_stack([np.full(60, 0.016), y])  # a wall, 4 mm into a 20 mm foam
    >>> fit = fit_primitive(points, np.full(60, 2e-5), delta_m=np.full(60, 0.004))
    >>> str(fit.best.kind)
    'line'
    """
    settings = settings or PrimitiveSettings()
    points = np.asarray(points_m, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("points_m", f"found shape {points.shape}, expected (K, 2)")
    k = len(points)
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=float), (k,)) if np.ndim(sigma_m) == 0 else sigma_m
    for name, values in (("sigma_m", sigma), ("delta_m", delta_m), ("contact_mask", contact_mask)):
        if values is not None and np.shape(values) != (k,):
            raise InputError(name, f"found shape {np.shape(values)}, expected ({k},)")
    given = [points, sigma] if delta_m is None else [points, sigma, delta_m]
    if not all(np.all(np.isfinite(values)) for values in given):
        raise InputError("points_m", "found values that are not finite, expected finite points and sigma")
    if not np.all(np.asarray(sigma) > 0):
        raise InputError("sigma_m", f"found {np.min(sigma)}, expected standard deviations > 0")
    down = np.array(settings.press_direction) / np.hypot(*settings.press_direction)
    frame = np.stack([np.array([down[1], -down[0]]), down])  # rows: u, v in the frame of the points
    used = np.arange(k) if contact_mask is None else np.flatnonzero(contact_mask)
    used = used[np.argsort(points[used] @ frame[0], kind="stable")]
    if len(used) < settings.min_points:
        return PrimitiveFit(None, (), 0.0)
    profile = _profile(
        points[used] @ frame.T,
        np.asarray(sigma)[used],
        None if delta_m is None else np.asarray(delta_m)[used],
    )
    if profile.scale_m <= 3.0 * float(np.median(profile.sigma_m)):
        return PrimitiveFit(None, (), 0.0)
    fits = sorted(
        (fit_outline(profile, hypothesis, settings.flanks) for hypothesis in hypotheses(profile)),
        key=lambda fit: fit.criterion,
    )
    # A tip alone touches between two points: then only the whole contour can confirm a primitive.
    contact, by_contour = fits[0].touched, fits[0].touched.sum() < 3
    candidates: dict[PrimitiveKind, PrimitiveCandidate] = {}
    for fit in fits:
        kind, observed = _kind(fit, profile)
        if kind in candidates:
            continue
        bare = _primitive(kind, fit, profile, frame, observed)
        if by_contour:
            score = _score(np.abs(fit.model_m - profile.delta_m), settings.score_sigma_m)
        else:
            score = score_primitive(bare, points[used][contact], settings.score_sigma_m)
        touched = np.zeros(k, dtype=bool)
        touched[used] = fit.touched
        freedom = max(int(fit.touched.sum()) - len(fit.hypothesis.free), 1)
        candidates[kind] = PrimitiveCandidate(
            primitive=Primitive(bare.kind, bare.parameters, bare.covariance, score),
            criterion=fit.criterion,
            touched=touched,
            observed=observed,
            reduced_chi2=fit.chi2 / freedom,
            flank_length_m=float(profile.scale_m * np.exp(-np.mean(fit.theta[-3:-1]))),
        )
    good = [c for c in candidates.values() if c.primitive.score > settings.min_score]
    if settings.choice == "score":
        order = sorted(candidates.values(), key=lambda c: -c.primitive.score)
        good.sort(key=lambda c: -c.primitive.score)
    else:
        order = list(candidates.values())
    margin = order[1].criterion - order[0].criterion if len(order) > 1 else 0.0
    return PrimitiveFit(good[0].primitive if good else None, tuple(order), float(margin))


def _direction(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def _profile(uv: np.ndarray, sigma: np.ndarray, delta: np.ndarray | None) -> Profile:
    u, v = uv[:, 0].copy(), uv[:, 1]
    spacing = float(np.median(np.diff(u)))
    if spacing <= 0:
        raise InputError("points_m", "found points that coincide along the strip, expected distinct ones")
    if delta is None:
        rest = np.array([min(v[0], v[-1]), 0.0, 0.0])
        delta = v - rest[0]
    else:
        # The front at rest: a straight or evenly bent strip.
        at_rest = v - delta
        middle = u.mean()
        order = 2 if len(u) > 5 and np.ptp(at_rest - np.polyval(np.polyfit(u, at_rest, 1), u)) > 1e-6 else 1
        poly = np.zeros(3)
        poly[2 - order :] = np.polyfit(u - middle, at_rest, order)
        c, b, a = poly
        rest = np.array([a - b * middle + c * middle**2, b - 2 * c * middle, c])
    return Profile(u, np.asarray(delta, dtype=float).copy(), sigma.astype(float), rest, spacing)


def _kind(fit: OutlineFit, profile: Profile) -> tuple[PrimitiveKind, tuple[bool, bool]]:
    """Kind of a hypothesis, and which of its two ends or edges the data show.

    A face with one tip is the segment of a box if it runs out over the strip's
    end; if the foam leaves it before, it is one edge of a corner.
    """
    name = fit.hypothesis.name
    cut_left, cut_right = profile.cut
    if name == "line":
        return PrimitiveKind.LINE, (False, False)
    if name == "circle":
        return PrimitiveKind.CIRCLE, (True, True)
    if name == "two_tips":
        return PrimitiveKind.SEGMENT, (True, True)
    if name == "tip_left":
        runs_out = cut_right and fit.ends_m[1] >= profile.u_m[-1]
        return (PrimitiveKind.SEGMENT, (True, False)) if runs_out else (PrimitiveKind.CORNER, (False, True))
    if name == "tip_right":
        runs_out = cut_left and fit.ends_m[0] <= profile.u_m[0]
        return (PrimitiveKind.SEGMENT, (False, True)) if runs_out else (PrimitiveKind.CORNER, (True, False))
    if name == "point":
        return PrimitiveKind.CORNER, (False, False)
    tip = fit.theta[0]
    return PrimitiveKind.CORNER, (fit.ends_m[0] < tip - 1e-6, fit.ends_m[1] > tip + 1e-6)


def _primitive(
    kind: PrimitiveKind, fit: OutlineFit, profile: Profile, frame: np.ndarray, observed: tuple[bool, bool]
) -> Primitive:
    """Parameters of the primitive in the frame of the points, with their covariance."""
    name, theta = fit.hypothesis.name, fit.theta
    ends = fit.ends_m
    build: Callable[[np.ndarray], np.ndarray]
    centre = 0.5 * (max(ends[0], profile.u_m[0]) + min(ends[1], profile.u_m[-1]))

    def place(u: float, v: float) -> np.ndarray:
        return u * frame[0] + v * frame[1]

    def angle(du: float, dv: float) -> float:
        d = du * frame[0] + dv * frame[1]
        return float(np.arctan2(d[1], d[0]))

    extra = np.zeros((0,))  # variances of what is not observed, added behind
    if kind == PrimitiveKind.LINE:

        def line(t: np.ndarray) -> np.ndarray:
            return np.array([*place(centre, t[0] + t[1] * centre), angle(1.0, t[1])])

        build = line

    elif kind == PrimitiveKind.CIRCLE:

        def circle(t: np.ndarray) -> np.ndarray:
            return np.array([*place(t[0], t[1] - np.exp(t[2])), np.exp(t[2])])

        build = circle

    elif kind == PrimitiveKind.SEGMENT:

        def segment(t: np.ndarray) -> np.ndarray:
            left = t[2] if observed[0] else profile.u_m[0]
            right = t[3] if observed[1] else profile.u_m[-1]
            return np.array([*place(left, t[0] + t[1] * left), *place(right, t[0] + t[1] * right)])

        build = segment

    else:
        build = _corner_builder(name, place, angle)
    parameters = build(theta)
    jacobian = np.zeros((len(parameters), len(theta)))
    for j in fit.hypothesis.free:
        step = np.zeros(len(theta))
        step[j] = 1e-6
        difference = build(theta + step) - build(theta - step)
        if kind in (PrimitiveKind.LINE, PrimitiveKind.CORNER):
            difference[2:] = wrap_angle(difference[2:])
        jacobian[:, j] = difference / 2e-6
    freedom = max(int(fit.touched.sum()) - len(fit.hypothesis.free), 1)
    # Residuals larger than declared (a rough object) widen the covariance; smaller ones never narrow it.
    covariance = jacobian @ fit.covariance @ jacobian.T * max(1.0, fit.chi2 / freedom)
    extra = np.zeros(len(parameters))
    if kind == PrimitiveKind.CORNER and name != "corner":
        extra[2:] = [0.0 if seen else UNSEEN_EDGE_SIGMA_RAD**2 for seen in observed]
    covariance[np.diag_indices_from(covariance)] += extra
    if kind == PrimitiveKind.SEGMENT:
        along = _direction(angle(1.0, theta[1]))
        for index, seen in enumerate(observed):
            if not seen:
                block = slice(2 * index, 2 * index + 2)
                covariance[block, block] += UNSEEN_END_SIGMA_M**2 * np.outer(along, along)
    return Primitive(kind, parameters, 0.5 * (covariance + covariance.T), 0.0)


def _corner_builder(
    name: str, place: Callable[[float, float], np.ndarray], angle: Callable[[float, float], float]
) -> Callable[[np.ndarray], np.ndarray]:
    """Tip and edge directions; an edge that is not touched is taken at a right angle to the other."""
    if name == "corner":
        return lambda t: np.array([*place(t[0], t[1]), angle(-1.0, -t[2]), angle(1.0, -t[3])])
    if name == "point":
        return lambda t: np.array([*place(t[0], t[1]), angle(-1.0, -1.0), angle(1.0, -1.0)])
    if name == "tip_left":  # face to the right of the tip, direction (1, m); the other edge (-(-m), -1)
        return lambda t: np.array([*place(t[2], t[0] + t[1] * t[2]), angle(t[1], -1.0), angle(1.0, t[1])])
    return lambda t: np.array([*place(t[3], t[0] + t[1] * t[3]), angle(-1.0, -t[1]), angle(-t[1], -1.0)])
