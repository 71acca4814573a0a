"""Conversion of explorations to contacts of a haptic map, and their positions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ....core import BaseState, Contact, Primitive, PrimitiveKind, Reason
from ....navigation.mapping.haptic_map import HapticContact, HapticMap
from ....sensing.push.push_record import StopReason
from ..explore import ObstacleExploration
from ._odometry_scale import OdometryScale
from ._straight_walls import correct_by_walls
from .map_records import MapSettings

#: An object that stopped the foam and has moved less than this is fixed [m].
MAX_FIXED_MOTION_M = 0.005


class ContactPlacement:
    """Positions of all contacts, from the present estimates of walls and odometry scale.

    Parameters
    ----------
    settings
        Settings of the mapping.
    haptic_map
        Map that :meth:`draw` rebuilds.
    start
        Odometry at the start.
    """

    def __init__(self, settings: MapSettings, haptic_map: HapticMap, start: BaseState) -> None:
        self.settings, self.start = settings, start
        self.scale = OdometryScale(settings.scale_sigma)
        self._by_odometry: list[HapticContact] = []
        self._times_s: list[float] = []
        self._map = haptic_map
        self._before = haptic_map.static.copy(), haptic_map.movable.copy(), haptic_map.contacts

    def add(self, contact: HapticContact, found: ObstacleExploration) -> list[HapticContact]:
        """Add a contact; returns all contacts so far with their updated positions.

        Parameters
        ----------
        contact
            Contact at its odometry position.
        found
            Exploration that made it.
        """
        self.scale.add(found)
        self._by_odometry.append(contact)
        self._times_s.append(found.fit_state.t_s if found.fit_state is not None else math.inf)
        scaled = [self._scaled(one) for one in self._by_odometry]
        return correct_by_walls(scaled, self._times_s, self.settings.square_rad)

    def _scaled(self, contact: HapticContact) -> HapticContact:
        """The contact with its distance from the start corrected by the odometry scale."""
        x, y, heading = contact.T_map_foam
        ahead = self.settings.front_m * math.cos(heading), self.settings.front_m * math.sin(heading)
        from_x, from_y = self.start.x_m + ahead[0], self.start.y_m + ahead[1]
        scale = self.scale.value
        place = (from_x + (x - from_x) / scale, from_y + (y - from_y) / scale, heading)
        return replace(contact, T_map_foam=place)

    def draw(self, contacts: list[HapticContact]) -> None:
        """Rebuild the map.

        Parameters
        ----------
        contacts
            All contacts of the map.
        """
        self._map.static[:], self._map.movable[:], self._map.contacts = self._before
        for contact in contacts:
            self._map.add(contact)


def contact_of(found: ObstacleExploration, settings: MapSettings | None = None) -> HapticContact | None:
    """Contact of one exploration for the map; ``None`` without a contact.

    If no primitive fits well, the contact is represented by a segment between
    its ends.

    Parameters
    ----------
    found
        Result of the exploration.
    settings
        Settings of the mapping.
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
    """The fitted contact: the largest at the time of the fit."""
    for profile, other in zip(reversed(found.profiles), reversed(found.states), strict=True):
        if other.t_s <= state.t_s and profile.contacts:
            return profile.max_contact
    return None


def centring_turn_rad(found: ObstacleExploration, now: BaseState, settings: MapSettings) -> float:
    """Left turn that brings an object touched by the end of the foam in front of its middle; NaN if not needed.

    The end of the foam deforms at a small force: it is densified before a light object slides, and a shape
    fitted to a few points is not reliable.

    Parameters
    ----------
    found
        Result of the exploration.
    now
        Odometry after it.
    settings
        Settings of the mapping.
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
    """Whether the object stopped the platform where it was met.

    Foam that is hit fast relaxes while the platform brakes, which looks like the start of a motion. The criterion
    is the distance of the platform minus the deflection of the foam, unless the foam is densified.
    """
    if found.stopped_by not in (StopReason.DENSIFIED, StopReason.TOO_HEAVY):
        return False
    met = [index for index, profile in enumerate(found.profiles) if profile.contacts]
    if not met:
        return False
    full = [index for index in met if found.profiles[index].reason is Reason.SATURATED]
    last = full[0] if full else max(met, key=lambda index: float(np.nansum(found.profiles[index].delta_m)))
    first_m, last_m = (float(np.nanmax(found.profiles[index].delta_m)) for index in (met[0], last))
    return float(found.travel_m[last] - found.travel_m[met[0]]) - (last_m - first_m) < MAX_FIXED_MOTION_M


def _chord(contact: Contact) -> Primitive:
    """Segment over the deflected part of a contact."""
    pressed = contact.points_foam_m[contact.delta_m > 0.5 * contact.delta_m.max()]
    ends = np.concatenate([pressed[0], pressed[-1]])
    if len(pressed) < 2:
        ends = np.concatenate([pressed[0] - [0.0, 0.002], pressed[0] + [0.0, 0.002]])
    return Primitive(PrimitiveKind.SEGMENT, ends, 1e-4 * np.eye(4), 0.3)


def face_rad(contact: HapticContact) -> float:
    """Direction of the touched face in the map [rad]; for round and pointed objects that of the strip.

    Parameters
    ----------
    contact
        Contact at its position in the map.
    """
    p, yaw = contact.primitive, contact.T_map_foam[2]
    if p.kind == PrimitiveKind.LINE:
        return yaw + float(p.parameters[2])
    if p.kind == PrimitiveKind.SEGMENT:
        along = p.parameters[2:] - p.parameters[:2]
        if float(np.hypot(*along)) > 0.03:
            return yaw + math.atan2(along[1], along[0])
    return yaw + 0.5 * math.pi
