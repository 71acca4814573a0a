"""Bayesian planner of touches: posterior, unknown class, and the next touch.

Differences to the dissertation's trees: features keep their scale, each reading has its own noise, and a touch is
chosen by its expected information per second of robot time. Model of the candidates: :mod:`.haptic_model`;
probabilities: :mod:`.belief`; "unknown" is an additional answer with other smooth profiles of stiffness and width:
:mod:`.unknown_class`. Symbols are those of these modules.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from ...core.errors import InputError
from ..data import HEIGHTS, Touch, TouchReading, travel_seconds
from .belief import (
    WIDTH_VARIANCE,
    Belief,
    belief_of,
    by_answer,
    condition,
    evidence,
    log_likelihood,
    update_belief,
)
from .haptic_model import HapticModel
from .unknown_class import FIRST_WIDTH, HEIGHT
from .zeros import with_zeros

TOUCHES: tuple[Touch, ...] = tuple((height, axis) for height in range(1, HEIGHTS + 1) for axis in "xy")


@dataclass(frozen=True, slots=True, eq=False)
class TouchExploration:
    """Result of an exploration."""

    answer: str
    belief: Belief
    readings: tuple[TouchReading, ...]
    seconds: float  #: of robot time
    confident: bool  #: the requested confidence was reached


def touch_gains(
    model: HapticModel,
    readings: Sequence[TouchReading],
    *,
    samples: int = 64,
    rng: np.random.Generator | None = None,
) -> dict[Touch, tuple[float, float]]:
    """Expected information and duration of each remaining touch.

    The information is the expected decrease of the entropy of the answer: outcomes are sampled from the
    current belief, and the belief after each is computed in closed form. All touches are evaluated with the same samples.

    Parameters
    ----------
    model
        Of the candidates.
    readings
        Touches so far.
    samples
        Number of sampled outcomes of each touch.
    rng
        Source of the samples; seeded with 0 by default.

    Returns
    -------
    dict
        Expected information [nat] and duration [s] of each remaining touch.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    read, model = evidence(model, readings), with_zeros(model, readings)
    weight = belief_of(model, log_likelihood(model, *read), len(read[0])).weight
    use = np.flatnonzero(weight > 1e-3 * weight.max())
    weight = weight[use] / weight[use].sum()
    few = replace(model, answer_of=model.answer_of[use])
    means, spreads = (part[use] for part in condition(model, *read))
    done = {(reading.height, reading.axis) for reading in readings}
    left = [touch for touch in TOUCHES if touch not in done]
    if not left:
        return {}
    here = np.array([_places(model, touch, first=not readings) for touch in left])
    mean = means[:, here]
    noise = _expected_noise(model, mean)[..., None] * np.eye(here.shape[1])
    root = np.linalg.cholesky(spreads[:, here[:, :, None], here[:, None, :]] + noise)
    size = np.log(np.diagonal(root, axis1=2, axis2=3)).sum(axis=2)
    pick, fresh = _even_samples(samples, here.shape[1], rng)
    drawn = np.minimum(np.searchsorted(np.cumsum(weight), pick), len(use) - 1)
    outcome = mean[drawn] + np.einsum("stij,sj->sti", root[drawn], fresh)
    white = np.einsum("vtij,svtj->svti", np.linalg.inv(root), outcome[:, None] - mean)
    score = np.log(weight)[:, None] + (-0.5 * (white**2).sum(axis=3) - size) / model.temperature
    after = np.exp(score - score.max(axis=1, keepdims=True)).transpose(0, 2, 1)
    entropy = _entropy(by_answer(after / after.sum(axis=2, keepdims=True), few)).mean(axis=0)
    gains = np.maximum(_entropy(by_answer(weight, few)) - entropy, 0.0)
    last = (readings[-1].height, readings[-1].axis) if readings else None
    seconds = [travel_seconds(model.protocol, last, touch) + model.protocol.touch_s for touch in left]
    return dict(zip(left, zip(gains.tolist(), seconds, strict=True), strict=True))


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
    """Touch where the expected information per second is highest, until the requested confidence is reached.

    Parameters
    ----------
    model
        Of the candidates.
    touch
        Measures at a height 1 .. 16 along an axis "x" or "y".
    confidence
        Requested probability of the answer. At 95 %, one answer in twenty is wrong, and a larger fraction of unknown
        objects, which are rare, is classified as known; identifying nine objects in sequence requires more.
    max_touches, min_touches
        Bounds.
    rng
        Source of the sampled outcomes.
    samples
        Number of sampled outcomes of each touch.
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


def _places(model: HapticModel, touch: Touch, *, first: bool) -> list[int]:
    """Indices of the features that a touch measures; the first touch also measures the height of the object."""
    height, axis = touch
    column = 0 if axis == "x" else 2
    place = 4 * (height - 1) + column
    if not model.settings.use_width:
        return [place, place + 1]
    return [place, place + 1, FIRST_WIDTH + 2 * (height - 1) + column // 2, *[HEIGHT] * first]


def _even_samples(
    count: int, size: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "s"], Float[np.ndarray, "s k"]]:
    """Low-discrepancy uniform and standard normal numbers: a shifted Kronecker sequence (Roberts 2018).

    All touches are evaluated with the same numbers, so that their order does not depend on the samples.
    """
    # The real root g > 1 of g^(d + 1) = g + 1; the powers of 1 / g are badly approximable by fractions.
    root = 2.0
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (size + 2))
    steps = root ** -np.arange(1.0, size + 2)
    even = (rng.random(size + 1) + np.arange(count)[:, None] * steps) % 1.0
    return even[:, 0], ndtri(np.clip(even[:, 1:], 1e-9, 1 - 1e-9))


def _expected_noise(model: HapticModel, mean: Float[np.ndarray, "*n k"]) -> Float[np.ndarray, "*n k"]:
    out = np.full(mean.shape, WIDTH_VARIANCE)
    # A reading at the resolution limit has no upper bound of the stiffness: the denominator is limited to one half.
    seen = np.exp(mean[..., :2])
    stiffness = seen / np.maximum(1 - model.protocol.resolution_m_per_N * seen, 0.5)
    out[..., :2] = model.protocol.seen_variance(stiffness) + model.settings.repeat**2
    return out


def _entropy(fraction: Float[np.ndarray, "*s g"]) -> Float[np.ndarray, "*s"]:
    out: np.ndarray = -np.sum(fraction * np.log(np.maximum(fraction, 1e-300)), axis=-1)
    return out
