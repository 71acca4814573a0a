"""Probabilities that mean what they say, from explorations of training objects that are left out.

One temperature divides the evidence (Guo et al. 2017), fitted by the log loss; and "unknown" is
answered from the probability on that only the wanted fraction of known objects reaches.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..data.data_set import FeatureSet
from ..data.noise import noisy_copies
from ..data.readings import CurveCoefficients, TouchReading
from .bayes import TOUCHES
from .belief import belief_of, condition, evidence
from .haptic_model import HapticModel

__all__ = ["calibrate", "calibration_error", "reading_of"]


def calibrate(
    model: HapticModel,
    data: FeatureSet,
    rng: np.random.Generator,
    *,
    explorations: int = 300,
    max_touches: int = 5,
    false_rejection: float = 0.05,
) -> HapticModel:
    """Fit temperature and threshold of "unknown".

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
    false_rejection
        Fraction of known objects that may be called unknown.
    """
    if len(data) != len(model.component) or not 0 < false_rejection < 1:
        raise InputError("calibrate", "expected the training objects of the model, and a share 0..1")
    settings = model.settings
    found, truth, left_out = [], [], []
    for row in rng.integers(0, len(data), explorations):
        one = noisy_copies(
            data.take(np.array([row])), 1, rng, protocol=model.protocol, pose_m=settings.pose_m,
            discrepancy=settings.discrepancy, keep=False,
        )  # fmt: skip
        if not np.isfinite(model.log_prior[row]):
            continue
        order = rng.permutation(len(TOUCHES))[:max_touches]
        readings = [reading_of(one, 0, *TOUCHES[int(k)], model) for k in order]
        for count in range(1, max_touches + 1):
            place, value, noise = evidence(model, readings[:count])
            found.append(condition(model, place, value, noise)[0])
            truth.append(int(model.answer_of[model.component[row]]))
            left_out.append(int(row))
    rows = np.arange(len(model.component))

    def beliefs(temperature: float) -> Float[np.ndarray, "k g"]:
        warm = replace(model, temperature=temperature)
        return np.stack(
            [belief_of(warm, s, rows == row).probability for s, row in zip(found, left_out, strict=True)]
        )

    grid = np.geomspace(0.5, 6.0, 16)
    right = np.arange(len(truth)), np.array(truth)
    losses = []
    for temperature in grid:
        fraction = beliefs(float(temperature))
        losses.append(-np.log(np.maximum(fraction[right] / (1 - fraction[:, -1]).clip(1e-12), 1e-12)).mean())
    best = float(grid[int(np.argmin(losses))])
    uncertainty = beliefs(best)[:, -1]
    late = uncertainty[np.arange(len(uncertainty)) % max_touches >= 1]
    return replace(
        model,
        temperature=best,
        unknown_from=float(np.clip(np.quantile(late, 1 - false_rejection), 0.05, 0.95)),
    )


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
    return TouchReading(height, axis, (sides[0], sides[1]), float(data.width_m[row, height - 1, column // 2]))
