"""Checks of a measured force-deformation curve: it starts at contact, and only closes.

Both are tests at a stated false-alarm rate. No elastic wall resists less at first than a membrane, whose force is cubic in the
deformation: the coefficient of a cubic through the origin cannot be higher from d to 2 d than up to d, except by noise, or
because the fingers did not touch the wall before d.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from ...core import InputError, finite_array
from .readings import TouchNoise

#: False alarms of a curve: one in a thousand files of a hundred curves.
FALSE_ALARM = 1e-5
#: Power of the deformation in the force of a membrane.
MEMBRANE = 3


def check_curve(
    deformation_m: Float[np.ndarray, "k"], force_N: Float[np.ndarray, "k"], noise: TouchNoise | None = None
) -> None:
    """Refuse a curve that starts before contact, or that continues while the gripper opens.

    Parameters
    ----------
    deformation_m
        Of the contact point [m], in the order of time.
    force_N
        Of one tip [N].
    noise
        Standard deviations of one sample.

    Raises
    ------
    InputError
        Not two arrays of finite numbers, or empty; the force stays zero over a travel that neither the noise nor the stiffness beyond it explains; or it differs between
        closing and opening.
    """
    noise = TouchNoise() if noise is None else noise
    d = finite_array("curve", deformation_m, None, field="deformation_m")
    f = finite_array("curve", force_N, len(d), field="force_N")
    above_N = _hysteresis(d, f, noise)
    if above_N:
        raise InputError(
            "curve",
            f"found forces that are {abs(above_N):.2g} N {'lower' if above_N > 0 else 'higher'} while opening than while closing",
            field="force_N",
            remedy="give the samples up to the largest deformation",
        )
    order = np.argsort(d)
    free_m = _free_travel(d[order], f[order], noise)
    if free_m > 0:
        raise InputError(
            "curve",
            f"the force is zero up to {1e3 * free_m:.2g} mm",
            field="deformation_m",
            remedy="give the deformation from contact on",
        )


def _hysteresis(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> float:
    """Mean difference of the forces before and after the largest deformation, at the upper half [N]; 0 if not significant."""
    last = int(np.argmax(d))
    high = d >= 0.5 * d[last]
    before, after = np.flatnonzero(high[: last + 1]), last + 1 + np.flatnonzero(high[last + 1 :])
    if len(before) < 2 or len(after) < 2:
        return 0.0
    before = before[np.argsort(d[before])]
    within = after[d[after] >= d[before[0]]]
    if not len(within):
        return 0.0
    difference = float(np.mean(np.interp(d[within], d[before], f[before]) - f[within]))
    slope = float(np.polyfit(d[before], f[before], 1)[0])
    # Interpolation uses about as many samples as there are places.
    count = 1 / len(within) + 1 / min(len(before), len(within))
    sigma = math.hypot(noise.force_N, slope * noise.deformation_m) * math.sqrt(count)
    return difference if abs(difference) > -ndtri(FALSE_ALARM / 2) * sigma else 0.0


def _free_travel(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> float:
    """The most significant travel without force [m], or 0; samples ascend."""
    # One test for each number of leading samples.
    limit, best, found = -float(ndtri(FALSE_ALARM / max(len(d), 1))), 0.0, 0.0
    for count in range(1, len(d)):
        beyond = (d > d[count - 1]) & (d <= 2 * d[count - 1])
        if not beyond.any():
            continue
        slope, error = _scale(d[:count], f[:count], 1, noise)
        if slope > limit * error:
            break  # it is in contact
        before, after = (_scale(d[some], f[some], MEMBRANE, noise) for some in (slice(count), beyond))
        significance = (after[0] - before[0]) / math.hypot(before[1], after[1])
        if significance > max(limit, best):
            best, found = significance, float(d[count - 1])
    return found


def _scale(d: np.ndarray, f: np.ndarray, power: int, noise: TouchNoise) -> tuple[float, float]:
    """c of F = c d^power by weighted least squares, and its standard deviation."""
    shape = np.maximum(d, 0.0) ** power
    square = float(shape @ shape)
    if square == 0:
        return 0.0, math.inf
    slope = power * abs(float(shape @ f) / square) * np.maximum(d, 0.0) ** (power - 1)
    variance = noise.force_N**2 + (slope * noise.deformation_m) ** 2
    weight = 1.0 / np.maximum(variance, 1e-300)
    total = float(weight @ shape**2)
    return float((weight * shape) @ f) / total, 1.0 / math.sqrt(total)
