"""Doors from the geometry of a map: gaps of door width in walls, with a room on either side.

The narrow places of the map (:mod:`.door_openings`) are measured, and all are closed at once to find the rooms they
separate. The log-odds of a door are a weighted sum of the measures. From these, a path around each opening is found
that minimizes the maximum door probability along it, and the room on either side, which ends at openings that are more
likely doors. Both enter a second sum: furniture in a room can be passed on another side, a door cannot; and a bay
between shelves has the jambs of a door, but not the size of a room. Both sums are logistic regressions on generated and real buildings, whose weights
``python -m benchmarks.doors_training`` writes to ``door_weights.json``.

Not visible on a map: a closed door looks like wall, and an opening may or may not have a
wing. Openings between rooms are reported, with or without wing.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
from jaxtyping import Bool, Float, Int32

from ...core.errors import InputError
from ...core.ranges import POSITIVE, check_order, check_ranges, within
from ...io.maps.occupancy_map import OccupancyMap
from .door_openings import (
    LONG_M,
    MEASURES,
    DoorSpace,
    Opening,
    free_space,
    look,
    measure,
    narrow_places,
    without_gaps,
)

#: Names of the measures of an opening in the plan of the rooms.
PLAN_MEASURES = (
    "around",  #: minimum over all paths around it of the maximum door probability on the path; 1 without a path
    "room",  #: log of the edge length [m] of a square as large as the smaller side, which ends at likelier doors
)
#: Minimum area of a numbered room (m^2).
_ROOM_M2 = 0.8
#: Narrower gaps (m) do not connect rooms unless they are doors: scans leave many in a glass wall.
_ROOM_GAP_M = 0.56
#: Openings whose centres are nearer than this (m) are one door: the narrowest two need 0.4 m and a pier between them.
_SAME_DOOR_M = 0.6


@dataclass(frozen=True, slots=True)
class DoorSettings:
    """Criteria for a door."""

    #: between the jambs; a door of 0.7 m keeps half a metre between walls that noise has thickened
    min_width_m: float = field(default=0.42, metadata=POSITIVE)
    max_width_m: float = 2.0
    #: on buildings outside the training set, recall and precision are about equal at this value
    min_confidence: float = field(default=0.45, metadata=within(0, 1))

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_width_m", "max_width_m")


@dataclass(frozen=True, slots=True, eq=False)
class Door:
    """An opening between two rooms, in the map frame."""

    jambs_m: Float[np.ndarray, "2 2"]  #: (x, y) of both jambs
    width_m: float  #: free width between them
    passage: Float[np.ndarray, "2"]  #: unit vector (x, y) through the door, from the first room to the second
    rooms: tuple[int, int]  #: numbers in :attr:`DoorMap.rooms`; 0 if the room behind it is unknown
    confidence: float  #: probability that it is a door, 0..1

    @property
    def middle_m(self) -> Float[np.ndarray, "2"]:
        """Midpoint of the jambs (x, y) [m]."""
        return np.asarray(self.jambs_m.mean(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class DoorMap:
    """Doors and the rooms between them."""

    doors: tuple[Door, ...]  #: by descending confidence
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
        metre are treated as walls.
    settings
        Range of widths and the minimum confidence.

    Returns
    -------
    DoorMap
        Doors with confidence, and the rooms that they connect.

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
    space, openings, measures = door_candidates(grid, settings)
    by_shape, in_plan = _weights()
    plan = plan_measures(*room_pairs(space, openings), door_probability(measures, by_shape))
    confidence = door_probability(np.column_stack([measures, plan]), in_plan)
    return select_doors(grid, space, openings, confidence, settings.min_confidence)


def door_probability(
    measures: Float[np.ndarray, "openings measures"], weights: Float[np.ndarray, "measures+1"]
) -> Float[np.ndarray, "openings"]:
    """Probability that each opening is a door, 0..1.

    Parameters
    ----------
    measures
        Measures of each opening.
    weights
        Weight of each measure, and the constant.

    Raises
    ------
    InputError
        The number of weights is not one more than the number of measures.
    """
    if len(weights) != measures.shape[1] + 1:
        raise InputError(
            "door_probability",
            f"found {len(weights)} weights, expected {measures.shape[1] + 1}",
            field="weights",
        )
    return np.asarray(1.0 / (1.0 + np.exp(-(measures @ weights[:-1] + weights[-1]))))


def plan_measures(
    rooms: list[tuple[int, int]],
    area_m2: Float[np.ndarray, "rooms+1"],
    probability: Float[np.ndarray, "openings"],
) -> Float[np.ndarray, "openings 2"]:
    """Measures of each opening in the plan of the rooms (``PLAN_MEASURES``).

    Edges of a minimum spanning tree count as openings without a path around: any alternative is at least as likely a door.

    Parameters
    ----------
    rooms, area_m2
        From :func:`room_pairs`.
    probability
        Probability that each opening is a door.
    """
    found = np.ones((len(rooms), 2))
    tree: dict[int, list[tuple[int, float]]] = {}
    for k in np.argsort(probability, kind="stable").tolist():
        first, second = rooms[k]
        likeliest = _likeliest(tree, first)
        smaller_m2 = min(float(area_m2[list(side)].sum()) for side in (likeliest, _likeliest(tree, second)))
        found[k, 1] = np.log(np.clip(np.sqrt(smaller_m2), np.sqrt(_ROOM_M2), LONG_M))
        if second in likeliest and first:
            found[k, 0] = likeliest[second]
        elif first and second:
            tree.setdefault(first, []).append((second, float(probability[k])))
            tree.setdefault(second, []).append((first, float(probability[k])))
    return found


def _likeliest(tree: dict[int, list[tuple[int, float]]], room: int) -> dict[int, float]:
    """Rooms connected with a room, and the maximum door probability on the way to each."""
    found, waiting = {room: 0.0}, [room]
    while waiting:
        here = waiting.pop()
        for there, door in tree.get(here, ()):
            if there not in found:
                found[there] = max(found[here], door)
                waiting.append(there)
    return found


def select_doors(
    grid: OccupancyMap,
    space: DoorSpace,
    openings: list[Opening],
    confidence: Float[np.ndarray, "openings"],
    min_confidence: float,
) -> DoorMap:
    """The openings with sufficient confidence, one at each place, and the rooms between them.

    Parameters
    ----------
    grid
        See :func:`find_doors`.
    space, openings
        From :func:`door_candidates`.
    confidence
        Probability that each opening is a door, 0..1.
    min_confidence
        Lower limit.

    Returns
    -------
    DoorMap
        Doors by descending confidence.
    """
    taken: list[tuple[Opening, float]] = []
    for number in np.argsort(-confidence, kind="stable"):
        middle = openings[number].middle
        far_m = [float(np.hypot(*(other.middle - middle))) * space.resolution_m for other, _ in taken]
        if confidence[number] >= min_confidence and min(far_m, default=np.inf) >= _SAME_DOOR_M:
            taken.append((openings[number], float(confidence[number])))
    return _with_rooms(grid, space, taken)


def door_candidates(
    grid: OccupancyMap, settings: DoorSettings
) -> tuple[DoorSpace, list[Opening], Float[np.ndarray, "openings measures"]]:
    """Openings of door width, and their measures (``MEASURES`` of :mod:`.door_openings`).

    Parameters
    ----------
    grid
        See :func:`find_doors`.
    settings
        Range of widths.

    Returns
    -------
    tuple
        Searched space, openings, measures of each.
    """
    space = free_space(grid)
    found = [measure(space, place) for place in narrow_places(space, settings.max_width_m)]
    openings = [
        o for o in found if o is not None and settings.min_width_m <= o.width_m <= settings.max_width_m
    ]
    return space, openings, np.array([o.measures for o in openings]).reshape(-1, len(MEASURES))


@cache
def _weights() -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "n"]]:
    """Weights of the measures and the constant, without and with the surrounding doors."""
    weights = json.loads((resources.files(__package__) / "door_weights.json").read_text(encoding="utf-8"))
    shape, plan = ([*MEASURES, *more, "constant"] for more in ((), PLAN_MEASURES))
    by_shape = np.array([weights["by_shape"][name] for name in shape], dtype=np.float64)
    return by_shape, np.array([weights["in_plan"][name] for name in plan], dtype=np.float64)


def _closed(space: DoorSpace, openings: list[Opening]) -> Bool[np.ndarray, "rows columns"]:
    """Free space without the lines between the jambs."""
    import cv2

    lines = np.zeros(space.free.shape, dtype=np.uint8)
    for opening in openings:
        first, second = ([round(float(v)) for v in jamb[::-1]] for jamb in opening.jambs)
        cv2.line(lines, first, second, 1, 2)
    return space.free & (lines == 0)


def room_pairs(
    space: DoorSpace, openings: list[Opening]
) -> tuple[list[tuple[int, int]], Float[np.ndarray, "rooms+1"]]:
    """Numbers of the two rooms that each opening connects, with all openings closed, and the area of each number [m^2].

    Number 0 is unknown, of area 0.

    Parameters
    ----------
    space, openings
        From :func:`door_candidates`.
    """
    from scipy import ndimage

    rooms, _ = ndimage.label(_closed(space, openings))
    first, second = ([_room_at(rooms, o, sign, space.resolution_m) for o in openings] for sign in (-1.0, 1.0))
    area_m2 = np.bincount(rooms.ravel()) * space.resolution_m**2
    area_m2[0] = 0.0
    return list(zip(first, second, strict=True)), area_m2


def _room_at(rooms: np.ndarray, opening: Opening, sign: float, resolution_m: float) -> int:
    """First room on one side, up to 0.7 m from the opening."""
    steps = sign * np.arange(0.15, 0.7, 0.5 * resolution_m) / resolution_m
    found = look(rooms, opening.middle + steps[:, None] * opening.passage)
    return int(found[np.argmax(found > 0)])


def _with_rooms(grid: OccupancyMap, space: DoorSpace, taken: list[tuple[Opening, float]]) -> DoorMap:
    """Number the rooms, and find the rooms that each door connects."""
    from scipy import ndimage

    free = _closed(space, [opening for opening, _ in taken])
    rooms, count = ndimage.label(without_gaps(free, _ROOM_GAP_M, space.resolution_m))
    area = np.bincount(rooms.ravel(), minlength=count + 1) * space.resolution_m**2
    good = area >= _ROOM_M2
    good[0] = False
    number = np.where(good, np.cumsum(good), 0)
    rooms = number[rooms].astype(np.int32)
    doors = []
    for opening, confidence in taken:
        jambs_m = grid.world_from_cell(opening.jambs)
        ends = grid.world_from_cell(np.stack([opening.middle, opening.middle + opening.passage]))
        passage = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        sides = [_room_at(rooms, opening, sign, space.resolution_m) for sign in (-1.0, 1.0)]
        doors.append(Door(jambs_m, opening.width_m, passage, (sides[0], sides[1]), confidence))
    return DoorMap(tuple(doors), rooms)
