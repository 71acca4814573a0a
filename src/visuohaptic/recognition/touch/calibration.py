"""Calibration of a model by simulated explorations of objects that are left out of its training.

Whole objects are left out in turn, half of them moved outside the range of the others, and touched with the nuisances of the
model. The temperature that divides the evidence (Guo et al. 2017) minimises their mean log loss among the known
classes, if it is better than 1 by more than the standard error of that difference. Two limits decide for "unknown": its log odds are raised, and the limit of chi-square is, since residuals of objects
outside the training set are larger than those of a Gaussian. Both have the same rate of false alarms, with which
:data:`.FALSE_ALARM` of the explorations exceed one of them or both.

Objects that are left out at random lie between the others of their class, where a Gaussian interpolates. Real objects deviate beyond
the training objects, and this error is common to the readings of an object. It is learned from the outer objects of each class
(:data:`OUTER`), to which the others are extrapolated: the correlation of the errors maximises the likelihood of their classes.

The limits are quantiles of N simulated explorations. The rate p beyond an empirical quantile has a standard error of
sqrt(p (1 - p) / N), so that a relative error of :data:`RATE_ERROR` requires N = (1 - p) / (p RATE_ERROR^2) explorations.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from ...core.errors import InputError
from ..data import FeatureSet, SqueezedObject
from ..data.noise import as_measured
from .bayes import TOUCHES
from .belief import (
    FALSE_ALARM,
    JUDGED_TOUCHES,
    WIDTH_VARIANCE,
    class_chi_square,
    class_likelihood,
    evidence,
    log_likelihood,
    running_sums,
    values_of,
    whiten,
)
from .exemplars import learn_exemplars, pooled_powers, thinned
from .haptic_model import RANGE_WIDENING, HapticModel, fit_model
from .nuisances import APART, log_features
from .unknown_class import FEATURES, FIRST_WIDTH, HEIGHT, USUAL_HEIGHT_m

#: Number of folds of the training objects, each of which is left out in turn; candidate temperatures.
FOLDS = 3
TEMPERATURES = np.geomspace(0.5, 6.0, 16)
#: Fraction of each class, those farthest from its mean, that is left out for the correlation: as many as in a fold.
OUTER = 1 / FOLDS
#: Objects of each class that are left out for the powers of Gaussians and kernels, which a few hundred determine to a tenth.
JUDGED = 100
#: Fraction of explorations that may be wrong at any confidence when the temperature is fitted (a mixture with chance): a few of
#: them would dominate the loss.
IGNORED_FRACTION = 0.02
#: Relative standard error of the false-alarm rate by the number of simulated explorations: .0100 +- .0015. The log odds then
#: vary by .2 to .3 between seeds, less than by the choice of 180 training objects (.3 to .6 by a bootstrap of the objects).
RATE_ERROR = 0.15
#: Number of explorations for the limits, and for the temperature: as a mean, it is accurate to a few percent with these.
EXPLORATIONS = round((1.0 - FALSE_ALARM) / FALSE_ALARM / RATE_ERROR**2)
TEMPERED = 600
#: Explorations that are factorised together: their matrices fit into a cache, and the results are the same with any number.
BLOCK = 96


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """Likelihoods of n explorations of t touches by a model that was fitted without their objects."""

    model: HapticModel
    likelihood: Float[np.ndarray, "n t 2 c"]  #: and chi-square, after each touch
    truth: Int[np.ndarray, "n"]  #: answers, of this model
    obj: Int[np.ndarray, "n"]  #: object of each exploration
    values: Int[np.ndarray, "t"]  #: number of values after each touch

    @property
    def freedom(self) -> int:
        """Number of values after the last touch."""
        return int(self.values[-1])

    def losses(
        self, temperature: float, correlation: float = 0.0, explorations: int = TEMPERED // FOLDS
    ) -> Float[np.ndarray, "o"]:
        """Mean log loss of each object among the known classes, :data:`IGNORED_FRACTION` of which may be wrong at any confidence."""
        used = self.likelihood[:explorations, :, 0]
        divisor = replace(self.model, temperature=temperature, correlation=correlation).temperature_of(
            self.values
        )
        score = self.model.log_prior + used / divisor[:, None]
        known = np.where(self.model.answer_of < len(self.model.answers) - 1, score, -np.inf)
        right = self.model.answer_of == self.truth[: len(used), None, None]
        own = np.logaddexp.reduce(np.where(right, score, -np.inf), axis=2)
        probability = np.exp(own - np.logaddexp.reduce(known, axis=2))
        mixed = (1 - IGNORED_FRACTION) * probability + IGNORED_FRACTION / (len(self.model.answers) - 1)
        _, number = np.unique(self.obj[: len(used)], return_inverse=True)
        out: np.ndarray = np.bincount(number, -np.log(mixed).mean(axis=1)) / np.bincount(number)
        return out

    def margin(self, temperature: float) -> Float[np.ndarray, "n"]:
        """Log odds of the most probable class against "unknown" at the end."""
        score = self.model.log_prior + self.likelihood[:, -1, 0] / temperature
        answers = range(len(self.model.answers))
        each = [np.logaddexp.reduce(score[:, self.model.answer_of == k], axis=1) for k in answers]
        out: np.ndarray = np.max(each[:-1], axis=0) - each[-1]
        return out

    def tail(self) -> Float[np.ndarray, "n"]:
        """Chi-square of the best known class at the end, as a ratio to the limit."""
        known = self.model.answer_of < len(self.model.answers) - 1
        fit, square = np.moveaxis(self.likelihood[:, -1], 1, 0)
        best = np.argmax(np.where(known, fit + self.model.log_prior, -np.inf), axis=1)[:, None]
        found = np.take_along_axis(class_chi_square(self.model, square, self.freedom), best, axis=1)
        out: np.ndarray = found[:, 0] / chdtri(self.freedom, FALSE_ALARM)
        return out


def calibrate(
    model: HapticModel,
    data: FeatureSet,
    rng: np.random.Generator,
    *,
    explorations: int = EXPLORATIONS,
    max_touches: int = JUDGED_TOUCHES,
) -> HapticModel:
    """Fit the temperature, the correlation of errors, the offset of the log odds of "unknown", and the factor of the limit of chi-square.

    Parameters
    ----------
    model
        Of :func:`.fit_model`, from the same data.
    data
        Its training objects.
    rng
        Source of the sampled objects, touches and noise.
    explorations
        Number of simulated explorations of objects that are left out at random; a third as many are of outer ones.
    max_touches
        Number of touches of one exploration.
    """
    name_of = {member: name for name, members in model.groups.items() for member in members}
    answer = np.array([name_of.get(label, label) for label in data.label])
    if set(answer) != set(model.answers[:-1]):
        raise InputError("calibrate", "expected the training objects of the model")
    # Every class is in every fold; of a class with few objects, more stay in training than are left out.
    turn = np.empty(len(data), dtype=np.int64)
    for k in range(len(data.classes)):
        rows = rng.permutation(np.flatnonzero(data.number == k))
        turn[rows] = np.arange(len(rows)) % FOLDS
    judged = [
        _explored(model, data, answer, turn == fold, explorations // FOLDS, max_touches, rng)
        for fold in range(FOLDS)
    ]
    losses = [np.concatenate([one.losses(value) for one in judged]) for value in (1.0, *TEMPERATURES)]
    temperature = float((1.0, *TEMPERATURES)[best_or_first(np.array(losses))])
    margins = np.concatenate([one.margin(temperature) for one in judged])
    tails = np.concatenate([one.tail() for one in judged])
    rate = rate_of_each(margins, tails)
    log_odds = (
        float(np.quantile(margins, rate)) * values_of(model.settings, JUDGED_TOUCHES) / judged[0].freedom
    )
    tail = max(float(np.quantile(tails, 1.0 - rate)), 1.0)
    count = explorations // FOLDS
    outer = _explored(model, data, answer, _outer(model, data), count, max_touches, rng, stretches=(1.0,))
    common = minimize_scalar(
        lambda one: outer.losses(temperature, one, count).mean(), bounds=(0.0, 1.0), options={"xatol": 2e-3}
    )
    return replace(
        model, temperature=temperature, correlation=float(common.x), unknown_log_odds=log_odds, tail=tail
    )


def _outer(model: HapticModel, data: FeatureSet) -> Bool[np.ndarray, "n"]:
    """Objects farthest from the means of their classes, :data:`OUTER` of each, by the first Gaussian of each class."""
    features, out = log_features(data, model.protocol), np.zeros(len(data), dtype=bool)
    for k in range(len(data.classes)):
        rows = np.flatnonzero(data.number == k)
        first = int(np.flatnonzero(model.part == k)[0])
        white = np.linalg.solve(
            np.linalg.cholesky(model.covariance[first]), (features[rows] - model.mean[first]).T
        )
        out[rows[np.argsort(-(white**2).sum(axis=0))[: math.ceil(OUTER * len(rows))]]] = True
    return out


def with_exemplars(
    model: HapticModel,
    squeezed: Sequence[SqueezedObject],
    learn: Callable[[Sequence[SqueezedObject]], HapticModel],
) -> HapticModel:
    """The same model with a density around its objects, see :mod:`.exemplars`.

    It is unchanged unless more objects of each class than there are places were read at the same places, those of most objects,
    once at each. Fewer objects lie in a plane of these readings, and do not show how the class varies across it: no kernel that is
    learned by leaving them out knows an exploration that differs in that direction.

    Parameters
    ----------
    model
        Of :func:`.learn_from_curves`.
    squeezed
        Its training objects.
    learn
        Learns a model without some of them.
    """
    names = list(dict.fromkeys(one.label for one in squeezed))
    read = [evidence(model, one.readings) for one in squeezed]
    places = [tuple(np.sort(place)) for place, _, _ in read]
    common = Counter(places).most_common(1)[0][0]
    rows = [k for k, one in enumerate(places) if one == common]
    part = np.array([names.index(squeezed[k].label) for k in rows])
    if np.bincount(part, minlength=len(names)).min() <= len(common) or len(set(common)) < len(common):
        return model
    density = learn_exemplars([read[k] for k in rows], part)
    few = thinned(part, JUDGED)
    judged = density if len(few) == len(rows) else learn_exemplars([read[rows[k]] for k in few], part[few])
    asked = [squeezed[rows[k]] for k in few]
    turn = np.concatenate([np.arange(count) % FOLDS for count in np.bincount(part[few])])
    gaussian = np.empty((len(asked), len(names)))
    for fold in set(turn.tolist()):
        without = learn([one for one, its in zip(asked, turn, strict=True) if its != fold])
        for k in np.flatnonzero(turn == fold).tolist():
            seen = evidence(without, asked[k].readings)
            gaussian[k] = class_likelihood(without, log_likelihood(without, *seen)[0])
    powers = pooled_powers(gaussian, judged.left_out(turn), judged.part)
    return replace(model, exemplars=replace(density, powers=powers))


def best_or_first(losses: Float[np.ndarray, "t o"]) -> int:
    """Candidate with the lowest mean loss, or the first one if its loss is higher by at most one standard error.

    The rule of one standard error (Breiman et al. 1984): the simplest candidate is kept unless the data refute it. All
    candidates are evaluated on the same objects, so that the standard error is that of the mean difference; explorations of
    one object are not independent, objects are.

    Parameters
    ----------
    losses
        Cross-validated loss of each of t candidates on each of o objects, the simplest candidate first.
    """
    best = int(np.argmin(losses.mean(axis=1)))
    gain = losses[0] - losses[best]
    return best if gain.mean() > gain.std(ddof=1) / math.sqrt(len(gain)) else 0


def rate_of_each(margins: Float[np.ndarray, "n"], tails: Float[np.ndarray, "n"]) -> float:
    """Common false-alarm rate of both limits with which :data:`.FALSE_ALARM` of the explorations exceed one of them or both.

    An exploration exceeds a limit of the rate k / n if its rank from that end is below k: by its lower rank it exceeds the
    first of the two.

    Parameters
    ----------
    margins
        Log odds against "unknown"; low ones are beyond their limit.
    tails
        Chi-square as a ratio to its limit; high ones are beyond it.
    """
    first = np.minimum(np.argsort(np.argsort(margins)), np.argsort(np.argsort(-tails)))
    return float(np.quantile(first, FALSE_ALARM)) / len(first)


def _explored(
    model: HapticModel,
    data: FeatureSet,
    answer: np.ndarray,
    out: Bool[np.ndarray, "n"],
    explorations: int,
    max_touches: int,
    rng: np.random.Generator,
    stretches: Sequence[float] = (1.0, RANGE_WIDENING),
) -> _Judged:
    """Explorations of the objects that are left out, with a model fitted to the others."""
    without = fit_model(data.take(~out), model.groups, settings=model.settings, protocol=model.protocol)
    rows = np.resize(rng.permutation(np.flatnonzero(out)), explorations)  # all of them equally often
    value, noise = _features_as_touched(data, rows, model, rng, stretches)
    order = np.argsort(rng.random((explorations, len(TOUCHES))), axis=1)[:, :max_touches]
    # Touches are sorted by height, then by axis: touch k reads features 2 k and 2 k + 1, and width k.
    place = np.stack([2 * order, 2 * order + 1, FIRST_WIDTH + order], axis=2)
    first = 0
    if not model.settings.use_width:
        place = place[:, :, :2]
    elif data.height_m is not None:
        first = 1
    ends = first + place.shape[2] * np.arange(1, max_touches + 1)
    place = np.column_stack([np.full((explorations, first), HEIGHT), place.reshape(explorations, -1)])
    value, noise = (np.take_along_axis(one, place, axis=1) for one in (value, noise))
    found = _explored_likelihoods(without, place, value, noise, ends)
    truth = np.array([without.answers.index(str(name)) for name in answer[rows]])
    return _Judged(without, found, truth, rows, ends)


def _explored_likelihoods(
    model: HapticModel,
    place: Int[np.ndarray, "n o"],
    value: Float[np.ndarray, "n o"],
    noise: Float[np.ndarray, "n o"],
    ends: Int[np.ndarray, "e"],
) -> Float[np.ndarray, "n e 2 c"]:
    """:func:`sequential_likelihood` of many explorations with the same number of values.

    Gaussian by Gaussian: the covariance of one fits into the cache, those of all do not.
    """
    out = np.empty((len(place), len(ends), 2, len(model.mean)))
    pairs = place[:, :, None] * model.mean.shape[1] + place[:, None, :]
    own = np.arange(place.shape[1])
    parts = [slice(first, first + BLOCK) for first in range(0, len(place), BLOCK)]
    fit, before = (np.broadcast_to(one, len(model.mean)) for one in (model.fit, model.square))
    for k, (mean, covariance) in enumerate(zip(model.mean, model.covariance, strict=True)):
        for at in parts:
            seen = covariance.ravel().take(pairs[at])
            seen[:, own, own] += noise[at]
            square, size = running_sums(*whiten(seen, value[at] - mean[place[at]]), ends)
            out[at, :, 0, k], out[at, :, 1, k] = fit[k] - 0.5 * square - size, before[k] + square
    return out


def _features_as_touched(
    data: FeatureSet,
    rows: Int[np.ndarray, "n"],
    model: HapticModel,
    rng: np.random.Generator,
    stretches: Sequence[float],
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "n p"]]:
    """Features of objects as measured by explorations, and their variances.

    The factors of the range of their class (``stretches``) and of the pose error have equal probability, and the
    nuisances have the effects on the mean of the class.
    """
    settings, count = model.settings, len(rows)
    stretch = rng.choice(stretches, count)
    pose_m = settings.pose_m * rng.choice(settings.poses, count)

    def moved(values: np.ndarray) -> np.ndarray:
        logs = np.log(values)
        mean = np.stack([logs[data.number == k].mean(axis=0) for k in range(len(data.classes))])[data.number]
        factor = stretch.reshape(-1, *[1] * (logs.ndim - 1))
        return np.asarray(mean[rows] + factor * (logs - mean)[rows])

    measured = as_measured(
        moved(data.features[..., 0]), rng,
        pose_errors=None if data.pose_errors is None else data.pose_errors[rows],
        protocol=model.protocol, pose_m=pose_m, discrepancy=settings.discrepancy,
    )  # fmt: skip
    stiffness = np.exp(measured).reshape(count, -1)
    width_m = np.exp(moved(data.width_m)).reshape(count, -1)
    width_m += settings.width_m * rng.standard_normal(width_m.shape)
    height_m = np.full(count, USUAL_HEIGHT_m)
    if data.height_m is not None:
        height_m = np.exp(moved(data.height_m)) + pose_m * rng.standard_normal(count)
    value = np.column_stack([
        model.protocol.seen_stiffness(stiffness)[0], np.log(width_m), np.log(height_m / USUAL_HEIGHT_m), np.zeros(count)
    ])  # fmt: skip
    effect = np.stack([model.nuisance[model.part == k][0, APART] for k in range(len(data.classes))])
    value += np.einsum("nm,nmp->np", rng.standard_normal((count, len(APART))), effect[data.number[rows]])
    noise = np.full((count, FEATURES), WIDTH_VARIANCE)
    noise[:, :FIRST_WIDTH] = model.protocol.seen_variance(stiffness)
    return value, noise
