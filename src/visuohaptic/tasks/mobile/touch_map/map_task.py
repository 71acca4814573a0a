"""Map a room by touch alone (Alt 2016, Sec. 3.6.3), along its walls, one contact after the other.

Drive straight on until contact; push the obstacle to test whether it moves;
retreat; turn counter-clockwise and drive along it for a distance; turn
clockwise and drive straight on again. Every contact is added to a haptic map,
with separate layers for fixed and movable objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ....core.robots import BaseState, FrameSource, MobileBase, require_members
from ....navigation.mapping.haptic_map import HapticContact, HapticMap
from ...framework import Ending, Machine, Rule, Trace, run_machine
from ..explore import ObstacleExploration, explore_obstacle
from ..explore_records import ExploreOutcome, ExploreSettings
from ..force_guard import FoamLimit, ForceGuard, GuardState
from ._map_contacts import ContactPlacement, centring_turn_rad, contact_of, face_rad
from .map_records import MapCommand, MapObservation, MapOutcome, MapSettings, MapState

if TYPE_CHECKING:
    from ....sensing.foam.sensor import FoamSensor


def _exploration() -> ExploreSettings:
    return ExploreSettings(
        approach_m_s=0.08,
        push_m_s=0.04,
        back_off_m_s=0.1,
        search_m=1.2,
        timeout_s=40.0,
        push_m=0.05,
        halt_s=0.3,
        back_off_m=0.09,
        rise=1.0,  # a map needs to know whether the object moves, not its breakaway force
    )


_STOP, _EXPLORE = MapCommand(), MapCommand(explore=True)
#: Outcomes of an exploration that end the mapping.
_ENDINGS = {
    ExploreOutcome.SOURCE_ENDED: MapOutcome.SOURCE_ENDED,
    ExploreOutcome.DEVICE_FAILED: MapOutcome.DEVICE_FAILED,
    ExploreOutcome.CLOCK_STOPPED: MapOutcome.DEVICE_FAILED,
}


@dataclass(frozen=True, slots=True, eq=False)
class TouchMapping:
    """Result of mapping by touch."""

    ending: Ending
    haptic_map: HapticMap
    contacts: tuple[HapticContact, ...]
    explorations: tuple[ObstacleExploration, ...]
    trace: Trace


class TouchMapTask(Machine[MapState, MapObservation, MapCommand]):
    """State machine of the tour along the walls.

    Parameters
    ----------
    settings
        Distances, speeds and limits.
    """

    task = "map_by_touch"

    def __init__(self, settings: MapSettings | None = None) -> None:
        self.settings = settings or MapSettings()
        self.rules = {
            MapState.EXPLORE: Rule((MapState.TURN_AWAY, MapState.TURN_BACK, MapState.COME_FREE)),
            MapState.TURN_AWAY: Rule((MapState.ALONG, MapState.COME_FREE), 30.0),
            MapState.ALONG: Rule((MapState.TURN_BACK, MapState.EXPLORE, MapState.COME_FREE), 60.0),
            MapState.TURN_BACK: Rule((MapState.EXPLORE, MapState.COME_FREE), 30.0),
            MapState.COME_FREE: Rule((MapState.EXPLORE, MapState.COME_FREE, MapState.TURN_AWAY), 30.0),
        }
        super().__init__(self.settings)
        self.contacts = self._empty = self._frees = self._tries = 0
        self._goal_rad = 0.0
        self._from, self._from_rad = (0.0, 0.0), 0.0
        self._began_s = self._moved_s = math.nan
        self._last_turn = 1.0
        self.once_more = False  #: whether a contact of the foam's end is being repeated with its middle
        self._freeing = _STOP
        self._last = (math.inf, math.inf, math.inf)

    def halt(self) -> MapCommand:
        """Command that stops the platform."""
        return _STOP

    def decide(self, seen: MapObservation) -> MapCommand:
        """Motion command or start of an exploration, after one observation."""
        s = self.settings
        if math.isnan(self._began_s):
            self._began_s = self._moved_s = seen.t_s
        if seen.t_s - self._began_s > s.timeout_s:
            self.end(False, MapOutcome.TIMED_OUT, f"{self.contacts} contacts in {s.timeout_s:g} s")
            return _STOP
        if self.state is MapState.EXPLORE:
            self._moved_s = seen.t_s
            return self._explored(seen) if seen.explored else _EXPLORE
        if seen.overload:
            return self._free(seen, "the force is at the platform's limit")
        moved = math.dist(self._last, (seen.x_m, seen.y_m, seen.heading_rad))
        if moved > 0.005:
            self._last, self._moved_s = (seen.x_m, seen.y_m, seen.heading_rad), seen.t_s
        if seen.t_s - self._moved_s > s.stuck_s:
            return self._free(seen, f"stood for {s.stuck_s:g} s")
        if self.state is MapState.COME_FREE:
            return self._coming_free(seen)
        if self.state is MapState.ALONG:
            gone = math.dist(self._from, (seen.x_m, seen.y_m))
            if seen.touched:
                self.go(MapState.EXPLORE, f"contact ahead after {gone:.2f} m")
                return _EXPLORE
            if gone >= s.along_m:
                self._goal_rad = seen.heading_rad - 0.5 * math.pi
                self.go(MapState.TURN_BACK, f"{gone:.2f} m along")
                return MapCommand(turn_rate_rad_s=-s.turn_rad_s)
            return MapCommand(speed_m_s=s.along_m_s)
        return self._turning(seen)

    def _free(self, seen: MapObservation, why: str) -> MapCommand:
        """Start to come free, in a different direction than the last time."""
        s = self.settings
        self._frees += 1
        if self._frees > s.frees:
            self.end(False, MapOutcome.STUCK, f"could not come free {s.frees} times, last in {self.state}")
            return _STOP
        if self.state is not MapState.COME_FREE:
            # Resume the remaining motion when free; a straight drive is not resumed into the same place.
            if self.state is not MapState.TURN_AWAY:
                self._goal_rad = seen.heading_rad + s.free_rad
            self._last_turn = -1.0 if self.state is MapState.TURN_BACK else 1.0
            self._tries = 0
        self._start_recovery(seen, why)
        return self._freeing

    def _start_recovery(self, seen: MapObservation, why: str) -> None:
        """Try in turn: backward, along the incoming path; forward, where the foam senses contact; turning, in alternating senses."""
        self._from, self._from_rad, self._moved_s = (seen.x_m, seen.y_m), seen.heading_rad, seen.t_s
        speeds = (-0.06, 0.06, None)
        speed = speeds[self._tries % len(speeds)]
        self._tries += 1
        if speed is None:
            self._last_turn = -self._last_turn
            self._freeing = MapCommand(turn_rate_rad_s=self._last_turn * 0.5 * self.settings.turn_rad_s)
        else:
            self._freeing = MapCommand(speed_m_s=speed)
        self.go(MapState.COME_FREE, why)

    def _coming_free(self, seen: MapObservation) -> MapCommand:
        s = self.settings
        gone = math.dist(self._from, (seen.x_m, seen.y_m))
        if seen.touched and self._freeing.speed_m_s > 0:
            self.go(MapState.EXPLORE, f"contact ahead after {gone:.2f} m")
            return _EXPLORE
        if gone >= s.free_m:
            self.go(MapState.TURN_AWAY, f"free after {gone:.2f} m")
            return self._turning(seen)
        turned = abs(math.remainder(seen.heading_rad - self._from_rad, 2.0 * math.pi))
        if self._freeing.turn_rate_rad_s and turned >= s.free_rad:
            self._frees += 1
            self._start_recovery(seen, f"turned by {math.degrees(turned):.0f} deg")
        return self._freeing

    def _explored(self, seen: MapObservation) -> MapCommand:
        s = self.settings
        self._last = (seen.x_m, seen.y_m, seen.heading_rad)
        if seen.explored == ExploreOutcome.SENSOR_FAILED:
            self.end(False, MapOutcome.SENSOR_FAILED, f"after {self.contacts} contacts")
            return _STOP
        if math.isfinite(seen.centring_turn_rad) and not self.once_more:
            self.once_more = True
            self._goal_rad = seen.heading_rad + seen.centring_turn_rad
            degrees = math.degrees(seen.centring_turn_rad)
            self.go(MapState.TURN_BACK, f"contact at the end of the foam: {degrees:+.0f} deg, repeated")
            return MapCommand(turn_rate_rad_s=math.copysign(s.turn_rad_s, seen.centring_turn_rad))
        self.once_more = False
        if seen.contact:
            self.contacts += 1
            self._empty = self._frees = 0
            if self.contacts >= s.contacts:
                self.end(True, MapOutcome.MAPPED, f"{self.contacts} contacts")
                return _STOP
            # Turn left by up to half a turn until parallel to the touched face, with the face on the right.
            turn = 0.5 * math.pi
            if math.isfinite(seen.face_rad):
                turn = (seen.face_rad - seen.heading_rad) % math.pi
                turn += math.pi if turn < 0.15 * math.pi else 0.0
                turn = min(turn, 0.85 * math.pi)
            self._goal_rad = seen.heading_rad + turn
            self.go(MapState.TURN_AWAY, f"contact {self.contacts}, {math.degrees(turn):.0f} deg away from it")
            return MapCommand(turn_rate_rad_s=s.turn_rad_s)
        if seen.explored == ExploreOutcome.TIMED_OUT:
            return self._free(seen, "timed out")  # commanded to move, but blocked away from the foam
        self._empty += 1
        if self._empty >= s.empty_drives:
            self.end(False, MapOutcome.NOTHING_FOUND, f"{self._empty} successive drives without contact")
            return _STOP
        # The followed obstacle has ended: drive around its end.
        self._goal_rad = seen.heading_rad - 0.5 * math.pi
        self.go(MapState.TURN_BACK, f"{seen.explored}: around to the right")
        return MapCommand(turn_rate_rad_s=-s.turn_rad_s)

    def _turning(self, seen: MapObservation) -> MapCommand:
        s = self.settings
        left = self._goal_rad - seen.heading_rad
        # Headings may be wrapped; a turn is at most 0.85 of a half turn.
        left = (left + math.pi) % (2 * math.pi) - math.pi
        if self.state is MapState.TURN_AWAY and left < -0.5 * math.pi:
            left += 2 * math.pi
        if abs(left) > s.turn_tolerance_rad:
            rate = min(s.turn_rad_s, max(0.08, 1.5 * abs(left)))
            return MapCommand(turn_rate_rad_s=math.copysign(rate, left))
        if self.state is MapState.TURN_AWAY:
            self._from = (seen.x_m, seen.y_m)
            self.go(MapState.ALONG, "parallel to it")
            return MapCommand(speed_m_s=s.along_m_s)
        self.go(MapState.EXPLORE, "facing it again")
        return _EXPLORE


class _Contacts:
    """Runs explorations, and adds each contact to the map.

    Parameters
    ----------
    settings
        Settings of the mapping.
    haptic_map
        Map that is updated.
    start
        Odometry at the start.
    on_contact
        Called after each contact.
    """

    def __init__(
        self,
        settings: MapSettings,
        haptic_map: HapticMap,
        start: BaseState,
        on_contact: Callable[[HapticContact, HapticMap], None] | None,
    ) -> None:
        self._settings, self._map, self._on_contact = settings, haptic_map, on_contact
        self._placing = ContactPlacement(settings, haptic_map, start)
        self.contacts: list[HapticContact] = []
        self.explorations: list[ObstacleExploration] = []

    def add(self, found: ObstacleExploration, state: BaseState, *, once_more: bool) -> MapObservation:
        """Process an exploration that has ended at ``state``."""
        self.explorations.append(found)
        turn_rad = centring_turn_rad(found, state, self._settings)
        # A contact at the end of the foam determines neither the position nor whether the object is movable.
        waits = math.isfinite(turn_rad) and not once_more
        contact = None if waits else contact_of(found, self._settings)
        if contact is not None:
            face = face_rad(contact)
            self.contacts = self._placing.add(contact, found)
            self._map.add(self.contacts[-1])
            if self._on_contact is not None:
                self._on_contact(self.contacts[-1], self._map)
        return replace(
            _observation(state.t_s, state),
            explored=found.outcome.value,
            contact=contact is not None,
            face_rad=math.nan if contact is None else face,
            centring_turn_rad=turn_rad,
        )

    def redraw(self) -> None:
        """Rebuild the map with the final estimate of the odometry."""
        self._placing.draw(self.contacts)


def map_by_touch(
    base: MobileBase,
    source: FrameSource,
    sensor: FoamSensor,
    haptic_map: HapticMap,
    settings: MapSettings | None = None,
    explore: ExploreSettings | None = None,
    *,
    on_contact: Callable[[HapticContact, HapticMap], None] | None = None,
) -> TouchMapping:
    """Drive around a room and add every contact to a haptic map.

    Contacts are located by odometry, corrected by the directions and positions of the walls touched before.
    The deflection of the foam against fixed objects calibrates the scale of the odometry. The estimate is best
    at the end: the map is then rebuilt from all contacts.

    Parameters
    ----------
    base
        The platform.
    source
        Frames of the camera that looks at the foam.
    sensor
        Sensor with its zero reference.
    haptic_map
        Empty or existing map in the frame of the odometry at the start; it is updated.
    settings
        Settings of the tour.
    explore
        Settings of each contact; by default faster than for a haptic tag.
    on_contact
        Called after each contact.

    Raises
    ------
    InputError
        ``base`` or ``source`` lacks a member of its protocol.
    """
    require_members(base, MobileBase, "map_by_touch")
    require_members(source, FrameSource, "map_by_touch", "frame source", members=("__iter__",))
    settings, explore = settings or MapSettings(), explore or _exploration()
    full_m = explore.max_deflection_m(sensor.setup.material)
    guard = ForceGuard(explore.max_force_N, median_of=1, max_unread=explore.max_invalid_frames)
    task = TouchMapTask(settings)
    found = _Contacts(settings, haptic_map, base.state(), on_contact)
    command, limit = _STOP, FoamLimit(explore, full_m)

    def observations() -> Iterator[MapObservation]:
        nonlocal limit
        seen: MapObservation | None = None
        for frame in iter(source):
            if seen is not None and frame.t_s <= seen.t_s:
                yield replace(
                    seen, t_s=frame.t_s
                )  # late, or once more: it stands still until there is a new one
                continue
            state, profile = base.state(), sensor.read(frame)
            limit.update(frame.t_s, state.t_s, profile)
            pressing = command.speed_m_s > 0.0 or command.turn_rate_rad_s != 0.0
            allowed = guard.update(profile.force_N, profile.force_sigma_N, pressing=pressing)
            if allowed is GuardState.UNREAD:
                task.end(False, MapOutcome.SENSOR_FAILED, "the force is not read")
                return
            if pressing:
                execute(command)  # slower as the foam fills
            touched, overload = bool(profile.contacts), allowed is GuardState.TOO_HEAVY
            seen = replace(_observation(frame.t_s, state), touched=touched, overload=overload)
            yield seen
            while command.explore:
                exploration = explore_obstacle(base, source, sensor, limit.settings)
                limit = FoamLimit(replace(explore, reaction_s=exploration.reaction_s), full_m)
                if exploration.outcome in _ENDINGS:
                    task.end(False, _ENDINGS[exploration.outcome], exploration.ending.why)
                    return
                yield found.add(exploration, base.state(), once_more=task.once_more)

    def execute(requested: MapCommand) -> None:
        nonlocal command
        command = requested
        moving = requested.speed_m_s or requested.turn_rate_rad_s
        base.drive(*limit.limited(requested.speed_m_s, requested.turn_rate_rad_s)) if moving else base.stop()

    ending = run_machine(task, observations(), execute, base.stop)
    found.redraw()
    return TouchMapping(ending, haptic_map, tuple(found.contacts), tuple(found.explorations), task.trace())


def _observation(t_s: float, state: BaseState) -> MapObservation:
    return MapObservation(t_s, state.x_m, state.y_m, state.heading_rad, False, "", False, math.nan)
