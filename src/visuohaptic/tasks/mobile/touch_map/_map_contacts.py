"""What explorations say to a map by touch: contacts, and where they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ....core.measurement import Contact, Reason
from ....core.objects import Primitive, PrimitiveKind
from ....core.robots import BaseState
from ....navigation.mapping.haptic_map import HapticContact, HapticMap
from ....sensing.push.push_record import StopReason
from ..explore import ObstacleExploration
from ._felt_scale import FeltScale
from ._straight_walls import held_by_walls
from .map_records import MapSettings

__all__ = ["Placing", "aside_rad", "contact_of", "face_rad"]

#: What stopped the foam, and has not gone farther than this, is fixed [m].
HELD_M = 0.005


class Placing:
    """Where every contact is by what is known of the walls and of the odometry's scale until now.

    Parameters
    ----------
    settings
        Of the mapping.
    haptic_map
        Drawn anew by :meth:`draw`.
    start
        Odometry at the start.
    """

    def __init__(self, settings: MapSettings, haptic_map: HapticMap, start: BaseState) -> None:
        self.settings, self.start = settings, start
        self.scale = FeltScale(settings.scale_sigma)
        self._by_odometry: list[HapticContact] = []
        self._times_s: list[float] = []
        self._map = haptic_map
        self._before = haptic_map.static.copy(), haptic_map.movable.copy(), haptic_map.contacts

    def add(self, contact: HapticContact, found: ObstacleExploration) -> list[HapticContact]:
        """All contacts until now, with a new one.

        Parameters
        ----------
        contact
            The contact where odometry places it.
        found
            The exploration that made it.
        """
        self.scale.add(found)
        self._by_odometry.append(contact)
        self._times_s.append(found.fit_state.t_s if found.fit_state is not None else math.inf)
        scaled = [self._scaled(one) for one in self._by_odometry]
        return held_by_walls(scaled, self._times_s, self.settings.square_rad)

    def _scaled(self, contact: HapticContact) -> HapticContact:
        """With the distance from the start in true metres."""
        x, y, heading = contact.T_map_foam
        ahead = self.settings.front_m * math.cos(heading), self.settings.front_m * math.sin(heading)
        from_x, from_y = self.start.x_m + ahead[0], self.start.y_m + ahead[1]
        scale = self.scale.value
        place = (from_x + (x - from_x) / scale, from_y + (y - from_y) / scale, heading)
        return replace(contact, T_map_foam=place)

    def draw(self, contacts: list[HapticContact]) -> None:
        """Make the map anew.

        Parameters
        ----------
        contacts
            All that the map is to have.
        """
        self._map.static[:], self._map.movable[:], self._map.contacts = self._before
        for contact in contacts:
            self._map.add(contact)


def contact_of(found: ObstacleExploration, settings: MapSettings | None = None) -> HapticContact | None:
    """What one exploration says to the map; ``None`` without a contact.

    Where no primitive fits well the contact itself is used: a segment from
    its one end to the other.

    Parameters
    ----------
    found
        The exploration.
    settings
        Of the mapping.
    """
    settings = settings or MapSettings()
    state = found.fit_state
    if not found.touched or state is None:
        return None
    contact = _largest(found, state)
    if contact is None or contact.force_N < settings.min_N:
        return None
    primitive = found.fit.best if found.fit is not None else None
    if primitive is None or primitive.score < settings.min_score:
        primitive = _chord(contact)
    c, s = math.cos(state.heading_rad), math.sin(state.heading_rad)
    pose = (state.x_m + settings.front_m * c, state.y_m + settings.front_m * s, state.heading_rad)
    pressed = contact.delta_m > 0.5 * contact.delta_m.max()
    return HapticContact(
        primitive,
        contact.points_foam_m[pressed],
        pose,
        confidence=min(1.0, max(0.3, primitive.score)),
        movable=found.tag.fixed is False and not _held(found),
    )


def _largest(found: ObstacleExploration, state: BaseState) -> Contact | None:
    """The contact that was fitted: at the time of the fit, the largest."""
    for profile, other in zip(reversed(found.profiles), reversed(found.states), strict=True):
        if other.t_s <= state.t_s and profile.contacts:
            return profile.max_contact
    return None


def aside_rad(found: ObstacleExploration, now: BaseState, settings: MapSettings) -> float:
    """Turn to the left after which the platform faces what its foam has met; NaN unless only the foam's end has met it.

    There the foam deforms at little force: it is full before a light object slides, and a shape of a few
    points says nothing.

    Parameters
    ----------
    found
        The exploration.
    now
        Odometry after it.
    settings
        Of the mapping.
    """
    state = found.fit_state
    if not found.touched or state is None or found.stopped_by is not StopReason.DENSIFIED:
        return math.nan
    contact = _largest(found, state)
    if contact is None:
        return math.nan
    pressed = contact.points_foam_m[contact.delta_m > 0.5 * contact.delta_m.max()]
    s_m = found.profiles[0].s_m
    reach_m = 0.5 * settings.end_m
    at_end = contact.s_start_m < s_m[0] + reach_m or contact.s_end_m > s_m[-1] - reach_m
    if not at_end or float(np.hypot(*np.ptp(pressed, axis=0))) > settings.end_m:
        return math.nan
    c, s = math.cos(state.heading_rad), math.sin(state.heading_rad)
    u, v = pressed.mean(axis=0) + np.array([settings.front_m, 0.0])
    bearing = math.atan2(state.y_m + s * u + c * v - now.y_m, state.x_m + c * u - s * v - now.x_m)
    return math.remainder(bearing - now.heading_rad, 2.0 * math.pi)


def _held(found: ObstacleExploration) -> bool:
    """Whether it stopped the platform where it was met.

    Foam that is hit fast eases while the platform brakes, which looks like the start of a motion:
    how far the platform went less what the foam took of it decides, until the foam is as hard as the hull.
    """
    if found.stopped_by not in (StopReason.DENSIFIED, StopReason.TOO_HEAVY):
        return False
    met = [index for index, profile in enumerate(found.profiles) if profile.contacts]
    if not met:
        return False
    full = [index for index in met if found.profiles[index].reason is Reason.SATURATED]
    last = full[0] if full else max(met, key=lambda index: float(np.nansum(found.profiles[index].delta_m)))
    first_m, last_m = (float(np.nanmax(found.profiles[index].delta_m)) for index in (met[0], last))
    return float(found.travel_m[last] - found.travel_m[met[0]]) - (last_m - first_m) < HELD_M


def _chord(contact: Contact) -> Primitive:
    """A segment over the pressed part of a contact."""
    pressed = contact.points_foam_m[contact.delta_m > 0.5 * contact.delta_m.max()]
    ends = np.concatenate([pressed[0], pressed[-1]])
    if len(pressed) < 2:
        ends = np.concatenate([pressed[0] - [0.0, 0.002], pressed[0] + [0.0, 0.002]])
    return Primitive(PrimitiveKind.SEGMENT, ends, 1e-4 * np.eye(4), 0.3)


def face_rad(contact: HapticContact) -> float:
    """Direction of the touched face in the map; for round and pointed objects that of the strip.

    Parameters
    ----------
    contact
        Where it was placed.
    """
    p, yaw = contact.primitive, contact.T_map_foam[2]
    if p.kind == PrimitiveKind.LINE:
        return yaw + float(p.parameters[2])
    if p.kind == PrimitiveKind.SEGMENT:
        along = p.parameters[2:] - p.parameters[:2]
        if float(np.hypot(*along)) > 0.03:
            return yaw + math.atan2(along[1], along[0])
    return yaw + 0.5 * math.pi
