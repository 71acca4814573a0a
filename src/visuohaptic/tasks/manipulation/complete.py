"""Complete an object by touch: plan the least certain place, probe it, refit, until the error bound is met (Alt 2016, Sec. 5.4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from ...core import FINITE, POSITIVE, Frame, Pose, Wrench, check_ranges
from ...core.robots import FrameSource, ProbeArm, require_members
from ...reconstruction.completion.touch import Touch
from ..framework import Ending, Machine, Rule, Trace, run_machine
from .hand import as_vector

if TYPE_CHECKING:
    from ...reconstruction.completion.surface_completion import Completion

Vector = tuple[float, float, float]
_NOWHERE = (math.nan, math.nan, math.nan)


class CompleteState(StrEnum):
    """What the probe is doing."""

    PLAN = "plan"
    UP = "up"  #: above all obstacles
    ACROSS = "across"
    DOWN = "down"  #: to the start of the line
    PROBE = "probe"  #: along the line until contact
    BACK = "back"


class CompleteOutcome(StrEnum):
    """How it ended."""

    COMPLETED = "completed"  #: the expected error is below the bound, or the touches suffice
    TOUCHES_USED = "touches_used"  #: maximum number of touches reached with the error above the bound
    BLOCKED = "blocked"  #: contact on the way to a line
    OUT_OF_REACH = "out_of_reach"
    SENSOR_FAILED = "sensor_failed"
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or the supervisor, raised an error
    SOURCE_ENDED = "source_ended"


@dataclass(frozen=True, slots=True)
class CompleteSettings:
    """Settings of the probing."""

    bound_m: float = 0.001  #: expected error at which the task is complete [m]
    touches: int = 20  #: maximum number of touches
    touch_N: float = 0.4  #: force of a contact on a line [N]
    blocked_N: float = 1.0  #: force of a collision on the way to a line [N]
    above_m: float = 0.05  #: height above the object on the way around it [m]
    top_m: float = 0.3  #: top of the object in the base frame [m]
    travel_m_s: float = 0.15
    probe_m_s: float = 0.03
    sigma_m: float = 0.0005  #: standard deviation of a contact: arm, tip and sensor [m]
    compliance_m_per_N: float = field(default=0.0, metadata=FINITE)  #: compliance of the tip [m/N]
    max_invalid_frames: int = 15

    def __post_init__(self) -> None:
        check_ranges(self, POSITIVE)


@dataclass(frozen=True, slots=True)
class ProbeObservation:
    """State of the arm, force, and present plan."""

    t_s: float
    tip_m: Vector  #: in the base frame
    felt: bool
    force_N: float  #: magnitude of the force on the tip
    start_m: Vector  #: start of the planned line in the base frame; NaN without a plan
    end_m: Vector
    touches: int  #: number of probed lines
    error_m: float  #: expected error of the missing part
    done: bool  #: whether the stop rule is met


@dataclass(frozen=True, slots=True)
class ProbeCommand:
    """One command."""

    move: bool = False
    tip_m: Vector = _NOWHERE
    speed_m_s: float = 0.0
    report: bool = False  #: whether a line has ended here
    contact: bool = False  #: whether it ended at a contact


@dataclass(frozen=True, slots=True, eq=False)
class CompletionByTouch:
    """Result; the completed surface is ``completion.completed()``."""

    ending: Ending
    touches: tuple[Touch, ...]  #: in the base frame
    error_m: float  #: expected error at the end [m]
    trace: Trace


class CompleteTask(Machine[CompleteState, ProbeObservation, ProbeCommand]):
    """Probe line after line: up, across, down, along the line, and back.

    Parameters
    ----------
    settings
        Stop rule, speeds and limits.
    """

    task = "complete"

    def __init__(self, settings: CompleteSettings | None = None) -> None:
        self.settings = settings or CompleteSettings()
        s = CompleteState
        self.rules = {
            s.PLAN: Rule((s.UP,), 10.0),
            s.UP: Rule((s.ACROSS,), 30.0),
            s.ACROSS: Rule((s.DOWN,), 30.0),
            s.DOWN: Rule((s.PROBE,), 30.0),
            s.PROBE: Rule((s.BACK,), 60.0),
            s.BACK: Rule((s.PLAN,), 30.0),
        }
        super().__init__(self.settings)

    def halt(self) -> ProbeCommand:
        """Command that stops the tip."""
        return ProbeCommand()

    def decide(self, seen: ProbeObservation) -> ProbeCommand:
        """Command of the probe after one frame."""
        s = self.settings
        if self.unread(seen.felt, CompleteOutcome.SENSOR_FAILED, s.max_invalid_frames) or not seen.felt:
            return self.halt()
        work = {
            CompleteState.PLAN: self._plan, CompleteState.PROBE: self._probe, CompleteState.BACK: self._back,
        }.get(self.state, self._travel)  # fmt: skip
        # Retreating from a contact, the tip may still be loaded for a moment.
        if work == self._travel and seen.force_N > s.blocked_N:
            return self.give_up(
                CompleteOutcome.BLOCKED, f"{seen.force_N:.1f} N during the motion, {self.state}"
            )
        return work(seen)

    def _plan(self, seen: ProbeObservation) -> ProbeCommand:
        s, why = self.settings, f"{1e3 * seen.error_m:.2f} mm expected after {seen.touches} touches"
        if seen.done:
            self.end(True, CompleteOutcome.COMPLETED, why)
        elif seen.touches >= s.touches:
            self.end(False, CompleteOutcome.TOUCHES_USED, f"{why}, requested {1e3 * s.bound_m:.2f} mm")
        elif math.isfinite(seen.start_m[0]):
            self.go(CompleteState.UP, f"line {seen.touches + 1} at {1e3 * seen.start_m[2]:.0f} mm")
            return self._travel(seen)
        return self.halt()

    def _travel(self, seen: ProbeObservation) -> ProbeCommand:
        s, (x, y, z) = self.settings, seen.start_m
        over = s.top_m + s.above_m
        goal, after = {
            CompleteState.UP: ((seen.tip_m[0], seen.tip_m[1], over), CompleteState.ACROSS),
            CompleteState.ACROSS: ((x, y, over), CompleteState.DOWN),
            CompleteState.DOWN: ((x, y, z), CompleteState.PROBE),
        }[self.state]
        if math.dist(seen.tip_m, goal) < 3e-4:
            self.go(after, "there")
            return self._probe(seen) if after is CompleteState.PROBE else self._travel(seen)
        return ProbeCommand(True, goal, s.travel_m_s)

    def _probe(self, seen: ProbeObservation) -> ProbeCommand:
        s = self.settings
        if seen.force_N >= s.touch_N:
            self.go(CompleteState.BACK, f"touched, {seen.force_N:.2f} N")
            return ProbeCommand(report=True, contact=True)
        if math.dist(seen.tip_m, seen.end_m) < 3e-4:
            self.go(CompleteState.BACK, "no contact on the line")
            return ProbeCommand(report=True)
        return ProbeCommand(True, seen.end_m, s.probe_m_s)

    def _back(self, seen: ProbeObservation) -> ProbeCommand:
        if math.dist(seen.tip_m, seen.start_m) < 3e-4:
            self.go(CompleteState.PLAN, "back")
            return self.halt()
        return ProbeCommand(True, seen.start_m, self.settings.travel_m_s)


class _Probing:
    """The present line, and the results of the previous ones.

    Parameters
    ----------
    completion
        Every touch is added to it.
    settings
        Limits.
    base
        Frame of the visible surface in the base of the arm.
    enough
        Whether the touches so far suffice, whatever the expected error.
    """

    def __init__(
        self,
        completion: Completion,
        settings: CompleteSettings,
        base: Pose,
        enough: Callable[[Sequence[Touch]], bool],
    ) -> None:
        self._completion, self._settings, self._base, self._enough = completion, settings, base, enough
        self.touches: list[Touch] = []
        self.start_m = self.end_m = np.full(3, math.nan)
        self._planned = False
        self._evaluate()

    def _evaluate(self) -> None:
        self.error_m = self._completion.expected_error_m()
        self.done = self._enough(self.touches) or self._completion.done(self._settings.bound_m)

    def plan(self) -> None:
        """Plan the next line, unless the task is complete."""
        if self._planned or self.done or len(self.touches) >= self._settings.touches:
            return
        line = self._completion.next_touch()
        self.start_m, self.end_m = self._base.apply(line.start_m), self._base.apply(line.end_m)
        self._planned = True

    def report(self, tip_m: np.ndarray, force_N: float, *, contact: bool) -> None:
        """Add the contact of a line, or a free line up to ``tip_m``."""
        start, end, sigma_m = self.start_m, self.end_m, self._settings.sigma_m
        if contact:
            along = (end - start) / np.linalg.norm(end - start)
            met = tip_m - self._settings.compliance_m_per_N * force_N * along
            touch = Touch(met, start, end, sigma_m)
        else:
            touch = Touch(None, start, tip_m, sigma_m)
        self.touches.append(touch)
        self._completion.add(touch)
        self._evaluate()
        self._planned = False


def complete_by_touch(
    arm: ProbeArm,
    source: FrameSource,
    feel: Callable[[Frame], Wrench],
    completion: Completion,
    settings: CompleteSettings | None = None,
    *,
    T_base_visual: Pose | None = None,
    enough: Callable[[Sequence[Touch]], bool] = lambda touches: False,
) -> CompletionByTouch:
    """Touch an object where its surface is least certain, until the stop rule is met.

    Parameters
    ----------
    arm
        Arm with the probe.
    source
        Frames of the camera that looks at the sensor.
    feel
        Computes the wrench on the probe; only the magnitude of the force is used.
    completion
        The visible surface and its missing region; every touch is added to it. Create it
        with the inverse of ``T_base_visual`` as ``T_visual_haptic``.
    settings
        Stop rule, speeds and limits.
    T_base_visual
        Pose of the frame of the visible surface in the base frame of the arm; identity by default.
    enough
        Whether the touches so far suffice, whatever the expected error: for an object that is recognised by them.

    Raises
    ------
    InputError
        ``arm`` or ``source`` lacks a member of its protocol.

    Examples
    --------
    A simulated arm probes a bottle whose middle was not seen:

    >>> from visuohaptic.core import Reason
    >>> from visuohaptic.reconstruction.completion import Completion
    >>> from visuohaptic.reproduce.worlds import virtual_completion
    >>> from visuohaptic.simulation.tabletop import ProbeCell, SimulatedArm, random_bottle
    >>> rng = np.random.default_rng(4)
    >>> bottle = random_bottle(rng, "elliptic")
    >>> place = Pose(np.eye(3), np.array([0.5, 0.1, 0.0]))  # of the bottle before the arm
    >>> completion = Completion(*virtual_completion.scene(bottle), T_visual_haptic=place.inverse())
    >>> before_m = completion.expected_error_m()
    >>> arm = SimulatedArm(Pose(np.eye(3), np.array([0.3, 0.0, 0.3])), rng=rng)
    >>> cell = ProbeCell(arm, bottle, rng, T_base_bottle=place, force_sigma_N=0.02)
    >>> def feel(frame):
    ...     return Wrench(frame.t_s, True, Reason.OK, cell.force(), np.zeros(3), 4e-4 * np.eye(6))
    >>> settings = CompleteSettings(bound_m=0.0005, touches=2, top_m=bottle.height_m)
    >>> done = complete_by_touch(arm, cell, feel, completion, settings, T_base_visual=place)
    >>> len(done.touches), done.error_m < before_m
    (2, True)
    """
    require_members(arm, ProbeArm, "complete_by_touch", "arm")
    require_members(source, FrameSource, "complete_by_touch", "frame source", members=("__iter__",))
    settings = settings or CompleteSettings()
    task = CompleteTask(settings)
    probing = _Probing(completion, settings, T_base_visual or Pose.identity(), enough)
    pose, force_N = Pose.identity(), math.nan

    def observations() -> Iterator[ProbeObservation]:
        nonlocal pose, force_N
        for frame in source:
            if task.state is CompleteState.PLAN:
                probing.plan()
            wrench, (_, pose) = feel(frame), arm.pose()
            force_N = float(np.linalg.norm(wrench.force_N))
            yield ProbeObservation(
                frame.t_s, as_vector(pose.translation_m), wrench.valid and math.isfinite(force_N), force_N,
                as_vector(probing.start_m), as_vector(probing.end_m),
                len(probing.touches), probing.error_m, probing.done,
            )  # fmt: skip

    def execute(command: ProbeCommand) -> None:
        if command.report:
            probing.report(pose.translation_m, force_N, contact=command.contact)
        if command.move:
            arm.move_linear(Pose(pose.rotation, np.array(command.tip_m)), command.speed_m_s)
        else:
            arm.stop()

    ending = run_machine(task, observations(), execute, arm.stop, refused=CompleteOutcome.OUT_OF_REACH)
    return CompletionByTouch(ending, tuple(probing.touches), probing.error_m, task.trace())
