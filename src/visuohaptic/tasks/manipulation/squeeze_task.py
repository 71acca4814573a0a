"""Squeeze an object at several places: force over deformation at each (Alt 2016, Sec. 3.6.4 and Fig. 3.13)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, InputError, check_ranges
from ..framework import Ending, Rule, Trace
from .hand import Hand, HandCommand, HandObservation, HandTask, Place, run_hand


class SqueezeState(StrEnum):
    """What the hand is doing."""

    OPEN = "open"
    REACH = "reach"
    CLOSE = "close"
    HOLD = "hold"  #: hold and read at one force level


class SqueezeOutcome(StrEnum):
    """How it ended."""

    SQUEEZED = "squeezed"  #: every place yielded a curve
    SOME_MISSED = "some_missed"  #: no contact at one or more places
    SENSOR_FAILED = "sensor_failed"


@dataclass(frozen=True, slots=True)
class SqueezeSettings:
    """Settings of a squeeze."""

    object_m: tuple[float, float, float] = (0.5, 0.0, 0.0)  #: centre of the object's bottom in the base frame
    forces_N: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)  #: force levels at which readings are taken
    deformation_m: float = field(default=0.008, metadata=POSITIVE)  #: maximum before the next place
    open_m: float = field(default=0.11, metadata=POSITIVE)
    finger_m_s: float = field(default=0.012, metadata=POSITIVE)
    arm_m_s: float = field(default=0.15, metadata=POSITIVE)
    hold_frames: int = field(default=6, metadata=POSITIVE)
    max_invalid_frames: int = 15

    def __post_init__(self) -> None:
        if not self.forces_N or min(self.forces_N) <= 0 or list(self.forces_N) != sorted(self.forces_N):
            raise InputError(
                "SqueezeSettings", f"found {self.forces_N}, expected rising forces > 0", field="forces_N"
            )
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeCurve:
    """Force over displacement of the surface, at one place."""

    place: Place
    force_N: Float[np.ndarray, "k"]
    deformation_m: Float[np.ndarray, "k"]  #: relative to the surface extrapolated to zero force
    sigma_m: Float[np.ndarray, "k"]
    surface_m: float  #: undeformed wall, from the centre between the fingers
    why: str = ""  #: why the curve is short or empty

    @property
    def stiffness_N_per_m(self) -> float:
        """Slope by least squares; NaN with fewer than two levels."""
        if len(self.force_N) < 2:
            return math.nan
        return float(np.polyfit(self.deformation_m, self.force_N, 1)[0])


@dataclass(frozen=True, slots=True, eq=False)
class Squeezing:
    """Result of a squeeze."""

    ending: Ending
    curves: tuple[SqueezeCurve, ...]
    trace: Trace


class SqueezeTask(HandTask[SqueezeState]):
    """Squeeze at one place after the other, at one force level after the other.

    Parameters
    ----------
    places
        Where to squeeze, in order.
    settings
        Forces, speeds and limits.

    Raises
    ------
    InputError
        There is no place.
    """

    task = "squeeze"

    def __init__(self, places: Sequence[Place], settings: SqueezeSettings | None = None) -> None:
        if not places:
            raise InputError("squeeze", "found no place, expected at least one")
        self.settings, self.places = settings or SqueezeSettings(), tuple(places)
        self.rules = {
            SqueezeState.OPEN: Rule((SqueezeState.REACH,), 20.0),
            SqueezeState.REACH: Rule((SqueezeState.CLOSE,), 30.0),
            SqueezeState.CLOSE: Rule((SqueezeState.HOLD, SqueezeState.OPEN), 60.0),
            SqueezeState.HOLD: Rule((SqueezeState.CLOSE, SqueezeState.OPEN), 20.0),
        }
        super().__init__(self.settings)
        self.curves: list[SqueezeCurve] = []
        self._level = 0
        self._readings: list[tuple[float, float]] = []
        self._points: list[tuple[float, float, float]] = []

    def decide(self, seen: HandObservation) -> HandCommand:
        """Command of arm and gripper after one frame."""
        s = self.settings
        if seen.saturated and self.state in (SqueezeState.CLOSE, SqueezeState.HOLD):
            return self._next("the end of the finger's range")
        if self.unread(seen.felt, SqueezeOutcome.SENSOR_FAILED, s.max_invalid_frames):
            return self.halt()
        if self.state is SqueezeState.OPEN:
            if seen.opening_m >= s.open_m - 1e-3:
                self.go(SqueezeState.REACH, f"to {1e3 * self._place.height_m:.0f} mm")
                return self._reach()
            return HandCommand(opening_m=s.open_m, finger_m_s=0.1)
        if self.state is SqueezeState.REACH:
            if self.reached(seen, self._reach()):
                self._level, self._points = 0, []
                self.go(SqueezeState.CLOSE, "there")
                return self._close()
            return self._reach()
        if not seen.felt:
            return self.halt()
        if self.state is SqueezeState.CLOSE:
            if seen.force_N >= s.forces_N[self._level]:
                self._readings = []
                self.go(SqueezeState.HOLD, f"{seen.force_N:.2f} N")
                return self.halt()
            if seen.opening_m <= 1e-4:
                return self._next("closed without reaching the force")
            return self._close()
        return self._hold(seen)

    def _hold(self, seen: HandObservation) -> HandCommand:
        s = self.settings
        if self.since_s(seen.t_s) < 0.1:
            return self.halt()
        self._readings.append((seen.force_N, seen.surface_m))
        if len(self._readings) < s.hold_frames:
            return self.halt()
        force, surface = np.array(self._readings).T
        surface = surface[np.isfinite(surface)]
        if len(surface):
            # Median: robust against a single outlier of the force.
            spread = float(np.std(surface)) / math.sqrt(len(surface))
            self._points.append((float(np.median(force)), float(np.mean(surface)), max(spread, 1e-5)))
            if abs(self._points[0][1] - self._points[-1][1]) >= s.deformation_m:
                return self._next("maximum deformation reached")
        self._level += 1
        if self._level >= len(s.forces_N):
            return self._next("")
        self.go(SqueezeState.CLOSE, f"level {self._level + 1}")
        return self._close()

    def _next(self, why: str) -> HandCommand:
        s = self.settings
        self.curves.append(_curve(self._place, self._points, why))
        if len(self.curves) == len(self.places):
            empty = [c for c in self.curves if len(c.force_N) == 0]
            if empty:
                why = f"{len(empty)} of {len(self.curves)} places had no contact"
                self.end(False, SqueezeOutcome.SOME_MISSED, why)
            else:
                self.end(True, SqueezeOutcome.SQUEEZED, f"{len(self.curves)} places")
            return self.halt()
        self.go(SqueezeState.OPEN, why or "all levels read")
        return HandCommand(opening_m=s.open_m, finger_m_s=0.1)

    @property
    def _place(self) -> Place:
        return self.places[len(self.curves)]

    def _reach(self) -> HandCommand:
        (x, y, z), place = self.settings.object_m, self._place
        return HandCommand(True, (x, y, z + place.height_m), place.angle_rad, self.settings.arm_m_s)

    def _close(self) -> HandCommand:
        return HandCommand(opening_m=0.0, finger_m_s=self.settings.finger_m_s)


def _curve(place: Place, points: list[tuple[float, float, float]], why: str) -> SqueezeCurve:
    """Deformation relative to the undeformed wall: the first part of the curve extrapolated to zero force."""
    if not points:
        return SqueezeCurve(place, np.zeros(0), np.zeros(0), np.zeros(0), math.nan, why)
    force, surface, sigma = np.array(points).T
    rest = float(surface[0])
    if len(force) > 1 and force[1] > force[0]:
        rest = float(surface[0] + force[0] * (surface[0] - surface[1]) / (force[1] - force[0]))
    return SqueezeCurve(place, force, rest - surface, sigma, rest, why)


def squeeze(hand: Hand, places: Sequence[Place], settings: SqueezeSettings | None = None) -> Squeezing:
    """Squeeze an upright object at some places; force and deformation are measured by the finger sensor alone.

    Parameters
    ----------
    hand
        Arm, gripper and sensor.
    places
        Where to squeeze, in order.
    settings
        Forces, speeds and limits.

    Returns
    -------
    Squeezing
        A curve for each place that was reached, in order.

    Examples
    --------
    >>> from visuohaptic.simulation.served import kitchen
    >>> cell = kitchen(stiffness_N_per_m=3000.0)  # an arm with a gripper, and a container of 3 N/mm
    >>> hand = Hand(cell["arm"], cell["gripper"], cell["camera"], cell["feel"])
    >>> (curve,) = squeeze(hand, [Place(0.1)]).curves
    >>> abs(curve.stiffness_N_per_m / 3000.0 - 1) < 0.06
    True
    """
    task = SqueezeTask(places, settings)
    return Squeezing(run_hand(hand, task), tuple(task.curves), task.trace())
