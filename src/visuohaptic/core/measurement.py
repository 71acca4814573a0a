"""Sensor measurements: each has a time, a validity with its reason, and an uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float

#: Gravitational acceleration [m/s^2] and air pressure [Pa], used if not measured.
GRAVITY_M_S2, AIR_PA = 9.81, 101_325.0
#: Standard deviation of normal errors, per median absolute deviation.
SIGMA_PER_MAD = 1.4826


def normal_sigmas(probability: float) -> float:
    """Standard deviations that a normal error exceeds, in either direction, with a probability.

    Parameters
    ----------
    probability
        Two-sided probability, above 0 and below 1.

    Examples
    --------
    >>> round(normal_sigmas(0.05), 2)
    1.96
    """
    return NormalDist().inv_cdf(1.0 - 0.5 * probability)


class Reason(StrEnum):
    """Why a measurement is valid or invalid."""

    OK = "ok"
    OCCLUDED = "occluded"  #: something covers the sensor
    SATURATED = "saturated"  #: beyond the working range of the deformable element
    UNLOADING = "unloading"  #: on the unloading branch of the hysteresis
    LOST = "lost"  #: the contour, template or point could not be found
    STALE = "stale"  #: the frame is too old, out of order, or repeated
    NOT_ZEROED = "not_zeroed"  #: there is no zero reference yet
    DRIFTED = "drifted"  #: the zero reference is no longer valid
    MOVED = "moved"  #: the camera has moved relative to the sensor


class EventKind(StrEnum):
    """Events of a contact (Alt 2016, Sec. 3.5 and 4.1)."""

    CONTACT = "contact"
    MOTION = "motion"
    RELEASE = "release"
    FALL = "fall"
    SLIP = "slip"


@dataclass(frozen=True, slots=True)
class Event:
    """A timestamped event."""

    kind: EventKind
    t_s: float
    s_m: float = float("nan")  #: position along the sensor, NaN if it has none


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Independent standard deviations of a force [N], by cause."""

    image_N: float = 0.0  #: pixel noise, propagated through Eq. (3.9) and (3.10)
    calibration_N: float = 0.0  #: covariance of the fitted material curve
    model_N: float = 0.0  #: boundary and hysteresis model
    zero_N: float = 0.0  #: drift of the zero reference

    @classmethod
    def unknown(cls) -> ErrorBudget:
        """Budget of a force that was not measured: NaN."""
        return cls(*[float("nan")] * 4)

    @property
    def total_N(self) -> float:
        """Root of the sum of squares [N]."""
        return float(np.sqrt(self.image_N**2 + self.calibration_N**2 + self.model_N**2 + self.zero_N**2))


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """One contact region of a laminar sensor: an interval with positive deflection."""

    s_start_m: float  #: start of the region along the sensor
    s_end_m: float  #: end of the region along the sensor
    force_N: float  #: integral of the pressure over the region
    budget: ErrorBudget  #: standard deviations of the force by cause
    valid: bool
    reason: Reason
    points_foam_m: Float[np.ndarray, "k 2"]  #: front contour inside the region, frame F
    point_sigma_m: Float[np.ndarray, "k"]  #: standard deviation of each point along its deflection
    delta_m: Float[np.ndarray, "k"]  #: deflection of each point

    @property
    def force_sigma_N(self) -> float:
        """Standard deviation of the force [N]."""
        return self.budget.total_N

    @property
    def centre_m(self) -> float:
        """Centre of the region along the sensor, weighted by deflection [m]."""
        s = np.linspace(self.s_start_m, self.s_end_m, len(self.delta_m))
        total = float(self.delta_m.sum())
        return float(s @ self.delta_m / total) if total > 0 else 0.5 * (self.s_start_m + self.s_end_m)


@dataclass(frozen=True, slots=True, eq=False)
class ForceProfile:
    """Force and shape measured by a laminar sensor in one frame; K points along the strip.

    In an invalid frame, force, pressure and their standard deviations are NaN, including those of its contacts;
    the detected contour is kept for display. A valid frame without contact has a force of zero
    within the noise of the whole strip.

    Examples
    --------
    >>> nothing = np.zeros(3)
    >>> profile = ForceProfile(
    ...     0.1, True, Reason.OK, 2.0, ErrorBudget(0.03, 0.04, 0.0, 0.0), np.array([-0.01, 0.0, 0.01]),
    ...     nothing, nothing, nothing, nothing, np.ones(3, dtype=bool),
    ... )
    >>> f"{profile.force_N} N, sigma {profile.force_sigma_N:.2f} N"
    '2.0 N, sigma 0.05 N'
    >>> profile.unread().force_N  # as a frame that cannot be trusted
    nan
    """

    t_s: float  #: time of the frame
    valid: bool
    reason: Reason
    force_N: float  #: sum over all contacts
    budget: ErrorBudget  #: standard deviations of ``force_N`` by cause
    s_m: Float[np.ndarray, "K"]  #: position along the strip
    delta_m: Float[np.ndarray, "K"]  #: deflection towards the base, 0 = zero reference
    delta_sigma_m: Float[np.ndarray, "K"]
    pressure_Pa: Float[np.ndarray, "K"]
    pressure_sigma_Pa: Float[np.ndarray, "K"]
    point_valid: Bool[np.ndarray, "K"]
    contacts: tuple[Contact, ...] = ()
    evidence: str = ""  #: strongest evidence against reading the frame; empty if there is none

    def unread(self) -> ForceProfile:
        """The profile of an invalid frame: its contours, but neither force nor pressure."""
        unknown, budget = np.full(len(self.s_m), np.nan), ErrorBudget.unknown()
        contacts = tuple(
            replace(
                contact,
                force_N=float("nan"),
                budget=budget,
                valid=False,
                reason=self.reason if contact.valid else contact.reason,
            )
            for contact in self.contacts
        )
        return replace(
            self,
            force_N=float("nan"),
            budget=budget,
            pressure_Pa=unknown,
            pressure_sigma_Pa=unknown,
            contacts=contacts,
        )

    @property
    def max_contact(self) -> Contact | None:
        """The contact with the largest sum of deflections, whether or not its force is valid."""
        return max(self.contacts, key=lambda contact: float(contact.delta_m.sum()), default=None)

    @property
    def force_sigma_N(self) -> float:
        """Standard deviation of the force [N]."""
        return self.budget.total_N


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """Force and moment at a point.

    Examples
    --------
    >>> wrench = Wrench(0.1, True, Reason.OK, np.array([0.0, 2.0, 0.0]), np.zeros(3), 1e-4 * np.eye(6))
    >>> float(wrench.force_N[1]), float(wrench.covariance[1, 1] ** 0.5)
    (2.0, 0.01)
    """

    t_s: float
    valid: bool
    reason: Reason
    force_N: Float[np.ndarray, "3"]
    moment_Nm: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]  #: of (fx, fy, fz, mx, my, mz) [N, Nm]
    frame: str = "sensor"


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Planar motion between two frames: of the platform on the floor, or of an object."""

    t_s: float
    valid: bool
    reason: Reason
    translation_m: Float[np.ndarray, "2"]  #: (x, y) in the frame before the motion
    rotation_rad: float  #: about the floor's normal, counter-clockwise
    covariance: Float[np.ndarray, "3 3"]  #: of (x, y, rotation) [m, rad]
