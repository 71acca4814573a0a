"""Spikes of a recorded curve: single samples of a sensor that its noise does not explain.

The readings of force and deformation are smooth in time while the fingers close. Each sample is compared with a parabola through its
neighbours: it is a spike if a test with the stated false-alarm rate rejects it, and does not reject the neighbours without it. Where
these are no parabola either, as beside a jump or another spike, nothing is left out.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

#: Neighbours of a sample, on both sides together: of eight, a parabola leaves five degrees of freedom for the test.
NEIGHBOURS = 8
#: Coefficients of a parabola; a curve of two more samples can contradict it without one of them.
_COEFFICIENTS = 3


def without_spikes(
    readings: Float[np.ndarray, "k n"], sigmas: Float[np.ndarray, "k"], false_alarm: float
) -> Bool[np.ndarray, "n"]:
    """Samples of a curve that are no spikes of any sensor.

    Parameters
    ----------
    readings
        Of k sensors at n times.
    sigmas
        Standard deviation of one sample of each; zero: without noise, not tested.
    false_alarm
        Probability that any sample of a curve with Gaussian noise is left out.
    """
    count = readings.shape[1]
    size = min(NEIGHBOURS + 1, count)
    freedom = size - 1 - _COEFFICIENTS
    kept = np.ones(count, dtype=bool)
    if freedom < 1:
        return kept
    index = np.arange(count)[:, None]
    rows = np.clip(index - NEIGHBOURS // 2, 0, count - size) + np.arange(size)
    own = rows == index
    shape = ((rows - index) / size)[..., None] ** np.arange(_COEFFICIENTS)  # 1, 0, 0 at the sample itself
    others = np.where(own[..., None], 0.0, shape)
    normal = np.linalg.inv(others.transpose(0, 2, 1) @ others)
    noisy = sigmas > 0
    limit = chdtri(1, false_alarm / max(count * int(noisy.sum()), 1))
    for row, sigma in zip(readings[noisy], sigmas[noisy], strict=True):
        seen = row[rows] / sigma
        parabola = normal @ (others.transpose(0, 2, 1) @ seen[..., None])
        with np.errstate(over="ignore", invalid="ignore"):  # squares of what no sensor reads
            square = (seen - (shape @ parabola)[..., 0]) ** 2
            rest = np.where(own, 0.0, square).sum(axis=1)
        alone = square[own] / (1.0 + normal[:, 0, 0])
        kept &= ~((alone > limit) & (rest <= chdtri(freedom, false_alarm)))
    return kept
