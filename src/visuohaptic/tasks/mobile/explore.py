"""Drive at an obstacle, touch it, push it a bit, and say what it is like (Alt 2016, Sec. 3.6.2 and 4.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...core.camera.frame import Frame
from ...core.errors import InputError
from ...core.measurement import Event, EventKind, ForceProfile, Reason
from ...core.objects import HapticTag, PrimitiveKind
from ...core.robots import BaseState, ClockWatch, FrameSource, MobileBase, require_members
from ...sensing.foam.sensor import FoamSensor
from ...sensing.push.events import ContactEvents
from ...sensing.push.primitives import PrimitiveFit, fit_contact
from ...sensing.push.push_record import StopLimits, StopReason, record_push, stop_reason
from ...sensing.push.tag import tag_from_push
from ._look_ahead import LookAhead
from .force_guard import ForceGuard, GuardState

if TYPE_CHECKING:
    from ...sensing.scene.scene_tracker import SceneReading, SceneTracker

__all__ = ["Exploration", "ExploreSettings", "ExploreStep", "Outcome", "explore_obstacle"]


class Outcome(StrEnum):
    """How an exploration ended."""

    TAGGED = "tagged"  #: touched, pushed and tagged
    NOTHING_FOUND = "nothing_found"  #: no contact on the way
    SENSOR_FAILED = "sensor_failed"  #: too many frames in a row could not be trusted
    TIMED_OUT = "timed_out"
    CLOCK_STOPPED = "clock_stopped"  #: the platform's clock stands still
    SOURCE_ENDED = "source_ended"  #: the camera delivered no more frames


class _Phase(StrEnum):
    APPROACH = "approach"
    PUSH = "push"
    HALT = "halt"
    BACK_OFF = "back_off"


@dataclass(frozen=True, slots=True)
class ExploreSettings:
    """How to explore."""

    approach_m_s: float = 0.05  #: where something may be touched at any time
    #: where the floor ahead is seen to be free, only with scene tracking; what looks like the floor is not
    #: seen: faster than this the foam could not take up such a touch
    cruise_m_s: float = 0.06
    brake_m_s2: float = 0.3  #: how hard the platform may brake before what it sees
    near_m: float = 0.02  #: gap from foam to obstacle at which it is down to ``approach_m_s``
    free_ahead_m: float = 0.0  #: floor before the foam that is known to be free at the begin
    push_m_s: float = 0.03
    back_off_m_s: float = 0.08
    search_m: float = 0.5  #: how far to drive without a contact
    push_m: float = 0.06  #: an object that has moved by this much is movable; text: the sensor's width
    max_force_N: float = 20.0  #: what the platform can push
    strain_fraction: float = 0.9  #: share of the densification strain at which to stop
    halt_s: float = 0.7  #: how long to stand still: primitives and deceleration are read here
    back_off_m: float = 0.05
    blind_frames: int = 15  #: so many frames in a row without a usable contour end the push
    timeout_s: float = 60.0

    def __post_init__(self) -> None:
        for name in (
            "approach_m_s",
            "cruise_m_s",
            "brake_m_s2",
            "push_m_s",
            "back_off_m_s",
            "search_m",
            "push_m",
            "max_force_N",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError("ExploreSettings", f"found {value}, expected more than 0", field=name)


@dataclass(frozen=True, slots=True, eq=False)
class ExploreStep:
    """One frame of an exploration, for displays and logs."""

    frame: Frame
    profile: ForceProfile
    state: BaseState
    phase: str
    travel_m: float  #: since the begin
    events: tuple[Event, ...]
    scene: SceneReading | None = None  #: what else the frame shows


@dataclass(frozen=True, slots=True, eq=False)
class Exploration:
    """What came out of it.

    ``tag.primitive`` and ``fit`` are in frame F of the sensor where the platform
    stood at ``fit_state``; ``tag.contact_offset_m`` is along y of F, to the left of
    the fitted shape's centre. Lines and corners have no centre and no offset.
    """

    outcome: Outcome
    tag: HapticTag
    fit: PrimitiveFit | None  #: shape of the contact, fitted while the platform stood still
    stopped_by: StopReason | None
    events: tuple[Event, ...]
    profiles: tuple[ForceProfile, ...]
    states: tuple[BaseState, ...]
    travel_m: Float[np.ndarray, "N"]  #: along the direction in which the exploration began
    fit_state: BaseState | None = None  #: where the platform stood when the shape was fitted
    touched: bool = field(default=False)
    #: how far from the foam the obstacle was when it was first seen; NaN: unseen
    seen_ahead_m: float = math.nan
    expected_m: float = math.nan  #: travel at which the scene expected the touch, as it was last seen before
    #: turn of the object in the world since the touch, by its texture; NaN where it was not seen [rad]
    object_angle_rad: Float[np.ndarray, "N"] = field(default_factory=lambda: np.zeros(0))


def explore_obstacle(
    base: MobileBase,
    source: FrameSource,
    sensor: FoamSensor,
    settings: ExploreSettings | None = None,
    *,
    scene: SceneTracker | None = None,
    on_step: Callable[[ExploreStep], None] | None = None,
) -> Exploration:
    """Drive straight on until something is touched, push it, stand still, back off.

    The platform stops when the foam reaches densification or the force reaches
    what it can push (then the obstacle is fixed), when the object has been
    pushed by ``push_m`` (then it is movable), or when it falls.

    Parameters
    ----------
    sensor
        With its zero reference taken.
    scene
        Looks at the rest of each frame: the platform is then fast where the floor ahead is seen to be
        free and slow where it is not, falls and slips become events, and the object's turn is
        that of its texture. Without it the approach is blind and slow.
    on_step
        Called once per frame.
    """
    require_members(base, MobileBase, "explore_obstacle")
    require_members(source, FrameSource, "explore_obstacle", "frame source", members=("__iter__",))
    settings = settings or ExploreSettings()
    run = _Run(base, sensor, settings, scene)
    base.drive(settings.approach_m_s, 0.0)
    try:
        for frame in source:
            step = run.step(frame)
            if on_step is not None:
                on_step(step)
            if run.outcome is not None:
                break
    finally:
        base.stop()
    return run.result()


class _Run:
    """State of one exploration."""

    def __init__(
        self,
        base: MobileBase,
        sensor: FoamSensor,
        settings: ExploreSettings,
        scene: SceneTracker | None = None,
    ) -> None:
        self.base, self.sensor, self.settings = base, sensor, settings
        self.scene = scene
        self.ahead = LookAhead(scene.sight_m, settings) if scene is not None else None
        self.angles: list[float] = []
        material = sensor.setup.material
        self.limits = StopLimits(
            deflection_m=settings.strain_fraction * material.densification_strain * material.width_m,
            force_N=settings.max_force_N,
            distance_m=settings.push_m,
        )
        self.detector = ContactEvents()
        self.phase = _Phase.APPROACH
        self.outcome: Outcome | None = None
        self.stopped_by: StopReason | None = None
        self.events: list[Event] = []
        self.profiles: list[ForceProfile] = []
        self.states: list[BaseState] = []
        self.halted: list[tuple[ForceProfile, BaseState]] = []
        self.start: BaseState | None = None
        self.motion_travel: float | None = None
        self.halt_t = self.back_travel = self.first_frame_s = math.nan
        # The foam is compliant: its first reading at the limit is enough.
        self.guard = ForceGuard(settings.max_force_N, median_of=1, max_unread=settings.blind_frames)
        self.clock = ClockWatch()
        self.touched = False

    def step(self, frame: Frame) -> ExploreStep:
        profile, state = self.sensor.read(frame), self.base.state()
        if self.start is None:
            self.start, self.first_frame_s = state, profile.t_s
        travel = self._travel(state)
        seen_now: SceneReading | None = None
        if self.scene is not None:
            seen_now = self.scene.update(frame, profile, state)
        happened = () if seen_now is None else seen_now.events
        # What falls or slips before it is touched, or after it was left, is none of this push.
        happened = happened if self.phase in (_Phase.PUSH, _Phase.HALT) else ()
        found = self.detector.update(profile, travel_m=travel, external=happened)
        self.events += found
        if self.ahead is not None and seen_now is not None and not self.touched:
            self.ahead.look(seen_now, travel)
        if self.phase is not _Phase.BACK_OFF:
            self.profiles.append(profile)
            self.states.append(state)
            self.angles.append(seen_now.object_angle_rad if seen_now is not None else math.nan)
        for event in found:
            if event.kind is EventKind.MOTION and self.motion_travel is None:
                self.motion_travel = self._travel_at(event.t_s)
        seen = profile.reason in (Reason.OK, Reason.UNLOADING, Reason.SATURATED)
        pressing = self.phase in (_Phase.APPROACH, _Phase.PUSH)
        allowed = self.guard.update(
            profile.force_N if seen else math.nan, profile.force_sigma_N, pressing=pressing
        )
        self._decide(profile, state, travel, allowed)
        return ExploreStep(frame, profile, state, self.phase.value, travel, tuple(found), seen_now)

    def _travel(self, state: BaseState) -> float:
        assert self.start is not None
        dx, dy = state.x_m - self.start.x_m, state.y_m - self.start.y_m
        return dx * math.cos(self.start.heading_rad) + dy * math.sin(self.start.heading_rad)

    def _travel_at(self, t_s: float) -> float:
        times = [profile.t_s for profile in self.profiles]
        return float(np.interp(t_s, times, [self._travel(state) for state in self.states]))

    def _decide(self, profile: ForceProfile, state: BaseState, travel: float, allowed: GuardState) -> None:
        """Next phase, and what the platform does in it."""
        settings = self.settings
        assert self.start is not None
        passed_s = max(state.t_s - self.start.t_s, profile.t_s - self.first_frame_s)
        if self.clock.update(state.t_s):
            self._end(Outcome.CLOCK_STOPPED)
        elif passed_s > settings.timeout_s:
            self._end(Outcome.TIMED_OUT)
        elif allowed is GuardState.UNREAD:
            self._end(Outcome.SENSOR_FAILED)
        elif allowed is GuardState.TOO_HEAVY:
            self.touched = True
            self._halt(StopReason.TOO_HEAVY, state)
        elif self.phase is _Phase.APPROACH:
            if self.detector.in_contact:
                self.touched = True
                self.phase = _Phase.PUSH
                self.base.drive(settings.push_m_s, 0.0)
            elif travel > settings.search_m:
                self._end(Outcome.NOTHING_FOUND)
            elif self.ahead is not None:
                self.base.drive(self.ahead.speed_m_s(travel), 0.0)
        elif self.phase is _Phase.PUSH:
            pushed = travel - self.motion_travel if self.motion_travel is not None else 0.0
            reason = self._must_stop(profile, pushed)
            if reason is None and travel > settings.search_m + settings.push_m:
                # Lost on the way: what was touched went out of reach without ever resisting.
                reason = StopReason.PUSHED_FAR
            if reason is not None:
                self._halt(reason, state)
        elif self.phase is _Phase.HALT:
            if abs(state.speed_m_s) < 1e-3 and profile.contacts:
                self.halted.append((profile, state))
            if state.t_s - self.halt_t >= settings.halt_s:
                self.phase, self.back_travel = _Phase.BACK_OFF, travel
                self.base.drive(-settings.back_off_m_s, 0.0)
        elif travel < self.back_travel - settings.back_off_m:
            self._end(Outcome.TAGGED)

    def _must_stop(self, profile: ForceProfile, pushed_m: float) -> StopReason | None:
        if any(event.kind is EventKind.FALL for event in self.events):
            return StopReason.FELL
        if not np.isfinite(profile.delta_m).any():
            return None
        return stop_reason(
            float(np.nanmax(profile.delta_m)),
            profile.force_N,
            pushed_m,
            self.limits,
            force_sigma_N=profile.force_sigma_N,
            unread_frames=0,  # the force guard counts them
        )

    def _halt(self, reason: StopReason, state: BaseState) -> None:
        self.base.stop()
        self.stopped_by, self.phase, self.halt_t = reason, _Phase.HALT, state.t_s

    def _end(self, outcome: Outcome) -> None:
        self.base.stop()
        self.outcome = outcome

    def result(self) -> Exploration:
        """Evaluate what was recorded."""
        outcome = self.outcome or Outcome.SOURCE_ENDED
        travel = np.array([self._travel(state) for state in self.states])
        fit, fit_state = self._shape()
        enough = self.touched and len(self.profiles) >= 2
        tag = self._tag(travel, fit) if enough else HapticTag()
        return Exploration(
            outcome,
            tag,
            fit,
            self.stopped_by,
            tuple(self.events),
            tuple(self.profiles),
            tuple(self.states),
            travel,
            fit_state,
            self.touched,
            self.ahead.seen_m if self.ahead is not None else math.nan,
            self.ahead.expected_m if self.ahead is not None else math.nan,
            np.array(self.angles),
        )

    def _shape(self) -> tuple[PrimitiveFit | None, BaseState | None]:
        """The primitive, from the largest contact while the platform stood still, or at its deepest."""
        if self.halted:
            profile, state = self.halted[len(self.halted) // 2]
        else:
            pressed = [i for i, p in enumerate(self.profiles) if p.contacts]
            if not pressed:
                return None, None
            best = max(pressed, key=lambda i: float(np.nansum(self.profiles[i].delta_m)))
            profile, state = self.profiles[best], self.states[best]
        contact = profile.max_contact
        return (None, None) if contact is None else (fit_contact(contact), state)

    def _tag(self, travel: Float[np.ndarray, "N"], fit: PrimitiveFit | None) -> HapticTag:
        first = self.states[0]
        lateral = np.array(
            [
                -(state.x_m - first.x_m) * math.sin(first.heading_rad)
                + (state.y_m - first.y_m) * math.cos(first.heading_rad)
                for state in self.states
            ]
        )
        best = fit.best if fit is not None else None
        flat = best is not None and best.kind in (PrimitiveKind.LINE, PrimitiveKind.SEGMENT)
        face = None
        if flat:
            face = np.array(
                [
                    _face_angle(profile) + state.heading_rad
                    for profile, state in zip(self.profiles, self.states, strict=True)
                ]
            )
        pushed = np.array([bool(profile.contacts) for profile in self.profiles])
        texture = np.array(self.angles)
        # Its texture tells the turn of a round object, too; a face only that of a flat one.
        seen = bool(np.isfinite(texture[pushed]).mean() > 0.5)
        angle = _joined(texture, face) if seen and face is not None else (texture if seen else face)
        centre = float(best.parameters[1]) if best is not None and best.kind is PrimitiveKind.CIRCLE else None
        if best is not None and best.kind is PrimitiveKind.SEGMENT:
            centre = 0.5 * float(best.parameters[1] + best.parameters[3])
        tag = tag_from_push(
            record_push(self.profiles, travel, lateral_m=lateral, angle_rad=angle),
            events=self.events,
            stopped_by=self.stopped_by,
            primitive=best,
            object_centre_m=centre,
        )
        if tag.fixed and self.stopped_by is StopReason.TOO_HEAVY:
            return tag.updated(min_static_friction_N=self.settings.max_force_N)
        return tag


def _joined(texture_rad: np.ndarray, face_rad: np.ndarray) -> np.ndarray:
    """Mean of two angles that differ by a constant; where one is missing, the other."""
    both = np.isfinite(texture_rad) & np.isfinite(face_rad)
    if not both.any():
        return texture_rad
    shifted = face_rad - np.median(face_rad[both] - texture_rad[both])
    one = np.where(np.isfinite(texture_rad), texture_rad, shifted)
    return np.where(both, 0.5 * (texture_rad + shifted), one)


def _face_angle(profile: ForceProfile) -> float:
    """Angle of the flat face that is touched, in frame F [rad]; NaN without enough contact."""
    contact = profile.max_contact
    if contact is None:
        return math.nan
    pressed = contact.delta_m > 0.7 * contact.delta_m.max()
    if pressed.sum() < 4:
        return math.nan
    x, y = contact.points_foam_m[pressed].T
    slope = np.polyfit(y, x, 1)[0]
    # A face along y has angle zero; turning counter-clockwise moves x down as y grows.
    return float(-math.atan(slope))
