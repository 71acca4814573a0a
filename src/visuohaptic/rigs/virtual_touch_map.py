"""Simulated mapping of a room by touch, and evaluation of the map (Alt 2016, Fig. 3.11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from ..core.geometry import rotation_2d
from ..navigation.mapping.haptic_map import HapticContact, HapticMap
from ..simulation.foam.strip_geometry import FoamStripGeometry
from ..simulation.mobile import DriftingBase, PlatformConfig, QuickFoam, QuickFrames, QuickWorld
from ..simulation.mobile.touch_rooms import WALL_M, TouchRoom, touch_room
from ..tasks import MapSettings, TouchMapping, map_by_touch

if TYPE_CHECKING:
    from ..sensing.foam.sensor import FoamSensor

#: Radius around contact points in which a map is evaluated [m].
AROUND_M = 0.3


@dataclass(frozen=True, slots=True)
class MapScore:
    """Evaluation of the map against the truth, in the cells around the contacts."""

    occupied_iou: float
    free_iou: float
    correct_flags: int  #: contacts with a correct movable flag
    contacts: int
    mixed: int  #: touched movable objects that are in the layer of fixed ones

    @property
    def iou(self) -> float:
        """Mean of both intersections over union."""
        return 0.5 * (self.occupied_iou + self.free_iou)


@dataclass(frozen=True, slots=True, eq=False)
class RoomTrial:
    """Result for one room."""

    room: TouchRoom
    mapping: TouchMapping
    touched: tuple[tuple[str, float, float], ...]  #: for each contact: object, and its position at that time
    score: MapScore


def map_virtual_room(seed: int, contacts: int = 22) -> RoomTrial:
    """Map the room of a seed with the fast foam model and drifting odometry.

    Parameters
    ----------
    seed
        Seed of the room.
    contacts
        Number of contacts.
    """
    room, rng = touch_room(seed), np.random.default_rng(seed)
    x, y, heading = room.start
    # The bumper covers the whole front: an uncovered corner of the hull could not sense contacts.
    config = PlatformConfig(
        x_m=x, y_m=y, heading_rad=heading, width_m=0.28, strip=FoamStripGeometry(0.3, spacing_m=0.002)
    )
    world = QuickWorld(room.obstacles, config)
    size_m = (room.size_m[0] + 1.0, room.size_m[1] + 1.0)
    haptic = HapticMap.empty((-0.5, -0.5), size_m, 0.025, depth_m=WALL_M)
    touched: list[tuple[str, float, float]] = []

    def note(contact: HapticContact, so_far: HapticMap) -> None:
        # The object whose surface is closest to the foam.
        cx, cy, _ = world.platform_pose()
        name = world.last_touched
        touched.append((name, *world.places.get(name, (cx, cy))))

    mapping = map_by_touch(
        DriftingBase(world, rng),
        QuickFrames(world),
        cast("FoamSensor", QuickFoam(world, rng)),
        haptic,
        MapSettings(contacts=contacts),
        on_contact=note,
    )
    return RoomTrial(room, mapping, tuple(touched), score_map(room, mapping, touched))


def score_map(room: TouchRoom, mapping: TouchMapping, touched: list[tuple[str, float, float]]) -> MapScore:
    """Occupied and free intersection over union around the contacts.

    Evaluated are the cells within ``AROUND_M`` of a contact point, except those deeper
    than a wall behind a surface, which cannot be touched. Unknown counts as neither.

    Parameters
    ----------
    room
        Truth.
    mapping
        Estimated map.
    touched
        Contacts: name of the object and its position (x, y) [m].
    """
    from scipy.spatial import cKDTree

    haptic = mapping.haptic_map
    rows, columns = haptic.static.shape
    x = haptic.origin_m[0] + (np.arange(columns) + 0.5) * haptic.resolution_m
    y = haptic.origin_m[1] + (np.arange(rows) + 0.5) * haptic.resolution_m
    places = np.stack(np.meshgrid(x, y), axis=-1)
    points = [
        contact.points_foam_m @ rotation_2d(contact.T_map_foam[2]).T + contact.T_map_foam[:2]
        for contact in mapping.contacts
    ]
    if not points:
        return MapScore(0.0, 0.0, 0, 0, 0)
    near = cKDTree(np.concatenate(points)).query(places.reshape(-1, 2))[0].reshape(rows, columns) < AROUND_M
    solid = room.occupied(places)
    near &= ~room.occupied(places, grow_m=-WALL_M)
    wide, deep = room.size_m
    # The area outside the walls cannot be touched either.
    inside = (
        (places >= -WALL_M).all(axis=-1)
        & (places[..., 0] <= wide + WALL_M)
        & (places[..., 1] <= deep + WALL_M)
    )
    near &= inside
    told_solid, told_free = haptic.static >= 0.05, haptic.static <= -0.05
    names = {o.name: o for o in room.obstacles}
    right = sum(
        contact.movable == names[name].movable
        for contact, (name, _, _) in zip(mapping.contacts, touched, strict=True)
        if name in names
    )
    mixed = 0
    for (name, px, py), contact in zip(touched, mapping.contacts, strict=True):
        if name in names and names[name].movable:
            centre = np.array([[px, py]])
            mixed += bool(haptic.value_at(centre)[0] >= 0.05 or not contact.movable)
    return MapScore(
        _iou(told_solid, solid, near), _iou(told_free, ~solid, near), right, len(mapping.contacts), mixed
    )


def _iou(mapped: np.ndarray, true: np.ndarray, where: np.ndarray) -> float:
    both, either = (mapped & true & where).sum(), ((mapped | true) & where).sum()
    return float(both / either) if either else 1.0
