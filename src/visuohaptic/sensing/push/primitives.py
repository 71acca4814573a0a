"""Geometric primitives from the contour of a foam under contact (Alt 2016, Sec. 3.3.3).

A wall is a line, the face of a small box a segment, the edge of a box or a
table leg a corner, a bin or bottle a circle. Each is fitted together with the
flanks of the foam (:mod:`.contact_outline`) by maximum likelihood, and one is
selected.

Differences from the dissertation: the contact interval is estimated, not assumed;
residuals are taken along the deflection (where the noise is); and the selection
is by likelihood with a penalty per parameter (BIC). The score (3.11) is still
the test of whether a primitive is good enough to be reported.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core import POSITIVE, Contact, InputError, Primitive, PrimitiveKind, check_numbers, finite_array
from .contact_outline import FlankPrior, OutlineFit, fit_outline, integrate_drop
from .outline_hypotheses import Impression, hypotheses
from .outline_primitive import outline_kind, outline_primitive


@dataclass(frozen=True, slots=True)
class PrimitiveSettings:
    """Settings of the fit and the selection of primitives."""

    flanks: FlankPrior = field(default_factory=FlankPrior)
    score_sigma_m: float = 0.0005  #: sigma_2 of Eq. (3.11)
    min_score: float = 0.5
    min_points: int = 5  #: minimum number of points for a selection
    choice: Literal["likelihood", "score"] = "likelihood"  #: selection criterion; "score" is the printed rule
    #: unit vector of the deflection in the frame of the points
    press_direction: tuple[float, float] = (-1.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PrimitiveCandidate:
    """Best fit of one kind of primitive."""

    primitive: Primitive
    criterion: float  #: Bayesian information criterion; smaller is better, only differences are meaningful
    touched: Bool[np.ndarray, "K"]  #: points in contact with the object, in the order of the input
    observed: tuple[bool, bool]  #: segment: left and right end observed; corner: left and right edge touched


@dataclass(frozen=True, slots=True, eq=False)
class PrimitiveFit:
    """Result of :func:`fit_primitive`."""

    best: Primitive | None  #: None: no fit is good enough, or there are too few points
    candidates: tuple[PrimitiveCandidate, ...]  #: one per kind, best first
    margin: float  #: criterion of the second minus that of the first; above about 6 the selection is reliable

    def candidate(self, kind: PrimitiveKind) -> PrimitiveCandidate:
        """The candidate of a kind.

        Parameters
        ----------
        kind
            Kind of primitive.
        """
        for candidate in self.candidates:
            if candidate.primitive.kind == kind:
                return candidate
        known = ", ".join(str(c.primitive.kind) for c in self.candidates) or "none"
        raise InputError("kind", f"found {kind}, expected one that was fitted: {known}")


def primitive_distance_m(primitive: Primitive, points_m: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K"]:
    """Distance of each point from the nearest point of a primitive, d_M of Eq. (3.11) [m].

    Parameters
    ----------
    primitive
        Line, segment, corner or circle.
    points_m
        Points (K, 2) in its frame [m].
    """
    points = np.asarray(points_m, dtype=float)
    p = primitive.parameters

    def unit(angle: float) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle)])

    def from_ray(origin: np.ndarray, direction: np.ndarray, low: float, high: float) -> np.ndarray:
        along = np.clip((points - origin) @ direction, low, high)
        nearest = origin + along[:, None] * direction
        return np.linalg.norm(points - nearest, axis=1)

    if primitive.kind == PrimitiveKind.CIRCLE:
        return np.abs(np.linalg.norm(points - p[:2], axis=1) - p[2])
    if primitive.kind == PrimitiveKind.LINE:
        return from_ray(p[:2], unit(p[2]), -np.inf, np.inf)
    if primitive.kind == PrimitiveKind.SEGMENT:
        along = p[2:] - p[:2]
        length = float(np.hypot(*along))
        return from_ray(p[:2], along / max(length, 1e-12), 0.0, length)
    return np.minimum(from_ray(p[:2], unit(p[2]), 0.0, np.inf), from_ray(p[:2], unit(p[3]), 0.0, np.inf))


def score_primitive(primitive: Primitive, points_m: Float[np.ndarray, "N 2"], sigma_2_m: float) -> float:
    """S_p of Eq. (3.11) over the deformation set; a point within three sigma_2 is confirmed.

    Parameters
    ----------
    primitive
        Line, segment, corner or circle.
    points_m
        Points (N, 2) of the deformation set, in its frame [m].
    sigma_2_m
        Standard deviation of a confirmed point, sigma_2 [m].
    """
    return _score(primitive_distance_m(primitive, points_m), sigma_2_m)


def _score(distance: np.ndarray, sigma_2_m: float) -> float:
    if len(distance) == 0:
        return 0.0
    confirmed = float(np.mean(distance <= 3.0 * sigma_2_m))
    return float(np.exp(-np.mean(distance**2) / sigma_2_m**2) * confirmed)


def fit_contact(contact: Contact, settings: PrimitiveSettings | None = None) -> PrimitiveFit:
    """:func:`fit_primitive` on the points of a measured contact region.

    Parameters
    ----------
    contact
        Region of a force profile.
    settings
        As of :func:`fit_primitive`.
    """
    return fit_primitive(
        contact.points_foam_m, contact.point_sigma_m, delta_m=contact.delta_m, settings=settings
    )


def fit_primitive(
    points_m: Float[np.ndarray, "K 2"],
    sigma_m: Float[np.ndarray, "K"],
    *,
    delta_m: Float[np.ndarray, "K"] | None = None,
    settings: PrimitiveSettings | None = None,
) -> PrimitiveFit:
    """Fit line, segment, corner and circle to a contact, and select one.

    Parameters
    ----------
    points_m
        Front contour in one contact region, including the flanks [m].
    sigma_m
        Standard deviation of each point along its deflection [m].
    delta_m
        Deflection of each point [m]. By default the undeformed strip is assumed
        straight between the ends of the region.
    settings
        Flank prior, score and selection criterion.

    Returns
    -------
    PrimitiveFit
        ``best`` is None if no candidate scores more than ``min_score``.

    Raises
    ------
    InputError
        Shapes do not match, values are not finite, or a sigma is not positive.

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
    points = finite_array("fit_primitive", points_m, None, 2, field="points_m", least=0)
    k = len(points)
    sigma = finite_array("fit_primitive", sigma_m, k, field="sigma_m", least=0)
    check_numbers("fit_primitive", POSITIVE, sigma_m=sigma)
    if delta_m is not None:
        delta_m = finite_array("fit_primitive", delta_m, k, field="delta_m", least=0)
    down = np.array(settings.press_direction) / np.hypot(*settings.press_direction)
    frame = np.stack([np.array([down[1], -down[0]]), down])  # rows: u, v in the frame of the points
    used = np.argsort(points @ frame[0], kind="stable")
    if len(used) < settings.min_points:
        return PrimitiveFit(None, (), 0.0)
    impression = _impression(points[used] @ frame.T, sigma[used], None if delta_m is None else delta_m[used])
    if impression.scale_m <= 3.0 * float(np.median(impression.sigma_m)):
        return PrimitiveFit(None, (), 0.0)
    fits = sorted(
        (fit_outline(impression, hypothesis, settings.flanks) for hypothesis in hypotheses(impression)),
        key=lambda fit: fit.criterion,
    )
    # A single tip touches between two points: only the whole contour can confirm such a primitive.
    contact = None if fits[0].touched.sum() < 3 else points[used][fits[0].touched]
    candidates: dict[PrimitiveKind, PrimitiveCandidate] = {}
    for fit in fits:
        if (kind := outline_kind(fit, impression)[0]) not in candidates:
            touched = np.zeros(k, dtype=bool)
            touched[used] = fit.touched
            bare = outline_primitive(
                kind, integrate_drop(fit, impression, settings.flanks), impression, frame
            )
            candidates[kind] = _candidate(bare, fit, impression, contact, touched, settings.score_sigma_m)
    good = [c for c in candidates.values() if c.primitive.score > settings.min_score]
    if settings.choice == "score":
        order = sorted(candidates.values(), key=lambda c: -c.primitive.score)
        good.sort(key=lambda c: -c.primitive.score)
    else:
        order = list(candidates.values())
    margin = order[1].criterion - order[0].criterion if len(order) > 1 else 0.0
    return PrimitiveFit(good[0].primitive if good else None, tuple(order), float(margin))


def _candidate(
    bare: Primitive,
    fit: OutlineFit,
    impression: Impression,
    contact_m: Float[np.ndarray, "n 2"] | None,
    touched: Bool[np.ndarray, "K"],
    score_sigma_m: float,
) -> PrimitiveCandidate:
    """A primitive with its score over the points in contact in the best fit, or over the contour if there are none."""
    if contact_m is None:
        score = _score(np.abs(fit.model_m - impression.delta_m), score_sigma_m)
    else:
        score = score_primitive(bare, contact_m, score_sigma_m)
    return PrimitiveCandidate(
        primitive=Primitive(bare.kind, bare.parameters, bare.covariance, score),
        criterion=fit.criterion,
        touched=touched,
        observed=outline_kind(fit, impression)[1],
    )


def _impression(uv: np.ndarray, sigma: np.ndarray, delta: np.ndarray | None) -> Impression:
    u, v = uv[:, 0].copy(), uv[:, 1]
    spacing = float(np.median(np.diff(u)))
    if spacing <= 0:
        raise InputError("points_m", "found points that coincide along the strip, expected distinct ones")
    if delta is None:
        rest = np.array([min(v[0], v[-1]), 0.0, 0.0])
        delta = v - rest[0]
    else:
        # Undeformed front: a straight or uniformly bent strip.
        at_rest = v - delta
        middle = u.mean()
        order = 2 if len(u) > 5 and np.ptp(at_rest - np.polyval(np.polyfit(u, at_rest, 1), u)) > 1e-6 else 1
        poly = np.zeros(3)
        poly[2 - order :] = np.polyfit(u - middle, at_rest, order)
        c, b, a = poly
        rest = np.array([a - b * middle + c * middle**2, b - 2 * c * middle, c])
    return Impression(u, np.asarray(delta, dtype=float).copy(), sigma.astype(float), rest, spacing)
