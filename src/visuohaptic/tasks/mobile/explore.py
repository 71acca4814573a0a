"""Drive to an obstacle, touch it, push it a little, and compute its haptic tag (Alt 2016, Sec. 3.6.2 and 4.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...core import ClockWatch, Event, EventKind, ForceProfile, Frame, HapticTag, Reason
from ...core.robots import BaseState, FrameSource, MobileBase, require_members
from ...sensing import ContactEvents, PrimitiveFit, StopReason
from ...sensing.foam.sensor import FoamSensor
from ..framework import Ending, Trace, run_machine
from ._pushed_tag import PushRecording
from .explore_records import (
    ExploreObservation,
    ExploreOutcome,
    ExploreSettings,
    ExploreState,
)
from .explore_task import ExploreTask

if TYPE_CHECKING:
    from ...sensing.scene.scene_tracker import SceneReading, SceneTracker


@dataclass(frozen=True, slots=True, eq=False)
class ExploreStep:
    """One frame of an exploration, for displays and logs."""

    frame: Frame
    profile: ForceProfile
    state: BaseState
    phase: str  #: state of the task after this frame
    travel_m: float  #: distance since the start
    events: tuple[Event, ...]
    scene: SceneReading | None = None  #: measurement of the scene tracker


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleExploration:
    """Result of an exploration by pushing.

    ``tag.primitive`` and ``fit`` are in frame F of the sensor where the platform
    stood at ``fit_state``; ``tag.contact_offset_m`` is along y of F, to the left of
    the fitted shape's centre. Lines and corners have no centre and no offset.
    """

    ending: Ending
    tag: HapticTag
    fit: PrimitiveFit | None  #: shape of the contact, fitted while the platform stood still
    stopped_by: StopReason | None
    events: tuple[Event, ...]
    profiles: tuple[ForceProfile, ...]
    states: tuple[BaseState, ...]
    travel_m: Float[np.ndarray, "N"]  #: along the initial heading
    trace: Trace  #: can be replayed by :class:`~visuohaptic.tasks.mobile.explore_task.ExploreTask`
    fit_state: BaseState | None = None  #: odometry at the fit of the shape
    touched: bool = field(default=False)
    #: distance from the foam to the obstacle at its first detection; NaN: not detected
    seen_ahead_m: float = math.nan
    expected_m: float = math.nan  #: last prediction of the scene tracker of the travel at contact
    #: rotation of the object in the world since contact, from its texture; NaN where not measured [rad]
    object_angle_rad: Float[np.ndarray, "N"] = field(default_factory=lambda: np.zeros(0))
    reaction_s: float = math.nan  #: longest time from contact to braking, from the age of the readings

    @property
    def outcome(self) -> ExploreOutcome:
        """How it ended."""
        return ExploreOutcome(self.ending.outcome)


def explore_obstacle(
    base: MobileBase,
    source: FrameSource,
    sensor: FoamSensor,
    settings: ExploreSettings | None = None,
    *,
    scene: SceneTracker | None = None,
    on_step: Callable[[ExploreStep], None] | None = None,
) -> ObstacleExploration:
    """Drive straight on until contact, push the obstacle, stand still, retreat.

    The platform stops when the foam reaches densification or the force reaches
    its maximum push force (then the friction of the obstacle is above the measured force), when the object
    has been pushed by ``push_m`` (then it is movable), or when it falls.

    Parameters
    ----------
    base
        Platform; it drives along its heading.
    source
        Frames of the camera that looks at the foam.
    sensor
        Sensor with its zero reference.
    settings
        Speeds, distances and limits.
    scene
        Tracks the rest of each frame: the platform then drives fast where the floor ahead is seen to be
        free and slowly elsewhere, falls and slips become events, and the rotation of the object is that
        of its texture. Without it the whole approach is slow.
    on_step
        Called once per frame.

    Raises
    ------
    InputError
        ``base`` or ``source`` lacks a member of its protocol.

    Examples
    --------
    A simulated platform, 3 mm before a bin that its camera and foam feel:

    >>> from visuohaptic.rigs import VirtualSensor
    >>> from visuohaptic.simulation.mobile import FoamPushWorld, SimulatedSensorCamera, cylinder
    >>> virtual = VirtualSensor()
    >>> sensor = virtual.build(".", np.random.default_rng(0), zero_frames=5)
    >>> bin = cylinder("bin", 0.273, 0.0, 0.08, 0.12, mass_kg=0.3, friction=0.35, static_ratio=1.2)
    >>> world = FoamPushWorld([bin])
    >>> brief = ExploreSettings(approach_m_s=0.04, push_m_s=0.03, push_m=0.01, halt_s=0.1, back_off_m=0.005)
    >>> with SimulatedSensorCamera(world, virtual.renderer(), seed=1) as source:
    ...     found = explore_obstacle(world.base, source, sensor, brief)
    >>> found.tag.fixed, abs(found.tag.static_friction_N.value / bin.static_friction_N - 1) < 0.15
    (False, True)
    """
    require_members(base, MobileBase, "explore_obstacle")
    require_members(source, FrameSource, "explore_obstacle", "frame source", members=("__iter__",))
    settings = settings or ExploreSettings()
    task = ExploreTask(
        settings,
        max_deflection_m=settings.max_deflection_m(sensor.setup.material),
        sight_m=0.0 if scene is None else scene.sight_m,
    )
    senses = _Senses(sensor, scene)

    def after() -> None:
        step = senses.newest
        if step.phase == ExploreState.HALT and not task.ended:
            senses.recording.add_standstill(step.profile, step.state)
        if on_step is not None:
            on_step(replace(step, phase=task.state.value))

    ending = run_machine(
        task,
        senses.observations(base, source, task),
        lambda command: base.drive(command.speed_m_s, 0.0) if command.speed_m_s else base.stop(),
        base.stop,
        after=after,
    )
    return senses.result(task, ending)


class _Senses:
    """Observations of each frame from foam, scene and odometry, and the record of the push.

    Parameters
    ----------
    sensor
        Foam sensor.
    scene
        Scene tracker.
    """

    def __init__(self, sensor: FoamSensor, scene: SceneTracker | None) -> None:
        self.sensor, self.scene = sensor, scene
        self.detector = ContactEvents()
        self.events: list[Event] = []
        self.recording = PushRecording()
        self.motion_travel_m = math.nan
        self.newest: ExploreStep  #: result of the latest frame

    def observations(
        self, base: MobileBase, source: FrameSource, task: ExploreTask
    ) -> Iterator[ExploreObservation]:
        """Yield one observation per frame; a platform clock that has stopped ends the task."""
        clock, newest_s = ClockWatch(), -math.inf
        for frame in source:
            if frame.t_s > newest_s:
                newest_s = frame.t_s
                self.newest, seen = self.read(frame, base.state(), task.state)
            else:  # late or repeated: the task stops the platform until there is a new one
                seen = replace(seen, t_s=frame.t_s)
            if stopped := clock.update(self.newest.state.t_s):
                task.end(False, ExploreOutcome.CLOCK_STOPPED, stopped)
                return
            yield seen

    def read(
        self, frame: Frame, state: BaseState, phase: ExploreState
    ) -> tuple[ExploreStep, ExploreObservation]:
        """Process one frame while the task is in state ``phase``."""
        profile = self.sensor.read(frame)
        travel_m = self.recording.travel_m(state)
        reading = None if self.scene is None else self.scene.update(frame, profile, state)
        # Falls and slips before contact or after the retreat are not events of this push.
        pushing = phase in (ExploreState.PUSH, ExploreState.HALT)
        external = reading.events if reading is not None and pushing else ()
        found = self.detector.update(profile, travel_m=travel_m, external=external)
        self.events += found
        if phase is not ExploreState.BACK_OFF:
            self.recording.add(profile, state, math.nan if reading is None else reading.object_angle_rad)
        for event in found:
            if event.kind is EventKind.MOTION and math.isnan(self.motion_travel_m):
                self.motion_travel_m = self.recording.travel_at(event.t_s)
        step = ExploreStep(frame, profile, state, phase.value, travel_m, tuple(found), reading)
        return step, self._observation(step)

    def _observation(self, step: ExploreStep) -> ExploreObservation:
        profile, state = step.profile, step.state
        depth = np.asarray(profile.delta_m)
        obstacle = None if step.scene is None else step.scene.obstacle
        return ExploreObservation(
            t_s=float(profile.t_s),
            base_t_s=float(state.t_s),
            travel_m=step.travel_m,
            speed_m_s=float(state.speed_m_s),
            force_N=float(profile.force_N),
            force_sigma_N=float(profile.force_sigma_N),
            force_read=profile.reason in (Reason.OK, Reason.UNLOADING, Reason.SATURATED),
            deflection_m=float(np.nanmax(depth)) if np.isfinite(depth).any() else math.nan,
            contact=bool(profile.contacts),
            in_contact=self.detector.in_contact,
            motion_travel_m=self.motion_travel_m,
            fell=any(event.kind is EventKind.FALL for event in self.events),
            sight=obstacle is not None,
            sight_valid=obstacle is not None and bool(obstacle.valid),
            ahead_m=math.inf if obstacle is None else float(obstacle.proximity_m),
            at_border=obstacle is not None and bool(obstacle.at_border),
        )

    def result(self, task: ExploreTask, ending: Ending) -> ObstacleExploration:
        """Evaluate what was recorded."""
        recording = self.recording
        fit, fit_state = recording.shape()
        # The last readings of a failed robot are not used.
        failed = ending.outcome == ExploreOutcome.DEVICE_FAILED
        enough = task.touched and not failed and len(recording.profiles) >= 2
        tag = HapticTag()
        if enough:
            tag = recording.tag(fit, self.events, task.stopped_by, task.settings.max_force_N)
        return ObstacleExploration(
            ending,
            tag,
            fit,
            task.stopped_by,
            tuple(self.events),
            tuple(recording.profiles),
            tuple(recording.states),
            recording.travels_m(),
            task.trace(),
            fit_state,
            task.touched,
            task.ahead.seen_m,
            task.ahead.expected_m,
            np.array(recording.angles_rad),
            task.reaction.reaction_s,
        )
