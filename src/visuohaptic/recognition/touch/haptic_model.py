"""Gaussian model of the features of each candidate class, for an exploration by touch.

Symbols: g answers, k trained classes (a group has several), c Gaussians, m nuisances, p = 98 features: logarithms of 64
stiffnesses (height * 4 + side), of 32 widths (height * 2 + axis), and of the height of the object; and the mean curvature of its curves.

An exploration of an object of class k reads, at the places that are touched,

    y = mu_k + l w + s e + J theta + d,    w ~ N(0, W_k),  e ~ N(0, P_k),  theta ~ N(0, 1),  d ~ N(0, D)

w is the variation within the class, e the effect of a pose error of the gripper, J theta the effects of force gain, sensor
zeros, Young's modulus and the closure of the mouth, and d the error of the simulation at each place. All but d are shared by
the touches of one exploration. All are integrated out in closed form, since everything is Gaussian given l and s: l is 1 for
an object inside the trained ranges and :data:`RANGE_WIDENING` for one outside, s is 1 for an accurate pose and :data:`POSE_RATIO` for
an inaccurate one. The part of w that is of second order in the parameters of the class grows with l^2, as its standard deviation
does with the square of that of the parameters. Each combination is a Gaussian component with equal prior probability, so that
residuals have the heavy tails of the mixture. W_k is shrunk to the average of all classes by the strength with the highest cross-validated likelihood.
The unknown class is an answer with its own components (:mod:`.unknown_class`). Stiffness is measured in series with the resolution
c0 of a touch, k / (1 + c0 k): it saturates beyond the resolution, and its logarithm keeps a Gaussian error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data import FeatureSet, TouchProtocol
from .exemplars import ExemplarDensity
from .nuisances import (
    APART,
    NUISANCES,
    ModelSettings,
    discrepancy,
    log_features,
    nuisance_effects,
    pose_covariance,
)
from .unknown_class import (
    HEIGHT,
    UNKNOWN_CLASS_SIGMAS,
    round_fraction,
    simulated_kinds,
    simulated_spread,
    unknown_kinds,
)

UNKNOWN = "unknown"
#: A parameter uniform in its range has a standard deviation of 0.29 widths. If every fourth one exceeds its range by up to
#: 0.3 widths, the root mean square is 0.41 widths: a factor of 1.43. If all do, the factor is 2.25; with this factor, more
#: unknown objects are falsely accepted than known objects outside their ranges are gained.
RANGE_WIDENING = 1.43
#: Number of independent parameters of a class: mean of the shipped ones.
PARAMETERS = 12
#: Candidate strengths of the shrinkage: number of objects that the average covariance of all classes is equivalent to.
SHRINKAGE_STRENGTHS = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)


@dataclass(frozen=True, slots=True, eq=False)
class HapticModel:
    """Mixture of c Gaussians over the features, each of which belongs to an answer."""

    answers: tuple[str, ...]  #: classes that are answered, "unknown" last
    answer_of: Int[np.ndarray, "c"]  #: of each Gaussian
    part: Int[np.ndarray, "c"]  #: trained class of each Gaussian; -1: unknown
    mean: Float[np.ndarray, "c p"]
    covariance: Float[np.ndarray, "c p p"]
    log_prior: Float[np.ndarray, "c"]
    fraction: Float[np.ndarray, "c"]  #: prior probability of each Gaussian among those of its trained class
    nuisance: Float[np.ndarray, "c m p"]  #: effect of one standard deviation of each of :data:`NUISANCES`
    spread: Float[np.ndarray, "c"]  #: l of each Gaussian
    pose: Float[np.ndarray, "c"]  #: s of each Gaussian
    groups: Mapping[str, Sequence[str]]  #: name -> trained classes with this answer
    settings: ModelSettings
    protocol: TouchProtocol
    temperature: float = 1.0  #: evidence of one value is divided by this, see :mod:`.calibration`
    #: Added to those of "unknown" after ten touches, in proportion to the number of values, see :mod:`.calibration`.
    unknown_log_odds: float = 0.0
    tail: float = 1.0  #: factor of the chi-square limit of known classes, see :mod:`.calibration`
    #: Correlation of the errors of the classes beyond those of their Gaussians, see :mod:`.calibration`.
    correlation: float = 0.0
    fit: Float[np.ndarray, "c"] | float = 0.0  #: log likelihood of an outline, see :func:`.with_outline`
    square: Float[np.ndarray, "c"] | float = 0.0  #: its chi-square
    freedom: int = 0  #: number of its values
    exemplars: ExemplarDensity | None = None  #: of the trained classes, see :mod:`.exemplars`

    def temperature_of(self, values: int | Int[np.ndarray, "e"]) -> Float[np.ndarray, "*e"]:
        """Divisor of the evidence between trained classes: values with correlated errors count as fewer independent ones.

        Parameters
        ----------
        values
            Number of values.
        """
        return self.temperature * (1.0 + self.correlation * np.maximum(np.asarray(values) - 1.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ClassStatistics:
    """Learned distribution of a class's features."""

    mean: Float[np.ndarray, "p"]
    mean_covariance: Float[np.ndarray, "p p"]  #: uncertainty of the mean
    within: Float[np.ndarray, "p p"]  #: variation within the class
    pose: Float[np.ndarray, "p p"]  #: effect of pose errors
    #: l of its Gaussians, and the probability of each
    spreads: Mapping[float, float] = field(default_factory=lambda: {1.0: 0.5, RANGE_WIDENING: 0.5})
    curved: Float[np.ndarray, "p p"] | float = 0.0  #: part of ``within`` of second order in the parameters
    touched: bool = False  #: learned from separate explorations: ``within`` includes the nuisances


def fit_model(
    data: FeatureSet,
    groups: Mapping[str, Sequence[str]] | None = None,
    *,
    settings: ModelSettings | None = None,
    protocol: TouchProtocol | None = None,
) -> HapticModel:
    """Fit the model to training objects with complete features.

    Parameters
    ----------
    data
        Objects with the names of their classes.
    groups
        Answer -> classes that it combines; a class in no group is an answer of its own.
    settings, protocol
        Assumed standard deviations, and the protocol of a touch.
    """
    settings, protocol = settings or ModelSettings(), protocol or TouchProtocol()
    learned = class_statistics(data, settings, protocol)
    return assemble(learned, groups or {}, settings, protocol)


def class_statistics(
    data: FeatureSet, settings: ModelSettings, protocol: TouchProtocol
) -> dict[str, ClassStatistics]:
    """Mean, variation and effects of pose errors of each class, by its name.

    Parameters
    ----------
    data
        Objects with the names of their classes.
    settings, protocol
        Assumed standard deviations, and the protocol of a touch.
    """
    features, number = log_features(data, protocol), data.number
    counts = np.bincount(number)
    mean = np.stack([features[number == k].mean(axis=0) for k in range(len(counts))])
    away = features - mean[number]
    if counts.max() < 2:
        raise InputError(
            "fit_model",
            "no class has two objects, expected two objects or more of some class, for the variation within a class",
        )
    within = _within(away, number, discrepancy(settings))
    if data.height_m is None:
        within[:, HEIGHT, HEIGHT] = UNKNOWN_CLASS_SIGMAS[4] ** 2
    out = {}
    for k, name in enumerate(data.classes):
        rows = number == k
        pose = pose_covariance(data.take(rows), features[rows], settings, protocol)
        out[name] = ClassStatistics(
            mean[k], within[k] / counts[k], within[k], pose, curved=_curved(within[k])
        )
    return out


def assemble(
    learned: Mapping[str, ClassStatistics],
    groups: Mapping[str, Sequence[str]],
    settings: ModelSettings,
    protocol: TouchProtocol,
) -> HapticModel:
    """Assemble the mixture from learned classes.

    Parameters
    ----------
    learned
        Trained class -> its statistics.
    groups, settings, protocol
        As for :func:`fit_model`; classes have equal prior probability.
    """
    name_of = {part: part for part in learned}
    for group, members in groups.items():
        name_of |= {member: group for member in members if member in name_of}
    answers = tuple(dict.fromkeys(name_of.values()))
    fraction = _prior(answers, None, settings)
    own = np.diag(discrepancy(settings))
    rows: list[tuple[Any, ...]] = []
    for index, (part, one) in enumerate(learned.items()):
        effect = (not one.touched) * nuisance_effects(one.mean, one.pose, settings, protocol)
        shared = one.mean_covariance + effect[APART].T @ effect[APART] + (not one.touched) * own
        number = answers.index(name_of[part])
        alike = sum(name == name_of[part] for name in name_of.values())
        poses = settings.poses if one.pose.any() else (1.0,)
        for (spread, each), pose in product(one.spreads.items(), poses):
            within = spread**2 * one.within + (spread**4 - spread**2) * one.curved
            scaled = effect * np.where(np.array(NUISANCES) == "height", pose, 1.0)[:, None]
            among, whole = each / len(poses), shared + within + pose**2 * one.pose
            chance = fraction[name_of[part]] / alike * among
            rows.append((number, index, one.mean, whole, chance, among, scaled, spread, pose))
    for mean, whole, effect, chance in _unknown(learned, settings, protocol):
        chance *= fraction[UNKNOWN]
        rows.append((len(answers), -1, mean, whole, chance, chance, effect, 1.0, 1.0))
    columns: Any = [np.array(part) for part in zip(*rows, strict=True)]
    with np.errstate(divide="ignore"):
        columns[4] = np.log(columns[4])
    rest: Any = {"groups": dict(groups), "settings": settings, "protocol": protocol}
    return HapticModel((*answers, UNKNOWN), *columns, **rest)


def _unknown(
    learned: Mapping[str, ClassStatistics], settings: ModelSettings, protocol: TouchProtocol
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    """Mean, covariance, effects and probability of each Gaussian of unknown objects."""
    own, means = np.diag(discrepancy(settings)), np.stack([one.mean for one in learned.values()])
    if not settings.simulate_unknown:
        kinds, likely = unknown_kinds(means)
        for one in learned.values():
            effect = (not one.touched) * nuisance_effects(one.mean, one.pose, settings, protocol)
            shared = one.mean_covariance + effect[APART].T @ effect[APART] + (not one.touched) * own
            for kind, chance in zip(kinds, likely, strict=True):
                yield one.mean, shared + one.within + one.pose + kind, effect, chance / len(learned)
        return
    data, even = simulated_kinds(), round_fraction(means)
    kinds = np.mean([one.within for one in learned.values()], axis=0) + simulated_spread()
    for k, mean in enumerate(log_features(data, protocol)):
        pose = pose_covariance(data.take(np.array([k])), mean[None], settings, protocol)
        effect = nuisance_effects(mean, pose, settings, protocol)
        shared = own + effect[APART].T @ effect[APART] + pose
        for kind, chance in zip(kinds, (even, 1 - even), strict=True):
            yield mean, shared + kind, effect, chance / len(data)


def with_prior(model: HapticModel, prior: Mapping[str, float] | None) -> HapticModel:
    """The same model with other prior probabilities.

    Parameters
    ----------
    model
        Of the candidates.
    prior
        Visual prior by answer; uniform by default. Answers that are not named are excluded.
    """
    answers = model.answers[:-1]
    fraction = _prior(answers, prior, model.settings)
    alike = _prior(answers, None, model.settings)
    if fraction[UNKNOWN] > 0 and alike[UNKNOWN] == 0:
        raise InputError(
            "prior",
            f"found {fraction[UNKNOWN]:.3g} for {UNKNOWN!r}, expected 0: the model was fitted with unknown_prior=0",
        )
    # A class that is impossible before stays impossible.
    ratio = np.array([fraction[name] / (alike[name] or 1.0) for name in model.answers])
    with np.errstate(divide="ignore"):
        return replace(model, log_prior=model.log_prior + np.log(ratio)[model.answer_of])


def _within(
    away: Float[np.ndarray, "n p"], number: Int[np.ndarray, "n"], own: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "k p p"]:
    """Covariance of each class, shrunk to their average (empirical Bayes with an inverse Wishart prior).

    The strength maximises the likelihood in a three-fold cross-validation. A class has its own strength where the
    Bayesian information criterion (Schwarz) accepts one more parameter.
    """
    turn = np.arange(len(number)) % 3
    score = np.zeros((len(SHRINKAGE_STRENGTHS), int(number.max()) + 1))
    for fold in range(3):
        kept = [away[(turn != fold) & (number == k)] for k in range(score.shape[1])]
        middle = np.stack([rows.mean(axis=0) if len(rows) else np.zeros_like(own) for rows in kept])
        moved = away - middle[number]
        for trial, strength in enumerate(SHRINKAGE_STRENGTHS):
            for k, covariance in enumerate(_shrunk(moved[turn != fold], number[turn != fold], strength)):
                # The variance of the mean of n objects is that of one object divided by n.
                root = np.linalg.cholesky(covariance * (1 + 1 / max(len(kept[k]), 1)) + np.diag(own))
                white = np.linalg.solve(root, moved[(turn == fold) & (number == k)].T)
                score[trial, k] -= 0.5 * (white**2).sum() + white.shape[1] * np.log(np.diag(root)).sum()
    each = np.stack([_shrunk(away, number, strength) for strength in SHRINKAGE_STRENGTHS])
    score[score.sum(axis=1).argmax()] += 0.5 * np.log(away.size)
    return np.asarray(each[score.argmax(axis=0), np.arange(score.shape[1])])


def _curved(within: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Part of a covariance beyond its first :data:`PARAMETERS` directions: a linear function of that many parameters has none."""
    variance, direction = (part[..., :-PARAMETERS] for part in np.linalg.eigh(within))
    return np.asarray(direction * np.maximum(variance, 0.0) @ direction.T)


def _shrunk(
    away: Float[np.ndarray, "n p"], number: Int[np.ndarray, "n"], strength: float
) -> Float[np.ndarray, "k p p"]:
    counts = np.bincount(number)
    freedom = np.maximum(counts - 1, 0)
    scatter = np.stack([away[number == k].T @ away[number == k] for k in range(len(counts))])
    average = scatter.sum(axis=0) / max(int(freedom.sum()), 1)
    return np.asarray((strength * average + scatter) / (strength + freedom)[:, None, None])


def _prior(
    answers: Sequence[str], given: Mapping[str, float] | None, settings: ModelSettings
) -> dict[str, float]:
    """Probability of each answer and of "unknown"."""
    given = dict.fromkeys(answers, 1.0) if given is None else dict(given)
    if bad := [name for name in given if name not in answers and name != UNKNOWN]:
        raise InputError("prior", f"found {bad[0]!r}, expected one of {', '.join(answers)}")
    if not all(0 <= value < float("inf") for value in given.values()) or not sum(given.values()) > 0:
        raise InputError("prior", "expected probabilities >= 0, not all 0")
    unknown = given.pop(UNKNOWN, settings.unknown_prior)
    total = sum(given.values())
    return {name: (1 - unknown) * given.get(name, 0.0) / total for name in answers} | {UNKNOWN: unknown}
