"""Doors from the geometry of a map: gaps of door width in walls, with a room on either side.

The narrow places of the map (:mod:`.door_openings`) are scored by their shape
and by what closing all of them separates. The best is taken first and closed;
the others are measured again, because two doors side by side make the piece of
corridor between them look like a third.

What a map cannot show: a closed door is wall, and whether an opening has a
wing. Openings between rooms are reported, with or without wing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int32

from ...core.errors import InputError
from ...core.ranges import POSITIVE, check_ranges, within
from ...io.maps.occupancy_map import OccupancyMap
from .door_openings import MEASURES, DoorSpace, Opening, free_space, measure, narrow_places

__all__ = ["Door", "DoorMap", "DoorSettings", "find_doors"]

#: Weights of the measures, the two of what lies behind, and the constant, of a logistic score. Fitted with
#: ridge regularisation to the openings of two floors of an office building and looked at on a dozen other maps.
_WEIGHTS = {
    "too_wide_m": -1.7,
    "too_narrow_m": -11.0,
    "recess": 0.2,
    "crossed_recess": 0.5,
    "widening": 4.2,
    "turn_rad": -3.0,
    "straightness": 5.3,
    "thickness_m": -2.3,
    "wall_length": 0.65,
    "separates": 1.75,
    "room": 2.15,
}
_CONSTANT = -11.15

#: Rooms smaller than this (m^2), or with a smaller free circle (radius, m), are no rooms.
_ROOM_M2, _ROOM_CIRCLE_M = 0.8, 1.2
#: Factor of the confidence of a gap inside one room.
_SAME_ROOM = 0.5


@dataclass(frozen=True, slots=True)
class DoorSettings:
    """What counts as a door."""

    narrowest_m: float = field(default=0.6, metadata=POSITIVE)  #: between the jambs
    widest_m: float = 2.0
    min_confidence: float = field(
        default=0.4, metadata=within(0, 1)
    )  #: found nine of ten drawn doors of two floors with four wrong in ten

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.narrowest_m < self.widest_m:
            raise InputError(
                "DoorSettings",
                f"found {self.widest_m}, expected more than narrowest_m ({self.narrowest_m})",
                field="widest_m",
            )


@dataclass(frozen=True, slots=True, eq=False)
class Door:
    """An opening between two rooms, in the map frame."""

    jambs_m: Float[np.ndarray, "2 2"]  #: (x, y) of both jambs
    width_m: float  #: free width between them
    passage: Float[np.ndarray, "2"]  #: unit vector (x, y) through the door, from the first room to the second
    rooms: tuple[int, int]  #: numbers in :attr:`DoorMap.rooms`; 0 where no room is known behind it
    confidence: float  #: 0..1

    @property
    def middle_m(self) -> Float[np.ndarray, "2"]:
        """Between the jambs (x, y) [m]."""
        return np.asarray(self.jambs_m.mean(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class DoorMap:
    """Doors and the rooms between them."""

    doors: tuple[Door, ...]  #: the most certain first
    rooms: Int32[np.ndarray, "rows columns"]  #: 0 no room; 1.. free space with all doors closed

    @property
    def adjacency(self) -> frozenset[tuple[int, int]]:
        """Pairs of rooms with a door between them, the lower number first."""
        pairs = (tuple(sorted(door.rooms)) for door in self.doors if min(door.rooms) > 0)
        return frozenset((a, b) for a, b in pairs if a != b)


def find_doors(grid: OccupancyMap, settings: DoorSettings | None = None) -> DoorMap:
    """Find doors in a map.

    Parameters
    ----------
    grid
        Occupied cells are walls and furniture; unknown areas above a square
        metre are taken for wall.
    settings
        Range of widths and the least confidence.

    Returns
    -------
    DoorMap
        Doors with confidence, and the rooms that they join.

    Examples
    --------
    >>> import numpy as np
    >>> cells = np.full((80, 120), 100, np.int8)
    >>> cells[2:78, 2:58] = 0
    >>> cells[2:78, 61:118] = 0
    >>> cells[30:48, 58:61] = 0  # a door of 0.9 m in the wall between two rooms
    >>> found = find_doors(OccupancyMap(cells, 0.05))
    >>> len(found.doors), round(found.doors[0].width_m, 1), found.adjacency
    (1, 0.9, frozenset({(1, 2)}))
    """
    settings = settings or DoorSettings()
    space = free_space(grid)
    openings = [
        opening
        for place in narrow_places(space, settings.widest_m)
        if (opening := measure(space, space.free, place)) is not None and _fits(opening, settings)
    ]
    behind = _behind(space, openings)
    first = [_confidence(opening, *both) for opening, both in zip(openings, behind, strict=True)]
    taken: list[tuple[Opening, float]] = []
    free = space.free.copy()
    for number in np.argsort([-value for value in first], kind="stable"):
        if first[number] < 0.5 * settings.min_confidence:
            break
        found = _again(space, free, openings[number], settings) if taken else openings[number]
        if found is None:
            continue
        confidence = min(_confidence(found, *behind[number]), first[number])
        if confidence >= settings.min_confidence:
            taken.append((found, confidence))
            free &= ~_line(free.shape, found)
    return _with_rooms(grid, space, _kept(space, free, taken, settings.min_confidence))


def _kept(
    space: DoorSpace,
    free: Bool[np.ndarray, "rows columns"],
    taken: list[tuple[Opening, float]],
    min_confidence: float,
) -> list[tuple[Opening, float]]:
    """Half the confidence for a gap that has the same room on both sides when every door is closed."""
    from scipy import ndimage

    rooms, _ = ndimage.label(free)
    kept = []
    for opening, confidence in taken:
        here, there = (_room_at(rooms, opening, sign, space.resolution_m) for sign in (1.0, -1.0))
        weighed = confidence * (_SAME_ROOM if here == there else 1.0)
        if weighed >= min_confidence:
            kept.append((opening, weighed))
    return sorted(kept, key=lambda pair: -pair[1])


def _fits(opening: Opening, settings: DoorSettings) -> bool:
    return settings.narrowest_m <= opening.width_m <= settings.widest_m


def _again(
    space: DoorSpace, free: Bool[np.ndarray, "rows columns"], before: Opening, settings: DoorSettings
) -> Opening | None:
    """The opening with the doors closed that are known by now; None where nothing is left of it."""
    if not free[tuple(before.place)]:
        return None
    now = measure(space, free, before.place)
    if now is None or not _fits(now, settings):
        return None
    # The closed door is no jamb of another.
    return now if np.abs(now.jambs - before.jambs).max() * space.resolution_m < 0.3 else None


def _line(shape: tuple[int, ...], opening: Opening) -> Bool[np.ndarray, "rows columns"]:
    """Cells of the closed door."""
    import cv2

    mask = np.zeros(shape, dtype=np.uint8)
    ends = [tuple(int(round(v)) for v in jamb[::-1]) for jamb in opening.jambs]
    cv2.line(mask, ends[0], ends[1], 1, 2)
    return mask > 0


def _behind(space: DoorSpace, openings: list[Opening]) -> list[tuple[bool, float]]:
    """With all openings closed that could be doors: is it another room behind, and how large is the smaller one.

    All at once, because a room with two doors is separated only when both are closed.
    """
    from scipy import ndimage

    from .door_openings import distance_cells

    r = space.resolution_m
    free = space.free.copy()
    for opening in openings:
        if opening.measures[MEASURES.index("recess")] > np.log(0.2):
            free &= ~_line(free.shape, opening)
    rooms, count = ndimage.label(free)
    numbers = np.arange(count + 1)
    area = np.bincount(rooms.ravel(), minlength=count + 1) * r * r
    circle = np.asarray(ndimage.maximum(distance_cells(free), rooms, numbers)) * r
    good = (area >= _ROOM_M2) & (numbers > 0)
    found = []
    for opening in openings:
        sides = [_room_at(rooms, opening, sign, r) for sign in (1.0, -1.0)]
        apart = sides[0] != sides[1] and bool(good[sides].all())
        found.append((apart, float(min(circle[sides].min(), _ROOM_CIRCLE_M)) if min(sides) else 0.0))
    return found


def _room_at(rooms: np.ndarray, opening: Opening, sign: float, resolution_m: float) -> int:
    """First room on one side, up to 0.7 m from the opening."""
    for t in np.arange(0.15, 0.7, 0.5 * resolution_m):
        row, column = np.rint(opening.middle + sign * t / resolution_m * opening.passage).astype(int)
        if 0 <= row < rooms.shape[0] and 0 <= column < rooms.shape[1] and rooms[row, column]:
            return int(rooms[row, column])
    return 0


def _confidence(opening: Opening, apart: bool, circle_m: float) -> float:
    values = [*opening.measures, float(apart), circle_m]
    score = _CONSTANT + float(np.dot(list(_WEIGHTS.values()), values))
    return float(1.0 / (1.0 + np.exp(-np.clip(score, -30, 30))))


def _with_rooms(
    grid: OccupancyMap,
    space: DoorSpace,
    taken: list[tuple[Opening, float]],
) -> DoorMap:
    """Number the rooms, and tell of each door which it joins."""
    from scipy import ndimage

    free = space.free.copy()
    for opening, _ in taken:
        free &= ~_line(free.shape, opening)
    rooms, count = ndimage.label(free)
    area = np.bincount(rooms.ravel(), minlength=count + 1) * space.resolution_m**2
    good = area >= _ROOM_M2
    good[0] = False
    number = np.where(good, np.cumsum(good), 0)
    rooms = number[rooms].astype(np.int32)
    doors = []
    for opening, confidence in taken:
        jambs_m = _place_m(grid, opening.jambs)
        ends = _place_m(grid, np.stack([opening.middle, opening.middle + opening.passage]))
        passage = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        sides = [_room_at(rooms, opening, sign, space.resolution_m) for sign in (-1.0, 1.0)]
        doors.append(Door(jambs_m, opening.width_m, passage, (sides[0], sides[1]), confidence))
    return DoorMap(tuple(doors), rooms)


def _place_m(grid: OccupancyMap, cells: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Map frame of places (row, column) between the centres of cells."""
    x, y, yaw = grid.origin
    c, s = np.cos(yaw), np.sin(yaw)
    local = (cells[:, ::-1] + 0.5) * grid.resolution_m
    return local @ np.array([[c, s], [-s, c]]) + [x, y]
