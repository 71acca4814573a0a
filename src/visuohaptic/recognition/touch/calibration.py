"""Probabilities that mean what they say, from explorations of what is left out of the training.

Whole objects are left out in turn, half of them moved outside the range of the others and half of them touched by a gripper
whose pose is poor. The temperature that divides the evidence (Guo et al. 2017) has their smallest mean log loss among the known
classes; what is added to the log odds of "unknown" is as much as lets only :data:`.FALSE_ALARM` of them be called so at the end.
Residuals of objects that the classes were not learned from are larger than a Gaussian's: the chi-square from which on readings
are like no class is that which only :data:`.FALSE_ALARM` of these explorations exceed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtri

from ...core.errors import InputError
from ..data.data_set import FeatureSet
from ..data.noise import as_measured
from ..data.readings import CurveCoefficients, TouchReading
from .bayes import TOUCHES
from .belief import FALSE_ALARM, evidence, log_likelihood
from .haptic_model import POSE_RATIO, RANGE_WIDENING, HapticModel, fit_model

__all__ = ["calibrate", "calibration_error", "reading_of"]

#: Parts of the training objects that are left out in turn; what is tried of the temperature.
FOLDS = 3
TEMPERATURES = np.geomspace(0.5, 6.0, 16)
#: Fraction of explorations ignored when the temperature is fitted: a few confidently wrong ones would dominate the loss.
IGNORED_FRACTION = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """What a model without some objects says of n explorations of them."""

    model: HapticModel
    likelihood: Float[np.ndarray, "n 2 c"]
    truth: Int[np.ndarray, "n"]  #: answers, of this model
    limit: Float[np.ndarray, "n"]  #: chi-square that a Gaussian exceeds at the false-alarm rate

    def loss(self, temperature: float) -> float:
        """Mean log loss among the known classes, of which :data:`IGNORED_FRACTION` may be wrong however sure."""
        score = self.model.log_prior + self.likelihood[:, 0] / temperature
        known = np.where(self.model.answer_of < len(self.model.answers) - 1, score, -np.inf)
        right = np.where(self.model.answer_of == self.truth[:, None], score, -np.inf)
        told = np.exp(np.logaddexp.reduce(right, axis=1) - np.logaddexp.reduce(known, axis=1))
        return float(
            -np.log((1 - IGNORED_FRACTION) * told + IGNORED_FRACTION / (len(self.model.answers) - 1)).mean()
        )

    def margin(self, temperature: float) -> Float[np.ndarray, "n"]:
        """Log odds of the most probable class against "unknown"."""
        score = self.model.log_prior + self.likelihood[:, 0] / temperature
        answers = range(len(self.model.answers))
        each = [np.logaddexp.reduce(score[:, self.model.answer_of == k], axis=1) for k in answers]
        out: np.ndarray = np.max(each[:-1], axis=0) - each[-1]
        return out

    def tail(self) -> Float[np.ndarray, "n"]:
        """Chi-square of the best Gaussian of a known class by the limit."""
        known = self.model.answer_of < len(self.model.answers) - 1
        fit, beside = np.moveaxis(self.likelihood[..., known], 1, 0)
        best = np.argmax(fit + self.model.log_prior[known], axis=1)[:, None]
        out: np.ndarray = 1.0 + 2.0 * np.take_along_axis(beside - fit, best, axis=1)[:, 0] / self.limit
        return out


def calibrate(
    model: HapticModel,
    data: FeatureSet,
    rng: np.random.Generator,
    *,
    explorations: int = 300,
    max_touches: int = 6,
) -> HapticModel:
    """Fit the temperature, what is added to the log odds of "unknown", and from which chi-square on nothing is known.

    Parameters
    ----------
    model
        Of :func:`.fit_model`, from the same data.
    data
        Its training objects.
    rng
        Which objects, which touches, what noise.
    explorations
        How many; each is judged after every touch.
    max_touches
        Of one exploration.
    """
    name_of = {member: name for name, members in model.groups.items() for member in members}
    answer = np.array([name_of.get(label, label) for label in data.label])
    if set(answer) != set(model.answers[:-1]):
        raise InputError("calibrate", "expected the training objects of the model")
    # Every class is in every fold; of few objects, more are left than are taken.
    turn = np.empty(len(data), dtype=np.int64)
    for k in range(len(data.classes)):
        rows = rng.permutation(np.flatnonzero(data.number == k))
        turn[rows] = np.arange(len(rows)) % FOLDS
    judged = [
        _explored(model, data, answer, turn == fold, explorations // FOLDS, max_touches, rng)
        for fold in range(FOLDS)
    ]
    temperature = float(
        min(TEMPERATURES, key=lambda value: float(np.mean([one.loss(float(value)) for one in judged])))
    )
    last = np.concatenate([one.margin(temperature)[max_touches - 1 :: max_touches] for one in judged])
    # Before anything is touched "unknown" is at most as probable as all classes together.
    log_odds = min(
        float(np.quantile(last, FALSE_ALARM)), math.log(1 / max(model.settings.unknown_prior, 1e-300) - 1)
    )
    tails = np.concatenate([one.tail()[max_touches - 1 :: max_touches] for one in judged])
    tail = max(float(np.quantile(tails, 1.0 - FALSE_ALARM)), 1.0)
    return replace(model, temperature=temperature, unknown_log_odds=log_odds, tail=tail)


def calibration_error(
    confidence: Float[np.ndarray, "k"], right: Float[np.ndarray, "k"], bins: int = 10
) -> float:
    """Expected calibration error: mean distance of confidence and accuracy, in bins of equal width (Guo et al. 2017).

    Parameters
    ----------
    confidence
        Of k answers, 0 to 1.
    right
        1 where the answer was right, 0 elsewhere.
    bins
        Number of bins.
    """
    confidence, right = np.asarray(confidence, dtype=float), np.asarray(right, dtype=float)
    edges = np.linspace(0, 1, bins + 1)
    which = np.clip(np.digitize(confidence, edges) - 1, 0, bins - 1)
    total = 0.0
    for k in np.unique(which):
        some = which == k
        total += abs(confidence[some].mean() - right[some].mean()) * np.count_nonzero(some)
    return float(total / len(confidence))


def reading_of(data: FeatureSet, row: int, height: int, axis: str, model: HapticModel) -> TouchReading:
    """A touch of a training object, with the uncertainty expected of such a reading.

    Parameters
    ----------
    data
        Training objects.
    row
        Number of the object.
    height
        1 to 16.
    axis
        ``x`` or ``y``.
    model
        Says how the gripper touches.
    """
    column = 0 if axis == "x" else 2
    sides = []
    for k in (column, column + 1):
        i, full, second = (float(value) for value in data.features[row, height - 1, k])
        sides.append(CurveCoefficients(i, full, second, model.protocol.relative_sigma(i), float("nan")))
    tall = math.nan if data.height_m is None else float(data.height_m[row])
    width = float(data.width_m[row, height - 1, column // 2])
    return TouchReading(height, axis, (sides[0], sides[1]), width, tall)


def _explored(
    model: HapticModel,
    data: FeatureSet,
    answer: np.ndarray,
    out: Bool[np.ndarray, "n"],
    explorations: int,
    max_touches: int,
    rng: np.random.Generator,
) -> _Judged:
    """Explorations of the objects that are left out, by a model of the others."""
    rest = data.take(~out)
    without = fit_model(rest, model.groups, settings=model.settings, protocol=model.protocol)
    found, truth, limit = [], [], []
    for row in rng.choice(np.flatnonzero(out), explorations):
        one = _as_touched(data, int(row), model, rng)
        right = without.answers.index(str(answer[row]))
        order = rng.permutation(len(TOUCHES))[:max_touches]
        readings = [reading_of(one, 0, *TOUCHES[int(k)], without) for k in order]
        for count in range(1, max_touches + 1):
            read = evidence(without, readings[:count])
            found.append(log_likelihood(without, *read))
            truth.append(right)
            limit.append(chdtri(len(read[0]), FALSE_ALARM))
    return _Judged(without, np.array(found), np.array(truth), np.array(limit))


def _as_touched(data: FeatureSet, row: int, model: HapticModel, rng: np.random.Generator) -> FeatureSet:
    """An object as an exploration reads it: half of them outside the range of their class, half by a poor pose."""
    settings = model.settings
    alike = np.array(data.label) == data.label[row]
    stretch = RANGE_WIDENING if rng.random() < 0.5 else 1.0
    one = data.take(np.array([row]))

    def moved(values: np.ndarray) -> np.ndarray:
        middle = np.log(values[alike]).mean(axis=0)
        return np.asarray(np.exp(middle + stretch * (np.log(values[[row]]) - middle)))

    features = one.features.copy()
    features[..., 0] = moved(data.features[..., 0]) * np.exp(settings.gain * rng.standard_normal())
    width = moved(data.width_m) + settings.width_m * rng.standard_normal(one.width_m.shape)
    pose_m = settings.pose_m * (POSE_RATIO if rng.random() < 0.5 else 1.0)
    tall = None if data.height_m is None else moved(data.height_m) + pose_m * rng.standard_normal(1)
    measured = as_measured(
        np.log(features[..., 0]), rng, pose_errors=one.pose_errors, protocol=model.protocol,
        pose_m=pose_m, discrepancy=settings.discrepancy,
    )  # fmt: skip
    features[..., 0] = np.exp(measured)
    return replace(one, features=features, width_m=width, height_m=tall)
