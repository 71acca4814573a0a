"""Probabilities after some readings: each Gaussian of a model is conditioned in closed form.

Symbols: those of :mod:`.haptic_model`; o values that were read, v1 training objects and kinds of unknown,
c1 components and kinds of unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..data.readings import TouchReading
from .haptic_model import UNKNOWN, HapticModel
from .unknown_class import FIRST_WIDTH

__all__ = [
    "Belief",
    "answers_of",
    "belief_of",
    "by_answer",
    "condition",
    "evidence",
    "parts_of",
    "update_belief",
]


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Probabilities after some readings."""

    probability: Float[np.ndarray, "g"]  #: of each of the model's answers, "unknown" last
    weight: Float[np.ndarray, "v"]  #: of each training object
    unknown_weight: Float[np.ndarray, "u"]  #: of each kind of unknown object
    unknown_from: float
    answers: tuple[str, ...]

    @property
    def answer(self) -> str:
        """Most probable class, or "unknown"."""
        if self.probability[-1] >= self.unknown_from:
            return UNKNOWN
        return self.answers[int(np.argmax(self.probability[:-1]))]

    @property
    def confidence(self) -> float:
        """Probability of the answer."""
        return float(self.probability[self.answers.index(self.answer)])

    def as_mapping(self) -> dict[str, float]:
        """Class -> probability."""
        return dict(zip(self.answers, self.probability.tolist(), strict=True))


def update_belief(model: HapticModel, readings: Sequence[TouchReading]) -> Belief:
    """Posterior probabilities of the answers given what was measured.

    Parameters
    ----------
    model
        Of the candidates.
    readings
        Touches in any order; none gives the prior.
    """
    place, value, noise = evidence(model, readings)
    log_likelihood, _ = condition(model, place, value, noise)
    return belief_of(model, log_likelihood)


def evidence(
    model: HapticModel, readings: Sequence[TouchReading]
) -> tuple[Int[np.ndarray, "o"], Float[np.ndarray, "o"], Float[np.ndarray, "o"]]:
    """Places among the features, values and variances of the readings.

    Parameters
    ----------
    model
        Says whether widths count.
    readings
        Touches of one object.

    Returns
    -------
    tuple
        Places (o,), logarithms of what was measured (o,), their variances (o,).
    """
    place, value, noise = [], [], []
    for reading in readings:
        column = 0 if reading.axis == "x" else 2
        for k, side in enumerate(reading.sides):
            if side is None:
                continue
            place.append(4 * (reading.height - 1) + column + k)
            value.append(np.log(side.i_N_per_m))
            # Beyond this a logarithm is no Gaussian any more.
            noise.append(min(side.i_relative_sigma, 1.5) ** 2)
        if model.settings.use_width and np.isfinite(reading.width_m) and reading.width_m > 0:
            place.append(FIRST_WIDTH + 2 * (reading.height - 1) + column // 2)
            value.append(np.log(reading.width_m))
            noise.append(1e-6)
    return np.array(place, dtype=np.int64), np.array(value, dtype=float), np.array(noise, dtype=float)


def condition(
    model: HapticModel,
    place: Int[np.ndarray, "o"],
    value: Float[np.ndarray, "o"],
    noise: Float[np.ndarray, "o"],
) -> tuple[Float[np.ndarray, "v1"], tuple[Float[np.ndarray, "v1 p"], Float[np.ndarray, "c1 p p"]]]:
    """Log likelihood of each Gaussian of the model, and what it predicts given the readings.

    Parameters
    ----------
    model
        Of the candidates.
    place, value, noise
        Of :func:`evidence`.

    Returns
    -------
    tuple
        Log likelihood of each training object and, last, of each kind of unknown object; their conditioned means
        and covariances.
    """
    kinds = len(model.unknown_covariance)
    means = np.concatenate([model.mean, np.repeat(model.unknown_mean[None], kinds, axis=0)])
    part = parts_of(model)
    spreads = np.concatenate([model.covariance, model.unknown_covariance])
    if not len(place):
        return np.zeros(len(means)), (means, spreads)
    score = np.empty(len(means))
    after, left = np.empty_like(means), np.empty_like(spreads)
    for k, spread in enumerate(spreads):
        rows = part == k
        seen = spread[np.ix_(place, place)] + np.diag(noise)
        root = np.linalg.cholesky(seen)
        away = value - means[np.ix_(rows, place)]
        white = np.linalg.solve(root, away.T)
        score[rows] = -0.5 * (white**2).sum(axis=0) - np.log(np.diag(root)).sum()
        gain = np.linalg.solve(seen, spread[place]).T
        after[rows] = means[rows] + away @ gain.T
        left[k] = spread - gain @ spread[place]
    return score, (after, left)


def belief_of(
    model: HapticModel,
    log_likelihood: Float[np.ndarray, "v1"],
    without: Bool[np.ndarray, "v"] | None = None,
) -> Belief:
    """Posterior probabilities from the likelihoods of the Gaussians.

    Parameters
    ----------
    model
        Of the candidates.
    log_likelihood
        Of each training object and, last, of each kind of unknown object, see :func:`condition`.
    without
        Training objects that are left out; the prior of their class goes to the others of it.
    """
    prior = model.log_prior if without is None else np.where(without, -np.inf, model.log_prior)
    left = float(np.exp(model.log_prior).sum())
    if without is not None:
        # Each class keeps its share.
        for k in range(len(model.answer_of)):
            rows = model.component == k
            change = np.logaddexp.reduce(model.log_prior[rows]) - np.logaddexp.reduce(prior[rows])
            prior = np.where(rows, prior + np.where(np.isfinite(change), change, 0.0), prior)
    kinds = len(model.unknown_covariance)
    with np.errstate(divide="ignore"):
        strange = np.repeat(np.log(max(1 - left, 0.0) / kinds), kinds)
    score = np.concatenate([prior, strange]) + log_likelihood / model.temperature
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    probability = by_answer(weight[None], answers_of(model)[parts_of(model)], len(model.answers))[0]
    return Belief(probability, weight[:-kinds], weight[-kinds:], model.unknown_from, model.answers)


def parts_of(model: HapticModel) -> Int[np.ndarray, "v1"]:
    """Component of each Gaussian; kinds of unknown objects are counted after the components.

    Parameters
    ----------
    model
        Of the candidates.
    """
    known = len(model.answer_of)
    return np.concatenate([model.component, known + np.arange(len(model.unknown_covariance))])


def answers_of(model: HapticModel) -> Int[np.ndarray, "c1"]:
    """Answer of each component and of each kind of unknown.

    Parameters
    ----------
    model
        Of the candidates.
    """
    return np.append(model.answer_of, [len(model.answers) - 1] * len(model.unknown_covariance))


def by_answer(weight: Float[np.ndarray, "s v"], answer: Int[np.ndarray, "v"], count: int) -> np.ndarray:
    """Weights of Gaussians, summed for each answer.


    Parameters
    ----------
    weight
        Of v Gaussians, in s rows.
    answer
        Answer of each Gaussian.
    count
        Number of answers.
    """
    out: np.ndarray = weight @ np.eye(count)[answer]
    return out
