"""Known objects by the laser points of those that are there today: which is which, with its probability.

Hypotheses are the known objects and one that was never observed; no object is in two places. The likelihood of points
given an outline (:func:`outline_fit`) is averaged over the errors of what is stored: for a known object over its
width, for an unknown one over all widths and shapes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d
from ...core.objects import HapticTag, VisuoHapticObject
from .footprint_after_push import END_QUANTILES, width_sigma_m

__all__ = ["outline_fit", "recognise"]

#: A stored object is used from this probability on.
CONFIDENT_PROBABILITY = 0.9
#: Prior of an object that was never observed here, among the same number of hypotheses.
NEW = 0.2
#: Standard deviation of laser points from their outline [m]: 9.3 +- 0.8 mm over twenty objects of random houses, for a laser
#: of 10 mm. Errors of points of one scan are correlated: a group counts as this many independent points, because the root
#: mean square of a group varies by 21 % = 1 / sqrt(2 * 11) over 142 objects. Iterations of the fit.
POINT_M, INDEPENDENT, FIT_ROUNDS = 0.0093, 10, 4
#: Root mean square of the excess of a visible width over the outline's, and of the hidden part of it, over 142 objects [m].
WIDTH_M, HIDDEN_M = 0.013, 0.027
#: Widths of objects that were never observed: half of them round, half of them square [m].
POPULATION_M = np.geomspace(0.05, 0.4, 8)
#: Deviates and weights of the Gauss-Hermite quadrature over a stored outline's width.
QUADRATURE = (-math.sqrt(3.0), 0.0, math.sqrt(3.0)), (1 / 6, 2 / 3, 1 / 6)
#: Frictions that are equivalent for a plan, as a fraction.
FRICTION_TOLERANCE = 0.15


def outline_fit(
    points_m: Float[np.ndarray, "k 2"], outline_m: Float[np.ndarray, "p 2"], heading_rad: float
) -> tuple[float, Float[np.ndarray, "p 2"]]:
    """Log likelihood of laser points given an outline anywhere on the floor, and its most probable pose.

    For every rotation the near sides are aligned, and the outline is moved to fit the points; all rotations have the
    same prior, and the likelihood is their mean. Part of the outline may be hidden.

    Parameters
    ----------
    points_m
        Hits on one object [m].
    outline_m
        Corners about any origin [m].
    heading_rad
        Direction of observation [rad].
    """
    import shapely

    turn = rotation_2d(heading_rad)
    local = (points_m @ turn)[:: max(1, len(points_m) // 60)]
    # Without the outliers.
    low, high = np.quantile(local, END_QUANTILES, axis=0)
    hits = shapely.points(local)
    best, placed, logs = -math.inf, outline_m, []
    for angle in _turns(outline_m):
        own = outline_m @ rotation_2d(float(angle)).T
        a, b = own.min(axis=0), own.max(axis=0)
        own = own + np.array([low[0] - a[0], 0.5 * (low[1] + high[1] - a[1] - b[1])])
        for _ in range(FIT_ROUNDS):
            ring = shapely.LinearRing(own)
            foot = shapely.line_interpolate_point(ring, shapely.line_locate_point(ring, hits))
            off = local - shapely.get_coordinates(foot)
            own = own + off.mean(axis=0)
        hidden_m = float(b[1] - a[1] - (high[1] - low[1]))
        value = _log_likelihood(float(np.mean(np.sum(off**2, axis=1))), hidden_m)
        logs.append(value)
        if value > best:
            best, placed = value, own @ turn.T
    return _log_mean(logs), placed


def _turns(outline_m: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "n"]:
    """Rotations that are compared [rad]: steps of 15 degrees, of a regular polygon up to its period."""
    turns = np.arange(24) * math.pi / 12
    sides = np.hypot(*(outline_m - np.roll(outline_m, 1, axis=0)).T)
    regular = np.ptp(sides) < 1e-6 and np.ptp(np.hypot(*(outline_m - outline_m.mean(axis=0)).T)) < 1e-6
    return turns[turns < 2 * math.pi / len(outline_m) - 1e-9] if regular else turns


def _stored_fit(
    group: Float[np.ndarray, "k 2"], one: VisuoHapticObject, heading_rad: float
) -> tuple[float, Float[np.ndarray, "p 2"]]:
    """Log likelihood of laser points given a stored object, over the uncertainty of its width; its outline there."""
    outline = one.geometry.footprint_m if one.geometry is not None else None
    assert outline is not None
    relative = width_sigma_m(one.tag.primitive if one.tag is not None else None) / np.ptp(outline[:, 1])
    deviates, weights = QUADRATURE
    fits = [outline_fit(group, outline * max(1.0 + relative * x, 0.1), heading_rad) for x in deviates]
    return _log_mean([fit[0] for fit in fits], weights), fits[1][1]


def _population_fit(group: Float[np.ndarray, "k 2"], heading_rad: float) -> float:
    """Log likelihood of laser points given an object that was never observed, of any width and shape."""
    angle = np.arange(16) * math.pi / 8
    round_m = np.column_stack([np.cos(angle), np.sin(angle)])
    square_m = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    fits = [
        outline_fit(group, 0.5 * w * one, heading_rad)[0] for w in POPULATION_M for one in (round_m, square_m)
    ]
    return _log_mean(fits)


def _log_mean(logs: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Logarithm of the weighted mean of likelihoods."""
    from scipy.special import logsumexp

    return float(logsumexp(logs, b=np.full(len(logs), 1.0 / len(logs)) if weights is None else weights))


def _log_likelihood(square_m2: float, hidden_m: float) -> float:
    points = INDEPENDENT * (math.log(POINT_M) + 0.5 * square_m2 / POINT_M**2)
    width_m = HIDDEN_M if hidden_m > 0 else WIDTH_M
    return -points - math.log(HIDDEN_M + WIDTH_M) - 0.5 * (hidden_m / width_m) ** 2


def recognise(
    groups: Sequence[Float[np.ndarray, "k 2"]], known: Sequence[VisuoHapticObject], heading_rad: float
) -> list[tuple[VisuoHapticObject, float, Float[np.ndarray, "p 2"]] | None]:
    """For every group of laser points the matching known object, its probability, and its outline there.

    Parameters
    ----------
    groups
        Points of each object that is currently there [m].
    known
        Known objects with outlines.
    heading_rad
        Direction of observation of the groups [rad].

    Returns
    -------
    list
        ``None`` if no known object has a probability of at least ``CONFIDENT_PROBABILITY``.
    """
    known = [one for one in known if one.geometry is not None and one.geometry.footprint_m is not None]
    fits = [[_stored_fit(group, one, heading_rad) for one in known] for group in groups]
    new = [math.log(NEW) + _population_fit(group, heading_rad) for group in groups]
    marginal = np.zeros((len(groups), len(known) + 1))
    # A hypothesis with e^-12 of the best likelihood is negligible.
    choices = [
        [-1, *(k for k, fit in enumerate(row) if fit[0] > max(base, *(one[0] for one in row)) - 12.0)]
        for row, base in zip(fits, new, strict=True)
    ]
    logs, ways = [], []
    for way in itertools.product(*choices):
        used = [k for k in way if k >= 0]
        if len(set(used)) == len(used):
            ways.append(way)
            logs.append(
                sum(
                    new[g] if k < 0 else fits[g][k][0] + math.log((1 - NEW) / max(len(known), 1))
                    for g, k in enumerate(way)
                )
            )
    weights = np.exp(np.array(logs) - max(logs, default=0.0))
    for way, weight in zip(ways, weights / max(weights.sum(), 1e-300), strict=True):
        for g, k in enumerate(way):
            marginal[g, k] += weight
    found: list[tuple[VisuoHapticObject, float, Float[np.ndarray, "p 2"]] | None] = []
    for g in range(len(groups)):
        k = int(np.argmax(marginal[g, :-1])) if known else -1
        # Several fixed legs are equivalent: they count as one.
        alike = [j for j, other in enumerate(known) if k >= 0 and (j == k or _alike(known[k].tag, other.tag))]
        probability = float(marginal[g, alike].sum())
        found.append(
            (known[k], probability, fits[g][k][1])
            if k >= 0 and probability >= CONFIDENT_PROBABILITY
            else None
        )
    return found


def _alike(first: HapticTag | None, second: HapticTag | None) -> bool:
    """Whether they are interchangeable for a plan."""
    if first is None or second is None or first.fixed != second.fixed:
        return first is second
    one, other = first.static_friction_N, second.static_friction_N
    if one is None or other is None:
        return bool(first.fixed)
    return abs(one.value - other.value) <= FRICTION_TOLERANCE * min(one.value, other.value)
