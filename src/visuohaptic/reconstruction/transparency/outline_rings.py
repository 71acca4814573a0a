"""Place, lean and radii of a body, from the outlines of the rays that no other body explains.

Seen from one side or in part, bodies along a curved ridge and at several maxima are almost as likely as the best: the place is the mean of the
posterior distribution (stretch moves, Goodman and Weare 2010), whose log-likelihood is multiplied by a factor for its misspecification
(:func:`.outline_fit.covariance`). A body leans if the likelihood ratio of its outlines, with the same factor, contradicts every upright one,
and none with a handle or a spout is likelier (:func:`.body_pairs.attached_part`), whose rays are no evidence of the body then. Radii are those at several heights, from the edges of upright outlines.

A wall of glass changes nearly all readings just inside of its outline, whatever its middle does, so the edge is that between two
rates of changed readings, which are estimated from the sequence (expectation and maximisation over the edges). For a circle around the
axis, the tangents from each camera give the two image columns of its wall, and the likelihood of a radius is summed over the views.

An image shows at each height the widest of all circles, of which a camera above sees ellipses: w(z) is the maximum of
sqrt(r(z')^2 - (z - z')^2 cot(e)^2) over z' at an elevation e. The visual hull (Laurentini 1994) is the largest r with these widths, and
only circles on the outline tell of the body. The second eye fails where its window meets the body, by up to half a window beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from ..vessel_shapes import OutlineRings, UprightBody
from .body_pairs import attached_part, without_body
from .outline_fit import (
    MIN_HEIGHT_M,
    MIN_RADIUS_M,
    OPEN,
    RADII,
    SEARCHES,
    STEP_M,
    TURNS,
    Outlines,
    OutlineView,
    covariance,
)
from .regions import TransparentRegion

#: Rates of changed readings outside and inside of an edge before they are estimated, in how many rounds, and their margin from 0 and 1.
_RATES, _ROUNDS, _RARE = (0.05, 0.9), 3, 0.02
#: Step of the radius in matching windows, and largest radius in those of the body.
_RADIUS_STEP, _WIDER = 1 / 16, 2.0
#: Tangents of the leans from which a leaning body is sought, about the middle and both ends of the upright one.
_LEANS, _PIVOTS = (0.3, 0.6), (-0.5, 0.0, 0.5)
#: Shapes that are moved together through their posterior distribution, their moves, of which the first third is not counted, and the deviation of
#: the first of them from the maxima, about that of a good fit [m].
_WALKERS, _MOVES, _JITTER_M = 24, 200, 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class _Walls:
    """Readings between the middle of a body and walls at heights and radii, summed over both sides, of each view."""

    changed: Float[np.ndarray, "views z r"]  #: number of changed readings, in matching windows
    known: Float[np.ndarray, "views z r"]  #: number of readings, likewise
    radii_m: Float[np.ndarray, "r"]  #: [m]

    def ratios(self, rates: tuple[float, float]) -> Float[np.ndarray, "views z r"]:
        """Log-likelihood ratio of a wall against none, with rates of changed readings outside and inside [nat]."""
        outside, inside = rates
        same = np.log((1 - inside) / (1 - outside))
        return np.asarray(self.known * same + self.changed * (np.log(inside / outside) - same))

    def share(self, low_m: Float[np.ndarray, "z"], high_m: Float[np.ndarray, "z"]) -> float:
        """Share of changed readings between radii at each height."""
        ends = [
            self._at(sums.sum(axis=0), high_m) - self._at(sums.sum(axis=0), low_m)
            for sums in (self.changed, self.known)
        ]
        return float(np.clip(ends[0].sum() / max(ends[1].sum(), 1e-9), _RARE, 1 - _RARE))

    def _at(self, sums: np.ndarray, radius_m: np.ndarray) -> np.ndarray:
        return np.array([np.interp(r, self.radii_m, row) for r, row in zip(radius_m, sums, strict=True)])

    def moments_m(
        self, ratios: Float[np.ndarray, "*n z r"]
    ) -> tuple[Float[np.ndarray, "*n z"], Float[np.ndarray, "*n z"]]:
        """Mean [m] and variance [m2] of the radius at each height."""
        chances = np.exp(ratios - ratios.max(axis=-1, keepdims=True))
        chances /= chances.sum(axis=-1, keepdims=True)
        mean_m = chances @ self.radii_m
        return np.asarray(mean_m), np.asarray(np.maximum(chances @ self.radii_m**2 - mean_m**2, 0.0))


def with_rings(
    regions: Sequence[TransparentRegion],
    views: Sequence[OutlineView],
    foot_z_m: float,
    threshold: float,
    rate: float,
) -> tuple[TransparentRegion, ...]:
    """Give each body its place and lean, and the radii of its outlines if it is upright, by the rays that miss all others.

    Parameters
    ----------
    regions
        Transparent parts.
    views
        All views.
    foot_z_m, threshold
        As for :func:`outline_rings`.
    rate
        As for :func:`settled`.
    """
    found, bodies = [], [region.body for region in regions if region.body is not None]
    for region in regions:
        if (body := region.body) is not None:
            left = views
            for other in bodies:
                left = left if other is body else without_body(left, other.shape_m)
            upright, body = body, settled(left, body, rate)
            if any(body.lean_m) and (part := attached_part(left, upright, body, threshold)):
                left = without_body(left, part.shape_m)
                body = settled(left, upright, rate)
            if not any(body.lean_m):
                body = replace(body, rings=outline_rings(left, body, foot_z_m, threshold))
            region = replace(region, body=body)
        found.append(region)
    return tuple(found)


def settled(views: Sequence[OutlineView], body: UprightBody, rate: float) -> UprightBody:
    """The expected body, upright unless its outlines contradict that, with its deviations.

    Parameters
    ----------
    views
        All views, without the rays through other bodies.
    body
        Upright body.
    rate
        Probability with which an upright body is said to lean.
    """
    outlines = Outlines(views, np.array([*body.axis_m, np.mean(body.height_m)]))
    widest_m = max(2 * max(body.radius_m), STEP_M * RADII[-1])
    bounds_m, window_px = np.array([MIN_RADIUS_M, MIN_HEIGHT_M, widest_m]), views[0].window_px
    opening = min(OPEN, key=lambda one: outlines.cost(body.shape_m, one, bounds_m))

    def cost(shape_m: np.ndarray) -> float:
        return outlines.cost(shape_m, opening, bounds_m)

    def ends(starts: Sequence[np.ndarray]) -> list[np.ndarray]:
        first, *others = sorted((outlines.search(one, opening, bounds_m) for one in starts), key=cost)
        found = outlines.search(first, opening, bounds_m, side=-1), *others
        return [one for one in found if cost(one) < 0]

    start = body.shape_m[:6]
    leaning = ends([np.append(start, [0.0, 0.0]), *sorted(_leans(start), key=cost)[:SEARCHES]])
    # A cone is wide where a leaning one reaches to: upright again, a lean that is none is often nearer to the maximum.
    beside = [one[:6] for one in leaning[:1]]
    upright = ends([start, *beside, *sorted(_widths(start), key=cost)[:SEARCHES]])
    for maxima in (leaning, upright):
        told = covariance(outlines, maxima[0], opening, window_px) if maxima else None
        if told is None:
            continue
        # Twice the gain of two more parameters is chi-squared distributed with two degrees of freedom (Wilks 1938).
        gain = cost(upright[0]) - cost(maxima[0]) if upright and maxima is leaning else np.inf
        if told[1] * gain < -np.log(rate):
            continue
        samples = _samples(cost, maxima, told[1])
        return _body(samples, -cost(maxima[0]))
    return body


def _leans(shape_m: np.ndarray) -> list[np.ndarray]:
    """Leaning bodies from which the search starts, as wide at both ends."""
    turns, rise_m = 2 * np.pi * np.arange(TURNS) / TURNS, shape_m[5] - shape_m[4]
    x, y, low_r, high_r, low_z, high_z = shape_m
    found = []
    for tangent, turn, pivot in product(_LEANS, turns, _PIVOTS):
        lean = tangent * rise_m * np.array([np.cos(turn), np.sin(turn)])
        place = np.array([x, y]) + pivot * lean
        found.append(np.array([*place, *[0.5 * (low_r + high_r)] * 2, low_z, high_z, *lean]))
    return found


def _widths(shape_m: np.ndarray) -> list[np.ndarray]:
    """Upright bodies of other widths that have one side in common with a body, as high or reaching lower by as much as they are wider."""
    x, y, low_r, high_r, low_z, high_z = shape_m
    turns, found = 2 * np.pi * np.arange(TURNS) / TURNS, []
    for radius, turn, lower in product(STEP_M * np.array(RADII), turns, (0.0, 1.0)):
        wider = radius - 0.5 * (low_r + high_r)
        place = np.array([x, y]) + wider * np.array([np.cos(turn), np.sin(turn)])
        found.append(np.array([*place, radius, radius, low_z - lower * max(wider, 0.0), high_z]))
    return found


def _samples(
    cost: Callable[[np.ndarray], float], maxima: Sequence[np.ndarray], factor: float
) -> Float[np.ndarray, "n shape"]:
    """Shapes sampled from their posterior distribution, with a uniform prior and the log-likelihood times a factor (stretch moves)."""
    rng, size, half = np.random.default_rng(0), len(maxima[0]), _WALKERS // 2
    places = np.resize(maxima, (_WALKERS, size))
    places += np.where(
        np.arange(_WALKERS) < len(maxima), 0.0, _JITTER_M * rng.standard_normal((size, _WALKERS))
    ).T
    costs, kept = np.array([cost(one) for one in places]), []
    for step in range(_MOVES):
        for own in (np.arange(half), np.arange(half, _WALKERS)):
            stretch = 0.5 * (1 + rng.random(half)) ** 2
            others = places[(rng.integers(half, size=half) + own[0] + half) % _WALKERS]
            chance = rng.random(half)
            for k, trial, far, limit in zip(
                own, others + stretch[:, None] * (places[own] - others), stretch, chance, strict=True
            ):
                here = cost(trial)
                if here < 0 and np.log(limit) < (size - 1) * np.log(far) + factor * (costs[k] - here):
                    places[k], costs[k] = trial, here
        if 3 * step >= _MOVES:
            kept.append(places.copy())
    return np.concatenate(kept)


def _body(samples: Float[np.ndarray, "n shape"], evidence: float) -> UprightBody:
    """The mean of sampled shapes with their deviations."""
    x, y, low_r, high_r, low_z, high_z, *lean = samples.mean(axis=0).tolist()
    sigma_m, radius_m = samples[:, :2].std(axis=0), float(samples[:, 2:4].mean(axis=1).std())
    found = UprightBody(np.array([x, y]), sigma_m, (low_r, high_r), radius_m, (low_z, high_z), evidence)
    if not lean:
        return found
    ends_m = np.array([(samples[:, :2] + part * samples[:, 6:]).std(axis=0) for part in (-0.5, 0.5)])
    return replace(found, lean_m=(lean[0], lean[1]), ends_sigma_m=ends_m)


def outline_rings(
    views: Sequence[OutlineView], body: UprightBody, foot_z_m: float, threshold: float
) -> OutlineRings:
    """Radii of a body at heights from its foot to its top.

    Parameters
    ----------
    views
        Views, without the rays through other bodies.
    body
        The body.
    foot_z_m
        Lowest height [m].
    threshold
        Minimum log-likelihood ratio of a ring against none [nat].
    """
    top_m, axis_m = body.height_m[1], body.axis_m
    middle_m = np.array([*axis_m, np.mean(body.height_m), 1.0])
    pixel_m = float(np.median([view.T_camera_world[2] @ middle_m / view.matrix[0] for view in views]))
    window_m = pixel_m * views[0].window_px
    z_m = np.arange(top_m, foot_z_m, -0.5 * window_m)[::-1]
    if len(z_m) < 2:
        return OutlineRings()
    step_m = _RADIUS_STEP * window_m
    walls = _walls(views, middle_m, z_m, np.arange(step_m, _WIDER * max(body.radius_m) + window_m, step_m))
    rates = _RATES
    for _ in range(_ROUNDS):
        ratios = walls.ratios(rates)
        told = ratios.sum(axis=0).max(axis=1) > threshold
        if not told.any():
            return OutlineRings()
        wide_m, square_m2 = walls.moments_m(ratios.sum(axis=0))
        # Without the pixels at the edge itself, of which a part is glass.
        outside, inside = (
            walls.share(*(np.where(told, wide_m + end * window_m, 0.0) for end in ends))
            for ends in ((0.15, 0.65), (-0.65, -0.15))
        )
        if outside >= inside:
            return OutlineRings()
        rates = outside, inside
    # Jackknife over the views (Efron 1982, Eq. 3.12), and the likelihood's own deviation: a few views may agree by chance.
    apart_m = walls.moments_m(ratios.sum(axis=0) - ratios)[0]
    square_m2 = square_m2 + (len(views) - 1) * apart_m.var(axis=0)
    # The edge of the second eye is uniform within half of its window, and a radius is half of the width.
    edge_m = pixel_m * views[0].edge_px if views[0].baseline_m else 0.0
    z_m, wide_m, square_m2 = z_m[told], np.maximum(wide_m[told] - 0.25 * edge_m, 0.0), square_m2[told]
    # Of a row (first index) and a circle (second).
    apart_m2 = (_cotangents(views, axis_m, z_m) * (z_m[:, None] - z_m)) ** 2
    radius_m = np.sqrt((wide_m[:, None] ** 2 + apart_m2).min(axis=0))
    shown = np.unique((radius_m**2 - apart_m2).argmax(axis=1))
    return OutlineRings(z_m[shown], radius_m[shown], np.sqrt(square_m2[shown]), edge_m / np.sqrt(48))


def _cotangents(views: Sequence[OutlineView], axis_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """Cotangent of the elevation of the cameras above heights, median over the views."""
    eyes_m = np.array([-view.T_camera_world[:, :3].T @ view.T_camera_world[:, 3] for view in views])
    away_m = np.hypot(*(eyes_m[:, :2] - axis_m).T)
    return np.asarray(np.median(away_m[:, None] / np.maximum(np.abs(eyes_m[:, 2:] - z_m), 1e-6), axis=0))


def _walls(
    views: Sequence[OutlineView], middle_m: np.ndarray, z_m: np.ndarray, radii_m: np.ndarray
) -> _Walls:
    """Readings from the axis through a point to walls at heights and radii."""
    axis_m = middle_m[:2]
    changed, known = np.zeros((2, len(views), len(z_m), len(radii_m)))
    for number, view in enumerate(views):
        (fx, fy, cx, cy), (height, width) = view.matrix, view.limit_m.shape
        motion = view.T_camera_world
        way = -motion[:, :3].T @ motion[:, 3]
        away_m = np.hypot(*(way[:2] - axis_m))
        if away_m <= 1.01 * radii_m[-1]:
            continue
        way = (way[:2] - axis_m) / away_m
        # Tangent points: the cosine of their angle from the way to the camera is r / d.
        along, aside = radii_m**2 / away_m, radii_m * np.sqrt(1 - (radii_m / away_m) ** 2)
        points = np.empty((2, len(z_m), len(radii_m), 3))
        points[..., 2] = z_m[:, None]
        for side, sign in enumerate((1.0, -1.0)):
            points[side, ..., 0] = axis_m[0] + along * way[0] - sign * aside * way[1]
            points[side, ..., 1] = axis_m[1] + along * way[1] + sign * aside * way[0]
        x, y, depth = np.moveaxis(points @ motion[:, :3].T + motion[:, 3], -1, 0)
        if depth.min() < 0.05:
            continue
        u, v = fx * x / depth + cx, fy * y / depth + cy
        left, right = np.minimum(u[0], u[1]), np.maximum(u[0], u[1])
        row = np.rint(0.5 * (v[0] + v[1])).astype(int)
        held = (row >= 0) & (row < height)
        row, middle, depth = np.clip(row, 0, height - 1), 0.5 * (left + right), 0.5 * (depth[0] + depth[1])
        behind, place = depth.copy(), middle
        for _ in range(3):
            # As in the fit of the outlines: the farthest background past which the second eye looks.
            limit = view.limit_m[row, np.clip(place.astype(int), 0, width - 1)]
            behind = np.where(limit > depth, limit, behind)
            shift = fx * view.baseline_m * (1 / depth - 1 / behind)
            place = (left if view.baseline_m >= 0 else right) - shift
        ends = (middle, right), (left - shift, middle - shift)
        if view.baseline_m < 0:
            ends = (left, middle), (middle - shift, right - shift)
        beyond = view.limit_m > motion[2] @ middle_m
        # A row counts as a part of a matching window, as in the evidence of a pixel.
        rows = view.weight / view.window_px**2 * np.abs(np.gradient(v[0][:, 0]))[:, None] * held
        for sums, counted in ((changed, view.changed > 0), (known, view.changed != 0)):
            whole = np.pad(np.cumsum(counted & beyond, axis=1, dtype=np.float64), ((0, 0), (1, 0)))
            sums[number] = rows * sum(_between(whole, row, *end) for end in ends)
    return _Walls(changed, known, radii_m)


def _between(whole: np.ndarray, row: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Sum of a row between two columns, from cumulative sums with one more column."""
    found = []
    for end in (high, low):
        place = np.clip(end + 0.5, 0.0, whole.shape[1] - 1.0)
        k = np.minimum(place.astype(int), whole.shape[1] - 2)
        found.append(whole[row, k] + (place - k) * (whole[row, k + 1] - whole[row, k]))
    return np.asarray(found[0] - found[1])
