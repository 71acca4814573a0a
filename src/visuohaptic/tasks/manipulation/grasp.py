"""Execute a planned grasp, lift the object, and verify that it was lifted (Alt 2016, Sec. 6.4.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from ...core.measurement import GRAVITY_M_S2, normal_sigmas
from ...core.ranges import POSITIVE, Ranged
from ..framework import Ending, Rule, Trace
from .hand import Hand, HandCommand, HandObservation, HandTask, Place, run_hand

#: Fraction of its force by which a grasp may exceed it, apart from the noise of the reading that ends it.
EXCESS = 0.1
#: Standard deviations of a reading that are exceeded with a probability of one in a hundred.
NOISE = normal_sigmas(0.02)


class GraspState(StrEnum):
    """What the hand is doing."""

    OPEN = "open"
    REACH = "reach"
    CLOSE = "close"
    LIFT = "lift"
    CHECK = "check"
    LOWER = "lower"  #: back to the table, still held
    PUT_DOWN = "put_down"  #: down again, before the next grasp


class GraspOutcome(StrEnum):
    """How it ended."""

    LIFTED = "lifted"
    NOTHING_THERE = "nothing_there"  #: closed without contact
    TIMED_OUT = "timed_out"  #: the fingers did not reach the force
    TOO_SOFT = "too_soft"  #: maximum deformation reached before the force
    LOST = "lost"  #: the force vanished during the lift
    SENSOR_FAILED = "sensor_failed"


@dataclass(frozen=True, slots=True)
class LiftPlan(Ranged):
    """Place and force of a grasp, and height of the lift."""

    place: Place
    force_N: float = field(metadata=POSITIVE)
    deformation_m: float = field(default=0.01, metadata=POSITIVE)  #: maximum deformation of the object
    object_m: tuple[float, float, float] = (0.5, 0.0, 0.0)  #: centre of its bottom in the base frame
    lift_m: float = field(default=0.1, metadata=POSITIVE)
    open_m: float = field(default=0.11, metadata=POSITIVE)  #: opening at which the object is not touched
    finger_m_s: float = field(default=0.015, metadata=POSITIVE)
    #: upper bound of the stiffness of the foam of one finger before a rigid flat wall [N/m]
    finger_N_per_m: float = field(default=3e4, metadata=POSITIVE)
    arm_m_s: float = field(default=0.12, metadata=POSITIVE)
    hold_s: float = 0.5
    put_back: bool = False  #: whether to put it back, as after weighing
    max_invalid_frames: int = 15


@dataclass(frozen=True, slots=True, eq=False)
class GraspAndLift:
    """Result of a grasp."""

    ending: Ending
    trace: Trace
    force_N: float  #: at the end, or at the failure
    deformation_m: float  #: of one side at the grasp; NaN without contact
    load_N: float = math.nan  #: measured weight; NaN if not lifted or without a load sensor
    load_sigma_N: float = math.nan

    @property
    def mass_kg(self) -> tuple[float, float] | None:
        """Lifted mass and its standard deviation [kg]; ``None``: unknown."""
        if not (self.ending.success and math.isfinite(self.load_N)):
            return None
        return self.load_N / GRAVITY_M_S2, self.load_sigma_N / GRAVITY_M_S2


class GraspAndLiftTask(HandTask[GraspState]):
    """Open, reach, close up to the force, lift, verify.

    Parameters
    ----------
    plan
        Place and force.
    *others
        Grasps to try in order after a failure.
    """

    task = "grasp"

    def __init__(self, plan: LiftPlan, *others: LiftPlan) -> None:
        self.plan, self._others = plan, list(others)
        s, count = GraspState, len(others)
        self.rules = {
            s.OPEN: Rule((s.REACH,), 20.0),
            s.REACH: Rule((s.CLOSE,), 30.0),
            s.CLOSE: Rule((s.LIFT, s.OPEN), otherwise=s.OPEN, attempts=count),
            s.LIFT: Rule((s.CHECK, s.PUT_DOWN), 30.0, s.PUT_DOWN, count),
            s.CHECK: Rule((s.LOWER, s.PUT_DOWN), 10.0, s.PUT_DOWN, count),
            s.LOWER: Rule((), 30.0),
            s.PUT_DOWN: Rule((s.OPEN,), 30.0),
        }
        super().__init__({"plan": plan, "others": others} if others else plan)
        self.force_N, self.deformation_m = 0.0, math.nan
        self._first_m = math.nan
        self._weak = self._frames = 0
        self._closing: list[tuple[float, float]] = []  #: opening [m] and force [N]
        self._idle_N: list[float] = []  #: force before a contact [N]
        #: readings since one reached the force and the fingers stopped [N]
        self._stopped_N: list[float] | None = None
        self._unloaded_N: list[float] = []  #: load on the table [N]
        self._loaded_N: list[float] = []

    def decide(self, seen: HandObservation) -> HandCommand:
        """Command of arm and gripper after one frame."""
        p = self.plan
        if self.unread(seen.felt, GraspOutcome.SENSOR_FAILED, p.max_invalid_frames):
            return self.halt()
        grasp, top = self._at(0.0), self._at(p.lift_m)
        if self.state is GraspState.OPEN:
            if seen.opening_m < p.open_m - 1e-3:
                return HandCommand(opening_m=p.open_m, finger_m_s=0.1)
            self.go(GraspState.REACH, "open")
            return grasp
        if self.state in (GraspState.REACH, GraspState.PUT_DOWN):
            if self.reached(seen, grasp):
                down = self.state is GraspState.PUT_DOWN
                self.go(*(GraspState.OPEN, "down") if down else (GraspState.CLOSE, "there"))
            return grasp
        if not seen.felt:
            return self.halt()
        self.force_N = seen.force_N
        if self.state is GraspState.CLOSE:
            return self._close(seen)
        # A low force for several frames: the object has slipped out.
        self._weak = self._weak + 1 if seen.force_N < 0.4 * p.force_N else 0
        if self._weak >= 3:
            return self._fail(GraspOutcome.LOST, f"{seen.force_N:.2f} N remain of {p.force_N:.2f} N")
        if self.state is GraspState.LIFT:
            if self.reached(seen, top):
                self.go(GraspState.CHECK, "up")
            return top
        if self.state is GraspState.LOWER:
            if self.reached(seen, grasp):
                self.end(True, GraspOutcome.LIFTED, "weighed and put back")
            return grasp
        self._loaded_N.append(seen.load_N)
        if self.since_s(seen.t_s) >= p.hold_s and p.put_back:
            self.go(GraspState.LOWER, "weighed")
        elif self.since_s(seen.t_s) >= p.hold_s:
            self.end(True, GraspOutcome.LIFTED, f"{seen.force_N:.2f} N held {1e2 * p.lift_m:.0f} cm up")
        return top

    def _at(self, above_m: float) -> HandCommand:
        """Command to the place of the grasp, or above it."""
        p, (x, y, z) = self.plan, self.plan.object_m
        return HandCommand(True, (x, y, z + p.place.height_m + above_m), p.place.angle_rad, p.arm_m_s)

    def _close(self, seen: HandObservation) -> HandCommand:
        p = self.plan
        self._unloaded_N.append(seen.load_N)
        # A contact that is lost although the fingers have closed further was a false one.
        touched_m = seen.surface_m if math.isnan(self._first_m) else self._first_m
        self._first_m = touched_m if math.isfinite(seen.surface_m) else math.nan
        self.deformation_m = self._first_m - seen.surface_m
        if self.deformation_m > p.deformation_m:
            why = f"deforms by {1e3 * self.deformation_m:.1f} mm at {seen.force_N:.2f} N"
            return self._fail(GraspOutcome.TOO_SOFT, why)
        if self._stopped_N is not None or seen.force_N >= p.force_N:
            reached_N = self._confirmed_N(seen.force_N)
            if math.isnan(reached_N):
                return self.halt()
            if reached_N >= (1.0 - 0.5 * EXCESS) * p.force_N:
                self.go(GraspState.LIFT, f"{reached_N:.2f} N")
                return self.halt()
            seen = replace(seen, force_N=reached_N)
        if (late := self._late(seen.t_s)) is not None:
            return self._fail(GraspOutcome.TIMED_OUT, late)
        if seen.opening_m <= 1e-4:
            return self._fail(GraspOutcome.NOTHING_THERE, "closed without reaching the force")
        return HandCommand(opening_m=self._next_opening_m(seen), finger_m_s=p.finger_m_s)

    def _late(self, t_s: float) -> str | None:
        """Why the fingers should have reached the force long ago: twice the frames and the time of the whole way.

        Twice, since a gripper that moves one frame after its command needs two frames for each step.
        """
        p, self._frames = self.plan, self._frames + 1
        steps = p.open_m / self._blind_m + 2.0 / EXCESS * (1.0 + self._noise**2)
        late = self._frames > 2.0 * steps and self.since_s(t_s) > 2.0 * p.open_m / p.finger_m_s
        return f"still closing after {self._frames} frames, where {steps:.0f} were expected" if late else None

    @property
    def _blind_m(self) -> float:
        """Way of one frame by which the foam of both fingers presses with less than the force before a rigid wall [m]."""
        return (1.0 - EXCESS) * self.plan.force_N / (0.5 * self.plan.finger_N_per_m)

    @property
    def _noise(self) -> float:
        """Standard deviation of a reading before the contact, by half of the excess."""
        return float(np.std(self._idle_N)) / (0.5 * EXCESS * self.plan.force_N) if self._idle_N else 0.0

    def _confirmed_N(self, felt_N: float) -> float:
        """Force at which the fingers stopped [N]; NaN while more readings of it are needed.

        The reading that reaches the force first is one of many, chosen for its noise: those after it are averaged until
        their standard error is half of the excess. Where one reading is as good as that, it decides.
        """
        if self._noise <= 1.0:
            return felt_N
        if self._stopped_N is None:
            self._stopped_N = []
            return math.nan
        self._stopped_N.append(felt_N)
        if len(self._stopped_N) < self._noise**2:
            return math.nan
        mean_N, self._stopped_N = float(np.mean(self._stopped_N)), None
        return mean_N

    def _next_opening_m(self, seen: HandObservation) -> float:
        """Opening up to which to close until the next frame.

        A contact is felt at its next frame only: before a rigid wall, the foam of both fingers then presses with less than
        the force. Afterwards, one half of the way to the force by its rise so far, since walls and foam stiffen, and at
        least the rise of half the excess. The rise since the last frame without contact would be too small, as the contact
        began somewhere between: after the first frame with a contact it is that of the foam before a rigid wall. By the
        noise of the readings before the contact, force and rise are larger with a probability of one in a hundred. The rise
        is that of the newest frames which exceeds this noise, or since the first contact.
        """
        p, felt_N = self.plan, seen.force_N
        foam_m = seen.surface_m - 0.5 * seen.opening_m
        if math.isfinite(foam_m):
            self._closing.append((seen.opening_m, felt_N))
        elif not self._closing:
            self._idle_N.append(felt_N)
        noise_N = NOISE * float(np.std(self._idle_N)) if self._idle_N else 0.0
        start_m, spread_N = seen.opening_m, math.sqrt(2.0) * noise_N
        rise_N = 0.5 * max(p.force_N - felt_N - noise_N, EXCESS * p.force_N)
        min_rise_N = max(EXCESS * p.force_N, spread_N)
        wider = [one for one in self._closing if one[0] > start_m]
        if wider:
            weaker = (one for one in reversed(wider) if one[1] <= felt_N - min_rise_N)
            opening_m, force_N = next(weaker, wider[0])
            N_per_m = (max(felt_N - force_N, EXCESS * p.force_N) + spread_N) / (opening_m - start_m)
        elif foam_m > 0.0 and felt_N > EXCESS * p.force_N:
            N_per_m = (felt_N + noise_N) / (2.0 * foam_m)
        else:
            return max(0.0, min(start_m, p.open_m) - self._blind_m)
        return max(0.0, start_m - rise_N / N_per_m)

    def weighs(self, t_s: float) -> bool:
        """Read the load while the object is lifted, and before for as long with nothing between the fingers.

        Parameters
        ----------
        t_s
            Time of the observation [s].
        """
        tares = self.state is GraspState.CLOSE and self.since_s(t_s) <= self.plan.hold_s
        return tares or self.state is GraspState.CHECK

    def load_N(self) -> tuple[float, float]:
        """Difference of the load while lifted and before, and its standard deviation [N]; NaN if not measured."""
        felt = [np.array([v for v in one if math.isfinite(v)]) for one in (self._unloaded_N, self._loaded_N)]
        if min(len(one) for one in felt) < 2:
            return math.nan, math.nan
        variance = sum(float(np.var(one, ddof=1)) / len(one) for one in felt)
        return float(felt[1].mean() - felt[0].mean()), math.sqrt(variance)

    def _fail(self, outcome: GraspOutcome, why: str) -> HandCommand:
        if self._others:
            self.fail(outcome, why)
        else:
            self.end(False, outcome, why)
        return self.halt()

    def go(self, state: GraspState, why: str) -> None:
        """Change the state; a return to the first state starts the next grasp."""
        super().go(state, why)
        if state is GraspState.OPEN and self._others:
            self.plan = self._others.pop(0)
            self._weak, self._frames, self._closing = 0, 0, []
            self._first_m = self.deformation_m = math.nan
            self._idle_N, self._unloaded_N, self._loaded_N, self._stopped_N = [], [], [], None


def grasp_and_lift(hand: Hand, plan: LiftPlan, *others: LiftPlan) -> GraspAndLift:
    """Execute a planned grasp, or alternatives if it fails.

    Parameters
    ----------
    hand
        Arm, gripper and sensors.
    plan
        Place and force.
    *others
        Grasps to try in order after a failure.

    Examples
    --------
    >>> from visuohaptic.simulation.served import kitchen
    >>> cell = kitchen(stiffness_N_per_m=3000.0)  # an arm with a gripper, and a container of 3 N/mm
    >>> hand = Hand(cell["arm"], cell["gripper"], cell["camera"], cell["feel"])
    >>> done = grasp_and_lift(hand, LiftPlan(Place(0.1), force_N=6.0))
    >>> str(done.ending.outcome)
    'lifted'
    """
    task = GraspAndLiftTask(plan, *others)
    ending = run_hand(hand, task)
    load_N, noise_N = task.load_N()
    sigma_N = math.hypot(noise_N, hand.weigh_sigma_N, hand.weigh_scale * load_N)
    return GraspAndLift(ending, task.trace(), task.force_N, task.deformation_m, load_N, sigma_N)
