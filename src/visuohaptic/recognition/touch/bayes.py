"""A Bayesian planner of touches: probabilities, "unknown", and what to touch next.

Beyond the dissertation's trees: features keep their scale, each reading has its noise, and a touch is
chosen by what it tells per second of robot time. What is known of the candidates: :mod:`.haptic_model`;
probabilities: :mod:`.belief`; "unknown" is one more class, any smooth profile of stiffness and width:
:mod:`.unknown_class`. Symbols are those of these modules.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.places import HEIGHTS, Touch
from ..data.protocol import travel_seconds
from ..data.readings import TouchReading
from .belief import Belief, answers_of, belief_of, by_answer, condition, evidence, parts_of, update_belief
from .haptic_model import UNKNOWN, HapticModel, ModelSettings, calibrated, fit_model
from .unknown_class import FIRST_WIDTH

__all__ = [
    "UNKNOWN",
    "Belief",
    "HapticModel",
    "ModelSettings",
    "TouchExploration",
    "calibrated",
    "explore",
    "fit_model",
    "touch_gains",
    "update_belief",
]

TOUCHES: tuple[Touch, ...] = tuple((height, axis) for height in range(1, HEIGHTS + 1) for axis in "xy")


@dataclass(frozen=True, slots=True, eq=False)
class TouchExploration:
    """What an exploration came to."""

    answer: str
    belief: Belief
    readings: tuple[TouchReading, ...]
    seconds: float  #: of robot time
    sure: bool  #: the requested confidence was reached


def touch_gains(
    model: HapticModel,
    readings: Sequence[TouchReading],
    *,
    samples: int = 64,
    rng: np.random.Generator | None = None,
) -> dict[Touch, tuple[float, float]]:
    """Expected information of each touch that is left, and its duration.

    The information is the expected decrease of the entropy of the answer: outcomes are sampled from the
    present belief, and the belief after each is computed in closed form.

    Parameters
    ----------
    model
        Of the candidates.
    readings
        Touches so far.
    samples
        Outcomes that are sampled of each touch.
    rng
        Source of the samples; seeded with 0 by default.

    Returns
    -------
    dict
        Expected information [nat] and duration [s] of each touch that is left.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    place, value, noise = evidence(model, readings)
    log_likelihood, predicted = condition(model, place, value, noise)
    belief = belief_of(model, log_likelihood)
    weight = np.concatenate([belief.weight, belief.unknown_weight])
    weight = np.where(weight > 1e-3 * weight.max(), weight, 0.0)
    use = np.flatnonzero(weight)
    weight = weight[use] / weight[use].sum()
    part = parts_of(model)[use]
    answer = answers_of(model)[part]
    means, spreads = predicted
    drawn = np.searchsorted(np.cumsum(weight), (np.arange(samples) + rng.random()) / samples)
    drawn = np.minimum(drawn, len(use) - 1)
    now = _entropy(by_answer(weight[None], answer, len(model.answers)))[0]
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
        fractions = by_answer(after / after.sum(axis=1, keepdims=True), answer, len(model.answers))
        gain = max(now - float(_entropy(fractions).mean()), 0.0)
        start = None if last is None else (last.height, last.axis)
        out[touch] = (gain, travel_seconds(model.protocol, start, touch) + model.protocol.touch_s)
    return out


def explore(
    model: HapticModel,
    touch: Callable[[int, str], TouchReading],
    *,
    confidence: float = 0.99,
    max_touches: int = 10,
    min_touches: int = 1,
    rng: np.random.Generator | None = None,
    samples: int = 64,
    follow: Callable[[Sequence[TouchReading], Touch | None], object] | None = None,
) -> TouchExploration:
    """Touch where the expected information per second is highest until the answer is sure.

    Parameters
    ----------
    model
        Of the candidates.
    touch
        Measures at a height 1 .. 16 along an axis "x" or "y".
    confidence
        Requested probability of the answer. One in twenty that are 95 % sure is wrong, and of unknown objects, which are
        rare, a larger share still passes for something known: nine objects in a row need more.
    max_touches, min_touches
        Bounds.
    rng
        Source of the sampled outcomes.
    samples
        Sampled outcomes of each touch.
    follow
        Called before each touch with the readings so far and the planned touch, and at the end with
        None; see :mod:`.steps`.
    """
    if not 0 < confidence <= 1 or not 1 <= min_touches <= max_touches <= len(TOUCHES):
        raise InputError(
            "explore", f"found confidence {confidence}, touches {min_touches} to {max_touches}, "
            f"expected 0..1 and 1 to {len(TOUCHES)}"
        )  # fmt: skip
    rng = np.random.default_rng(0) if rng is None else rng
    readings: tuple[TouchReading, ...] = ()
    seconds = 0.0
    while True:
        gains = touch_gains(model, readings, samples=samples, rng=rng)
        best = max(gains, key=lambda one: gains[one][0] / gains[one][1])
        seconds += gains[best][1]
        if follow is not None:
            follow(readings, best)
        readings = (*readings, touch(*best))
        belief = update_belief(model, readings)
        sure = bool(belief.probability.max() >= confidence) and len(readings) >= min_touches
        if sure or len(readings) >= max_touches:
            if follow is not None:
                follow(readings, None)
            return TouchExploration(belief.answer, belief, readings, seconds, sure)


def _places(model: HapticModel, touch: Touch) -> Int[np.ndarray, "k"]:
    height, axis = touch
    column = 0 if axis == "x" else 2
    first = 4 * (height - 1) + column
    width = [FIRST_WIDTH + 2 * (height - 1) + column // 2] if model.settings.use_width else []
    return np.array([first, first + 1, *width])


def _expected_noise(model: HapticModel, touch: Touch, typical: Float[np.ndarray, "k"]) -> np.ndarray:
    sigma = np.minimum(model.protocol.relative_sigmas(np.exp(typical[:2])), 1.5) ** 2
    return np.array([*sigma, *([1e-6] if len(typical) > 2 else [])])


def _entropy(fraction: Float[np.ndarray, "s g"]) -> Float[np.ndarray, "s"]:
    out: np.ndarray = -np.sum(fraction * np.log(np.maximum(fraction, 1e-300)), axis=1)
    return out
