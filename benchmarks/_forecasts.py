"""Calibration of forecast probabilities: forecasts compared with observed frequencies."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "calibration_by_chance",
    "calibration_error",
    "calibration_figure",
    "chance_note",
    "expected_calibration_error",
]

#: Edges between which forecasts are compared with how often they come true.
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995, 1.0)


def _bins(forecasts: Sequence[tuple[float, bool]]) -> list[tuple[float, float, int]]:
    """Mean forecast, fraction that came true and count, of each bin that is not empty."""
    found = []
    for low, high in itertools.pairwise(BINS):
        inside = [(p, good) for p, good in forecasts if low <= p < high or p == high == 1.0]
        if inside:
            p, good = np.array(inside, dtype=float).T
            found.append((float(p.mean()), float(good.mean()), len(inside)))
    return found


def expected_calibration_error(forecasts: Sequence[tuple[float, bool]]) -> float:
    """Expected calibration error: mean distance of forecasts from observed frequencies, weighted by their number.

    Parameters
    ----------
    forecasts
        Probability and whether the claim is right; NaN without any.
    """
    if not forecasts:
        return math.nan
    return sum(count * abs(p - good) for p, good, count in _bins(forecasts)) / len(forecasts)


def calibration_error(confidence: np.ndarray, right: np.ndarray, bins: int = 10) -> float:
    """Expected calibration error: mean difference of confidence and accuracy, in bins of equal width (Guo et al. 2017).

    Parameters
    ----------
    confidence
        Of k answers (k,), 0 to 1.
    right
        1 where the answer was right, 0 elsewhere (k,).
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


def calibration_by_chance(confidence: np.ndarray, draws: int = 1000) -> tuple[float, float]:
    """Mean and 95 % quantile of the calibration error that a calibrated forecaster has with these forecasts, if they are independent.

    Parameters
    ----------
    confidence
        As of :func:`calibration_error`.
    draws
        Number of simulated outcomes of all forecasts.
    """
    confidence, rng = np.asarray(confidence, dtype=float), np.random.default_rng(0)
    errors = [calibration_error(confidence, rng.random(len(confidence)) < confidence) for _ in range(draws)]
    return float(np.mean(errors)), float(np.quantile(errors, 0.95))


def chance_note(confidence: np.ndarray) -> str:
    """Text of :func:`calibration_by_chance` for a row of a benchmark.

    Parameters
    ----------
    confidence
        As of :func:`calibration_error`.
    """
    mean, high = calibration_by_chance(confidence)
    return f"a calibrated classifier has {mean:.3f} with these {len(confidence)} forecasts, in 95 % less than {high:.3f}"


def calibration_figure(forecasts: Sequence[tuple[float, bool]]) -> Figure:
    """Observed frequency over declared probability, with the 90 % range of a calibrated forecast.

    Parameters
    ----------
    forecasts
        Probability and whether the claim is right.
    """
    from scipy.stats import beta

    from visuohaptic.report.style import COLOURS, draw_axes

    def draw(axes: Axes) -> None:
        # One column per bin: most claims have more than 0.98, which a linear axis cannot resolve.
        rows = list(_bins(forecasts))
        for column, (p, good, count) in enumerate(rows):
            right = round(good * count)
            low, high = beta.ppf([0.05, 0.95], right + 0.5, count - right + 0.5)
            axes.errorbar(
                column, good, [[max(good - low, 0.0)], [max(high - good, 0.0)]], fmt="o", capsize=3,
                color=COLOURS["blue"], label="right" if column == 0 else None,
            )  # fmt: skip
            axes.plot(column, p, "_", ms=18, color=COLOURS["grey"], label="said" if column == 0 else None)
        axes.set(xlabel="probability that is said, and number of claims", ylabel="fraction", ylim=(0, 1.03))
        axes.set_xticks(range(len(rows)), [f"{p:.3f}\n{count}" for p, _, count in rows])
        axes.legend(loc="lower right")

    return draw_axes(1, 1, draw, size=(4.6, 4.2))
