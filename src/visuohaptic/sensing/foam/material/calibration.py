"""Calibration of a foam material from press records, with rejection of unsuitable data (Alt 2016, Sec. 3.2).

The published model is the cubic (3.2). A single cubic cannot represent a stiff start, a plateau and a
densification, so the default is a cubic spline with increasing
B-spline coefficients, which makes it monotone by construction; its number
of knots is chosen by cross-validation. Both residuals are reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr, stdtrit

from ....core.errors import CalibrationError
from .foam_material import FoamMaterial
from .hysteresis import identify_hysteresis
from .press_checks import MAX_RESIDUAL, MIN_STRAINS, REQUIRED_RANGE, refuse_bad_points, refuse_unsuitable
from .records import StrainStress
from .stress_curve import CurveKind, StressCurve
from .tension import Tension

#: Multiples of the minimum slope at which the plateau ends and densification begins.
PLATEAU_SLOPE, DENSIFICATION_SLOPE = 2.0, 3.0
INTERIOR_KNOTS = (1, 2, 3, 4, 6, 8, 10)


@dataclass(frozen=True, slots=True, eq=False)
class StressCurveFit:
    """A fitted curve and its goodness of fit."""

    curve: StressCurve
    residual_Pa: float  #: standard deviation of the points about the curve
    correlation: float  #: of neighbouring residuals; the covariance is inflated for it
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class FoamCalibration:
    """The material, and diagnostics of the calibration."""

    material: FoamMaterial
    data: StrainStress
    residual_spline_Pa: float
    residual_cubic_Pa: float
    cubic_monotone: bool
    hysteresis_loss: float  #: dissipated fraction of the work of compression; 0 without unloading points
    presses: int  #: number of presses from rest in the record
    #: Standard deviation of the stress of a further press, relative to the curve; NaN for a single press, which does not show it.
    press_sigma: float
    notes: tuple[str, ...] = ()


def plateau(curve: StressCurve) -> tuple[tuple[float, float], float]:
    """Working range and densification limit from the slope of the curve.

    The plateau is the interval about the lowest slope where the slope stays
    below twice its minimum; there the foam is most sensitive. Densification
    begins where the slope reaches three times its minimum, or at the end of the
    calibration.

    Parameters
    ----------
    curve
        Monotone loading curve.

    Returns
    -------
    tuple
        Strains (low, high) of the plateau, and the strain at which densification begins.
    """
    strain = np.linspace(0.0, curve.max_strain, 601)
    slope = curve.slope(strain)
    lowest = int(np.argmin(slope))
    steep = slope > PLATEAU_SLOPE * slope[lowest]
    before, after = np.flatnonzero(steep[:lowest]), np.flatnonzero(steep[lowest:])
    low = float(strain[before[-1] + 1]) if len(before) else 0.0
    high = float(strain[lowest + after[0] - 1]) if len(after) else curve.max_strain
    if high <= low:
        low, high = 0.0, curve.max_strain
    dense = np.flatnonzero(slope[lowest:] > DENSIFICATION_SLOPE * slope[lowest])
    limit = float(strain[lowest + dense[0]]) if len(dense) else curve.max_strain
    return (low, high), max(limit, high)


def calibrate_foam(
    data: StrainStress,
    *,
    width_m: float,
    height_m: float,
    curve: CurveKind = "spline",
    tension: Tension | None = None,
) -> FoamCalibration:
    """Fit the material, or reject the data.

    Parameters
    ----------
    data
        Points of one or more runs with a plate that covers the whole strip.
    width_m, height_m
        Size of the strip: w along the compression, h across the contour.
    curve
        ``spline`` (default) or the published ``cubic``.
    tension
        Lateral tension, if it was calibrated with a narrow plate before.

    Raises
    ------
    CalibrationError
        The foam is unsuitable or the data are bad; one line states the cause and its location.

    Examples
    --------
    >>> strain = np.linspace(0.0, 0.6, 61)
    >>> stress_Pa = 4e3 * strain + 3e4 * strain**3  # what a press has measured
    >>> data = StrainStress(strain, stress_Pa, np.ones(61, dtype=int))
    >>> found = calibrate_foam(data, width_m=0.02, height_m=0.01)
    >>> found.residual_spline_Pa < 50.0, round(found.material.loading.max_strain, 2)
    (True, 0.6)
    """
    record, (strain, stress) = data, data.loading
    refuse_bad_points(data.where, strain, stress)
    spline = fit_curve(strain, stress, kind="spline", where=data.where)
    presses, press_sigma = _presses(data), float("nan")
    if len(presses) > 1:
        data, press_sigma = _levelled(data, presses, spline.curve)
        strain, stress = data.loading
        spline = fit_curve(strain, stress, kind="spline", where=data.where)
    refuse_unsuitable(data.where, strain, stress, spline.curve)
    notes: list[str] = []
    cubic = _cubic(data, required=curve == "cubic")
    cubic_residual = cubic.residual_Pa if cubic is not None else float("nan")
    cubic_monotone = cubic is not None and cubic.curve.minimum_slope()[1] > 0
    chosen = spline if curve == "spline" or cubic is None else cubic
    limit = MAX_RESIDUAL * float(stress.max())
    if chosen.residual_Pa > limit:
        raise CalibrationError(
            data.where,
            f"the {curve} leaves a residual of {chosen.residual_Pa:.0f} Pa, expected at most {limit:.0f} Pa",
            remedy="use the spline curve" if curve == "cubic" else "repeat the press test more slowly",
        )
    working, densification = plateau(chosen.curve)
    unloading, peak, loss = _unloading(data, chosen, notes)
    loading = chosen.curve
    if len(presses) > 1:
        common = press_sigma * loading.parameters
        loading = replace(loading, covariance=loading.covariance + np.outer(common, common))
    material = FoamMaterial(
        loading=loading,
        width_m=width_m,
        height_m=height_m,
        working_strain=working,
        densification_strain=densification,
        residual_Pa=chosen.residual_Pa,
        unloading=unloading,
        unloading_peak_strain=peak,
        hysteresis=(
            identify_hysteresis(data.strain, data.stress_Pa, data.direction, chosen.curve)
            if unloading is not None
            else None
        ),
        tension=tension or Tension(),
    )
    return FoamCalibration(
        material, record, spline.residual_Pa, cubic_residual, cubic_monotone, loss, len(presses), press_sigma,
        tuple(notes),
    )  # fmt: skip


def _cubic(data: StrainStress, *, required: bool) -> StressCurveFit | None:
    """The published cubic, for comparison; where it is ``required``, it has to exist and to rise."""
    try:
        cubic = fit_curve(*data.loading, kind="cubic", where=data.where)
    except CalibrationError:
        if required:
            raise
        return None
    at, slope = cubic.curve.minimum_slope()
    if required and slope <= 0:
        raise CalibrationError(
            data.where,
            f"the cubic falls at strain {at:.2f} (slope {slope:.0f} Pa), expected a rising curve",
            remedy="use the spline curve, which is monotone",
        )
    return cubic


def _presses(data: StrainStress) -> list[Int[np.ndarray, "k"]]:
    """Indices of the points of each press from rest; one that is aborted belongs to the next one, at the end to the last.

    All points where a press begins at a larger strain: gains over different parts of the curve do not compare.
    """
    again = np.diff(data.strain) < -0.5 * np.ptp(data.strain)
    again |= (np.diff(data.direction) > 0) & (data.strain[1:] <= REQUIRED_RANGE[0])
    ends, starts = np.flatnonzero(again & (data.direction[1:] > 0)) + 1, [0]
    for end in (*ends.tolist(), len(data.strain)):
        part = slice(starts[-1], end)
        up = data.strain[part][data.direction[part] > 0]
        if up.max(initial=0.0) >= REQUIRED_RANGE[1]:
            if up.min() > REQUIRED_RANGE[0]:
                return [np.arange(len(data.strain))]
            starts.append(end)
    return np.split(np.arange(len(data.strain)), starts[1:-1])


def _levelled(
    data: StrainStress, presses: list[Int[np.ndarray, "k"]], curve: StressCurve
) -> tuple[StrainStress, float]:
    """The record with all presses at their mean stress, and the relative standard deviation of a further press.

    Foam is stiffer the faster it is pressed, and differs from press to press. Each press has a gain relative to the common curve; what
    the gains of R presses scatter beyond their own errors is that of the next press, relative to their mean: s^2 (1 + 1 / R). As
    s itself is estimated from R - 1 differences, one standard deviation is the 68 % interval of Student's distribution.
    """
    gain, error2 = np.zeros((2, len(presses)))
    for i, press in enumerate(presses):
        up = press[data.direction[press] > 0]
        model = curve.stress(data.strain[up])
        gain[i] = model @ data.stress_Pa[up] / (model @ model)
        rest = data.stress_Pa[up] - gain[i] * model
        error2[i] = rest @ rest / ((len(up) - 1) * (model @ model))
    if gain.min() <= 0.0:
        raise CalibrationError(
            data.where,
            f"the stress does not rise in press {int(gain.argmin()) + 1} of {len(presses)}",
            remedy="remove that press, or repeat it",
        )
    scatter2 = max(float(gain.var(ddof=1) - error2.mean()), 0.0) * (1.0 + 1.0 / len(presses))
    sigma = float(stdtrit(len(presses) - 1, ndtr(1.0))) * math.sqrt(scatter2) / float(gain.mean())
    if sigma >= 1.0:  # the force of the next press could as well be none
        raise CalibrationError(
            data.where,
            f"the stresses of {len(presses)} presses differ by a factor of {gain.max() / gain.min():.3g}",
            remedy="give all presses of one foam in one unit, or more presses",
        )
    stress = data.stress_Pa.copy()
    for press, own in zip(presses, gain, strict=True):
        stress[press] *= float(gain.mean()) / own
    return replace(data, stress_Pa=stress), sigma


def fit_curve(
    strain: Float[np.ndarray, "n"],
    stress_Pa: Float[np.ndarray, "n"],
    *,
    kind: CurveKind = "spline",
    where: str = "strain and stress",
) -> StressCurveFit:
    """Least-squares fit of a curve through the origin, with the covariance of its parameters.

    Neighbouring residuals of one run are rarely independent; the covariance is
    multiplied by (1 + r) / (1 - r) with their correlation r.

    Parameters
    ----------
    strain
        Compressive strains, 0 to less than 1.
    stress_Pa
        Stress at them [Pa].
    kind
        ``spline``: monotone, knots by cross-validation; ``cubic``: as published, Eq. (3.2).
    where
        Source named in error messages.
    """
    end = float(strain.max())
    if kind == "cubic":
        start = StressCurve("cubic", np.array([0.0, end]), np.zeros(3), np.zeros((3, 3)))
        return _solve(start, strain, stress_Pa, monotone=False, where=where)
    fits, scores = [], []
    distinct = len(np.unique(np.round(strain, 6)))
    for interior in INTERIOR_KNOTS:
        if interior + 3 > distinct // 3:
            break
        # The curve bends most at its stiff start: knots are closer there.
        knots = end * np.linspace(0.0, 1.0, interior + 2) ** 1.5
        empty = StressCurve("spline", knots, np.zeros(interior + 3), np.zeros((interior + 3,) * 2))
        try:
            scores.append(_cross_validation(empty, strain, stress_Pa))
            fits.append(empty)
        except np.linalg.LinAlgError:
            break
    if not fits:
        raise CalibrationError(where, f"found {distinct} different strains, expected {MIN_STRAINS} or more")
    # The smallest model that predicts as well as the best. A wider tolerance would save knots, but a model error
    # of half the noise changes the score by only a tenth, and is not included in the covariance.
    best = next(i for i, score in enumerate(scores) if score <= 1.002 * min(scores) + 1e-12)
    return _solve(fits[best], strain, stress_Pa, monotone=True, where=where)


def _design(
    curve: StressCurve, strain: Float[np.ndarray, "n"], *, monotone: bool
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "p p"]]:
    """Design matrix and the map from its unknowns to the curve's parameters.

    For a monotone spline the unknowns are the increments of the B-spline coefficients.
    """
    basis = curve.basis(strain)
    size = basis.shape[1]
    steps = np.tril(np.ones((size, size))) if monotone else np.eye(size)
    return basis @ steps, steps


def _increments(
    design: Float[np.ndarray, "n p"], stress: Float[np.ndarray, "n"], *, monotone: bool
) -> Float[np.ndarray, "p"]:
    if not monotone:
        return np.linalg.lstsq(design, stress, rcond=None)[0]
    from scipy.optimize import nnls

    # A rising floor far below any real slope keeps the curve strictly monotone.
    floor = 1e-4 * float(stress.max()) / design.shape[1]
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0] = 1.0
    rest, _ = nnls(design / scale, stress - design.sum(axis=1) * floor)
    return rest / scale + floor


def _cross_validation(
    curve: StressCurve, strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"], folds: int = 5
) -> float:
    """Root mean square error of the prediction of left-out points."""
    order = np.argsort(strain, kind="stable")
    fold = np.empty(len(strain), dtype=np.int64)
    fold[order] = np.arange(len(strain)) % folds
    design, _ = _design(curve, strain, monotone=True)
    if np.any(np.count_nonzero(design > 0, axis=0) < 2):
        raise np.linalg.LinAlgError
    squares = 0.0
    for held in range(folds):
        out = fold == held
        found = _increments(design[~out], stress[~out], monotone=True)
        squares += float(np.sum((design[out] @ found - stress[out]) ** 2))
    return float(np.sqrt(squares / len(strain)))


def _solve(
    curve: StressCurve,
    strain: Float[np.ndarray, "n"],
    stress: Float[np.ndarray, "n"],
    *,
    monotone: bool,
    where: str,
) -> StressCurveFit:
    design, steps = _design(curve, strain, monotone=monotone)
    found = _increments(design, stress, monotone=monotone)
    residual = stress - design @ found
    free = np.ones(len(found), dtype=bool)
    if monotone:
        free = found > 1.5e-4 * float(stress.max()) / len(found)
    freedom = max(len(stress) - int(free.sum()), 1)
    variance = float(residual @ residual) / freedom
    energy = float(residual @ residual)
    correlation = float(residual[1:] @ residual[:-1]) / energy if energy > 0 else 0.0
    correlation = float(np.clip(correlation, 0.0, 0.95))
    inflated = variance * (1 + correlation) / (1 - correlation)
    normal = design[:, free].T @ design[:, free]
    covariance = np.zeros((len(found), len(found)))
    covariance[np.ix_(free, free)] = inflated * np.linalg.pinv(normal, rcond=1e-13)
    covariance = steps @ covariance @ steps.T
    fitted = replace(curve, parameters=steps @ found, covariance=0.5 * (covariance + covariance.T))
    if not np.all(np.isfinite(fitted.parameters)):
        raise CalibrationError(where, "the fit did not give finite numbers", remedy="check the data")
    return StressCurveFit(fitted, float(np.sqrt(variance)), correlation, len(stress))


def _unloading(
    data: StrainStress, loading: StressCurveFit, notes: list[str]
) -> tuple[StressCurve | None, float, float]:
    strain, stress = data.unloading
    if len(strain) == 0:
        return None, 0.0, 0.0
    if len(np.unique(np.round(strain, 6))) < MIN_STRAINS or strain.max() < REQUIRED_RANGE[1]:
        notes.append(f"{len(strain)} unloading points are too few for an unloading curve")
        return None, 0.0, 0.0
    if not (np.all(np.isfinite(strain)) and np.all(np.isfinite(stress))):
        raise CalibrationError(data.where, "found NaN or infinity among the unloading points")
    fit = fit_curve(strain, stress, where=data.where)
    # The first unloading point is one step after the reversal; the reversal itself is the end of loading.
    end = loading.curve.max_strain
    peak = end if strain.max() > 0.9 * end else float(strain.max())
    grid = np.linspace(0.0, peak, 200)
    up, down = loading.curve.stress(grid), fit.curve.stress(grid)
    # The foam cannot return more work than was done on it.
    loss = float(1.0 - np.trapezoid(down, grid) / np.trapezoid(up, grid))
    if loss < -0.02:
        raise CalibrationError(
            data.where,
            f"the foam returns {1 - loss:.2f} of the work of loading, expected at most 1",
            field="direction",
            remedy="loading and unloading seem to be swapped",
        )
    return fit.curve, peak, max(loss, 0.0)
