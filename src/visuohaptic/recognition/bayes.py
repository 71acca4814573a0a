"""A Bayesian planner of touches: probabilities, "unknown", and what to touch next.

Beyond the dissertation's trees: features keep their scale, each reading has its noise, and a touch
is chosen by what it tells per second of robot time. Symbols: g classes that are answered, c
components (trained classes; a group has several), v training objects, p = 96 features: logarithms
of 64 stiffnesses (height * 4 + side) and of 32 widths (height * 2 + axis).

A class is a mixture of Gaussians, one around each of its training objects, with the covariance
``K_c = h^2 cov_c + P_c + D``: what variants lie between (a kernel density with West's shrinkage,
which leaves mean and covariance of the class as they are), wrong poses along the height, and what
simulation gets wrong. Given readings, each Gaussian is conditioned in closed form.

"Unknown" is one more class: any smooth profile of stiffness and width.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..errors import InputError
from .data_set import HEIGHTS, FeatureSet
from .protocol import TouchProtocol, travel_seconds
from .readings import TouchReading
from .tree_nodes import Touch

__all__ = [
    "UNKNOWN",
    "Belief",
    "Exploration",
    "HapticModel",
    "ModelSettings",
    "believe",
    "explore",
    "fit_model",
    "touch_gains",
]

UNKNOWN = "unknown"
_WIDTH0 = HEIGHTS * 4  # first width among the features
_ALL = HEIGHTS * 6
_PLACE_m = 0.01  # between two of the 16 heights
TOUCHES: tuple[Touch, ...] = tuple((height, axis) for height in range(1, HEIGHTS + 1) for axis in "xy")


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """What is assumed beyond the training data."""

    #: h of the kernel, of the class's own spread. Objects that are left out are most likely under wider ones;
    #: this is narrow enough that strangers between the known objects are not taken for them.
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


@dataclass(frozen=True, slots=True, eq=False)
class Exploration:
    """What an exploration came to."""

    answer: str
    belief: Belief
    readings: tuple[TouchReading, ...]
    seconds: float  #: of robot time
    sure: bool  #: the wanted confidence was reached


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
    covariance, pose = (np.empty((len(parts), _ALL, _ALL)) for _ in range(2))
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
        share = given.get(name_of[part], 0.0) / total / sum(name_of[p] == name_of[part] for p in parts)
        with np.errstate(divide="ignore"):
            log_prior[rows] = np.log(known * share / np.count_nonzero(rows))
    average = np.stack([features[component == k].mean(axis=0) for k in range(len(parts))]).mean(axis=0)
    return HapticModel(
        (*answers, UNKNOWN),
        np.array([answers.index(name_of[part]) for part in parts]),
        mean, component, covariance, log_prior, average,
        _unknown(features, component) + pose.mean(axis=0) + own, settings,
        TouchProtocol() if protocol is None else protocol,
    )  # fmt: skip


def believe(
    model: HapticModel,
    readings: Sequence[TouchReading],
    *,
    without: Bool[np.ndarray, "v"] | None = None,
) -> Belief:
    """Probabilities given what was measured; ``without`` leaves training objects out."""
    place, value, noise = _evidence(model, readings)
    log_likelihood, _ = _condition(model, place, value, noise)
    return _belief(model, log_likelihood, without)


def touch_gains(
    model: HapticModel,
    readings: Sequence[TouchReading],
    *,
    samples: int = 64,
    rng: np.random.Generator | None = None,
    without: Bool[np.ndarray, "v"] | None = None,
) -> dict[Touch, tuple[float, float]]:
    """What each touch that is left would tell [nat], and how long it takes [s].

    The information is the expected fall of the entropy of the answer: outcomes are drawn from the
    present belief, and the belief after each is computed in closed form.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    place, value, noise = _evidence(model, readings)
    log_likelihood, predicted = _condition(model, place, value, noise)
    belief = _belief(model, log_likelihood, without)
    weight = np.concatenate([belief.weight, belief.unknown_weight])
    weight = np.where(weight > 1e-3 * weight.max(), weight, 0.0)
    use = np.flatnonzero(weight)
    weight = weight[use] / weight[use].sum()
    part = _parts(model)[use]
    answer = _answers(model)[part]
    means, spreads = predicted
    drawn = np.searchsorted(np.cumsum(weight), (np.arange(samples) + rng.random()) / samples)
    drawn = np.minimum(drawn, len(use) - 1)
    now = _entropy(_by_answer(weight[None], answer, len(model.answers)))[0]
    last = readings[-1] if readings else None
    done = {(reading.height, reading.axis) for reading in readings}
    out = {}
    for touch in TOUCHES:
        if touch in done:
            continue
        here = _places(model, touch)
        m = means[np.ix_(use, here)]
        inverse_root, size = {}, {}
        outcome = np.empty((samples, len(here)))
        for k in np.unique(part):
            spread = spreads[k][np.ix_(here, here)]
            typical = m[part == k].mean(axis=0)
            spread = spread + np.diag(_expected_noise(model, touch, typical))
            root = np.linalg.cholesky(spread)
            inverse_root[k], size[k] = np.linalg.inv(root), float(np.log(np.diag(root)).sum())
            some = np.flatnonzero(part[drawn] == k)
            outcome[some] = m[drawn[some]] + rng.standard_normal((len(some), len(here))) @ root.T
        score = np.empty((samples, len(use)))
        for k, inverse in inverse_root.items():
            rows = part == k
            away = (outcome[:, None, :] - m[rows]) @ inverse.T
            score[:, rows] = -0.5 * np.einsum("svk,svk->sv", away, away) - size[k]
        score = np.log(weight) + score / model.temperature
        after = np.exp(score - score.max(axis=1, keepdims=True))
        shares = _by_answer(after / after.sum(axis=1, keepdims=True), answer, len(model.answers))
        gain = max(now - float(_entropy(shares).mean()), 0.0)
        start = None if last is None else (last.height, last.axis)
        out[touch] = (gain, travel_seconds(model.protocol, start, touch) + model.protocol.touch_s)
    return out


def explore(
    model: HapticModel,
    touch: Callable[[int, str], TouchReading],
    *,
    confidence: float = 0.99,
    most_touches: int = 10,
    least_touches: int = 1,
    rng: np.random.Generator | None = None,
    samples: int = 64,
    without: Bool[np.ndarray, "v"] | None = None,
    follow: Callable[[Sequence[TouchReading], Touch | None], object] | None = None,
) -> Exploration:
    """Touch where it tells most per second until the answer is sure.

    Parameters
    ----------
    model
        Of the candidates.
    touch
        Measures at a height 1 .. 16 along an axis "x" or "y".
    confidence
        Wanted probability of the answer. One in twenty that are 95 % sure is wrong, and of strangers, which are
        rare, a larger share still passes for something known: nine objects in a row need more.
    most_touches, least_touches
        Bounds.
    rng
        For the drawn outcomes.
    samples
        Drawn outcomes of each touch.
    without
        Training objects to leave out.
    follow
        Called before each touch with what was read so far and the touch that is wanted, and at the end with
        None; see :mod:`.steps`.
    """
    if not 0 < confidence <= 1 or not 1 <= least_touches <= most_touches <= len(TOUCHES):
        raise InputError(
            "explore", f"found confidence {confidence}, touches {least_touches} to {most_touches}, "
            f"expected 0..1 and 1 to {len(TOUCHES)}"
        )  # fmt: skip
    rng = np.random.default_rng(0) if rng is None else rng
    readings: tuple[TouchReading, ...] = ()
    seconds = 0.0
    while True:
        gains = touch_gains(model, readings, samples=samples, rng=rng, without=without)
        best = max(gains, key=lambda one: gains[one][0] / gains[one][1])
        seconds += gains[best][1]
        if follow is not None:
            follow(readings, best)
        readings = (*readings, touch(*best))
        belief = believe(model, readings, without=without)
        sure = bool(belief.probability.max() >= confidence) and len(readings) >= least_touches
        if sure or len(readings) >= most_touches:
            if follow is not None:
                follow(readings, None)
            return Exploration(belief.answer, belief, readings, seconds, sure)


def calibrated(model: HapticModel, temperature: float, unknown_from: float) -> HapticModel:
    """The same model with other calibration."""
    return replace(model, temperature=temperature, unknown_from=unknown_from)


def _features(data: FeatureSet) -> Float[np.ndarray, "v p"]:
    stiffness = np.log(data.features[..., 0].reshape(len(data), -1))
    return np.concatenate([stiffness, np.log(data.width_m).reshape(len(data), -1)], axis=1)


def _discrepancy(settings: ModelSettings) -> Float[np.ndarray, "p"]:
    out = np.full(_ALL, settings.discrepancy**2)
    out[:4] = out[_WIDTH0 - 4 : _WIDTH0] = settings.end_discrepancy**2
    out[_WIDTH0:] = settings.width_discrepancy**2
    return out


def _pose(
    data: FeatureSet, features: Float[np.ndarray, "v p"], settings: ModelSettings
) -> Float[np.ndarray, "p p"]:
    """Wrong poses: one error of the gripper against the object for all touches.

    From the maps of the objects where there are any. Else a wrong height moves all contacts along the slope
    of each profile, and a tilt in the plane of the tips moves them up on one side and down on the other.
    """
    count = len(features)
    stiffness = features[:, :_WIDTH0].reshape(count, HEIGHTS, 4)
    slopes = np.gradient(stiffness, axis=1)
    wide = np.gradient(features[:, _WIDTH0:].reshape(count, HEIGHTS, 2), axis=1)
    # Heights of training objects differ; about 1 cm is between two places of most containers.
    per_place = settings.pose_m / _PLACE_m
    shift = per_place * np.concatenate([slopes.reshape(count, -1), wide.reshape(count, -1)], axis=1)
    out = shift.T @ shift / count
    if data.posed is not None:
        moved = np.asarray(data.posed, dtype=float).reshape(-1, _WIDTH0)
        out[:_WIDTH0] = out[:, :_WIDTH0] = 0.0
        out[:_WIDTH0, :_WIDTH0] = moved.T @ moved / len(moved)
    else:
        lever = 0.5 * settings.tilt_rad * data.width_m / _PLACE_m
        for axis in range(2):
            tilted = np.zeros_like(slopes)
            for k, sign in enumerate((1.0, -1.0)):
                tilted[:, :, 2 * axis + k] = sign * lever[:, :, axis] * slopes[:, :, 2 * axis + k]
            flat = tilted.reshape(count, -1)
            out[:_WIDTH0, :_WIDTH0] += flat.T @ flat / count
    spread = (settings.width_m / data.width_m.mean(axis=0)) ** 2
    out[np.arange(_WIDTH0, _ALL), np.arange(_WIDTH0, _ALL)] += spread.ravel()
    return out


def _unknown(
    features: Float[np.ndarray, "v p"], component: Int[np.ndarray, "v"]
) -> Float[np.ndarray, "u p p"]:
    """Covariances of containers that nobody has seen, of three kinds.

    Two are of the size and stiffness of what is known, and of another profile, with grooves and smooth: what is
    mistaken most easily. The third is anything, as glass and paper are.
    """
    middle = np.stack([features[component == k].mean(axis=0) for k in np.unique(component)]).mean(axis=0)
    away = features - middle
    inner = slice(4, _WIDTH0 - 4)  # what holds the ends says nothing of the wall
    level = away[:, inner].mean(axis=1)
    wide = away[:, _WIDTH0:].mean(axis=1)
    own = (
        max(1.2 * level.std(), 0.5),
        max(1.2 * (away[:, inner] - level[:, None]).std(), 0.4),
        max(1.2 * wide.std(), 0.15),
        max(1.2 * (away[:, _WIDTH0:] - wide[:, None]).std(), 0.1),
    )
    return np.stack(
        [
            _any_profile(*own),
            _any_profile(*own, grooves=0.0, reach=5.0),
            _any_profile(1.5, 0.8, 0.29, 0.2),
        ]
    )


def _any_profile(
    level: float, bend: float, size: float, shape: float, *, grooves: float = 0.2, reach: float = 3.0
) -> Float[np.ndarray, "p p"]:
    """Smooth over ``reach`` places; standard deviations of logarithms, in common and by place."""
    height, side = (part.ravel() for part in np.mgrid[:HEIGHTS, :4])
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    axis = np.where(side[:, None] // 2 == side // 2, 1.0, 0.7)
    out = np.zeros((_ALL, _ALL))
    # Grooves and shoulders run all around.
    ring = grooves**2 * (height[:, None] == height)
    out[:_WIDTH0, :_WIDTH0] = level**2 + (bend**2 * near + ring) * axis
    height, side = (part.ravel() for part in np.mgrid[:HEIGHTS, :2])
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    same = side[:, None] == side
    out[_WIDTH0:, _WIDTH0:] = size**2 * np.where(same, 1.4, 1.0) + shape**2 * near * np.where(same, 1.0, 0.5)
    return out


def _evidence(
    model: HapticModel, readings: Sequence[TouchReading]
) -> tuple[Int[np.ndarray, "o"], Float[np.ndarray, "o"], Float[np.ndarray, "o"]]:
    """Places among the features, values, and variances of the readings."""
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
            place.append(_WIDTH0 + 2 * (reading.height - 1) + column // 2)
            value.append(np.log(reading.width_m))
            noise.append(1e-6)
    return np.array(place, dtype=np.int64), np.array(value, dtype=float), np.array(noise, dtype=float)


def _condition(
    model: HapticModel,
    place: Int[np.ndarray, "o"],
    value: Float[np.ndarray, "o"],
    noise: Float[np.ndarray, "o"],
) -> tuple[Float[np.ndarray, "v1"], tuple[Float[np.ndarray, "v1 p"], Float[np.ndarray, "c1 p p"]]]:
    """Log likelihood of each training object and of the kinds of unknown (last), and what each predicts."""
    kinds = len(model.unknown_covariance)
    means = np.concatenate([model.mean, np.repeat(model.unknown_mean[None], kinds, axis=0)])
    part = _parts(model)
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


def _belief(
    model: HapticModel, log_likelihood: Float[np.ndarray, "v1"], without: Bool[np.ndarray, "v"] | None
) -> Belief:
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
    probability = _by_answer(weight[None], _answers(model)[_parts(model)], len(model.answers))[0]
    return Belief(probability, weight[:-kinds], weight[-kinds:], model.unknown_from, model.answers)


def _parts(model: HapticModel) -> Int[np.ndarray, "v1"]:
    """What each Gaussian is part of: its component, or a kind of unknown after those."""
    known = len(model.answer_of)
    return np.concatenate([model.component, known + np.arange(len(model.unknown_covariance))])


def _answers(model: HapticModel) -> Int[np.ndarray, "c1"]:
    """Answer of each component and of each kind of unknown."""
    return np.append(model.answer_of, [len(model.answers) - 1] * len(model.unknown_covariance))


def _places(model: HapticModel, touch: Touch) -> Int[np.ndarray, "k"]:
    height, axis = touch
    column = 0 if axis == "x" else 2
    first = 4 * (height - 1) + column
    width = [_WIDTH0 + 2 * (height - 1) + column // 2] if model.settings.use_width else []
    return np.array([first, first + 1, *width])


def _expected_noise(model: HapticModel, touch: Touch, typical: Float[np.ndarray, "k"]) -> np.ndarray:
    sigma = [min(model.protocol.relative_sigma(float(np.exp(value))), 1.5) ** 2 for value in typical[:2]]
    return np.array([*sigma, *([1e-6] if len(typical) > 2 else [])])


def _by_answer(weight: Float[np.ndarray, "s v"], answer: Int[np.ndarray, "v"], count: int) -> np.ndarray:
    out: np.ndarray = weight @ np.eye(count)[answer]
    return out


def _entropy(share: Float[np.ndarray, "s g"]) -> Float[np.ndarray, "s"]:
    out: np.ndarray = -np.sum(share * np.log(np.maximum(share, 1e-300)), axis=1)
    return out
