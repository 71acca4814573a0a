"""Calibration of the sensor's 6 x 6 compliance from known loads, with rejection of unsuitable data.

The data fit E of ``g = (I + E) f + b`` row by row (ridge regression): f the
known loads, g the wrenches of the beam model for the observations, b a zero offset that
need not be exact. The prior of E follows from the tolerances of the parts, so
that axes without load keep the analytic beam with calibrated sigmas. The
data are checked with the fit *without* the prior, which cannot hide bad data;
a beam that does not match the data sheet is reported, not averaged with it.

A template half a millimetre from its declared position misreads each load by the same
fraction every time. Readings under known loads therefore have this error in E, and it is not
counted again (``Correction.place_left``); the motion of a cross section does not show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import CalibrationError, InputError
from ...core.geometry import so3_exp
from ...core.measurement import SIGMA_PER_MAD
from .correction import Correction, prior_correction
from .estimate import estimate_wrench
from .mechanics import Beam, compliance
from .observation import SectionMotion
from .records import LoadRecord

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
#: Minimum number of rows, and of loaded rows among them.
MIN_ROWS, MIN_LOADED = 8, 4
#: An axis counts as loaded if its load changes by more than this fraction of the largest load.
LOADED = 0.05
#: Fractions of the load range: maximum scatter of the unloaded rows, and maximum residual.
MAX_WANDER, MAX_RESIDUAL = 0.05, 0.05
#: Minimum fraction of the variance of a loaded axis that a linear fit explains.
MIN_EXPLAINED = 0.95
#: Residuals beyond this many robust standard deviations are outliers, not noise.
OUTLIER = 7.0
#: Maximum deviation from the beam's data sheet, in standard deviations of the prior.
MAX_SURPRISE = 5.0
_LOAD_BOTH_WAYS = "load each axis both ways, and leave it unloaded in between"


@dataclass(frozen=True, slots=True, eq=False)
class BeamCalibration:
    """The correction, and diagnostics of the calibration."""

    beam: Beam
    correction: Correction
    record: LoadRecord
    residual: Float[np.ndarray, "n 6"]  #: reading of the calibrated sensor minus applied load [N, Nm]
    residual_rms: Float[np.ndarray, "6"]
    uncalibrated_rms: Float[np.ndarray, "6"]  #: the same with the data sheet alone
    explained: Float[np.ndarray, "6"]  #: fraction of the variance, NaN for axes that were not loaded
    zero: Float[np.ndarray, "6"]  #: b, reading of the unloaded sensor [N, Nm]
    notes: tuple[str, ...] = ()

    @property
    def compliance(self) -> Float[np.ndarray, "6 6"]:
        """Calibrated motion of the tip per unit of the wrench, C = C_0 (I + E)."""
        return compliance(self.beam, 1.0) @ (np.eye(6) + self.correction.matrix)

    @property
    def sigma_percent(self) -> Float[np.ndarray, "6"]:
        """Uncertainty of the scale of each axis [%]."""
        return 100 * np.sqrt(np.array([self.correction.row_covariance[k, k, k] for k in range(6)]))


def calibrate_beam(
    record: LoadRecord,
    beam: Beam,
    *,
    xi: float = 1.0,
    load_tolerance: float = 0.002,
    prior: Correction | None = None,
) -> BeamCalibration:
    """Fit the correction of a beam to known loads, or reject the data.

    Parameters
    ----------
    record
        Known loads and readings, or known loads and motions of the cross section at ``xi``.
    beam
        Parts of the sensor and their tolerances.
    xi
        Position x / L of the cross section whose motion was observed.
    load_tolerance
        Relative standard deviation common to all known loads (weights, g, lever arm).
    prior
        Prior of E; from the tolerances of ``beam`` by default.

    Raises
    ------
    CalibrationError
        Too few or bad data, or another beam; one line states the cause and its location.
    """
    prior = prior or prior_correction(beam)
    scale = np.array([1.0, 1.0, 1.0, *[1 / beam.length_m] * 3])  # moments as forces at the clamp
    load = record.load * scale
    reach = float(np.abs(load).max())
    _refuse_few(record, load)
    read = _model_wrenches(record, beam, xi) * scale
    loaded = np.ptp(load, axis=0) > LOADED * reach
    free, free_rest, free_sigma = _free_fit(load, read, loaded)
    # Reading at the largest load: another beam has its scatter in its own scale.
    span = reach * np.where(loaded, np.linalg.norm((np.eye(6) + free)[:, loaded], axis=1), 1.0)
    _refuse_wander(record, load, read, span)
    explained = _refuse_noise(record, read, free_rest, loaded, span)
    prior_rows = prior.row_covariance * (scale[:, None, None] ** 2 / np.multiply.outer(scale, scale)[None])
    matrix, rows, zero, place_left = (
        np.zeros((6, 6)),
        np.zeros((6, 6, 6)),
        np.zeros(6),
        prior.place_left.copy(),
    )
    for k in range(6):
        spread, mean = np.sqrt(np.diag(prior_rows[k])), prior.matrix[k] * scale[k] / scale
        _refuse_surprise(record, k, free[k], mean, np.hypot(spread, free_sigma[k]))
        matrix[k], rows[k], zero[k] = _ridge(
            load, read[:, k] - load[:, k], mean, prior_rows[k], free_rest[:, k]
        )
        if record.kind == "wrench":
            # An error with the variance of the prior is reduced to this fraction of it by the ridge regression.
            place_left[k] *= rows[k, k, k] / prior_rows[k, k, k]
        rows[k, k, k] += load_tolerance**2
    residual = (read - zero) @ np.linalg.inv(np.eye(6) + matrix).T - load
    before = read - zero - load
    notes = [
        f"{AXES[k]} was not loaded: it keeps the beam's data sheet, {100 * np.sqrt(rows[k, k, k]):.1f} %"
        for k in range(6)
        if not loaded[k]
    ]
    back = matrix * scale[None, :] / scale[:, None]
    rows_back = rows * np.multiply.outer(scale, scale)[None] / scale[:, None, None] ** 2
    return BeamCalibration(
        beam,
        Correction(back, rows_back, place_left),
        record,
        residual / scale,
        np.sqrt((residual**2).mean(axis=0)) / scale,
        np.sqrt((before**2).mean(axis=0)) / scale,
        explained,
        zero / scale,
        tuple(notes),
    )


def _model_wrenches(record: LoadRecord, beam: Beam, xi: float) -> Float[np.ndarray, "n 6"]:
    """Wrenches of the beam model for the observations.

    Parameters
    ----------
    record
        Known loads with readings or with motions of a cross section.
    beam
        Parts of the sensor and their tolerances.
    xi
        Position x / L of that cross section.
    """
    if record.kind == "wrench":
        return record.observed
    # One section with six observations for six unknowns: the weights are irrelevant.
    weight = np.diag([1e-10] * 3 + [1e-8] * 3)
    wrenches = []
    for row, line in zip(record.observed, record.line, strict=True):
        rotation = so3_exp(row[3:])
        motion = SectionMotion(np.array([xi]), row[None, :3], rotation[None], weight, 0 * weight)
        try:
            wrenches.append(estimate_wrench(beam, motion, model="exact").wrench)
        except InputError as error:
            raise CalibrationError(record.where, error.problem, field=f"line {line}") from error
    return np.array(wrenches)


def _refuse_few(record: LoadRecord, load: np.ndarray) -> None:
    loaded = int((np.abs(load).max(axis=1) > 0).sum())
    if len(load) < MIN_ROWS or loaded < MIN_LOADED:
        raise CalibrationError(
            record.where,
            f"found {len(load)} rows, {loaded} of them with a load, expected {MIN_ROWS} and {MIN_LOADED} or more",
            remedy=_LOAD_BOTH_WAYS,
        )
    reach = float(np.abs(load).max())
    # Offset and scale of an axis cannot be separated if its load never changes.
    if not (np.ptp(load, axis=0) > LOADED * reach).any():
        raise CalibrationError(
            record.where,
            f"no load changes by more than {100 * LOADED:.0f} % of the largest one between the rows",
            remedy=_LOAD_BOTH_WAYS,
        )


def _refuse_wander(record: LoadRecord, load: np.ndarray, read: np.ndarray, span: np.ndarray) -> None:
    unloaded = np.abs(load).max(axis=1) < 1e-9
    if unloaded.sum() < 2:
        return
    wander = read[unloaded].std(axis=0, ddof=1) / span
    k = int(np.argmax(wander))
    if wander[k] > MAX_WANDER:
        raise CalibrationError(
            record.where,
            f"the unloaded sensor reads {AXES[k]} with a scatter of {100 * wander[k]:.0f} % of the "
            f"largest load, expected below {100 * MAX_WANDER:.0f} %",
            field=f"lines {', '.join(str(n) for n in record.line[unloaded][:6])}",
            remedy="let the zero settle, or load more",
        )


def _free_fit(
    load: np.ndarray, read: np.ndarray, loaded: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares without prior on the loaded axes: E, residuals, and the sigma of E."""
    design = np.column_stack([load[:, loaded], np.ones(len(load))])
    solution, _, rank, _ = np.linalg.lstsq(design, read, rcond=1e-9)
    rest = read - design @ solution
    freedom = max(len(load) - int(rank), 1)
    sigma2 = (rest**2).sum(axis=0) / freedom
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(design.T @ design)), 0))[:-1]
    free, sigma = np.zeros((6, 6)), np.full((6, 6), np.inf)
    free[:, loaded] = solution[:-1].T
    free[np.arange(6)[loaded], np.arange(6)[loaded]] -= 1
    sigma[:, loaded] = np.sqrt(sigma2)[:, None] * spread[None]
    return free, rest * np.sqrt(len(load) / freedom), sigma


def _refuse_noise(
    record: LoadRecord, read: np.ndarray, rest: np.ndarray, loaded: np.ndarray, span: np.ndarray
) -> Float[np.ndarray, "6"]:
    """Reject data that no linear sensor explains; returns the explained fraction of the variance."""
    total = ((read - read.mean(axis=0)) ** 2).sum(axis=0)
    explained = np.where(loaded, 1 - (rest**2).sum(axis=0) / np.maximum(total, 1e-300), np.nan)
    fraction = np.sqrt((rest**2).mean(axis=0)) / span
    worst = int(np.nanargmin(explained))
    if explained[worst] < MIN_EXPLAINED:
        raise CalibrationError(
            record.where,
            f"the loads explain only {100 * max(explained[worst], 0):.0f} % of what {AXES[worst]} reads, expected "
            f"{100 * MIN_EXPLAINED:.0f} % or more",
            remedy="repeat the session: settle, zero, heavier weights",
        )
    robust = SIGMA_PER_MAD * np.median(np.abs(rest), axis=0)
    away = np.abs(rest) / np.maximum(robust, 0.005 * span)
    if away.max() > OUTLIER:
        row, k = divmod(int(np.argmax(away)), 6)
        raise CalibrationError(
            record.where,
            f"{AXES[k]} deviates by {away[row, k]:.0f} standard deviations from the other rows",
            field=f"line {record.line[row]}",
            remedy="check the load of this row, or leave it out",
        )
    loose = int(np.argmax(fraction))
    if fraction[loose] > MAX_RESIDUAL:
        raise CalibrationError(
            record.where,
            f"{AXES[loose]} scatters by {100 * fraction[loose]:.0f} % of the largest load, expected at most "
            f"{100 * MAX_RESIDUAL:.0f} %",
            remedy="repeat the session: settle, zero, heavier weights",
        )
    return explained


def _refuse_surprise(
    record: LoadRecord, k: int, free: np.ndarray, mean: np.ndarray, sigma: np.ndarray
) -> None:
    """Reject a beam that does not match the data sheet, or an earlier calibration."""
    surprise = np.abs(free - mean) / sigma
    j = int(np.argmax(surprise))
    if surprise[j] <= MAX_SURPRISE:
        return
    if j == k:
        what = f"the beam moves {1 + free[j]:.3g} times as far along {AXES[k]} as its data sheet states"
        remedy = "check units, signs, length, diameter and spring in the beam's file"
    else:
        what = f"a load of {AXES[j]} shows as {100 * free[j]:.0f} % of {AXES[k]}"
        remedy = "check the axes of the loads and of the sensor"
    raise CalibrationError(
        record.where,
        f"{what}, {surprise[j]:.0f} standard deviations of the tolerances, expected up to {MAX_SURPRISE:.0f}",
        remedy=remedy,
    )


def _ridge(
    load: np.ndarray, excess: np.ndarray, mean: np.ndarray, prior: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """One row of E and its covariance, and its offset; the noise is that of the fit without prior."""
    design = np.column_stack([load, np.ones(len(load))])
    floor = 1e-6 * float(np.abs(load).max())
    noise = max(float((rest**2).mean()), floor**2)
    precision = np.zeros((7, 7))
    precision[:6, :6] = np.linalg.inv(prior)
    normal = design.T @ design / noise + precision
    covariance = np.linalg.inv(normal)
    start = np.append(mean, 0.0)
    found = covariance @ (design.T @ excess / noise + precision @ start)
    return found[:6], covariance[:6, :6], float(found[6])
