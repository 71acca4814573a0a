"""Compiled statistics of grey levels along the lines and of neighbouring points; used by ``edges.py``."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: Neighbours to either side.
BESIDE = 4


@kernel(nogil=True)
def mean_between(image, place):
    """Mean grey levels between consecutive positions on each line, (K, n - 1); NaN where there is no sample.

    Parameters
    ----------
    image
        Grey levels along the lines, (K, parallels, samples).
    place
        Positions in ascending order [samples]; clipped to the line, NaN where there is none, (K, n).
    """
    parallels, samples = image.shape[1], image.shape[2]
    result = np.empty((place.shape[0], place.shape[1] - 1))
    for k in range(place.shape[0]):
        for i in range(place.shape[1] - 1):
            if not math.isfinite(place[k, i] + place[k, i + 1]):
                result[k, i] = math.nan
                continue
            first = int(round(min(max(place[k, i], 0.0), samples)))
            last = int(round(min(max(place[k, i + 1], 0.0), samples)))
            total = 0.0
            for lane in range(parallels):
                for j in range(first, last):
                    total += image[k, lane, j]
            result[k, i] = total / (parallels * (last - first)) if last > first else math.nan
    return result


@kernel(nogil=True)
def _median(ordered, count):
    """Median of the first ``count`` values of an array, which are sorted in place."""
    for i in range(1, count):
        value, j = ordered[i], i
        while j > 0 and ordered[j - 1] > value:
            ordered[j] = ordered[j - 1]
            j -= 1
        ordered[j] = value
    return 0.5 * (ordered[(count - 1) // 2] + ordered[count // 2])


@kernel(nogil=True)
def local_statistics(values):
    """Median over each point and ``BESIDE`` neighbours to either side, its standard error from their scatter, and their range.

    Parameters
    ----------
    values
        One value for each point, NaN where unknown; where all are unknown, the three are zero, (K,).
    """
    result = np.empty((3, len(values)))
    near = np.empty(2 * BESIDE + 1)
    for k in range(len(values)):
        count = 0
        for j in range(max(k - BESIDE, 0), min(k + BESIDE + 1, len(values))):
            if math.isfinite(values[j]):
                near[count] = values[j]
                count += 1
        result[0, k], result[1, k], result[2, k] = 0.0, 0.0, 0.0
        if count > 0:
            middle = _median(near, count)
            result[2, k] = near[count - 1] - near[0]
            for i in range(count):
                near[i] = abs(near[i] - middle)
            result[0, k], result[1, k] = (
                middle,
                1.4826 * _median(near, count) * math.sqrt(0.5 * math.pi / count),
            )
    return result
