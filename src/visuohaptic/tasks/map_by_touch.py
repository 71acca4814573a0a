"""Map a room by touch alone (Alt 2016, Sec. 3.6.3): along its circumference, one contact after the other.

Drive straight on until something is hit; push it to learn whether it moves;
back off; turn counter-clockwise and drive along it for a while; turn
clockwise and drive straight on again. Every contact goes into a haptic map,
fixed and movable things in layers of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..navigation.haptic_map import HapticContact, HapticMap
from ..objects import Contact, Primitive, PrimitiveKind
from ..robots import BaseState, FrameSource, MobileBase
from ._straight_walls import StraightWalls
from .explore import Exploration, ExploreSettings, Outcome, explore_obstacle
from .machine import Machine, Rule
from .trace import Ending, Trace

if TYPE_CHECKING:
    from ..sensing.foam import FoamSensor

__all__ = [
    "MapCommand",
    "MapMoment",
    "MapOutcome",
    "MapSettings",
    "MapState",
    "TouchMapTask",
    "TouchMapping",
    "contact_of",
    "map_by_touch",
]


class MapState(StrEnum):
    """What the platform is doing."""

    EXPLORE = "explore"  #: straight on, touch, push, back off: one exploration is one observation
    TURN_AWAY = "turn_away"  #: counter-clockwise, until it is parallel to what was touched
    ALONG = "along"
    TURN_BACK = "turn_back"  #: clockwise, to meet the obstacle again
    COME_FREE = "come_free"  #: something at its side holds it: a bit forward or back


class MapOutcome(StrEnum):
    """How it ended."""

    MAPPED = "mapped"  #: as many contacts as were asked for
    SENSOR_FAILED = "sensor_failed"
    NOTHING_FOUND = "nothing_found"  #: several ways in a row met nothing
    STUCK = "stuck"  #: told to move, but stands
    TIMED_OUT = "timed_out"
    SOURCE_ENDED = "source_ended"


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
    )


@dataclass(frozen=True, slots=True)
class MapSettings:
    """How to map."""

    contacts: int = 22
    along_m: float = 0.4  #: way along an obstacle before it is met again
    along_m_s: float = 0.15
    turn_rad_s: float = 0.6
    turn_tolerance_rad: float = 0.03
    front_m: float = 0.17  #: from the platform's centre to the origin of frame F
    least_share: float = 0.25  #: score of a primitive below which its contact points alone are trusted
    empty_ways: int = 6  #: so many ways in a row without a contact end it
    stuck_s: float = 1.5  #: told to move but not moving for so long
    frees: int = 12  #: how often to come free in a row without a contact
    free_m: float = 0.12  #: way to come free
    free_rad: float = 0.6  #: and turn to the left after it
    square_rad: float = math.radians(
        4.0
    )  #: walls are straight and square to each other within; tiny: odometry alone
    least_N: float = 0.3  #: force of a contact for the map: less is a graze
    timeout_s: float = 1800.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(
                    "MapSettings", f"found {getattr(self, name)}, expected more than 0", field=name
                )


@dataclass(frozen=True, slots=True)
class MapMoment:
    """One observation: a frame on the way, or a whole exploration."""

    t_s: float
    x_m: float
    y_m: float
    heading_rad: float
    touched: bool  #: the foam bears on something now
    explored: str  #: outcome of the exploration that has just ended; empty on the way
    contact: bool  #: it gave a contact for the map
    face_rad: float  #: direction of the touched face in the map, to be driven along; NaN unknown


@dataclass(frozen=True, slots=True)
class MapCommand:
    """What the platform is told."""

    explore: bool = False
    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0


_STOP, _EXPLORE = MapCommand(), MapCommand(explore=True)


@dataclass(frozen=True, slots=True, eq=False)
class TouchMapping:
    """What came of it."""

    ending: Ending
    haptic_map: HapticMap
    contacts: tuple[HapticContact, ...]
    explorations: tuple[Exploration, ...]
    trace: Trace


class TouchMapTask(Machine[MapState, MapMoment, MapCommand]):
    """The decisions on the way around."""

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
        self.contacts = self._empty = self._frees = 0
        self._goal_rad = 0.0
        self._from = (0.0, 0.0)
        self._began_s = self._moved_s = math.nan
        self._free_m_s = 0.0
        self._last = (math.inf, math.inf, math.inf)

    def halt(self) -> MapCommand:
        """Stand still."""
        return _STOP

    def decide(self, seen: MapMoment) -> MapCommand:
        """What to do now."""
        s = self.settings
        if math.isnan(self._began_s):
            self._began_s = self._moved_s = seen.t_s
        if seen.t_s - self._began_s > s.timeout_s:
            self.end(False, MapOutcome.TIMED_OUT, f"{self.contacts} contacts in {s.timeout_s:g} s")
            return _STOP
        if self.state is MapState.EXPLORE:
            self._moved_s = seen.t_s
            return self._explored(seen) if seen.explored else _EXPLORE
        moved = math.dist(self._last, (seen.x_m, seen.y_m, seen.heading_rad))
        if moved > 0.005:
            self._last, self._moved_s = (seen.x_m, seen.y_m, seen.heading_rad), seen.t_s
        if seen.t_s - self._moved_s > s.stuck_s:
            return self._free(seen)
        if self.state is MapState.COME_FREE:
            gone = math.dist(self._from, (seen.x_m, seen.y_m))
            if seen.touched and self._free_m_s > 0:
                self.go(MapState.EXPLORE, f"something ahead after {gone:.2f} m")
                return _EXPLORE
            if gone >= s.free_m:
                # Not into the same place again.
                self._goal_rad = seen.heading_rad + s.free_rad
                self.go(MapState.TURN_AWAY, f"free after {gone:.2f} m")
                return MapCommand(turn_rate_rad_s=s.turn_rad_s)
            return MapCommand(speed_m_s=self._free_m_s)
        if self.state is MapState.ALONG:
            gone = math.dist(self._from, (seen.x_m, seen.y_m))
            if seen.touched:
                self.go(MapState.EXPLORE, f"something ahead after {gone:.2f} m")
                return _EXPLORE
            if gone >= s.along_m:
                self._goal_rad = seen.heading_rad - 0.5 * math.pi
                self.go(MapState.TURN_BACK, f"{gone:.2f} m along")
                return MapCommand(turn_rate_rad_s=-s.turn_rad_s)
            return MapCommand(speed_m_s=s.along_m_s)
        return self._turning(seen)

    def _free(self, seen: MapMoment) -> MapCommand:
        """Away from what holds it; the other way the next time."""
        s = self.settings
        self._frees += 1
        if self._frees > s.frees:
            self.end(False, MapOutcome.STUCK, f"could not come free {s.frees} times, last in {self.state}")
            return _STOP
        self._from, self._moved_s = (seen.x_m, seen.y_m), seen.t_s
        # What holds it while it turns is at its side or back; on a straight way it is in front.
        turning = self.state in (MapState.TURN_AWAY, MapState.TURN_BACK)
        self._free_m_s = 0.06 if turning == bool(self._frees % 2) else -0.06
        self.go(MapState.COME_FREE, f"stood for {s.stuck_s:g} s")
        return MapCommand(speed_m_s=self._free_m_s)

    def _explored(self, seen: MapMoment) -> MapCommand:
        s = self.settings
        self._last = (seen.x_m, seen.y_m, seen.heading_rad)
        if seen.explored == Outcome.SENSOR_FAILED:
            self.end(False, MapOutcome.SENSOR_FAILED, f"after {self.contacts} contacts")
            return _STOP
        if seen.contact:
            self.contacts += 1
            self._empty = self._frees = 0
            if self.contacts >= s.contacts:
                self.end(True, MapOutcome.MAPPED, f"{self.contacts} contacts")
                return _STOP
            # Parallel to what was touched, it on the right: a turn to the left by up to half a turn.
            turn = 0.5 * math.pi
            if math.isfinite(seen.face_rad):
                turn = (seen.face_rad - seen.heading_rad) % math.pi
                turn += math.pi if turn < 0.15 * math.pi else 0.0
                turn = min(turn, 0.85 * math.pi)
            self._goal_rad = seen.heading_rad + turn
            self.go(MapState.TURN_AWAY, f"contact {self.contacts}, {math.degrees(turn):.0f} deg away from it")
            return MapCommand(turn_rate_rad_s=s.turn_rad_s)
        if seen.explored == Outcome.TIMED_OUT:
            return self._free(seen)  # told to go on, but held where the foam is not
        self._empty += 1
        if self._empty >= s.empty_ways:
            self.end(False, MapOutcome.NOTHING_FOUND, f"{self._empty} ways in a row met nothing")
            return _STOP
        # What was followed has ended: around its end.
        self._goal_rad = seen.heading_rad - 0.5 * math.pi
        self.go(MapState.TURN_BACK, f"{seen.explored}: around to the right")
        return MapCommand(turn_rate_rad_s=-s.turn_rad_s)

    def _turning(self, seen: MapMoment) -> MapCommand:
        s = self.settings
        left = self._goal_rad - seen.heading_rad
        # Headings may come wrapped; a turn is never more than 0.85 of a half turn.
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
    """Go around a room and write every contact into a haptic map.

    Contacts are placed by odometry, and by the walls touched before: their direction and place hold the drift.

    Parameters
    ----------
    sensor
        With its zero reference taken.
    haptic_map
        Empty or from before; its frame is that of the odometry at the begin. It is changed.
    explore
        How each contact is made; by default faster than for a haptic tag.
    on_contact
        Called after each contact.
    """
    settings, explore = settings or MapSettings(), explore or _exploration()
    task = TouchMapTask(settings)
    walls = StraightWalls(settings.square_rad)
    contacts: list[HapticContact] = []
    explorations: list[Exploration] = []
    frames = iter(source)
    command = _STOP
    try:
        for frame in frames:
            touched = bool(sensor.read(frame).contacts)
            command = task.step(_moment(frame.t_s, base.state(), touched))
            while command.explore and not task.ended:
                found = explore_obstacle(base, source, sensor, explore)
                explorations.append(found)
                contact = contact_of(found, settings)
                face = _face_rad(contact) if contact is not None else math.nan
                if contact is not None:
                    contact = walls.corrected(contact)
                    haptic_map.add(contact)
                    contacts.append(contact)
                    if on_contact is not None:
                        on_contact(contact, haptic_map)
                state = base.state()
                moment = _moment(state.t_s, state, False)
                if found.outcome is Outcome.SOURCE_ENDED:
                    task.interrupt(MapOutcome.SOURCE_ENDED, f"after {len(contacts)} contacts")
                    break
                command = task.step(
                    replace(moment, explored=found.outcome.value, contact=contact is not None, face_rad=face)
                )
            if task.ended:
                break
            if command == _STOP:
                base.stop()
            else:
                base.drive(command.speed_m_s, command.turn_rate_rad_s)
    finally:
        base.stop()
    if task.ending is None:
        task.interrupt(MapOutcome.SOURCE_ENDED, f"after {len(contacts)} contacts")
    assert task.ending is not None
    return TouchMapping(task.ending, haptic_map, tuple(contacts), tuple(explorations), task.trace())


def contact_of(found: Exploration, settings: MapSettings | None = None) -> HapticContact | None:
    """What one exploration says to the map; ``None`` without a contact.

    Where no primitive fits well the contact itself is used: a segment from
    its one end to the other.
    """
    settings = settings or MapSettings()
    state = found.fit_state
    if not found.touched or state is None:
        return None
    contact = _largest(found, state)
    if contact is None or contact.force_N < settings.least_N:
        return None
    primitive = found.fit.best if found.fit is not None else None
    if primitive is None or primitive.score < settings.least_share:
        primitive = _chord(contact)
    c, s = math.cos(state.heading_rad), math.sin(state.heading_rad)
    pose = (state.x_m + settings.front_m * c, state.y_m + settings.front_m * s, state.heading_rad)
    pressed = contact.delta_m > 0.5 * contact.delta_m.max()
    return HapticContact(
        primitive,
        contact.points_foam_m[pressed],
        pose,
        confidence=min(1.0, max(0.3, primitive.score)),
        movable=found.tag.fixed is False,
    )


def _largest(found: Exploration, state: BaseState) -> Contact | None:
    """The contact that was fitted: at the time of the fit, the one of the largest force."""
    for profile, other in zip(reversed(found.profiles), reversed(found.states), strict=True):
        if other.t_s <= state.t_s and profile.contacts:
            return max(profile.contacts, key=lambda one: one.force_N)
    return None


def _chord(contact: Contact) -> Primitive:
    """A segment over the pressed part of a contact."""
    pressed = contact.points_foam_m[contact.delta_m > 0.5 * contact.delta_m.max()]
    ends = np.concatenate([pressed[0], pressed[-1]])
    if len(pressed) < 2:
        ends = np.concatenate([pressed[0] - [0.0, 0.002], pressed[0] + [0.0, 0.002]])
    return Primitive(PrimitiveKind.SEGMENT, ends, 1e-4 * np.eye(4), 0.3)


def _face_rad(contact: HapticContact) -> float:
    """Direction of the touched face in the map; for round and pointed things that of the strip."""
    p, yaw = contact.primitive, contact.pose_map_foam[2]
    if p.kind == PrimitiveKind.LINE:
        return yaw + float(p.parameters[2])
    if p.kind == PrimitiveKind.SEGMENT:
        along = p.parameters[2:] - p.parameters[:2]
        if float(np.hypot(*along)) > 0.03:
            return yaw + math.atan2(along[1], along[0])
    return yaw + 0.5 * math.pi


def _moment(t_s: float, state: BaseState, touched: bool) -> MapMoment:
    return MapMoment(t_s, state.x_m, state.y_m, state.heading_rad, touched, "", False, math.nan)
