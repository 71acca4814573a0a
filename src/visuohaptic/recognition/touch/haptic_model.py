"""What the planner knows of its candidates: Gaussians over all that one exploration could read.

Symbols: g answers, k trained classes (a group has several), c Gaussians, m nuisances, p = 97 features: logarithms of 64
stiffnesses (height * 4 + side), of 32 widths (height * 2 + axis) and of the height of the object.

An exploration of an object of class k reads, at the places that it touches,

    y = mu_k + l w + s e + J theta + d,    w ~ N(0, W_k),  e ~ N(0, P_k),  theta ~ N(0, 1),  d ~ N(0, D)

w is what objects of a class differ by, e what a wrong pose of the gripper does to all touches, J theta the gain and the
zeros of its sensors and Young's modulus, which all touches share, too, and d what simulation gets wrong, place by place.
All of them are integrated out, since everything is Gaussian given l and s: l is 1 for an object inside the trained ranges
and :data:`OUTSIDE` for one that leaves them, s is 1 for a pose as good as it should be and :data:`CARELESS` for a poor one.
Each combination is a Gaussian of its own, equally probable beforehand, so that residuals have the heavy tails of their
mixture. W_k is shrunk to the average of all classes, by as much as makes objects of k that are left out most probable.
"Unknown" is an answer like the others, with Gaussians of its own (:mod:`.unknown_class`).

Stiffness is read in series with the resolution c0 of a touch, k / (1 + c0 k): what hardly moves is as stiff as can be seen,
and the logarithm of what is read keeps a Gaussian error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.data_set import FeatureSet
from ..data.places import HEIGHTS
from ..data.pose_error import POSE_m
from ..data.protocol import TouchProtocol
from .unknown_class import ANYTHING, FEATURES, FIRST_WIDTH, HEIGHT, USUAL_HEIGHT_m, unknown_kinds

__all__ = [
    "NUISANCES",
    "UNKNOWN",
    "ClassStatistics",
    "HapticModel",
    "ModelSettings",
    "assemble",
    "class_statistics",
    "fit_model",
    "log_features",
    "nuisance_effects",
    "pose_covariance",
    "with_prior",
]

UNKNOWN = "unknown"
_PLACE_m = 0.01  # between two of the 16 heights of most containers
#: A parameter that is uniform in a range has a standard deviation of 0.29 of its width. Where every fourth one leaves its
#: range by up to 0.3 widths, the root mean square over all of them is 0.41 widths: 1.43 times as much. Where all do it is
#: 2.25 times; then more of what is unknown is taken for a class outside its ranges than of what is outside is known.
OUTSIDE = 1.43
#: A pose is known to 2 mm by a calibrated gripper, and to 5 mm by one that is not.
CARELESS = 2.5
#: Objects that the average covariance of all classes counts for: what is tried. A hundredth of an object is next to none.
STRENGTHS = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
#: Nuisances that have a name, with their unit and the scale of their settings to that unit.
NUISANCES = ("gain", "height", "zero of the force", "zero of the deformation")


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """What is assumed beyond the training data; all are standard deviations."""

    discrepancy: float = 0.04  #: relative error of simulated stiffness, by place
    end_discrepancy: float = 0.5  #: at the lowest and the highest place, where what holds the wall decides
    pose_m: float = POSE_m  #: wrong height of all touches
    poses: tuple[float, ...] = (1.0, CARELESS)  #: factors of it, alike probable; 1 if it was measured
    tilt_rad: float = 0.05  #: wrong tilt of the gripper against the object, 3 degrees
    width_m: float = 0.0008  #: wrong width by pose and contact
    width_discrepancy: float = 0.005  #: relative
    gain: float = 0.09  #: of all stiffnesses: a force gain of 5 %, and a modulus within 12 % (7 % if uniform)
    zero_N: float = 0.05  #: wrong zero of the force of all touches
    zero_m: float = 5e-5  #: wrong contact, and with it deformation, of all touches
    unknown_prior: float = 0.1  #: probability that an object is of no trained class
    use_width: bool = True  #: widths and the height of the object count as evidence


@dataclass(frozen=True, slots=True, eq=False)
class HapticModel:
    """What is known of the candidates: c Gaussians, each of which belongs to an answer."""

    answers: tuple[str, ...]  #: classes that are answered, "unknown" last
    answer_of: Int[np.ndarray, "c"]  #: of each Gaussian
    mean: Float[np.ndarray, "c p"]
    covariance: Float[np.ndarray, "c p p"]
    log_prior: Float[np.ndarray, "c"]
    nuisance: Float[np.ndarray, "c m p"]  #: what a standard deviation of each of :data:`NUISANCES` does
    spread: Float[np.ndarray, "c"]  #: l of each Gaussian
    pose: Float[np.ndarray, "c"]  #: s of each Gaussian
    groups: Mapping[str, Sequence[str]]  #: name -> trained classes that are answered by it
    settings: ModelSettings
    protocol: TouchProtocol
    temperature: float = 1.0  #: evidence is divided by this, see :mod:`.calibration`
    unknown_log_odds: float = 0.0  #: added to those of "unknown", see :mod:`.calibration`
    tail: float = 1.0  #: factor of the chi-square at which nothing is known, see :mod:`.calibration`
    square: Float[np.ndarray, "c"] | float = 0.0  #: chi-square of an outline, see :func:`.with_outline`
    freedom: int = 0  #: number of its values


@dataclass(frozen=True, slots=True, eq=False)
class ClassStatistics:
    """Features of a class, as learned."""

    mean: Float[np.ndarray, "p"]
    mean_covariance: Float[np.ndarray, "p p"]  #: of the mean, which few objects leave uncertain
    within: Float[np.ndarray, "p p"]  #: what its objects differ by
    pose: Float[np.ndarray, "p p"]  #: what wrong poses do
    spreads: tuple[float, ...] = (1.0, OUTSIDE)  #: l of its Gaussians
    touched: bool = False  #: its objects were, each anew: nuisances are in ``within`` already


def fit_model(
    data: FeatureSet,
    groups: Mapping[str, Sequence[str]] | None = None,
    *,
    prior: Mapping[str, float] | None = None,
    settings: ModelSettings | None = None,
    protocol: TouchProtocol | None = None,
) -> HapticModel:
    """Learn from training objects of which all features are known.

    Parameters
    ----------
    data
        Objects with the names of their classes.
    groups
        Name -> classes that go under this name; a class in no group answers by its own name.
    prior
        Of vision, by answer; alike by default. What is not named is no candidate.
    settings, protocol
        What is assumed, and how the gripper touches.
    """
    settings, protocol = settings or ModelSettings(), protocol or TouchProtocol()
    found = assemble(class_statistics(data, settings, protocol), groups or {}, settings, protocol)
    return with_prior(found, prior)


def class_statistics(
    data: FeatureSet, settings: ModelSettings, protocol: TouchProtocol
) -> dict[str, ClassStatistics]:
    """Mean, spread and effects of wrong poses of each class, by its name.

    Parameters
    ----------
    data
        Objects with the names of their classes.
    settings, protocol
        What is assumed, and how the gripper touches.
    """
    features, number = log_features(data, protocol), data.number
    counts = np.bincount(number)
    mean = np.stack([features[number == k].mean(axis=0) for k in range(len(counts))])
    away = features - mean[number]
    if counts.max() < 2:
        raise InputError(
            "fit_model", "no class has two objects, expected some that show what objects of a class differ by"
        )
    within = _within(away, number, _discrepancy(settings))
    if data.height_m is None:
        within[:, HEIGHT, HEIGHT] = ANYTHING[4] ** 2
    out = {}
    for k, name in enumerate(data.classes):
        rows = number == k
        pose = pose_covariance(data.take(rows), features[rows], settings, protocol)
        out[name] = ClassStatistics(mean[k], within[k] / counts[k], within[k], pose)
    return out


def assemble(
    learned: Mapping[str, ClassStatistics],
    groups: Mapping[str, Sequence[str]],
    settings: ModelSettings,
    protocol: TouchProtocol,
) -> HapticModel:
    """The model of classes that were learned.

    Parameters
    ----------
    learned
        Trained class -> its statistics.
    groups, settings, protocol
        As for :func:`fit_model`; classes are alike probable.
    """
    name_of = {part: part for part in learned}
    for group, members in groups.items():
        name_of |= {member: group for member in members if member in name_of}
    answers = tuple(dict.fromkeys(name_of.values()))
    fraction = _prior(answers, None, settings)
    own = np.diag(_discrepancy(settings))
    kinds, likely = unknown_kinds(np.stack([one.mean for one in learned.values()]))
    rows: list[tuple[int, np.ndarray, np.ndarray, float, np.ndarray, float, float]] = []
    for part, one in learned.items():
        effect = (not one.touched) * nuisance_effects(one.mean, one.pose, settings, protocol)
        # The height is among the poses.
        shared = one.mean_covariance + effect[[0, 2, 3]].T @ effect[[0, 2, 3]] + (not one.touched) * own
        number = answers.index(name_of[part])
        alike = sum(name == name_of[part] for name in name_of.values())
        chance = fraction[name_of[part]] / alike / len(one.spreads) / len(settings.poses)
        for spread, pose in product(one.spreads, settings.poses):
            whole = shared + spread**2 * one.within + pose**2 * one.pose
            scaled = effect * np.array([1.0, pose, 1.0, 1.0])[:, None]
            rows.append((number, one.mean, whole, chance, scaled, spread, pose))
        for kind, part_of in zip(kinds, likely, strict=True):
            chance = fraction[UNKNOWN] / len(learned) * part_of
            rows.append(
                (len(answers), one.mean, shared + one.within + one.pose + kind, chance, effect, 1.0, 1.0)
            )
    answer_of, mean, covariance, chance_of, nuisance, spreads, pose_of = zip(*rows, strict=True)
    with np.errstate(divide="ignore"):
        log_prior = np.log(chance_of)
    return HapticModel(
        (*answers, UNKNOWN), np.array(answer_of), np.array(mean), np.array(covariance), log_prior,
        np.array(nuisance), np.array(spreads), np.array(pose_of), dict(groups), settings, protocol,
    )  # fmt: skip


def with_prior(model: HapticModel, prior: Mapping[str, float] | None) -> HapticModel:
    """The same model with other probabilities beforehand.

    Parameters
    ----------
    model
        Of the candidates.
    prior
        Of vision, by answer; alike by default. What is not named is no candidate.
    """
    answers = model.answers[:-1]
    fraction = _prior(answers, prior, model.settings)
    alike = _prior(answers, None, model.settings)
    ratio = np.array([fraction[name] / alike[name] for name in model.answers])
    with np.errstate(divide="ignore"):
        return replace(model, log_prior=model.log_prior + np.log(ratio)[model.answer_of])


def log_features(data: FeatureSet, protocol: TouchProtocol) -> Float[np.ndarray, "n p"]:
    """Logarithms of the stiffness [N/m], of the width [m] and of the height of objects by :data:`USUAL_HEIGHT_m`.

    Parameters
    ----------
    data
        Objects.
    protocol
        Resolution of the stiffness.
    """
    stiffness = protocol.seen_stiffness(data.features[..., 0].reshape(len(data), -1))[0]
    tall = np.zeros(len(data)) if data.height_m is None else np.log(data.height_m / USUAL_HEIGHT_m)
    return np.column_stack([stiffness, np.log(data.width_m).reshape(len(data), -1), tall])


def nuisance_effects(
    mean: Float[np.ndarray, "p"],
    pose: Float[np.ndarray, "p p"],
    settings: ModelSettings,
    protocol: TouchProtocol,
) -> Float[np.ndarray, "m p"]:
    """What one standard deviation of each nuisance adds to the features of a class.

    A line through the origin, fitted to samples spread evenly up to the reach r, is changed by 3 z / (2 r) by a contact that
    is wrong by z, and by 3 f / (2 k r) by a wrong zero f of the force. Of the wrong poses, "height" is the part that moves
    all features along the slope s of their profile, P s / sqrt(s' P s).

    Parameters
    ----------
    mean
        Features of the class.
    pose
        P, what wrong poses do.
    settings, protocol
        What is assumed, and how the gripper touches.
    """
    out = np.zeros((len(NUISANCES), FEATURES))
    stiffness = np.exp(mean[:FIRST_WIDTH])
    reach = np.minimum(protocol.max_deformation_m, protocol.max_force_N / stiffness)
    out[0, :FIRST_WIDTH] = settings.gain
    slope = _slopes(mean[None])[0]
    along = pose @ slope
    out[1] = along / np.sqrt(max(float(slope @ along), 1e-12))
    out[2, :FIRST_WIDTH] = 1.5 * settings.zero_N / (stiffness * reach)
    # Beyond its own size a logarithm is not linear in it any more.
    out[3, :FIRST_WIDTH] = np.minimum(1.5 * settings.zero_m / reach, 1.0)
    return out


def pose_covariance(
    data: FeatureSet, features: Float[np.ndarray, "n p"], settings: ModelSettings, protocol: TouchProtocol
) -> Float[np.ndarray, "p p"]:
    """Wrong poses: one error of the gripper against the object for all touches.

    From the maps of the objects where there are any. Else a wrong height moves all contacts along the slope
    of each profile, and a tilt in the plane of the tips moves them up on one side and down on the other.

    Parameters
    ----------
    data
        Objects of one class.
    features
        Of them, see :func:`log_features`.
    settings, protocol
        Standard deviations of the pose, and the resolution of the stiffness.
    """
    count = len(features)
    slopes = _slopes(features)
    shift = settings.pose_m / _PLACE_m * slopes
    out = shift.T @ shift / count
    if data.pose_errors is not None:
        scale = settings.pose_m / POSE_m * protocol.seen_stiffness(data.features[..., 0])[1]
        moved = (scale[:, None] * np.asarray(data.pose_errors, dtype=float)).reshape(-1, FIRST_WIDTH)
        out[:FIRST_WIDTH] = out[:, :FIRST_WIDTH] = 0.0
        out[:FIRST_WIDTH, :FIRST_WIDTH] = moved.T @ moved / len(moved)
    else:
        lever = 0.5 * settings.tilt_rad * data.width_m / _PLACE_m
        steep = slopes[:, :FIRST_WIDTH].reshape(count, HEIGHTS, 4)
        for axis in range(2):
            tilted = np.zeros_like(steep)
            for k, sign in enumerate((1.0, -1.0)):
                tilted[:, :, 2 * axis + k] = sign * lever[:, :, axis] * steep[:, :, 2 * axis + k]
            flat = tilted.reshape(count, -1)
            out[:FIRST_WIDTH, :FIRST_WIDTH] += flat.T @ flat / count
    spread = (settings.width_m / data.width_m.mean(axis=0)) ** 2
    # The top is seen as well as the gripper is placed.
    tall = (settings.pose_m / USUAL_HEIGHT_m * np.exp(-features[:, HEIGHT].mean())) ** 2
    return out + np.diag(np.concatenate([np.zeros(FIRST_WIDTH), spread.ravel(), [tall]]))


def _within(
    away: Float[np.ndarray, "n p"], number: Int[np.ndarray, "n"], own: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "k p p"]:
    """Covariance of each class, shrunk to their average (empirical Bayes with an inverse Wishart prior).

    Every third object is left out in turn, and judged by the covariance of the others. A class has a strength of its own
    where the criterion of Schwarz grants it one more parameter: one whose walls have few parameters does not bend as those of
    another with grooves do.
    """
    turn = np.arange(len(number)) % 3
    score = np.zeros((len(STRENGTHS), int(number.max()) + 1))
    for fold in range(3):
        kept = [away[(turn != fold) & (number == k)] for k in range(score.shape[1])]
        middle = np.stack([rows.mean(axis=0) if len(rows) else np.zeros_like(own) for rows in kept])
        moved = away - middle[number]
        for trial, strength in enumerate(STRENGTHS):
            for k, covariance in enumerate(_shrunk(moved[turn != fold], number[turn != fold], strength)):
                # The mean of the others is as uncertain as one of them, by their number.
                root = np.linalg.cholesky(covariance * (1 + 1 / max(len(kept[k]), 1)) + np.diag(own))
                left = moved[(turn == fold) & (number == k)]
                white = np.linalg.solve(root, left.T)
                score[trial, k] -= 0.5 * (white**2).sum() + len(left) * np.log(np.diag(root)).sum()
    each = np.stack([_shrunk(away, number, strength) for strength in STRENGTHS])
    score[score.sum(axis=1).argmax()] += 0.5 * np.log(away.size)
    return np.asarray(each[score.argmax(axis=0), np.arange(score.shape[1])])


def _shrunk(
    away: Float[np.ndarray, "n p"], number: Int[np.ndarray, "n"], strength: float
) -> Float[np.ndarray, "k p p"]:
    counts = np.bincount(number)
    freedom = np.maximum(counts - 1, 0)
    scatter = np.stack([away[number == k].T @ away[number == k] for k in range(len(counts))])
    average = scatter.sum(axis=0) / max(int(freedom.sum()), 1)
    return np.asarray((strength * average + scatter) / (strength + freedom)[:, None, None])


def _slopes(features: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
    """Change of each feature from one height to the next."""
    count = len(features)
    stiffness = np.gradient(features[:, :FIRST_WIDTH].reshape(count, HEIGHTS, 4), axis=1)
    width = np.gradient(features[:, FIRST_WIDTH:HEIGHT].reshape(count, HEIGHTS, 2), axis=1)
    return np.column_stack([stiffness.reshape(count, -1), width.reshape(count, -1), np.zeros(count)])


def _discrepancy(settings: ModelSettings) -> Float[np.ndarray, "p"]:
    out = np.full(FEATURES, settings.discrepancy**2)
    out[:4] = out[FIRST_WIDTH - 4 : FIRST_WIDTH] = settings.end_discrepancy**2
    out[FIRST_WIDTH:] = settings.width_discrepancy**2
    return out


def _prior(
    answers: Sequence[str], given: Mapping[str, float] | None, settings: ModelSettings
) -> dict[str, float]:
    """Probability of each answer and of "unknown"."""
    given = dict.fromkeys(answers, 1.0) if given is None else dict(given)
    if bad := [name for name in given if name not in answers and name != UNKNOWN]:
        raise InputError("prior", f"found {bad[0]!r}, expected one of {', '.join(answers)}")
    if not all(0 <= value < float("inf") for value in given.values()) or not sum(given.values()) > 0:
        raise InputError("prior", "expected probabilities from 0 up, not all 0")
    unknown = given.pop(UNKNOWN, settings.unknown_prior)
    total = sum(given.values())
    return {name: (1 - unknown) * given.get(name, 0.0) / total for name in answers} | {UNKNOWN: unknown}
