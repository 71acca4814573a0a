"""Readings of one touch: coefficients of a measured curve with their uncertainty (Alt 2016, Secs. 6.1.6, 6.4.2).

Deformation d and force F are both noisy. Least squares of F on a noisy d underestimates the stiffness by
the fraction of the noise in d^2: the known noise is subtracted from the moments (Fuller 1987). If the
fingers hardly move, only the weighted distance to the line (Deming) is informative, and the error of the compliance is
Gaussian: the reading is its mean given that it is positive.

A curve must start at contact, and only close. Both are tested at a stated false-alarm rate. No elastic wall resists less at first
than a membrane, whose force is cubic in the deformation: the coefficient of a cubic through the origin cannot be higher from d to
2 d than up to d, except by noise, or because the fingers did not touch the wall before d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from ...core import InputError, finite_array
from ...core.objects import HEIGHTS, NOMINAL_N, LOW_m, NOMINAL_m
from .spikes import without_spikes

#: False alarms of a curve: one in a thousand files of a hundred curves.
FALSE_ALARM = 1e-5
#: No gripper opens wider, and no container is higher [m]; 4 mm in millimetres are beyond it.
MAX_SIZE_m = 3.0
#: Power of the deformation in the force of a membrane.
MEMBRANE = 3


@dataclass(frozen=True, slots=True)
class TouchNoise:
    """Standard deviations of one sample."""

    force_N: float = 0.1
    deformation_m: float = 1e-4


@dataclass(frozen=True, slots=True)
class CurveCoefficients:
    """Coefficients of one side; NaN if the curve is too short."""

    i_N_per_m: float  #: linear, up to 3 mm
    I_N_per_m: float  #: linear, whole curve
    II: float  #: quadratic, whole curve, times (1 cm)^2 / 50 N
    i_relative_sigma: float  #: of ``i_N_per_m``, relative to it
    II_sigma: float
    #: Deformation at which a line through the curve up to 3 mm has no force, and its standard deviation [m]; NaN if soft.
    contact_m: float = math.nan
    contact_sigma_m: float = math.nan

    @property
    def curvature(self) -> tuple[float, float]:
        """Relative quadratic coefficient b (1 cm) / I of F = a d + b d^2, and its standard deviation; NaN unless I > 0.

        Its error is independent of that of the linear coefficient (Frisch and Waugh 1933), and it does not depend on the gain of
        the force sensor.
        """
        if not self.I_N_per_m > 0:  # a wall that snaps through has no stiffness to compare with
            return math.nan, math.nan
        scale = NOMINAL_N / (NOMINAL_m * self.I_N_per_m)
        return self.II * scale, self.II_sigma * scale


@dataclass(frozen=True, slots=True)
class TouchReading:
    """One touch: both sides at one height, 1 .. 16."""

    height: int
    axis: str  #: "x" or "y", along which the tips press
    sides: tuple[CurveCoefficients | None, CurveCoefficients | None]  #: + and -; None: not measured
    width_m: float = math.nan  #: opening of the gripper at contact
    object_height_m: float = math.nan  #: measured by the camera, used to position the touch

    @classmethod
    def of_stiffness(
        cls,
        height: int,
        axis: str,
        stiffness_N_per_m: Sequence[float] | Float[np.ndarray, "2"],
        relative_sigma: float = 0.05,
        width_m: float = math.nan,
    ) -> TouchReading:
        """Touch with known linear stiffness of both sides.

        Parameters
        ----------
        height
            1 to 16.
        axis
            ``x`` or ``y``, along which the tips press.
        stiffness_N_per_m
            Of the sides + and - [N/m].
        relative_sigma
            Relative standard deviation of each.
        width_m
            Opening of the gripper at contact [m]; NaN if not measured.

        Raises
        ------
        InputError
            A stiffness is missing or not positive, or the standard deviation is negative or NaN.
        """
        sides = np.ravel(stiffness_N_per_m)
        if len(sides) != 2 or (sides <= 0).any():
            found = ", ".join(f"{k:g}" for k in sides)
            said = f"found {found} N/m, expected more than 0 for both sides"
            raise InputError("touch", said, field="stiffness_N_per_m")
        if not relative_sigma >= 0:
            said = f"found {relative_sigma:g}, expected at least 0"
            raise InputError("touch", said, field="relative_sigma")
        first, second = (
            CurveCoefficients(float(k), float(k), math.nan, relative_sigma, math.nan) for k in sides
        )
        return cls(height, axis, (first, second), width_m)

    def __post_init__(self) -> None:
        if self.height not in range(1, HEIGHTS + 1) or self.axis not in ("x", "y"):
            raise InputError(
                "touch", f"found {self.axis}{self.height}, expected x or y and 1 to {HEIGHTS}", field="height"
            )
        for key in ("width_m", "object_height_m"):
            if (size := getattr(self, key)) > MAX_SIZE_m:
                raise InputError(
                    "touch", f"found {key} {size:g}, expected metres, up to {MAX_SIZE_m:g}", field=key,
                    remedy="divide millimetres by 1000",
                )  # fmt: skip


def fit_curve(
    deformation_m: Float[np.ndarray, "k"],
    force_N: Float[np.ndarray, "k"],
    noise: TouchNoise | None = None,
    *,
    from_contact: bool = False,
) -> CurveCoefficients:
    """Coefficients of a closing curve that starts at contact, without its spikes (:func:`.without_spikes`).

    Parameters
    ----------
    deformation_m
        Of the contact point of this side [m], in the order of time.
    force_N
        Of one tip [N].
    noise
        Standard deviations of one sample.
    from_contact
        The curve is known to start at contact and to close only, as a simulated one: :func:`check_curve` is left out.

    Raises
    ------
    InputError
        Not two arrays of finite numbers, the force does not rise, or the curve is refused by :func:`check_curve`.
    """
    noise = TouchNoise() if noise is None else noise
    d = finite_array("curve", deformation_m, None, field="deformation_m")
    f = finite_array("curve", force_N, len(d), field="force_N")
    kept = without_spikes(np.stack([d, f]), np.array([noise.deformation_m, noise.force_N]), FALSE_ALARM)
    d, f = d[kept], f[kept]
    if not from_contact:
        check_curve(d, f, noise)
    low = d <= LOW_m * (1 + 1e-9)
    if not low.any():
        raise InputError("curve", f"no sample up to {LOW_m} m; the minimum is {d.min():.4g} m")
    i, relative = _slope(d[low], f[low], noise)
    if not i > 0:
        raise InputError(
            "curve", f"found {i:.4g} N/m, expected a force that rises with the deformation", field="force_N"
        )
    full, _ = _slope(d, f, noise)
    quadratic, uncertainty = _quadratic(d, f, noise)
    return CurveCoefficients(i, full, quadratic, relative, uncertainty, *_contact(d[low], f[low], noise))


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
        Not two arrays of finite numbers, or empty; the force stays zero over a travel that neither the noise nor the stiffness
        beyond it explains; or it differs between closing and opening.
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
            f"the force is zero up to {1e3 * free_m:.2g} mm within its noise, and beyond it higher than that of a wall in contact",
            field="deformation_m",
            remedy="give the deformation from contact on, without spikes",
        )


def stiffness_grid(readings: Sequence[TouchReading]) -> Float[np.ndarray, "16 4"]:
    """Stiffness i [N/m] at all places, NaN where not touched.

    A side that was not measured has the value of the opposite side, since a pinch loads both.

    Parameters
    ----------
    readings
        Touches of one object.
    """
    out = np.full((HEIGHTS, 4), np.nan)
    for reading in readings:
        column = 0 if reading.axis == "x" else 2
        values = [side.i_N_per_m if side is not None else np.nan for side in reading.sides]
        known = [value for value in values if np.isfinite(value)]
        if known:
            out[reading.height - 1, column : column + 2] = np.where(np.isfinite(values), values, known[0])
    return out


def _slope(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> tuple[float, float]:
    """k of F = k d and its relative standard deviation."""
    count = len(d)
    dd, df, ff = float(d @ d), float(d @ f), float(f @ f)
    var_d, var_f = noise.deformation_m**2, noise.force_N**2
    inside = dd - count * var_d
    if var_d == 0 or inside > 25 * count * var_d:
        k = df / inside if inside > 0 else math.nan
        return k, math.sqrt((var_f + k * k * var_d) / inside) / abs(k) if k else math.nan
    if df <= 0 and float(f.mean()) <= 5 * noise.force_N / math.sqrt(count):
        return math.nan, math.nan  # no significant force
    # Deming: the line with the least weighted distance, as a compliance, which may be negative due to noise.
    ratio = var_f / var_d
    half = 0.5 * (ff - ratio * dd)
    scale = half + math.hypot(half, math.sqrt(ratio) * df)
    if not scale > 0:
        return math.nan, math.nan
    compliance = df / scale
    # f^2 along the line, from both sensors, minus the noise.
    square = (ratio * dd + scale) / (1 + ratio * compliance**2)
    square = max(square - count * var_f / (1 + ratio * compliance**2), 0.25 * square)
    return _positive(compliance, math.sqrt((compliance**2 * var_f + var_d) / square))


def _contact(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> tuple[float, float]:
    """c of d = F / k + c and its standard deviation; NaN where the noise explains a part of the differences of the forces."""
    count, away = len(d), f - f.mean()
    square = float(away @ away) - (count - 1) * noise.force_N**2
    if square <= 25 * count * noise.force_N**2:
        return math.nan, math.nan
    compliance = float(away @ d) / square
    variance = noise.deformation_m**2 + (compliance * noise.force_N) ** 2
    sigma = math.sqrt(variance * (1 / count + float(f.mean()) ** 2 / square))
    return float(d.mean()) - compliance * float(f.mean()), sigma


def _positive(compliance: float, sigma: float) -> tuple[float, float]:
    """Stiffness and its relative standard deviation, from a Gaussian compliance truncated to positive values."""
    away = max(compliance / sigma, -8.0)  # beyond this both factors of the slope vanish
    slope = math.sqrt(2 / math.pi) * math.exp(-0.5 * away**2) / math.erfc(-away / math.sqrt(2))
    mean = compliance + sigma * slope
    return 1 / mean, sigma * math.sqrt(max(1 - slope * (away + slope), 0.0)) / mean


def _quadratic(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> tuple[float, float]:
    """b of F = a d + b d^2 and its standard deviation, in nominal units."""
    if len(d) < 3:
        return math.nan, math.nan
    count, var = len(d), noise.deformation_m**2
    s1, s2, s3, s4 = (float((d**k).sum()) for k in range(1, 5))
    m2 = s2 - count * var
    m3 = s3 - 3 * var * s1
    m4 = s4 - 6 * var * s2 + 3 * count * var**2
    right = np.array([d @ f, (d * d) @ f - var * f.sum()])
    determinant = m2 * m4 - m3 * m3
    if not (m2 > 0 and m4 > 0 and determinant > 1e-3 * m2 * m4):
        return math.nan, math.nan
    a = (m4 * right[0] - m3 * right[1]) / determinant
    b = (m2 * right[1] - m3 * right[0]) / determinant
    slope = a + 2 * b * float(np.mean(d))
    sigma = math.sqrt((noise.force_N**2 + slope**2 * var) * m2 / determinant)
    scale = NOMINAL_m**2 / NOMINAL_N
    return b * scale, sigma * scale


def _hysteresis(d: np.ndarray, f: np.ndarray, noise: TouchNoise) -> float:
    """Mean difference of the forces before and after the largest deformation, at the upper half [N]; 0 if not significant."""
    last = int(np.argmax(d))
    # The noise alone lets some sample of a closing curve be behind another: one test for each pair.
    apart = -ndtri(2 * FALSE_ALARM / len(d) ** 2) * math.sqrt(2.0) * noise.deformation_m
    if d[last] - d[last:].min() <= apart:
        return 0.0
    high = d >= 0.5 * d[last]
    before, after = np.flatnonzero(high[: last + 1]), last + 1 + np.flatnonzero(high[last + 1 :])
    if len(before) < 2 or len(after) < 2:
        return 0.0
    before = before[np.argsort(d[before])]
    within = after[d[after] >= d[before[0]]]
    if not len(within):
        return 0.0
    place = np.clip(np.searchsorted(d[before], d[within], side="right") - 1, 0, len(before) - 2)
    step = np.maximum(d[before][place + 1] - d[before][place], 1e-300)
    part = np.minimum((d[within] - d[before][place]) / step, 1.0)
    counts = np.bincount(place, 1 - part, len(before)) + np.bincount(place + 1, part, len(before))
    share = counts / len(within)
    difference = float(share @ f[before] - f[within].mean())
    away = d[before] - d[before].mean()
    square = float(away @ away)
    local = float(away @ f[before]) / max(
        square - len(before) * noise.deformation_m**2, 0.25 * square, 1e-300
    )
    # The stiffness of the whole curve is known better; that of a wall that stiffens is higher here.
    slope = np.fmax(local, _slope(d, f, noise)[0])
    sigma = math.hypot(noise.force_N, slope * noise.deformation_m) * math.sqrt(
        float(share @ share) + 1 / len(within)
    )
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
    """c of F = c d^power by weighted least squares, and its standard deviation; infinite without information on c."""
    shape = np.maximum(d, 0.0) ** power
    square = float(shape @ shape)
    if square == 0:
        return 0.0, math.inf
    with np.errstate(over="ignore"):  # of a step that is smaller than any sensor resolves
        slope = power * abs(np.divide(shape @ f, square)) * np.maximum(d, 0.0) ** (power - 1)
        variance = noise.force_N**2 + (slope * noise.deformation_m) ** 2
    weight = 1.0 / np.maximum(variance, 1e-300)
    total = float(weight @ shape**2)
    if total == 0:
        return 0.0, math.inf
    return float((weight * shape) @ f) / total, 1.0 / math.sqrt(total)
