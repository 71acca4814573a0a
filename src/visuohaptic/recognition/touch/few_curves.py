"""Learning of classes from a few squeezes at any places: a prior of containers, conditioned on the readings.

Symbols: p features as in :mod:`.haptic_model`, o readings of a class.

The mean mu of a class has the prior N(m, B): B is the covariance of the population of containers or, if the class was
simulated, that of the error of the simulation. Its objects are mu + w, with w ~ N(0, W), so that mu and the readings of all
its objects, y = H (mu + w) + noise, are jointly Gaussian. If a class has a single object, that object is mu; then l
in :mod:`.haptic_model` is 0 for the same object again, or 1 for another one of its class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data import HEIGHTS, FeatureSet, SqueezedObject, TouchProtocol
from .belief import evidence
from .calibration import with_exemplars
from .haptic_model import (
    ClassStatistics,
    HapticModel,
    assemble,
)
from .nuisances import ModelSettings, pose_covariance
from .unknown_class import (
    CURVATURE,
    FEATURES,
    FIRST_WIDTH,
    HEIGHT,
    UNKNOWN_CLASS_SIGMAS,
    smooth_profile,
    unknown_kinds,
)
from .zeros import curvatures

#: Prior standard deviations of the features of containers, including grooves and shoulders, in the order of
#: :data:`.UNKNOWN_CLASS_SIGMAS`, and the number of places over which a profile is smooth. Root mean squares over classes of
#: glass, tin and plastic, waists and bowls.
POPULATION, SMOOTH = (1.5, 0.6, 0.3, 0.2, 0.4), 2.5
#: Standard deviations within a class, in the order of :data:`.UNKNOWN_CLASS_SIGMAS`: root mean squares over the nine shipped
#: classes.
WITHIN_CLASS_SIGMAS = (0.34, 0.15, 0.045, 0.047, 0.1)
#: The same, independent at each place: the wall thickness varies by 1.5 %.
PLACE_SIGMA = 0.03
#: Candidate factors of these standard deviations, if several objects of a class were squeezed. The stiffness of pots varies by a
#: third, that of one pot by a percent.
WITHIN_CLASS_FACTORS = tuple(2.0**k for k in range(-5, 4))
_FACTORS = np.array(WITHIN_CLASS_FACTORS)
#: Factors of one exploration, l of the Gaussians of such a class. Explorations of another day differ by more than those of one
#: day, and a few of a class do not show by how much. On published grasps, these scales have a higher likelihood of left-out
#: explorations than those of Student's t distributions of 1 to 8 degrees of freedom.
EXPLORATION_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
#: Candidate standard deviations between classes, independent at each place: zero in stiffness and width for containers, whose
#: opposite sides are alike; large if the readings of the fingers of a hand are unrelated.
PLACES = (0.0, 0.03, 0.1, 0.3, 1.0)
#: Candidate relative differences of repeated touches of one place in stiffness: none by a machine, a tenth and more by hand; and of
#: repeated widths: a caliper held by hand is 2 mm off at most, on 7 cm.
REPEATS, WIDTH_REPEATS = (0.0, 0.03, 0.1, 0.3), (0.0, 0.003, 0.01, 0.03)
#: Candidate standard deviations of curvatures, between the places of an object and between objects: no two walls are alike by
#: less than the first, and none differ by more than the last.
CURVATURES = (0.03, 0.1, 0.3, 1.0, 3.0)
#: Standard deviations of the error of a simulated class: wall thickness and modulus are known to 10 % (k is proportional to
#: E t^2), lengths to 3 %.
SIMULATION_SIGMAS = (0.22, 0.1, 0.03, 0.02, 0.03)
#: Width of a container if none was measured [m].
_USUAL_WIDTH_m = 0.07


def learn_from_curves(
    squeezed: Sequence[SqueezedObject],
    simulated: Mapping[str, ClassStatistics] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    *,
    settings: ModelSettings | None = None,
) -> HapticModel:
    """Model of squeezed classes; simulated classes that were not squeezed are included unchanged.

    Parameters
    ----------
    squeezed
        Objects; a single curve of one object is enough to start.
    simulated
        Trained class -> its statistics, see :func:`.class_statistics`; the prior of a squeezed class of the same name.
    groups, settings
        As for :func:`.fit_model`.

    Raises
    ------
    InputError
        Fewer than two classes, or an object without a reading.
    """
    learn = partial(_learned_gaussians, simulated=simulated, groups=groups or {}, settings=settings)
    model = learn(squeezed)
    return model if simulated else with_exemplars(model, squeezed, learn)


def _learned_gaussians(
    squeezed: Sequence[SqueezedObject],
    simulated: Mapping[str, ClassStatistics] | None,
    groups: Mapping[str, Sequence[str]],
    settings: ModelSettings | None,
) -> HapticModel:
    settings = replace(settings or ModelSettings(), simulate_unknown=False)  # these need not be containers
    protocol = TouchProtocol()
    learned = dict(simulated or {})
    labels = dict.fromkeys(one.label for one in squeezed)
    if len({*learned, *labels}) < 2:
        raise InputError("curves", f"found {len({*learned, *labels})} classes, expected at least 2")
    # Any model maps readings to feature indices.
    reader = assemble({"any": _anything(settings, protocol)}, {}, settings, protocol)
    along, across = (np.inf, 0.0) if simulated else _curvature_scatter(reader, squeezed)
    reader = replace(reader, settings=replace(settings, curvature=along))
    read = [evidence(reader, one.readings) for one in squeezed]
    if empty := [one.name for one, (place, _, _) in zip(squeezed, read, strict=True) if not len(place)]:
        raise InputError(
            "curves", f"found no stiffness of {empty[0]!r}, expected at least one curve that rises"
        )
    mean, between = _population(read, list((simulated or {}).values()), across)
    tried = {one: _touched(reader, squeezed, one) for one in zip(REPEATS, WIDTH_REPEATS, strict=True)}
    repeat, between = _scatter(mean, between, tried, PLACES if simulated is None else PLACES[:1])
    touched = _touched(reader, squeezed, repeat)
    settings = replace(reader.settings, repeat=repeat[0], width_repeat=repeat[1])
    usual = _usual_within(mean, between, [objects for objects in touched.values() if len(objects) > 1])
    if np.isfinite(along):  # another object of a class differs as the places of one object do
        usual[CURVATURE, CURVATURE] = along**2
    for label, objects in touched.items():
        if prior := learned.get(label):
            wrong = smooth_profile(*SIMULATION_SIGMAS, reach=5.0)
            middle, left = _posterior(prior.mean, wrong, prior.within, objects)
            learned[label] = replace(prior, mean=middle, mean_covariance=left)
        elif len(objects) == 1:
            middle, left = _posterior(mean, between, 0 * usual, objects)
            pose = _pose(middle, settings, protocol)
            learned[label] = ClassStatistics(middle, left, usual, pose, {0.0: 0.5, 1.0: 0.5})
        else:
            own = _own_scale(mean, between, usual, objects)
            middle, left = _posterior(mean, between, float(own @ _FACTORS**2) * usual, objects)
            # Different objects were touched in different explorations: the variation includes the nuisances.
            scales = _exploration_scales(own)
            learned[label] = ClassStatistics(middle, left, usual, 0 * usual, scales, touched=True)
    return assemble(learned, groups or {}, settings, protocol)


@dataclass(frozen=True, slots=True, eq=False)
class _ClassReadings:
    """Sufficient statistics of the readings of a class for its mean mu, whose objects are independent given mu.

    Symbols: S_i = H_i W H_i' + noise is the covariance of the readings of object i, r_i their residuals from m. With
    A = sum H_i' S_i^-1 H_i and b = sum H_i' S_i^-1 r_i, the covariance S of all readings satisfies, for any covariance B of mu
    (Woodbury, with B singular as well),

        log |S| = sum log |S_i| + log |I + A B|,    r' S^-1 r = sum r_i' S_i^-1 r_i - b' B (I + A B)^-1 b.

    The cost is linear in the number of objects; that of the joint covariance is cubic.
    """

    place: Int[np.ndarray, "q"]  #: features that were read
    information: Float[np.ndarray, "q q"]  #: A
    weighted: Float[np.ndarray, "q"]  #: b
    alone: float  #: log likelihood of the objects if mu = m, up to a constant

    def given(self, spread: Float[np.ndarray, "p p"]) -> tuple[np.ndarray, np.ndarray]:
        """I + A B, and (I + A B)^-1 (b, A) (q, 1 + q), for mu ~ N(m, B)."""
        matrix = np.eye(len(self.place)) + self.information @ spread[np.ix_(self.place, self.place)]
        return matrix, np.linalg.solve(matrix, np.column_stack([self.weighted, self.information]))

    def log_likelihood(self, spread: Float[np.ndarray, "p p"]) -> float:
        """Log likelihood of all readings for mu ~ N(m, spread), up to a constant."""
        matrix, solved = self.given(spread)
        gained = self.weighted @ spread[np.ix_(self.place, self.place)] @ solved[:, 0]
        return self.alone + 0.5 * float(gained - np.linalg.slogdet(matrix)[1])


def _class_readings(
    mean: Float[np.ndarray, "p"],
    within: Float[np.ndarray, "p p"],
    objects: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> _ClassReadings:
    every = np.unique(np.concatenate([place for place, _, _ in objects]))
    information, weighted, alone = np.zeros((len(every), len(every))), np.zeros(len(every)), 0.0
    for count in {len(place) for place, _, _ in objects}:  # objects with equally many readings at once
        place, value, noise = (np.stack(part) for part in zip(*(one for one in objects if len(one[0]) == count), strict=True))  # fmt: skip
        root = np.linalg.cholesky(
            within[place[:, :, None], place[:, None]] + noise[..., None] * np.eye(count)
        )
        selected = (place[..., None] == every).astype(float)
        white = np.linalg.solve(root, np.concatenate([(value - mean[place])[..., None], selected], axis=2))
        white = white.reshape(-1, 1 + len(every))
        alone -= 0.5 * float(white[:, 0] @ white[:, 0])
        alone -= float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
        weighted += white[:, 1:].T @ white[:, 0]
        information += white[:, 1:].T @ white[:, 1:]
    return _ClassReadings(every, information, weighted, alone)


def _posterior(
    mean: Float[np.ndarray, "p"],
    spread: Float[np.ndarray, "p p"],
    within: Float[np.ndarray, "p p"],
    objects: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """Posterior mean and covariance of the mean of a class, given the readings of its objects."""
    read = _class_readings(mean, within, objects)
    solved = spread[:, read.place] @ read.given(spread)[1]
    return mean + solved[:, 0], spread - solved[:, 1:] @ spread[read.place]


def _likelihood(
    mean: Float[np.ndarray, "p"],
    spread: Float[np.ndarray, "p p"],
    within: Float[np.ndarray, "p p"],
    classes: Sequence[Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]],
) -> float:
    """Log likelihood of all readings of some classes, up to a constant."""
    return sum(_class_readings(mean, within, objects).log_likelihood(spread) for objects in classes)


def _container_within(stiff: float = 1.0, uneven: float = 1.0, wide: float = 1.0) -> Float[np.ndarray, "p p"]:
    """Covariance within a class: :data:`WITHIN_CLASS_SIGMAS` scaled by factors of stiffness, common and by place, and width."""
    level, bend, *outline = WITHIN_CLASS_SIGMAS
    smooth = smooth_profile(stiff * level, uneven * bend, *(wide * part for part in outline), reach=SMOOTH)
    return smooth + PLACE_SIGMA**2 * np.eye(len(smooth))


def _touched(
    reader: HapticModel, squeezed: Sequence[SqueezedObject], repeat: tuple[float, float]
) -> dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Readings of the objects of each class if repeated touches of a place differ by this, in stiffness and width."""
    settings = replace(reader.settings, repeat=repeat[0], width_repeat=repeat[1])
    reader = replace(reader, settings=settings)
    out: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for one in squeezed:
        out.setdefault(one.label, []).append(evidence(reader, one.readings))
    return out


def _scatter(
    mean: Float[np.ndarray, "p"],
    spread: Float[np.ndarray, "p p"],
    touched: Mapping[tuple[float, float], Mapping[str, Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]]],
    places: Sequence[float],
) -> tuple[tuple[float, float], Float[np.ndarray, "p p"]]:
    """Differences of repeated touches, and covariance between classes with the independent part of each place.

    Each is the root mean square over the posterior, given the readings with each candidate difference: places that were
    touched once do not distinguish the two. Stiffness and width are evaluated one by one: a hand holds a caliper otherwise than it
    presses, and their priors are independent.
    """
    feature, repeats, within = np.arange(len(mean)), [], _container_within()
    for k, part in enumerate((feature < FIRST_WIDTH, (feature >= FIRST_WIDTH) & (feature < CURVATURE))):
        score = {}
        for repeat, classes in touched.items():
            seen = [[tuple(x[part[one[0]]] for x in one) for one in objects] for objects in classes.values()]
            read = [_class_readings(mean, within, objects) for objects in seen]
            for apart in places:
                covariance = spread + apart**2 * np.diag(part)
                score[repeat[k], apart] = sum(one.log_likelihood(covariance) for one in read)
        # A width is as accurate as it is declared, unless one more parameter is worth it (Schwarz).
        gain = max(score.values()) - max(score[0.0, one] for one in places)
        count = sum(len(one[0]) for objects in seen for one in objects)
        if k and gain <= 0.5 * np.log(max(count, 1)):
            score = {one: fit for one, fit in score.items() if one[0] == 0.0}
        weight = np.exp(np.array(list(score.values())) - max(score.values()))
        differ, apart = np.sqrt(weight @ np.array(list(score)) ** 2 / weight.sum())
        repeats.append(float(differ))
        spread = spread + apart**2 * np.diag(part)
    return (repeats[0], repeats[1]), spread


def _curvature_scatter(reader: HapticModel, squeezed: Sequence[SqueezedObject]) -> tuple[float, float]:
    """Standard deviations of the curvature between places of an object and between objects; infinity and 0 without two objects.

    Each is the root mean square over the posterior, with a flat prior of the mean of all objects.
    """
    read = [curvatures(reader, one.readings) for one in squeezed]
    read = [one for one in read if len(one[0])]
    if len(read) < 2:
        return np.inf, 0.0
    score = {}
    for along, across in product(CURVATURES, CURVATURES):
        each = [_pooled(bent, along**2 + own + zero**2) for bent, own, zero in read]
        middle, variance, alone = np.array(each).T
        score[along, across] = alone.sum() + _pooled(middle, across**2 + variance)[2]
    weight = np.exp(np.array(list(score.values())) - max(score.values()))
    along, across = np.sqrt(weight @ np.array(list(score)) ** 2 / weight.sum())
    return float(along), float(across)


def _pooled(value: Float[np.ndarray, "q"], variance: Float[np.ndarray, "q"]) -> tuple[float, float, float]:
    """Mean of values with these variances, its variance, and their log likelihood with a flat prior of the mean."""
    weight = 1 / variance
    total = float(weight.sum())
    mean = float(weight @ value) / total
    return mean, 1 / total, 0.5 * float(np.log(weight).sum() - weight @ (value - mean) ** 2 - np.log(total))


def _usual_within(
    mean: Float[np.ndarray, "p"],
    spread: Float[np.ndarray, "p p"],
    classes: Sequence[Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]],
) -> Float[np.ndarray, "p p"]:
    """Covariance within a class that maximises the likelihood of the readings of classes with several objects."""
    best: tuple[float, ...] = (1.0, 1.0, 1.0)
    for k in (0, 1, 2, 0, 1, 2) if classes else ():  # coordinate ascent
        tried = [(*best[:k], factor, *best[k + 1 :]) for factor in WITHIN_CLASS_FACTORS]
        best = max(tried, key=lambda one: _likelihood(mean, spread, _container_within(*one), classes))
    return _measured_within(_container_within(*best), classes) if classes else _container_within()


def _own_scale(
    mean: Float[np.ndarray, "p"],
    spread: Float[np.ndarray, "p p"],
    usual: Float[np.ndarray, "p p"],
    objects: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> Float[np.ndarray, "f"]:
    """Posterior probability of each of :data:`WITHIN_CLASS_FACTORS` for one class, given its own readings."""
    score = np.array([_likelihood(mean, spread, factor**2 * usual, [objects]) for factor in _FACTORS])
    weight = np.exp(score - score.max())
    return np.asarray(weight / weight.sum())


def _exploration_scales(own: Float[np.ndarray, "f"]) -> dict[float, float]:
    """Scale of one exploration -> its probability: the class's own factor, which is uncertain, times that of the exploration.

    Both are on a grid of powers of two, so that the distribution of the product is a convolution.
    """
    each = np.full(len(EXPLORATION_FACTORS), 1 / len(EXPLORATION_FACTORS))
    likely = np.convolve(own, each)
    scales = EXPLORATION_FACTORS[0] * WITHIN_CLASS_FACTORS[0] * 2.0 ** np.arange(len(likely))
    kept = likely > 1e-9
    return dict(zip(scales[kept].tolist(), (likely[kept] / likely[kept].sum()).tolist(), strict=True))


def _measured_within(
    usual: Float[np.ndarray, "p p"],
    classes: Sequence[Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]],
) -> Float[np.ndarray, "p p"]:
    """Covariance within a class, updated at the places that were measured on all objects.

    The usual covariance is an inverse Wishart prior with as many degrees of freedom as there are such places. Other places
    follow by their regression on these.
    """
    objects = [[dict(zip(place.tolist(), value, strict=True)) for place, value, _ in one] for one in classes]
    common = sorted(set.intersection(*(set(each) for one in objects for each in one)) - {CURVATURE})
    if not common:
        return usual
    tables = [np.array([[each[place] for place in common] for each in one]) for one in objects]
    away = np.concatenate([table - table.mean(axis=0) for table in tables])
    freedom = len(away) - len(tables)
    before = usual[np.ix_(common, common)]
    after = (len(common) * before + away.T @ away) / (len(common) + freedom)
    reach = np.linalg.solve(before, usual[common]).T
    return usual + reach @ (after - before) @ reach.T


def _population(
    read: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    simulated: Sequence[ClassStatistics],
    curvature: float,
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """Prior mean and covariance of the classes."""
    if len(simulated) > 1:
        means = np.stack([one.mean for one in simulated])
        return means.mean(axis=0), unknown_kinds(means)[0][0]
    place, value, _ = (np.concatenate(part) for part in zip(*read, strict=True))
    kind = np.repeat(np.arange(4), [FIRST_WIDTH, HEIGHT - FIRST_WIDTH, 1, 1])
    usual = np.array([0.0, np.log(_USUAL_WIDTH_m), 0.0, 0.0])
    for k in np.unique(kind[place]):
        usual[k] = value[kind[place] == k].mean()
    return usual[kind], smooth_profile(*POPULATION, curvature, reach=SMOOTH)


def _pose(
    mean: Float[np.ndarray, "p"], settings: ModelSettings, protocol: TouchProtocol
) -> Float[np.ndarray, "p p"]:
    """Effect of pose errors on an object with these features."""
    one = FeatureSet.of_stiffness(
        np.exp(mean[:FIRST_WIDTH]).reshape(1, HEIGHTS, 4),
        np.exp(mean[FIRST_WIDTH:HEIGHT]).reshape(1, HEIGHTS, 2),
        ["any"],
    )
    return pose_covariance(one, mean[None], settings, protocol)


def _anything(settings: ModelSettings, protocol: TouchProtocol) -> ClassStatistics:
    mean = np.zeros(FEATURES)
    wide = smooth_profile(*UNKNOWN_CLASS_SIGMAS, reach=5.0)
    return ClassStatistics(mean, 0 * wide, wide, 0 * wide)
