"""Known objects by the outlines of those that are there today: which is which, with its probability.

Hypotheses are assignments of known objects, each in one place at most, and of objects that were never observed. A fitted
outline is a box or a cylinder with the likelihood of its laser points, and its size is Gaussian about the stored one; that of
an object that was never observed has the density of the population. The rate of objects that were never observed is
unknown and uniform, so that ``n`` of ``g`` have the prior ``n! (g - n)! / (g + 1)!`` (rule of succession); all assignments of
known objects to the others are equally probable.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from ...core.objects import HapticTag, VisuoHapticObject
from .floor_outline import SIDE_M, FloorOutline, log_depth_prior

#: A stored object is used from this probability on.
CONFIDENT_PROBABILITY = 0.9
#: Widths of objects that were never observed: half of them round, uniform in the logarithm over this factor, from 5 to 40 cm.
POPULATION_FACTOR = 8.0
#: Fraction of sides of which a part is hidden: 5 of 100 sides of boxes in random houses are more than three deviations short.
HIDDEN = 0.05
#: Frictions that are equivalent for a plan, as a fraction.
FRICTION_TOLERANCE = 0.15


def remembered_outline(one: VisuoHapticObject) -> FloorOutline | None:
    """Outline of a stored object about its centroid; ``None`` if it has none.

    Parameters
    ----------
    one
        With a footprint of four corners about its centroid, or of more if it is round; its width is along y. Standard deviations of width and
        depth are the quantities ``width_sigma_m`` and ``depth_sigma_m`` of its state.
    """
    if one.geometry is None or one.geometry.footprint_m is None:
        return None
    corners = one.geometry.footprint_m
    depth, width = (float(value) for value in np.ptp(corners, axis=0))
    sigma = [float(one.state.get(name, SIDE_M)) for name in ("width_sigma_m", "depth_sigma_m")]
    return FloorOutline(len(corners) > 4, (-0.5 * depth, 0.0, 0.0), (width, depth), (sigma[0], sigma[1]))


def recognise(
    seen: Sequence[Sequence[FloorOutline]], known: Sequence[VisuoHapticObject]
) -> list[tuple[VisuoHapticObject, float, FloorOutline] | None]:
    """For every object that is there the matching known one, its probability, and its outline there.

    Parameters
    ----------
    seen
        Fitted box and cylinder of each object, see :func:`~visuohaptic.tasks.mobile.fit_outlines`.
    known
        Known objects; those without an outline are left out.

    Returns
    -------
    list
        ``None`` if no known object has a probability of at least ``CONFIDENT_PROBABILITY``.
    """
    outlines = [(one, own) for one in known if (own := remembered_outline(one)) is not None]
    fits = [[_stored_fit(fitted, own) for _, own in outlines] for fitted in seen]
    new = [_population_fit(fitted) for fitted in seen]
    marginal = np.zeros((len(seen), len(outlines) + 1))
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
            likelihood = sum(new[g] if k < 0 else fits[g][k][0] for g, k in enumerate(way))
            logs.append(likelihood + _log_prior(len(way) - len(used), len(used), len(outlines)))
    weights = np.exp(np.array(logs) - max(logs, default=0.0))
    for way, weight in zip(ways, weights / max(weights.sum(), 1e-300), strict=True):
        for g, k in enumerate(way):
            marginal[g, k] += weight
    found: list[tuple[VisuoHapticObject, float, FloorOutline] | None] = []
    for g in range(len(seen)):
        k = int(np.argmax(marginal[g, :-1])) if outlines else -1
        # Several fixed legs are equivalent: they count as one.
        alike = [
            j
            for j, (other, _) in enumerate(outlines)
            if k >= 0 and (j == k or _alike(outlines[k][0].tag, other.tag))
        ]
        probability = float(marginal[g, alike].sum())
        sure = k >= 0 and probability >= CONFIDENT_PROBABILITY
        found.append((outlines[k][0], probability, fits[g][k][1]) if sure else None)
    return found


def _log_prior(new: int, old: int, known: int) -> float:
    """Log prior of an assignment of ``new`` unknown and ``old`` known objects, among ``known`` ones."""
    lg = math.lgamma
    return lg(new + 1) + lg(old + 1) - lg(new + old + 2) + lg(known - old + 1) - lg(known + 1)


def _stored_fit(fitted: Sequence[FloorOutline], own: FloorOutline) -> tuple[float, FloorOutline]:
    """Log likelihood of an object given a stored outline, and the outline there."""
    there = next(one for one in fitted if one.round == own.round)
    parts = []
    # Any side of a box may be the near one.
    for axes in ((0, 1),) if own.round else ((0, 1), (1, 0)):
        size, sigma = (tuple(values[axis] for axis in axes) for values in (own.size_m, own.sigma_m))
        sides = range(1 if own.round else 2)
        value = sum(
            _log_side(there.size_m[k], size[k], math.hypot(sigma[k], there.sigma_m[k])) for k in sides
        )
        parts.append((value, FloorOutline(own.round, there.pose, (size[0], size[1]), (sigma[0], sigma[1]))))
    log_size = float(np.logaddexp.reduce([value for value, _ in parts])) - math.log(len(parts))
    return there.log_likelihood + log_size, max(parts, key=lambda part: part[0])[1]


def _log_side(seen_m: float, size_m: float, sigma_m: float) -> float:
    """Log density of the visible length of a side of known length."""
    gauss = math.exp(-0.5 * ((seen_m - size_m) / sigma_m) ** 2) / (math.sqrt(2.0 * math.pi) * sigma_m)
    return math.log((1.0 - HIDDEN) * gauss + HIDDEN / size_m * (seen_m < size_m) + 1e-300)


def _population_fit(fitted: Sequence[FloorOutline]) -> float:
    """Log likelihood of an object that was never observed, of any width and shape."""
    logs = []
    for one in fitted:
        width, depth = one.size_m
        shape = 0.0 if one.round else log_depth_prior(width, depth)
        logs.append(one.log_likelihood + shape - math.log(2.0 * width * math.log(POPULATION_FACTOR)))
    return float(np.logaddexp.reduce(logs))


def _alike(first: HapticTag | None, second: HapticTag | None) -> bool:
    """Whether they are interchangeable for a plan."""
    if first is None or second is None or first.fixed != second.fixed:
        return first is second
    one, other = first.static_friction_N, second.static_friction_N
    if one is None or other is None:
        return bool(first.fixed)
    return abs(one.value - other.value) <= FRICTION_TOLERANCE * min(one.value, other.value)
