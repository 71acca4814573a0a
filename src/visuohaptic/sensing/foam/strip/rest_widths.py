"""Widths of the strip at rest: which are measured by their own edges, and which are inferred from their neighbours."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from ....core.measurement import SIGMA_PER_MAD

#: One strip in a hundred loses a right width that is taken for that of another edge.
STRIPS = 100.0


def without_wrong_edges(width_m: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Widths, NaN where the edge is not the front's but that of a pore or of dirt, at the same wrong place in every frame.

    Texture shifts the front of each point by its own amount: a width scatters about the mean of its neighbours, normally. One that
    is farther away than any of the right ones of ``STRIPS`` strips is not the front's; the farthest is removed first. The scatter is
    a median, which knows it like half as many differences as there are (Student's distribution): 0.7 to 1.1 strips of a
    hundred with 40 to 200 points lose a right one. A body that dents the strip moves more than one point, so that the neighbours
    of a point at its end differ as well.

    Parameters
    ----------
    width_m
        Observed widths, NaN where there is none [m].
    """
    left, chance = width_m.copy(), 0.5 / (STRIPS * len(width_m))
    while True:
        bend = np.abs(left[1:-1] - 0.5 * (left[:-2] + left[2:]))
        seen = bend[np.isfinite(bend)]
        if not len(seen):
            return left
        limit = -float(stdtrit(0.5 * len(seen), chance)) * SIGMA_PER_MAD * float(np.median(seen))
        alone = np.where(np.abs(left[:-2] - left[2:]) <= limit, np.nan_to_num(bend), 0.0)
        if alone.max() <= limit:
            return left
        left[1 + int(alone.argmax())] = np.nan


def infer_unseen(width_m: Float[np.ndarray, "K"]) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Widths with missing values (NaN) inferred from the nearest observed points, and the standard deviation of these.

    Linear interpolation between the neighbours, or the width of the only one. Predicting each observed point from points at
    the same distances has an error with standard deviation s over n points; the error of a missing point then follows
    Student's distribution, whose variance is n / (n - 2) s^2 and infinite up to n = 2.

    Parameters
    ----------
    width_m
        Observed widths, NaN where there is none [m].
    """
    count = len(width_m)
    known = np.flatnonzero(np.isfinite(width_m))
    padded = np.pad(width_m, count, constant_values=np.nan)
    result, sigma = width_m.copy(), np.where(np.isfinite(width_m), 0.0, math.inf)
    for k in np.setdiff1d(np.arange(count), known) if len(known) else ():
        nearest = np.concatenate([known[known < k][-1:], known[known > k][:1]])
        weight = np.ones(1) if len(nearest) == 1 else np.abs(nearest[::-1] - k) / np.ptp(nearest)
        pairs = list(zip(weight, nearest, strict=True))
        error = width_m - sum(w * padded[count + i - k : 2 * count + i - k] for w, i in pairs)
        error = error[np.isfinite(error)]
        result[k] = sum(w * width_m[i] for w, i in pairs)
        sigma[k] = math.sqrt((error @ error) / (len(error) - 2)) if len(error) > 2 else math.inf
    return result, sigma


def better_than_inferred(
    width_m: Float[np.ndarray, "K"], sigma_m: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Observed points, without those whose width the neighbours tell with a smaller standard deviation, the worst first.

    Parameters
    ----------
    width_m, sigma_m
        Width, NaN where it was not observed, and its standard deviation [m].
    """
    left = width_m.copy()
    for k in np.argsort(-sigma_m):
        if np.isfinite(left[k]):
            left[k] = np.nan
            if not infer_unseen(left)[1][k] < sigma_m[k]:
                left[k] = width_m[k]
    return np.isfinite(left)
