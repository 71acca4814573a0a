"""Posterior probabilities given some readings: each Gaussian of a model is conditioned in closed form.

Symbols: those of :mod:`.haptic_model`; o measured values; q their chi-square under a Gaussian.

The Gaussians of "unknown" describe other common containers. An object that none of them predicts would be assigned to the
known class that is least improbable. The best known class therefore has an alternative, similar but unknown, whose density is
everywhere that of the class where a test of the stated false-alarm rate just rejects it (:func:`.posterior_with_unknown`). The Gaussians
of a class differ by their scale: the tail probability of the readings is the average of those of its Gaussians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, chdtri

from ..data.places import HEIGHTS
from ..data.readings import TouchReading
from .haptic_model import HapticModel
from .nuisances import ModelSettings
from .unknown_class import CURVATURE, FIRST_WIDTH, HEIGHT, USUAL_HEIGHT_m
from .zeros import curvatures, with_zeros

#: Relative variance of a measured width: 1e-4 m of noise at each tip, at a width of about 6 cm, is 0.24 %; the contact error
#: is part of the model.
WIDTH_VARIANCE = 0.0024**2
#: Probability that readings of a known class are rejected, at each test: one in a hundred.
FALSE_ALARM = 0.01
#: Touches of the explorations by which "unknown" is calibrated; errors of its densities accumulate with the values that are read.
JUDGED_TOUCHES = 10


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Posterior probabilities given some readings."""

    probability: Float[np.ndarray, "g"]  #: of each of the model's answers, "unknown" last
    weight: Float[np.ndarray, "c"]  #: of each Gaussian
    answers: tuple[str, ...]

    @property
    def answer(self) -> str:
        """Most probable class, or "unknown"."""
        return self.answers[int(np.argmax(self.probability))]

    @property
    def confidence(self) -> float:
        """Probability of the answer."""
        return float(self.probability.max())

    def as_mapping(self) -> dict[str, float]:
        """Class -> probability."""
        return dict(zip(self.answers, self.probability.tolist(), strict=True))


def update_belief(model: HapticModel, readings: Sequence[TouchReading]) -> Belief:
    """Posterior probabilities of the answers given the readings.

    Parameters
    ----------
    model
        Of the candidates.
    readings
        Touches in any order; without any, the result is the prior, given the outline if the model has one.
    """
    read = evidence(model, readings)
    return belief_of(model, log_likelihood(with_zeros(model, readings), *read), len(read[0]))


def evidence(
    model: HapticModel, readings: Sequence[TouchReading]
) -> tuple[Int[np.ndarray, "o"], Float[np.ndarray, "o"], Float[np.ndarray, "o"]]:
    """Feature indices, values and variances of the readings.

    Parameters
    ----------
    model
        Defines whether widths are evidence, and the resolution of a touch.
    readings
        Touches of one object.

    Returns
    -------
    tuple
        Feature indices (o,), measured values (o,), logarithms but for the curvature, and their variances (o,).
    """
    place, value, noise = [], [], []
    for reading in readings:
        column = 0 if reading.axis == "x" else 2
        for k, side in enumerate(reading.sides):
            if side is None or not np.isfinite(side.i_N_per_m):
                continue
            place.append(4 * (reading.height - 1) + column + k)
            seen, factor = model.protocol.seen_stiffness(np.array(side.i_N_per_m))
            value.append(float(seen))
            # Beyond this, the error of a logarithm is no longer Gaussian.
            relative = math.hypot(side.i_relative_sigma, model.settings.repeat)
            noise.append(min(float(factor) * relative, 1.0) ** 2)
        if model.settings.use_width and np.isfinite(reading.width_m) and reading.width_m > 0:
            place.append(FIRST_WIDTH + 2 * (reading.height - 1) + column // 2)
            value.append(np.log(reading.width_m))
            noise.append(WIDTH_VARIANCE + model.settings.width_repeat**2)
    tall = [one.object_height_m for one in readings if one.object_height_m > 0]
    if model.settings.use_width and tall:
        # A single measurement, relative to which all touches were positioned.
        place.append(HEIGHT)
        value.append(np.log(np.mean(tall) / USUAL_HEIGHT_m))
        noise.append(WIDTH_VARIANCE)
    bent, own, zero = curvatures(model, readings)
    if np.isfinite(model.settings.curvature) and len(bent):
        # The errors of the zeros are common to all curves of an exploration, the others are independent.
        weight = 1 / (model.settings.curvature**2 + own + zero**2)
        weight /= weight.sum()
        place.append(CURVATURE)
        value.append(weight @ bent)
        noise.append(weight**2 @ (model.settings.curvature**2 + own) + (weight @ zero) ** 2)
    return np.array(place, dtype=np.int64), np.array(value, dtype=float), np.array(noise, dtype=float)


def log_likelihood(
    model: HapticModel,
    place: Int[np.ndarray, "o"],
    value: Float[np.ndarray, "o"],
    noise: Float[np.ndarray, "o"] | Float[np.ndarray, "o o"],
) -> Float[np.ndarray, "2 c"]:
    """Log likelihood of each Gaussian of the model and of its similar but unknown alternative, up to a constant.

    Parameters
    ----------
    model
        Of the candidates.
    place, value, noise
        Of :func:`evidence`, or with the covariance of the errors in place of their variances; without any reading
        or outline, the second row is minus infinity.
    """
    fit, square = sequential_likelihood(model, place, value, noise, np.array([len(place)]))[0]
    fit = fit + _by_exemplars(model, fit, (place, value, noise))
    freedom = model.freedom + len(place)
    each = model.temperature * model.unknown_log_odds / values_of(model.settings, JUDGED_TOUCHES)
    fit = np.where(model.part < 0, fit + each * freedom, fit)
    if not freedom:
        return np.stack([fit, np.full_like(fit, -np.inf)])
    limit = model.tail * chdtri(freedom, FALSE_ALARM)
    return np.stack([fit, fit + 0.5 * (class_chi_square(model, square, freedom) - limit)])


def values_of(settings: ModelSettings, touches: int) -> int:
    """Number of values of an exploration: two stiffnesses each, with widths one width each, and the height of the object.

    Parameters
    ----------
    settings
        Whether widths are evidence.
    touches
        Number of touches.
    """
    return 3 * touches + 1 if settings.use_width else 2 * touches


def class_likelihood(model: HapticModel, fit: Float[np.ndarray, "c"]) -> Float[np.ndarray, "k"]:
    """Log likelihood of each trained class: the average over its Gaussians.

    Parameters
    ----------
    model
        Of the candidates.
    fit
        Log likelihood of each Gaussian.
    """
    with np.errstate(divide="ignore"):
        score = fit + np.log(model.fraction)
    return np.array([np.logaddexp.reduce(score[model.part == k]) for k in range(int(model.part.max()) + 1)])


def _by_exemplars(
    model: HapticModel, fit: Float[np.ndarray, "c"], read: tuple[np.ndarray, ...]
) -> np.ndarray:
    """Change of the log likelihood of each Gaussian by the objects of its class; that of all classes together is kept."""
    log = None if model.exemplars is None else model.exemplars.log_density(*read)
    if model.exemplars is None or log is None:
        return np.zeros_like(fit)
    known = model.part >= 0
    own = class_likelihood(model, fit)
    moved = (model.exemplars.powers[0] - 1) * own + model.exemplars.powers[1] * log
    before, after = (
        np.logaddexp.reduce((score + model.log_prior)[known]) for score in (fit, fit + moved[model.part])
    )
    if not np.isfinite(before) or not np.isfinite(after):
        return np.zeros_like(fit)
    return np.where(known, moved[model.part] + before - after, 0.0)


def class_chi_square(
    model: HapticModel, square: Float[np.ndarray, "*n c"], freedom: int
) -> Float[np.ndarray, "*n c"]:
    """Chi-square with the tail probability that the readings have under all Gaussians of a trained class.

    Parameters
    ----------
    model
        Of the candidates.
    square
        Chi-square under each Gaussian.
    freedom
        Number of values, above 0.
    """
    alike = (model.part == model.part[:, None]) * model.fraction[:, None]
    tail = chdtrc(freedom, square) @ (alike / np.maximum(alike.sum(axis=0), 1e-300))
    # The lower bound keeps the result finite, far beyond any limit.
    out: np.ndarray = chdtri(freedom, np.maximum(tail, 1e-300))
    return out


def sequential_likelihood(
    model: HapticModel,
    place: Int[np.ndarray, "o"],
    value: Float[np.ndarray, "o"],
    noise: Float[np.ndarray, "o"] | Float[np.ndarray, "o o"],
    ends: Int[np.ndarray, "e"],
) -> Float[np.ndarray, "e 2 c"]:
    """Log likelihood and chi-square of each Gaussian for the first values of a sequence of readings, for several numbers of values.

    The Cholesky factor of the leading block of a matrix is the leading block of its factor, so one factorisation is enough for all.

    Parameters
    ----------
    model, place, value, noise
        As of :func:`log_likelihood`.
    ends
        Numbers of values that are used, up to o.
    """
    square, size = running_sums(*_whitened(model, place, value, noise), ends).transpose(0, 2, 1)
    return np.stack([model.fit - 0.5 * square - size, model.square + square], axis=1)


def running_sums(
    root: Float[np.ndarray, "n o o"], white: Float[np.ndarray, "n o"], ends: Int[np.ndarray, "e"]
) -> Float[np.ndarray, "2 n e"]:
    """Chi-squares of the first values, and logarithms of the roots of their determinants.

    Parameters
    ----------
    root, white
        Of :func:`whiten`.
    ends
        Numbers of values, up to o.
    """
    terms = np.zeros((2, len(white), white.shape[1] + 1))
    terms[0, :, 1:], terms[1, :, 1:] = white**2, np.log(np.diagonal(root, axis1=1, axis2=2))
    out: np.ndarray = np.cumsum(terms, axis=2)[:, :, ends]
    return out


def condition(
    model: HapticModel,
    place: Int[np.ndarray, "o"],
    value: Float[np.ndarray, "o"],
    noise: Float[np.ndarray, "o"] | Float[np.ndarray, "o o"],
) -> tuple[Float[np.ndarray, "c p"], Float[np.ndarray, "c p p"]]:
    """Prediction of each Gaussian of the model given the readings: conditional means and covariances.

    Parameters
    ----------
    model, place, value, noise
        As of :func:`log_likelihood`.
    """
    root, white = _whitened(model, place, value, noise)
    gain = np.linalg.solve(root, model.covariance[:, place]).transpose(0, 2, 1)
    after = model.mean + (gain @ white[..., None])[..., 0]
    return after, model.covariance - gain @ gain.transpose(0, 2, 1)


def with_outline(
    model: HapticModel, outline_m: Float[np.ndarray, "k 2"], errors: Float[np.ndarray, "k k"]
) -> HapticModel:
    """Model of an object whose outline is measured before the first touch: every Gaussian is conditioned on its widths.

    The outline discriminates between classes, and determines the width of the object at every place that is touched later.
    The foot and the closure are not part of the shape: the lowest and the highest place are left out. If the errors of
    neighbouring radii are alike, their covariance must say so: a smooth error would otherwise be evidence for another profile, and
    so for the unknown class. The error of the object's height is part of the model.

    Parameters
    ----------
    model
        Of the candidates.
    outline_m
        Radius and height (k, 2) [m], from the bottom up.
    errors
        Covariance (k, k) of the errors of the logarithms of these radii.
    """
    level = np.arange(1, HEIGHTS - 1)
    height = (level + 0.5) / HEIGHTS * outline_m[-1, 1]
    at = np.array([np.interp(height, outline_m[:, 1], row) for row in np.eye(len(outline_m))])
    noise = at.T @ errors @ at + WIDTH_VARIANCE * np.eye(len(level))
    read = FIRST_WIDTH + 2 * level, np.log(2.0 * outline_m[:, 0]) @ at, noise
    mean, covariance = condition(model, *read)
    fit, square = sequential_likelihood(model, *read, np.array([len(level)]))[0]
    return replace(
        model,
        mean=mean,
        covariance=covariance,
        fit=fit,
        square=square,
        freedom=model.freedom + len(level),
        exemplars=None,  # their density is not conditioned
    )


def _whitened(
    model: HapticModel, place: np.ndarray, value: np.ndarray, noise: np.ndarray
) -> tuple[Float[np.ndarray, "c o o"], Float[np.ndarray, "c o"]]:
    """Cholesky factor of the covariance of the readings under each Gaussian, and whitened residuals."""
    flat = model.covariance.reshape(len(model.mean), -1)
    seen = flat.take(place[:, None] * model.mean.shape[1] + place, axis=1)  # twice as fast as by two indices
    return whiten(seen + (noise if noise.ndim == 2 else np.diag(noise)), value - model.mean[:, place])


def whiten(
    covariance: Float[np.ndarray, "n o o"], residual: Float[np.ndarray, "n o"]
) -> tuple[Float[np.ndarray, "n o o"], Float[np.ndarray, "n o"]]:
    """Cholesky factors of covariances, and the residuals that they whiten.

    With the residuals as an additional row, the last row of the Cholesky factor contains the whitened residuals.

    Parameters
    ----------
    covariance, residual
        Of n sets of o values.
    """
    count = residual.shape[1]
    bordered = np.empty((len(covariance), count + 1, count + 1))
    bordered[:, :count, :count] = covariance
    bordered[:, count, :count] = bordered[:, :count, count] = residual
    bordered[:, count, count] = 1e300  # above any squared residual; no other entry depends on it
    root = np.linalg.cholesky(bordered)
    return root[:, :count, :count], root[:, count, :count]


def belief_of(model: HapticModel, likelihood: Float[np.ndarray, "2 c"], values: int) -> Belief:
    """Posterior probabilities from the likelihoods of the Gaussians; "unknown" includes what resembles none of them.

    Parameters
    ----------
    model
        Of the candidates.
    likelihood
        See :func:`log_likelihood`.
    values
        Number of values that were read, without those of an outline.
    """
    score, beside = likelihood / model.temperature + model.log_prior
    foreign = model.answer_of == len(model.answers) - 1
    best = int(np.argmax(np.where(foreign, -np.inf, score)))
    # Skipped without readings, and for a closed set of classes (prior probability of "unknown" 0).
    if np.isfinite(beside[best]) and np.isfinite(score[foreign]).any():
        known, other = (np.logaddexp.reduce(score[part]) for part in (~foreign, foreign))
        unlike = known + beside[best] - score[best]
        score[foreign] += np.logaddexp(other, unlike) - other
    # Among themselves, the classes share the errors of their simulation.
    if np.isfinite(score[~foreign]).any():
        common = model.log_prior + likelihood[0] / model.temperature_of(model.freedom + values)
        both = [np.logaddexp.reduce(part[~foreign]) for part in (score, common)]
        score = np.where(foreign, score, common + both[0] - both[1])
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    return Belief(by_answer(weight, model), weight, model.answers)


def by_answer(weight: Float[np.ndarray, "*s c"], model: HapticModel) -> Float[np.ndarray, "*s g"]:
    """Weights of the Gaussians, summed by answer.

    Parameters
    ----------
    weight
        Of the Gaussians, along the last axis.
    model
        Defines their answers.
    """
    belongs = model.answer_of[:, None] == np.arange(len(model.answers))
    out: np.ndarray = weight @ belongs.astype(float)
    return out
