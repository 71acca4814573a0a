"""From press records to a foam material, or a refusal that says why (Alt 2016, Sec. 3.2).

The published model is the cubic (3.2). A stiff start, a plateau and a
densification do not fit into one cubic, so the default is a cubic spline whose
B-spline coefficients rise, which makes it monotone by construction; its number
of knots is chosen by cross-validation. Both residuals are reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ....core.errors import CalibrationError
from .boundary import Tension
from .foam_material import FoamMaterial
from .hysteresis import identify_hysteresis
from .records import StrainStress
from .stress_curve import CurveKind, StressCurve

__all__ = ["CurveFit", "FoamCalibration", "calibrate_foam", "fit_curve", "plateau"]

#: Fewest different strains on the loading branch.
MIN_STRAINS = 10
#: The calibration must begin at or below the first and reach the second strain.
REQUIRED_RANGE = (0.1, 0.3)
#: Widest gap between neighbouring strains.
MAX_GAP = 0.15
#: Largest accepted residual, as a fraction of the highest stress.
MAX_RESIDUAL = 0.05
#: A foam whose lowest slope is below this fraction of its mean slope cannot tell stresses apart.
MIN_SLOPE_RATIO = 0.02
#: The plateau ends where the slope reaches this multiple of its minimum, densification begins at the other.
PLATEAU_SLOPE, DENSIFICATION_SLOPE = 2.0, 3.0
INTERIOR_KNOTS = (1, 2, 3, 4, 6, 8, 10)


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """A fitted curve and how well it fits."""

    curve: StressCurve
    residual_Pa: float  #: standard deviation of the points about the curve
    correlation: float  #: of neighbouring residuals; the covariance is inflated for it
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class FoamCalibration:
    """The material, and the figures a person wants to see before trusting it."""

    material: FoamMaterial
    data: StrainStress
    residual_spline_Pa: float
    residual_cubic_Pa: float
    cubic_monotone: bool
    hysteresis_loss: float  #: lost fraction of the work of compression; 0 without unloading points
    notes: tuple[str, ...] = ()


def plateau(curve: StressCurve) -> tuple[tuple[float, float], float]:
    """Working range and densification limit from the slope of the curve.

    The plateau is the interval about the lowest slope where the slope stays
    below twice its minimum; there the foam is most sensitive. The densification
    begins where the slope reaches three times its minimum, or where the
    calibration ends.
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
    """Fit the material, or refuse.

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
        The foam is unsuitable or the data are bad; one line says which and where.

    Examples
    --------
    >>> strain = np.linspace(0.0, 0.6, 61)
    >>> stress_Pa = 4e3 * strain + 3e4 * strain**3  # what a press has measured
    >>> data = StrainStress(strain, stress_Pa, np.ones(61, dtype=int))
    >>> found = calibrate_foam(data, width_m=0.02, height_m=0.01)
    >>> found.residual_spline_Pa < 50.0, round(found.material.loading.max_strain, 2)
    (True, 0.6)
    """
    strain, stress = data.loading
    _refuse_bad_points(data.where, strain, stress)
    spline = fit_curve(strain, stress, kind="spline", where=data.where)
    _refuse_unsuitable(data.where, strain, stress, spline)
    notes: list[str] = []
    cubic_residual, cubic_monotone = np.nan, False
    try:
        cubic = fit_curve(strain, stress, kind="cubic", where=data.where)
        cubic_residual = cubic.residual_Pa
        cubic_monotone = cubic.curve.minimum_slope()[1] > 0
    except CalibrationError:
        if curve == "cubic":
            raise
        cubic = spline
    if curve == "cubic" and not cubic_monotone:
        at, slope = cubic.curve.minimum_slope()
        raise CalibrationError(
            data.where,
            f"the cubic falls at strain {at:.2f} (slope {slope:.0f} Pa), expected a rising curve",
            remedy="use the spline curve, which is monotone",
        )
    chosen = spline if curve == "spline" else cubic
    limit = MAX_RESIDUAL * float(stress.max())
    if chosen.residual_Pa > limit:
        raise CalibrationError(
            data.where,
            f"the {curve} leaves a residual of {chosen.residual_Pa:.0f} Pa, expected at most {limit:.0f} Pa",
            remedy="use the spline curve" if curve == "cubic" else "repeat the press test more slowly",
        )
    working, densification = plateau(chosen.curve)
    unloading, peak, loss = _unloading(data, chosen, notes)
    material = FoamMaterial(
        loading=chosen.curve,
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
        material, data, spline.residual_Pa, float(cubic_residual), cubic_monotone, loss, tuple(notes)
    )


def fit_curve(
    strain: Float[np.ndarray, "n"],
    stress_Pa: Float[np.ndarray, "n"],
    *,
    kind: CurveKind = "spline",
    where: str = "strain and stress",
) -> CurveFit:
    """Least-squares fit of a curve through the origin, with the covariance of its parameters.

    Neighbouring residuals of one run are rarely independent; the covariance is
    multiplied by (1 + r) / (1 - r) with their correlation r.
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
    # The smallest model that predicts as well as the best. A wider tolerance would save knots, but a misfit
    # of half the noise moves the score by a tenth only, and the covariance knows nothing of a misfit.
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
    """Root mean square of the prediction of left-out points."""
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
) -> CurveFit:
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
    return CurveFit(fitted, float(np.sqrt(variance)), correlation, len(stress))


def _refuse_bad_points(where: str, strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"]) -> None:
    if not (np.all(np.isfinite(strain)) and np.all(np.isfinite(stress))):
        raise CalibrationError(where, "found NaN or infinity, expected finite numbers")
    distinct = len(np.unique(np.round(strain, 6)))
    if distinct < MIN_STRAINS:
        raise CalibrationError(
            where, f"found {distinct} different strains of loading, expected {MIN_STRAINS} or more"
        )
    # Runs without noise may repeat each other; a frozen logger repeats the row before.
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
        raise CalibrationError(where, f"the stress stays at {top:g} Pa whatever the strain")


def _refuse_unsuitable(
    where: str, strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"], spline: CurveFit
) -> None:
    """Refuse falling foams (Fig. 3.2d), flat foams, and outliers."""
    order = np.argsort(strain, kind="stable")
    x, y = strain[order], stress[order]
    top = float(y.max())
    residual = y - spline.curve.stress(x)
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    groups = np.array_split(np.arange(len(x)), min(20, len(x) // 2))
    means = np.array([y[g].mean() for g in groups])
    centres = np.array([x[g].mean() for g in groups])
    # Medians tell a falling curve from one wild point.
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
            f"expected about {spline.curve.stress(x[i]):.0f} Pa",
            remedy="remove them or repeat the test",
        )
    at, slope = spline.curve.minimum_slope()
    mean = float(spline.curve.stress(np.array(spline.curve.max_strain))) / spline.curve.max_strain
    if slope < MIN_SLOPE_RATIO * mean:
        raise CalibrationError(
            where,
            f"the curve is flat at strain {at:.2f} (slope {slope:.0f} Pa), "
            f"expected {MIN_SLOPE_RATIO * mean:.0f} Pa or more",
            remedy="this foam is unsuitable: its strain does not tell the stress",
        )


def _unloading(
    data: StrainStress, loading: CurveFit, notes: list[str]
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
    # The first unloading point comes a step after the turn: the turn itself is the end of the loading.
    end = loading.curve.max_strain
    peak = end if strain.max() > 0.9 * end else float(strain.max())
    grid = np.linspace(0.0, peak, 200)
    up, down = loading.curve.stress(grid), fit.curve.stress(grid)
    # Work done on the foam must not be less than what it gives back.
    loss = float(1.0 - np.trapezoid(down, grid) / np.trapezoid(up, grid))
    if loss < -0.02:
        raise CalibrationError(
            data.where,
            f"the foam gives back {1 - loss:.2f} of the work of loading, expected at most 1",
            field="direction",
            remedy="loading and unloading seem to be swapped",
        )
    return fit.curve, peak, max(loss, 0.0)
