"""What the planner knows of its candidates: a mixture of Gaussians for each class.

Symbols: g classes that are answered, c components (trained classes; a group has several), v training
objects, p = 96 features: logarithms of 64 stiffnesses (height * 4 + side) and of 32 widths (height * 2 +
axis), u kinds of unknown objects.

Around each training object of a class there is a Gaussian with the covariance ``K_c = h^2 cov_c + P_c + D``:
what variants lie between (a kernel density with West's shrinkage, which leaves mean and covariance of the
class as they are), wrong poses along the height, and what simulation gets wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.data_set import FeatureSet
from ..data.places import HEIGHTS
from ..data.protocol import TouchProtocol
from .unknown_class import FEATURES, FIRST_WIDTH, unknown_covariances

__all__ = ["UNKNOWN", "HapticModel", "ModelSettings", "calibrated", "fit_model"]

UNKNOWN = "unknown"
_PLACE_m = 0.01  # between two of the 16 heights


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """What is assumed beyond the training data."""

    #: h of the kernel, of the class's own spread. Objects that are left out are most likely under wider ones;
    #: this is narrow enough that unknown objects between the known objects are not taken for them.
    bandwidth: float = 0.35
    discrepancy: float = 0.04  #: relative error of simulated stiffness, by place
    end_discrepancy: float = 0.5  #: at the lowest and the highest place, where what holds the wall decides
    pose_m: float = 0.002  #: wrong height of a touch
    tilt_rad: float = 0.05  #: wrong tilt of the gripper against the object, 3 degrees
    width_m: float = 0.0008  #: wrong width by pose and contact
    width_discrepancy: float = 0.005  #: relative
    unknown_prior: float = 0.1
    use_width: bool = True  #: widths count as evidence


@dataclass(frozen=True, slots=True, eq=False)
class HapticModel:
    """What is known of the candidates."""

    answers: tuple[str, ...]  #: classes that are answered, "unknown" last
    answer_of: Int[np.ndarray, "c"]  #: of each component
    mean: Float[np.ndarray, "v p"]
    component: Int[np.ndarray, "v"]
    covariance: Float[np.ndarray, "c p p"]
    log_prior: Float[np.ndarray, "v"]  #: of each training object
    unknown_mean: Float[np.ndarray, "p"]
    unknown_covariance: Float[np.ndarray, "u p p"]  #: of each kind of unknown object, alike in number
    settings: ModelSettings
    protocol: TouchProtocol
    temperature: float = 1.0  #: evidence is divided by this, see :mod:`.calibration`
    unknown_from: float = 0.5  #: "unknown" is answered from this probability on


def fit_model(
    data: FeatureSet,
    groups: Mapping[str, Sequence[str]] | None = None,
    *,
    prior: Mapping[str, float] | None = None,
    settings: ModelSettings | None = None,
    protocol: TouchProtocol | None = None,
) -> HapticModel:
    """Learn from training objects.

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
    settings = ModelSettings() if settings is None else settings
    parts = data.classes
    name_of = {part: part for part in parts}
    for group, members in (groups or {}).items():
        for member in members:
            if member in name_of:
                name_of[member] = group
    answers = tuple(dict.fromkeys(name_of[part] for part in parts))
    given = dict.fromkeys(answers, 1.0) if prior is None else dict(prior)
    if bad := [name for name in given if name not in answers and name != UNKNOWN]:
        raise InputError("prior", f"found {bad[0]!r}, expected one of {', '.join(answers)}")
    if not all(0 <= value < float("inf") for value in given.values()) or not sum(given.values()) > 0:
        raise InputError("prior", "expected probabilities from 0 up, not all 0")
    features, component = _features(data), data.number
    mean = np.empty_like(features)
    covariance, pose = (np.empty((len(parts), FEATURES, FEATURES)) for _ in range(2))
    log_prior = np.empty(len(data))
    total = sum(given.get(name, 0.0) for name in answers)
    known = 1 - given.get(UNKNOWN, settings.unknown_prior)
    own, h2 = np.diag(_discrepancy(settings)), settings.bandwidth**2
    for k, part in enumerate(parts):
        rows = component == k
        if np.count_nonzero(rows) < 3:
            raise InputError("fit_model", f"class {part!r} has fewer than 3 objects")
        pose[k] = _pose(data.take(rows), features[rows], settings)
        middle = features[rows].mean(axis=0)
        mean[rows] = middle + np.sqrt(1 - h2) * (features[rows] - middle)
        covariance[k] = h2 * np.cov(features[rows].T) + pose[k] + own
        fraction = given.get(name_of[part], 0.0) / total / sum(name_of[p] == name_of[part] for p in parts)
        with np.errstate(divide="ignore"):
            log_prior[rows] = np.log(known * fraction / np.count_nonzero(rows))
    average = np.stack([features[component == k].mean(axis=0) for k in range(len(parts))]).mean(axis=0)
    return HapticModel(
        (*answers, UNKNOWN),
        np.array([answers.index(name_of[part]) for part in parts]),
        mean, component, covariance, log_prior, average,
        unknown_covariances(features, component) + pose.mean(axis=0) + own, settings,
        TouchProtocol() if protocol is None else protocol,
    )  # fmt: skip


def calibrated(model: HapticModel, temperature: float, unknown_from: float) -> HapticModel:
    """The same model with another calibration.

    Parameters
    ----------
    model
        Of the candidates.
    temperature
        The evidence is divided by this.
    unknown_from
        Probability from which "unknown" is answered.
    """
    return replace(model, temperature=temperature, unknown_from=unknown_from)


def _features(data: FeatureSet) -> Float[np.ndarray, "v p"]:
    stiffness = np.log(data.features[..., 0].reshape(len(data), -1))
    return np.concatenate([stiffness, np.log(data.width_m).reshape(len(data), -1)], axis=1)


def _discrepancy(settings: ModelSettings) -> Float[np.ndarray, "p"]:
    out = np.full(FEATURES, settings.discrepancy**2)
    out[:4] = out[FIRST_WIDTH - 4 : FIRST_WIDTH] = settings.end_discrepancy**2
    out[FIRST_WIDTH:] = settings.width_discrepancy**2
    return out


def _pose(
    data: FeatureSet, features: Float[np.ndarray, "v p"], settings: ModelSettings
) -> Float[np.ndarray, "p p"]:
    """Wrong poses: one error of the gripper against the object for all touches.

    From the maps of the objects where there are any. Else a wrong height moves all contacts along the slope
    of each profile, and a tilt in the plane of the tips moves them up on one side and down on the other.
    """
    count = len(features)
    stiffness = features[:, :FIRST_WIDTH].reshape(count, HEIGHTS, 4)
    slopes = np.gradient(stiffness, axis=1)
    wide = np.gradient(features[:, FIRST_WIDTH:].reshape(count, HEIGHTS, 2), axis=1)
    # Heights of training objects differ; about 1 cm is between two places of most containers.
    per_place = settings.pose_m / _PLACE_m
    shift = per_place * np.concatenate([slopes.reshape(count, -1), wide.reshape(count, -1)], axis=1)
    out = shift.T @ shift / count
    if data.pose_errors is not None:
        moved = np.asarray(data.pose_errors, dtype=float).reshape(-1, FIRST_WIDTH)
        out[:FIRST_WIDTH] = out[:, :FIRST_WIDTH] = 0.0
        out[:FIRST_WIDTH, :FIRST_WIDTH] = moved.T @ moved / len(moved)
    else:
        lever = 0.5 * settings.tilt_rad * data.width_m / _PLACE_m
        for axis in range(2):
            tilted = np.zeros_like(slopes)
            for k, sign in enumerate((1.0, -1.0)):
                tilted[:, :, 2 * axis + k] = sign * lever[:, :, axis] * slopes[:, :, 2 * axis + k]
            flat = tilted.reshape(count, -1)
            out[:FIRST_WIDTH, :FIRST_WIDTH] += flat.T @ flat / count
    spread = (settings.width_m / data.width_m.mean(axis=0)) ** 2
    out[np.arange(FIRST_WIDTH, FEATURES), np.arange(FIRST_WIDTH, FEATURES)] += spread.ravel()
    return out
