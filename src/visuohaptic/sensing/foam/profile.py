"""From one contour to pressures, contact regions and forces with their error budgets.

Symbols: K points along the strip, s position, delta deflection towards the base,
eps = delta / w strain. Equations (3.1), (3.9), (3.10) of the dissertation, with
the trapezoid rule on the real spacing in place of a constant s_d. Where foam goes
on beyond the first or the last point and that point is pressed, the rest of its
cell counts with its pressure (``end_cells_m``).

False alarms: a region needs one point above 5.5 sigma or two neighbours above
3.5 sigma. With Gaussian noise this happens by chance in less than 1e-5 of the
frames of 85 points. What noise doesn't explain but foam can't do, a shallow dent narrower
than its own decay (texture, dirt, a fold), is no region either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...core.measurement import ErrorBudget, Reason
from ...tracking.contours.contour import SHARED_POINTS
from .material.boundary import BOUNDARIES, Boundary
from .material.foam_material import FoamMaterial
from .material.hysteresis import RELEASE_STRAIN, HysteresisState

__all__ = ["ContactRegion", "FoamReading", "read_profile"]

SEED_PAIR_SIGMAS, SEED_SINGLE_SIGMAS = 3.5, 5.5
#: Gaps of invalid points up to this many are bridged by a straight line.
MAX_GAP_POINTS = 3
#: Free foam falls off beside a body over a good part of its width: what is deflected over less than this
#: part of it, ends included, and by less than foam that counts as released, is no contact.
NARROW_PER_WIDTH = 0.5
#: Misfit of each boundary law over simulated foams and bodies: fraction of the force.
MODEL_FLOOR = {"tension": 0.005, "enlarged": 0.005, "local": 0.10}


@dataclass(frozen=True, slots=True)
class ContactRegion:
    """One contact: points ``first..last`` are deflected, ``touch_start_m..touch_end_m`` are pressed."""

    first: int  #: index of the first deflected point on the strip
    last: int  #: index of the last one, inclusive
    s_start_m: float
    s_end_m: float
    touch_start_m: float  #: begin of the part that bears load by the tension law
    touch_end_m: float
    force_N: float
    enlarged_force_N: float  #: of the published law, for comparison
    budget: ErrorBudget
    max_strain: float
    valid: bool
    reason: Reason


@dataclass(frozen=True, slots=True, eq=False)
class FoamReading:
    """What one contour says."""

    force_N: float  #: sum over the contacts
    budget: ErrorBudget  #: of ``force_N``; zero and calibration are common to all contacts
    pressure_Pa: Float[np.ndarray, "K"]
    pressure_sigma_Pa: Float[np.ndarray, "K"]  #: image and zero noise, Eq. (3.9)
    point_valid: Bool[np.ndarray, "K"]
    contacts: tuple[ContactRegion, ...]
    saturated: bool  #: a point is beyond the densification limit
    unloading: bool  #: a point is on the unloading branch
    valid: bool
    reason: Reason


def read_profile(
    s_m: Float[np.ndarray, "K"],
    delta_m: Float[np.ndarray, "K"],
    delta_sigma_m: Float[np.ndarray, "K"],
    point_valid: Bool[np.ndarray, "K"],
    material: FoamMaterial,
    *,
    boundary: Boundary = "tension",
    zero_sigma_m: float = 0.0,
    memory: HysteresisState | None = None,
    uncertainty_m: Float[np.ndarray, "K"] | None = None,
    shared_noise: float = 0.0,
    own_noise_m: Float[np.ndarray, "K"] | None = None,
    end_cells_m: tuple[float, float] = (0.0, 0.0),
) -> FoamReading:
    """Read pressures and forces from the deflection of the front contour.

    Parameters
    ----------
    s_m
        Position of the points along the strip, increasing [m].
    delta_m, delta_sigma_m
        Deflection and its standard deviation, independent between points [m].
    point_valid
        False where the contour was not seen; short gaps are bridged, a contact
        that ends at a long one is not valid.
    material
        Calibrated foam.
    boundary
        Law at the ends of a contact, see :mod:`~visuohaptic.sensing.foam.material.boundary`.
    zero_sigma_m
        Standard deviation of the zero reference, common to all points [m].
    memory
        Strain history of the points; changed by the call. None: always loading.
    shared_noise
        Correlation of the noise of neighbouring points, ``tracking.SHARED_NOISE`` for its contours.
    own_noise_m
        Noise of each deflection beside ``delta_sigma_m`` that neighbours don't share, e.g. of a fit at a
        kink [m]; part of ``image_N``.
    uncertainty_m
        Systematic error of each deflection, e.g. where the contour has a kink [m]; the same
        in every frame, so that it goes to ``model_N``. Independent between points.
    end_cells_m
        Length of foam before the first and after the last point [m]. The points of a
        :class:`~visuohaptic.sensing.foam.strip.geometry.StripGeometry` lie half a spacing inside the
        ends, see :attr:`~visuohaptic.sensing.foam.strip.geometry.StripGeometry.end_cells_m`.

    Raises
    ------
    InputError
        Arrays of different lengths, positions that don't increase, unknown boundary.
    """
    points = len(s_m)
    if not (points >= 2 and delta_m.shape == delta_sigma_m.shape == point_valid.shape == s_m.shape):
        raise InputError(
            "read_profile",
            f"found shapes {s_m.shape}, {delta_m.shape}, {delta_sigma_m.shape}, {point_valid.shape}; "
            "expected four equal ones of two points or more",
        )
    if boundary not in BOUNDARIES:
        raise InputError("boundary", f"found {boundary!r}, expected one of {', '.join(BOUNDARIES)}")
    if not (np.isfinite(zero_sigma_m) and zero_sigma_m >= 0):
        raise InputError("zero_sigma_m", f"found {zero_sigma_m}, expected a number >= 0")
    if uncertainty_m is not None and uncertainty_m.shape != s_m.shape:
        raise InputError("uncertainty_m", f"found shape {uncertainty_m.shape}, expected {s_m.shape}")
    if own_noise_m is not None and own_noise_m.shape != s_m.shape:
        raise InputError("own_noise_m", f"found shape {own_noise_m.shape}, expected {s_m.shape}")
    if not (np.all(np.isfinite(end_cells_m)) and min(end_cells_m) >= 0):
        raise InputError("end_cells_m", f"found {end_cells_m}, expected two lengths >= 0")
    seen = point_valid & np.isfinite(delta_m) & np.isfinite(delta_sigma_m) & (delta_sigma_m >= 0)
    index = np.flatnonzero(seen)
    s = s_m[index].astype(np.float64)
    if len(index) < 2 or not np.all(np.diff(s) > 0):
        if len(index) < 2:
            return _nothing_seen(points)
        raise InputError("s_m", "positions must increase")
    delta, common = delta_m[index].astype(np.float64), delta_sigma_m[index].astype(np.float64)
    sigma = common if own_noise_m is None else np.hypot(common, np.nan_to_num(own_noise_m[index]))
    doubt = (
        np.zeros(len(index))
        if uncertainty_m is None
        else np.nan_to_num(uncertainty_m[index].astype(np.float64))
    )
    strain = delta / material.width_m
    factor, factor_sigma = np.ones(len(index)), np.zeros(len(index))
    unloading = np.zeros(points, dtype=bool)
    if memory is not None:
        full, full_sigma, noise = np.zeros(points), np.zeros(points), np.zeros(points)
        full[index], full_sigma[index] = strain, np.hypot(sigma, doubt) / material.width_m
        noise[index] = sigma / material.width_m
        unloading = memory.update(full, full_sigma, seen, material.hysteresis, noise_sigma=noise)
        if material.hysteresis is not None and memory.xi is not None:
            up = material.stress(strain)
            missing, missing_sigma = material.hysteresis.reduction(up, memory.xi[index])
            factor = 1.0 - missing / np.maximum(up, 1e-9)
            factor_sigma = missing_sigma / np.maximum(up, 1e-9)

    from ._profile_kernels import integrate_regions

    curve = material.loading
    # Beyond a point that was not seen nothing is known: the cell of a seen end point alone is filled.
    before = end_cells_m[0] if index[0] == 0 else 0.0
    after = end_cells_m[1] if index[-1] == points - 1 else 0.0
    count, p, p_sigma, table, sums, weight = integrate_regions(
        s, delta, sigma, doubt, index, factor, before, after, zero_sigma_m, material.width_m, material.height_m,
        material.tension.ratio, BOUNDARIES.index(boundary), SEED_PAIR_SIGMAS, SEED_SINGLE_SIGMAS,
        MAX_GAP_POINTS, curve.knots, curve.pieces, curve.basis_pieces,
        material.softening_table_Pa, material.softening_end,
    )  # fmt: skip
    table, sums = table[:count], sums[:count]
    spurious = np.array(
        [
            float(row[7]) < RELEASE_STRAIN
            and float(s[int(row[1])] - s[int(row[0])]) < NARROW_PER_WIDTH * material.width_m
            for row in table
        ],
        dtype=bool,
    )
    for row in table[spurious]:
        p[int(row[0]) : int(row[1]) + 1] = 0.0
    table, sums = table[~spurious], sums[~spurious]
    contacts = []
    slope = material.slope(strain) / material.width_m
    model_variance = image_variance = zero = 0.0
    for row, total in zip(table, sums, strict=True):
        first, last = int(row[0]), int(row[1])
        inside = slice(first, last + 1)
        force, relief = float(row[2]), float(row[5])
        enlarged = material.height_m * float(
            weight[inside] @ (factor[inside] * material.stress(strain[inside]))
        )
        model2 = (MODEL_FLOOR[boundary] * force) ** 2 + float(row[6]) + float(row[11])
        if boundary == "tension":
            model2 += (relief * material.tension.sigma) ** 2
        elif boundary == "enlarged":
            relief = _relief(s[inside], delta[inside], material)
            model2 += (relief * material.tension.ratio) ** 2
        # One law for all points: its error is common to them.
        uncertain = weight[inside] @ (factor_sigma[inside] * material.stress(strain[inside]))
        model2 += (material.height_m * float(uncertain)) ** 2
        calibration = float(np.sqrt(max(total @ material.covariance @ total, 0.0)))
        alone = material.height_m * weight[inside] * factor[inside] * slope[inside] * common[inside]
        image2 = float(row[3]) + shared_noise * _shared_variance(alone)
        budget = ErrorBudget(
            image_N=float(np.sqrt(image2)),
            calibration_N=calibration,
            model_N=float(np.sqrt(model2)),
            zero_N=abs(float(row[4])) * zero_sigma_m,
        )
        reason = Reason.OK
        if row[8] > 0:
            reason = Reason.OCCLUDED
        elif row[7] > material.densification_strain:
            reason = Reason.SATURATED
        elif material.hysteresis is None and unloading[index[inside]].any():
            reason = Reason.UNLOADING
        contacts.append(
            ContactRegion(
                int(index[first]), int(index[last]), float(s[first]), float(s[last]),
                float(s[int(row[9])]), float(s[int(row[10])]),
                force, enlarged, budget, float(row[7]), reason is Reason.OK, reason,
            )
        )  # fmt: skip
        image_variance += image2
        model_variance += model2
        zero += float(row[4])
    if not contacts:
        # Nothing stands out of the noise: the force is zero within the noise of the whole strip.
        each = material.height_m * np.gradient(s) * _slope_at_rest(material)
        image_variance = float(np.sum((each * sigma) ** 2)) + shared_noise * _shared_variance(each * common)
        model_variance = float(np.sum((each * doubt) ** 2))
        zero = float(each.sum())
    pressure, pressure_sigma = np.zeros(points), np.full(points, np.nan)
    pressure[index], pressure_sigma[index] = p, p_sigma
    saturated_points = np.zeros(points, dtype=bool)
    saturated_points[index] = strain > material.densification_strain
    trusted = seen & ~saturated_points
    if material.hysteresis is None:
        trusted &= ~unloading
    all_sums = sums.sum(axis=0)
    wrong = [contact.reason for contact in contacts if not contact.valid]
    return FoamReading(
        force_N=float(sum(contact.force_N for contact in contacts)),
        budget=ErrorBudget(
            image_N=float(np.sqrt(image_variance)),
            calibration_N=float(np.sqrt(max(all_sums @ material.covariance @ all_sums, 0.0))),
            model_N=float(np.sqrt(model_variance)),
            zero_N=abs(zero) * zero_sigma_m,
        ),
        pressure_Pa=pressure,
        pressure_sigma_Pa=pressure_sigma,
        point_valid=trusted,
        contacts=tuple(contacts),
        saturated=bool(saturated_points.any()),
        unloading=bool(unloading.any()),
        valid=not wrong,
        reason=wrong[0] if wrong else Reason.OK,
    )


def _slope_at_rest(material: FoamMaterial) -> float:
    """Pressure by deflection of foam that is hardly pressed [Pa/m]."""
    return float(material.slope(np.zeros(1))[0]) / material.width_m


def _shared_variance(alone_N: Float[np.ndarray, "k"]) -> float:
    """What neighbours add to the variance [N^2] for a correlation of one, from the noise of each alone.

    The tracker fits the levels on both sides of the edge over neighbouring points together;
    their error is common to these points.
    """
    window = np.ones(2 * SHARED_POINTS + 1)
    around = np.convolve(alone_N, window)[SHARED_POINTS:-SHARED_POINTS]
    return float(alone_N @ (around - alone_N))


def _relief(s: Float[np.ndarray, "k"], delta: Float[np.ndarray, "k"], material: FoamMaterial) -> float:
    """What unit kappa would take away [N]; the enlarged law declares it as its model error."""
    from .material.boundary import contour_force

    return contour_force(s, delta, material)[1] if len(s) > 1 else 0.0


def _nothing_seen(points: int) -> FoamReading:
    return FoamReading(
        force_N=0.0,
        budget=ErrorBudget(),
        pressure_Pa=np.zeros(points),
        pressure_sigma_Pa=np.full(points, np.nan),
        point_valid=np.zeros(points, dtype=bool),
        contacts=(),
        saturated=False,
        unloading=False,
        valid=False,
        reason=Reason.LOST,
    )
