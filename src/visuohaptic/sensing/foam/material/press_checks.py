"""Checks of press records before calibration: bad points, falling or flat curves, outliers (Alt 2016, Fig. 3.2)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ....core.errors import CalibrationError
from ....core.measurement import SIGMA_PER_MAD
from .stress_curve import StressCurve

#: Minimum number of different strains on the loading branch: three for each of the four parameters of the smallest spline.
MIN_STRAINS = 12
#: The calibration has to begin at or below the first strain and to reach the second one.
REQUIRED_RANGE = (0.1, 0.3)
#: Largest gap between neighbouring strains.
MAX_GAP = 0.15
#: With a lowest slope below this fraction of the mean slope, stresses cannot be distinguished.
MIN_SLOPE_RATIO = 0.02
#: Largest accepted residual, as a fraction of the highest stress.
MAX_RESIDUAL = 0.05


def refuse_bad_points(where: str, strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"]) -> None:
    """Reject press records to which no curve can be fitted.

    Parameters
    ----------
    where
        Source named in error messages.
    strain, stress
        Points of increasing load: compressive strain, and stress [Pa].

    Raises
    ------
    CalibrationError
        The points are not suitable; the message states what was found and expected, and the remedy.
    """
    if not (np.all(np.isfinite(strain)) and np.all(np.isfinite(stress))):
        raise CalibrationError(where, "found NaN or infinity, expected finite numbers")
    distinct = len(np.unique(np.round(strain, 6)))
    if distinct < MIN_STRAINS:
        raise CalibrationError(
            where, f"found {distinct} different strains of loading, expected {MIN_STRAINS} or more"
        )
    # Runs without noise may repeat each other; a frozen logger repeats the previous row.
    repeated = int(np.count_nonzero((np.diff(strain) == 0) & (np.diff(stress) == 0)))
    if repeated > len(strain) // 2:
        raise CalibrationError(
            where, f"found {repeated} of {len(strain)} rows repeated exactly", remedy="is the logger frozen?"
        )
    low, high = float(strain.min()), float(strain.max())
    if high >= 1.0 or low < -0.01:
        raise CalibrationError(
            where,
            f"found strains {low:.2f} to {high:.2f}, expected compression between 0 and 1",
            remedy="tension of a rubber is not a foam calibration",
        )
    if low > REQUIRED_RANGE[0] or high < REQUIRED_RANGE[1]:
        raise CalibrationError(
            where,
            f"found strains {low:.2f} to {high:.2f}, expected a range from "
            f"{REQUIRED_RANGE[0]} or less to {REQUIRED_RANGE[1]} or more",
            remedy="press deeper and begin before the contact",
        )
    ordered = np.unique(strain)
    gap = int(np.argmax(np.diff(ordered)))
    if ordered[gap + 1] - ordered[gap] > MAX_GAP:
        raise CalibrationError(
            where, f"no points between strain {ordered[gap]:.2f} and {ordered[gap + 1]:.2f}"
        )
    top = float(stress.max())
    if top <= 0:
        raise CalibrationError(where, f"the highest stress is {top:g} Pa, expected compression positive")
    if float(stress.min()) < -MAX_RESIDUAL * top:
        worst = int(np.argmin(stress))
        raise CalibrationError(
            where,
            f"found stress {stress[worst]:.0f} Pa at strain {strain[worst]:.2f}, expected 0 or more",
            remedy="compression counts positive",
        )
    if np.ptp(stress) < 0.05 * top:
        raise CalibrationError(where, f"the stress stays at {top:g} Pa regardless of the strain")


def refuse_unsuitable(
    where: str, strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"], spline: StressCurve
) -> None:
    """Reject falling curves (Fig. 3.2d), flat curves, and outliers.

    Parameters
    ----------
    where, strain, stress
        See :func:`refuse_bad_points`.
    spline
        Monotone curve fitted to them.

    Raises
    ------
    CalibrationError
        The curve falls or is flat, or a point is an outlier; the message states where.
    """
    order = np.argsort(strain, kind="stable")
    x, y = strain[order], stress[order]
    top = float(y.max())
    residual = y - spline.stress(x)
    spread = SIGMA_PER_MAD * float(np.median(np.abs(residual - np.median(residual))))
    groups = np.array_split(np.arange(len(x)), min(20, len(x) // 2))
    means = np.array([y[g].mean() for g in groups])
    centres = np.array([x[g].mean() for g in groups])
    # Medians distinguish a falling curve from one outlier.
    middles = np.array([np.median(y[g]) for g in groups])
    highest = np.maximum.accumulate(middles)
    drop = highest - middles
    noise = 3.0 * spread * np.sqrt(2.0 * len(groups) / len(x))
    worst = int(np.argmax(drop))
    single = np.abs(residual) > max(6.0 * spread, 0.04 * top)
    isolated = 0 < np.count_nonzero(single) <= max(3, len(x) // 50)
    if drop[worst] > max(noise, 0.01 * top) and not isolated:
        peak = int(np.argmax(means[: worst + 1]))
        raise CalibrationError(
            where,
            f"the stress falls by {drop[worst]:.0f} Pa between strain {centres[peak]:.2f} and "
            f"{centres[worst]:.2f}, expected a rising curve",
            remedy="this foam is unsuitable: one stress belongs to several strains",
        )
    if isolated:
        i = int(np.argmax(np.abs(residual)))
        raise CalibrationError(
            where,
            f"found {np.count_nonzero(single)} outliers, the worst {y[i]:.0f} Pa at strain {x[i]:.3f}, "
            f"expected about {spline.stress(x[i]):.0f} Pa",
            remedy="remove them or repeat the test",
        )
    at, slope = spline.minimum_slope()
    mean = float(spline.stress(np.array(spline.max_strain))) / spline.max_strain
    if slope < MIN_SLOPE_RATIO * mean:
        raise CalibrationError(
            where,
            f"the curve is flat at strain {at:.2f} (slope {slope:.0f} Pa), "
            f"expected {MIN_SLOPE_RATIO * mean:.0f} Pa or more",
            remedy="this foam is unsuitable: its strain does not determine the stress",
        )
