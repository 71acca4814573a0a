"""Pressures, contact regions and forces with their error budgets from one contour.

Symbols: K points along the strip, s position, delta deflection towards the base,
eps = delta / w strain. Equations (3.1), (3.9), (3.10) of the dissertation, with
the trapezoid rule on the actual spacing instead of a constant s_d. Where foam extends
beyond the first or the last point and that point is pressed, the rest of its
cell is included with its pressure (``end_cells_m``).

False alarms: a region needs one point above 5.5 sigma or two neighbours above
3.5 sigma. With Gaussian noise the false-alarm rate is less than 1e-5 per
frame of 85 points. A shallow dent that is narrower than the decay length of the foam (texture, dirt, a fold) is
physically impossible and does not count as a region either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import NON_NEGATIVE, ErrorBudget, InputError, Reason, check_ranges
from .material.boundary import BOUNDARIES, SHEARED_SIGMA, Boundary, contour_force
from .material.foam_material import FoamMaterial
from .material.hysteresis import RELEASE_STRAIN, HysteresisState

SEED_PAIR_SIGMAS, SEED_SINGLE_SIGMAS = 3.5, 5.5
#: Gaps of up to this many invalid points are interpolated linearly.
MAX_GAP_POINTS = 3
#: The deflection of free foam beside a body decays over a considerable fraction of its width: a region shorter than this
#: fraction of the width, including its ends, and shallower than the release strain is not a contact.
NARROW_PER_WIDTH = 0.5
#: Model error of a law without flanks, by the force; and relative standard deviation of the relief of the shear at a free end: with
#: it, the errors of 14 plates near an end are 1.0 standard deviations.
LOCAL_SIGMA, END_SIGMA = 0.10, 0.7
#: Fraction of the force that is negligible: of hidden foam, or of points that seem to be unloading.
NEGLIGIBLE_PART = 0.02
#: Columns of the kernel's table of regions.
_FIRST, _LAST, _FORCE, _IMAGE_VAR, _ZERO_SLOPE, _RELIEF, _SAMPLING_VAR, _MAX_STRAIN, _CUT = range(9)
_TOUCH_FIRST, _TOUCH_LAST, _UNCERTAINTY_VAR, _FREED, _SHARED, _ENLARGED, _TURNED, _SHEARED = range(9, 17)


@dataclass(frozen=True, slots=True)
class ContactRegion:
    """One contact: points ``first..last`` are deflected, ``touch_start_m..touch_end_m`` are pressed."""

    first: int  #: index of the first deflected point on the strip
    last: int  #: index of the last one, inclusive
    s_start_m: float
    s_end_m: float
    touch_start_m: float  #: start of the part that bears load according to the tension law
    touch_end_m: float
    force_N: float
    enlarged_force_N: float  #: force of the published law, for comparison
    budget: ErrorBudget
    max_strain: float
    valid: bool
    reason: Reason


@dataclass(frozen=True, slots=True, eq=False)
class FoamReading:
    """Force, pressure and contacts from one contour."""

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


@dataclass(frozen=True, slots=True, eq=False)
class FoamContour:
    """Deflection of the front contour in one frame, with its errors; K points along the strip.

    A point is used if it is valid and its values are finite; short gaps are interpolated, and a contact that ends
    at a long gap is not valid.

    Raises
    ------
    InputError
        Arrays of different lengths, positions that do not increase, negative errors.
    """

    s_m: Float[np.ndarray, "K"]  #: position along the strip, increasing
    delta_m: Float[np.ndarray, "K"]  #: deflection towards the base
    noise_m: Float[np.ndarray, "K"]  #: its standard deviation from frame to frame, which neighbours may share
    valid: Bool[np.ndarray, "K"]  #: False where the contour was not observed
    #: Additional noise of each deflection that neighbours do not share, e.g. of a fit at a kink.
    own_noise_m: Float[np.ndarray, "K"] | None = None
    #: Systematic error of each deflection, independent between points: the same in every frame, and therefore part of
    #: the model error of the budget.
    uncertainty_m: Float[np.ndarray, "K"] | None = None
    #: Part of it that neighbours share where it is not zero, e.g. of widths that were inferred at rest.
    unclean_m: Float[np.ndarray, "K"] | None = None
    #: Fully correlated error of all points, of equal or opposite signs, e.g. due to the camera's encoding.
    shared_m: Float[np.ndarray, "K"] | None = None
    zero_sigma_m: float = field(default=0.0, metadata=NON_NEGATIVE)  #: of the zero, common to all points
    #: Whether each deflection is the mean over the spacing of the points, as a tracker measures it, or the value at the point.
    averaged: bool = False
    #: Correlation of the noise of neighbouring points; ``tracking.SHARED_NOISE`` for contours of the tracker.
    shared_noise: float = field(default=0.0, metadata=NON_NEGATIVE)
    #: Points whose strain updates the hysteresis state, None: all; interpolated points do not.
    measured: Bool[np.ndarray, "K"] | None = None
    #: Length of foam before the first and after the last point, see
    #: :attr:`~visuohaptic.sensing.foam.strip.geometry.StripGeometry.end_cells_m`.
    end_cells_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=NON_NEGATIVE)
    seen: Bool[np.ndarray, "K"] = field(init=False)  #: points that are used

    def __post_init__(self) -> None:
        shape = self.s_m.shape
        if not (len(self.s_m) >= 2 and self.delta_m.shape == self.noise_m.shape == self.valid.shape == shape):
            raise InputError(
                "FoamContour",
                f"found shapes {shape}, {self.delta_m.shape}, {self.noise_m.shape}, {self.valid.shape}; "
                "expected four equal ones of two points or more",
            )
        for name in ("own_noise_m", "uncertainty_m", "unclean_m", "shared_m"):
            values = getattr(self, name)
            if values is not None and values.shape != shape:
                raise InputError("FoamContour", f"found shape {values.shape}, expected {shape}", field=name)
        seen = self.valid & np.isfinite(self.delta_m) & np.isfinite(self.noise_m) & (self.noise_m >= 0)
        object.__setattr__(self, "seen", seen)
        check_ranges(self)
        if not np.all(np.diff(self.s_m[seen]) > 0):
            raise InputError("FoamContour", "found positions that do not increase", field="s_m")


def read_profile(
    contour: FoamContour,
    material: FoamMaterial,
    *,
    boundary: Boundary = "tension",
    memory: HysteresisState | None = None,
) -> FoamReading:
    """Read pressures and forces from the deflection of the front contour, Eq. (3.1), (3.9) and (3.10).

    Parameters
    ----------
    contour
        Deflection of K points and its errors.
    material
        Calibrated foam.
    boundary
        Law at the ends of a contact, see :mod:`~visuohaptic.sensing.foam.material.boundary`.
    memory
        Strain history of the points; changed by the call. None: always loading.

    Returns
    -------
    FoamReading
        Not valid, with the reason ``lost``, if fewer than two points were observed.

    Raises
    ------
    InputError
        Unknown boundary law.
    """
    if boundary not in BOUNDARIES:
        raise InputError("boundary", f"found {boundary!r}, expected one of {', '.join(BOUNDARIES)}")
    points = len(contour.s_m)
    if contour.seen.sum() < 2:
        return _nothing_seen(points)
    seen = _integrated(contour, material, boundary, memory)
    each = range(len(seen.table))
    contacts = tuple(_contact(k, seen, contour, material, boundary) for k in each)
    budget = seen.at_rest
    if contacts:
        # Image and model errors of the contacts are independent, calibration and zero are common.
        total = seen.table.sum(axis=0)
        budget = ErrorBudget(
            image_N=math.hypot(*(contact.budget.image_N for contact in contacts)),
            calibration_N=material.force_sigma_N(
                seen.sums.sum(axis=0), -float(total[_RELIEF]), float(seen.lateral_N.sum())
            ),
            model_N=math.hypot(*(contact.budget.model_N for contact in contacts)),
            zero_N=math.hypot(total[_ZERO_SLOPE] * contour.zero_sigma_m, total[_SHARED]),
        )
    pressure, pressure_sigma = np.zeros(points), np.full(points, np.nan)
    pressure[seen.index], pressure_sigma[seen.index] = seen.pressure_Pa, seen.pressure_sigma_Pa
    saturated, unloading = np.zeros((2, points), dtype=bool)
    saturated[seen.index] = seen.delta / material.width_m > material.densification_strain
    unloading[seen.index] = seen.unloading
    trusted = contour.seen & ~saturated
    if material.hysteresis is None:
        trusted &= ~unloading
    wrong = [contact.reason for contact in contacts if not contact.valid]
    return FoamReading(
        force_N=float(sum(contact.force_N for contact in contacts)),
        budget=budget,
        pressure_Pa=pressure,
        pressure_sigma_Pa=pressure_sigma,
        point_valid=trusted,
        contacts=contacts,
        saturated=bool(saturated.any()),
        unloading=bool(unloading.any()),
        valid=not wrong,
        reason=wrong[0] if wrong else Reason.OK,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Integrals:
    """The n observed points of a contour, and integrals over its R regions."""

    index: Int[np.ndarray, "n"]  #: index on the strip
    s: Float[np.ndarray, "n"]
    delta: Float[np.ndarray, "n"]
    unloading: Bool[np.ndarray, "n"]
    pressure_Pa: Float[np.ndarray, "n"]
    pressure_sigma_Pa: Float[np.ndarray, "n"]
    table: Float[np.ndarray, "R 17"]  #: columns ``_FIRST`` to ``_SHEARED``
    sums: Float[np.ndarray, "R p"]  #: derivative of the force by the parameters of the loading curve
    lateral_N: Float[np.ndarray, "R"]  #: derivative of the force by the lateral expansion
    at_rest: ErrorBudget  #: without contacts: the force is zero within the noise of the whole strip


def _observed(contour: FoamContour) -> tuple[np.ndarray, ...]:
    """Index, position, deflection and errors of the n observed points, and lengths and positions of the free ends.

    Errors of each deflection [m], (5, n): all noise, systematic error, error common to all points, noise that neighbours may
    share, and the part of the systematic error that neighbours share where it is not zero.
    """
    index = np.flatnonzero(contour.seen)
    s, delta = contour.s_m[index].astype(np.float64), contour.delta_m[index].astype(np.float64)
    errors = np.zeros((5, len(index)))
    given = contour.own_noise_m, contour.uncertainty_m, contour.shared_m, contour.noise_m, contour.unclean_m
    for row, error in zip(errors, given, strict=True):
        if error is not None:
            row[:] = np.where(np.isfinite(error[index]), error[index], 0.0)
    errors[0] = np.hypot(errors[0], errors[3])
    errors[3] *= math.sqrt(contour.shared_noise)
    # Only the cell of an observed end point is extended to the end of the strip.
    seen_ends = index[0] == 0, index[-1] == len(contour.s_m) - 1
    cells_m = np.array(contour.end_cells_m)
    free_m = contour.s_m[[0, -1]] + np.where(cells_m > 0.0, cells_m, np.inf) * [-1.0, 1.0]
    ends_m = np.stack([np.where(seen_ends, cells_m, 0.0), free_m])
    return index, s, delta, errors, ends_m


def _integrated(
    contour: FoamContour, material: FoamMaterial, boundary: Boundary, memory: HysteresisState | None
) -> _Integrals:
    """Hysteresis of the observed points, and contact regions without physically impossible ones."""
    from ._profile_kernels import integrate_regions, shared_variance

    index, s, delta, errors, ends_m = _observed(contour)
    # Ratio of stress to loading stress (hysteresis), its standard deviation, and 1 where a point is unloading.
    history = np.zeros((3, len(index)))
    history[0] = 1.0
    if memory is not None:
        strain, full = delta / material.width_m, np.zeros((3, len(contour.s_m)))
        full[:, index] = (
            strain,
            np.hypot(errors[0], errors[1]) / material.width_m,
            errors[0] / material.width_m,
        )
        moved = contour.seen if contour.measured is None else contour.seen & contour.measured
        history[2] = memory.update(full[0], full[1], moved, material.hysteresis, noise_sigma=full[2])[index]
        if material.hysteresis is not None and memory.xi is not None:
            up = material.stress(strain)
            missing, missing_sigma = material.hysteresis.reduction(up, memory.xi[index])
            history[0] = 1.0 - missing / np.maximum(up, 1e-9)
            history[1] = missing_sigma / np.maximum(up, 1e-9)
    curve = material.narrow
    count, pressure, pressure_sigma, table, sums = integrate_regions(
        s, delta, errors, index, history, ends_m, contour.zero_sigma_m,
        material.width_m, material.height_m, material.tension.ratio,
        BOUNDARIES.index(boundary), SEED_PAIR_SIGMAS, SEED_SINGLE_SIGMAS, MAX_GAP_POINTS,
        contour.averaged, curve.knots, curve.pieces, curve.basis_pieces, material.softening_table_Pa,
        material.softening_end,
    )  # fmt: skip
    table, sums = table[:count], sums[:count]
    table[:, _RELIEF] *= boundary == "tension"  # no other law subtracts it
    first, last = table[:, _FIRST].astype(np.int64), table[:, _LAST].astype(np.int64)
    lateral_N = _widened(table, sums, pressure, material)
    narrow = s[last] - s[first] < NARROW_PER_WIDTH * material.width_m
    spurious = (table[:, _MAX_STRAIN] < RELEASE_STRAIN) & narrow
    for k in np.flatnonzero(spurious):
        pressure[first[k] : last[k] + 1] = 0.0
    at_rest = ErrorBudget()
    if spurious.all():
        each = material.height_m * np.gradient(s) * float(material.slope(np.zeros(1))[0]) / material.width_m
        common = shared_variance(each, errors[3], 0, len(each) - 1)
        at_rest = ErrorBudget(
            image_N=math.sqrt(np.sum((each * errors[0]) ** 2) + common),
            model_N=float(np.linalg.norm(each * errors[1])),
            zero_N=math.hypot(each.sum() * contour.zero_sigma_m, each @ errors[2]),
        )
    return _Integrals(
        index,
        s,
        delta,
        history[2] > 0.0,
        pressure,
        pressure_sigma,
        table[~spurious],
        sums[~spurious],
        lateral_N[~spurious],
        at_rest,
    )


def _widened(
    table: Float[np.ndarray, "R 17"],
    sums: Float[np.ndarray, "R p"],
    pressure_Pa: Float[np.ndarray, "n"],
    material: FoamMaterial,
) -> Float[np.ndarray, "R"]:
    """Give forces and pressures, which the kernel has for narrow bodies, the lateral expansion that each breadth permits.

    Returns the derivative of each force by that expansion.
    """
    narrow_N, lateral_N = material.expansion_N(sums, table[:, _MAX_STRAIN])
    held_N = material.tension.lateral * (lateral_N - narrow_N)
    for k in np.flatnonzero(table[:, _FORCE] > 0.0):
        points = slice(int(table[k, _FIRST]), int(table[k, _LAST]) + 1)
        pressure_Pa[points] *= 1.0 + held_N[k] / table[k, _FORCE]
    table[:, [_FORCE, _ENLARGED]] += held_N[:, None]
    return lateral_N


def _contact(
    k: int,
    seen: _Integrals,
    contour: FoamContour,
    material: FoamMaterial,
    boundary: Boundary,
) -> ContactRegion:
    """One region with its budget, and the first reason why it is not valid."""
    row = seen.table[k]
    first, last = int(row[_FIRST]), int(row[_LAST])
    force = float(row[_FORCE])
    own = LOCAL_SIGMA * force if boundary == "local" else SHEARED_SIGMA * float(row[_SHEARED])
    model2 = own**2 + float(row[_SAMPLING_VAR]) + float(row[_UNCERTAINTY_VAR])
    if boundary == "tension":
        model2 += (END_SIGMA * material.tension.ratio * float(row[_FREED])) ** 2
    elif boundary == "enlarged":
        # The relief at the ratio kappa, which the published law neglects, is its model error.
        inside = slice(first, last + 1)
        relief = contour_force(seen.s[inside], seen.delta[inside], material)[1] if last > first else 0.0
        model2 += (relief * material.tension.ratio) ** 2
    budget = ErrorBudget(
        image_N=float(np.sqrt(row[_IMAGE_VAR])),
        calibration_N=material.force_sigma_N(seen.sums[k], -float(row[_RELIEF]), float(seen.lateral_N[k])),
        model_N=float(np.sqrt(model2)),
        zero_N=math.hypot(row[_ZERO_SLOPE] * contour.zero_sigma_m, row[_SHARED]),
    )
    reason = Reason.OK
    if row[_CUT] > 0:
        reason = Reason.OCCLUDED
    elif row[_MAX_STRAIN] > material.densification_strain:
        reason = Reason.SATURATED
    elif material.hysteresis is None and row[_TURNED] > NEGLIGIBLE_PART * abs(force):
        reason = Reason.UNLOADING
    return ContactRegion(
        int(seen.index[first]), int(seen.index[last]), float(seen.s[first]), float(seen.s[last]),
        float(seen.s[int(row[_TOUCH_FIRST])]), float(seen.s[int(row[_TOUCH_LAST])]),
        force, float(row[_ENLARGED]), budget, float(row[_MAX_STRAIN]),
        reason is Reason.OK, reason,
    )  # fmt: skip


def _nothing_seen(points: int) -> FoamReading:
    pressure, none = np.zeros(points), np.zeros(points, dtype=bool)
    return FoamReading(
        0.0, ErrorBudget(), pressure, np.full(points, np.nan), none, (), False, False, False, Reason.LOST
    )
