"""Floor plans: rooms, a doorway that can be blocked, furniture of realistic size, and an accessible table.

A plan is generated with its doorway crossed along x, and then rotated or mirrored, so that the axes of
the world have no special role. Walls and furniture are cells of ``CELL_M``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int8
from scipy import ndimage

from ...io.maps.occupancy_map import FREE, OCCUPIED, UNKNOWN, OccupancyMap

CELL_M = 0.05
#: Solid border of a plan, and unknown cells beyond it [m].
WALL_M, MARGIN_M = 0.1, 0.2
#: Minimum distance of furniture from paths of a platform, and from its stops [m].
CLEAR_M, STAND_M = 0.3, 0.4
#: Furniture along a wall: depth [m], and range of its length [m].
WALL_FURNITURE = (
    (0.6, (1.2, 2.4)),
    (0.65, (0.6, 0.65)),
    (0.35, (0.8, 2.0)),
    (0.9, (1.4, 2.0)),
    (0.3, (0.3, 0.4)),
)
#: Furniture with four legs of one cell: ranges of its sides [m].
LEGGED_FURNITURE = (((1.0, 1.6), (0.7, 0.9)), ((0.45, 0.45), (0.4, 0.45)))
TABLE = ((1.2, 1.6), (0.8, 0.9))

Box = tuple[float, float, float, float]


@dataclass(slots=True, eq=False)
class FloorPlan:
    """A generated floor."""

    size_m: tuple[float, float]
    cells: Int8[np.ndarray, "rows columns"]
    door_m: tuple[float, float]  #: centre of the doorway
    door_width_m: float
    rooms: list[Box]  #: (x0, y0, x1, y1): start room, and the table's room
    table_m: tuple[float, float] = (math.nan, math.nan)  #: position from which the table is reached
    home_m: tuple[float, float] = (math.nan, math.nan)
    keep: list[Box] = field(default_factory=list)  #: where no furniture is allowed

    @property
    def beside_door_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Before and behind the doorway."""
        x, y = self.door_m
        return (x - 0.8, y), (x + 0.8, y)

    def clearance_m(self) -> Float[np.ndarray, "rows columns"]:
        """Distance of each cell from the nearest occupied cell [m]."""
        return ndimage.distance_transform_edt(self.cells == FREE) * CELL_M

    def index(self, point_m: tuple[float, float]) -> tuple[int, int]:
        """Row and column of a point.

        Parameters
        ----------
        point_m
            Point in the plan [m].
        """
        return int((point_m[1] + MARGIN_M) / CELL_M), int((point_m[0] + MARGIN_M) / CELL_M)

    def reachable(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells that a platform can reach in front of the door."""
        clear = self.clearance_m()
        labels, _ = ndimage.label(clear > CLEAR_M)
        row, column = self.index(self.beside_door_m[0])
        return (labels == labels[row, column]) & (clear > CLEAR_M)

    def fill(self, box: Box, value: int) -> None:
        """Set the cells of a rectangle.

        Parameters
        ----------
        box
            (x0, y0, x1, y1) [m].
        value
            Value of the occupancy map.
        """
        a, b, c, d = (round((v + MARGIN_M) / CELL_M) for v in box)
        self.cells[b : max(d, b + 1), a : max(c, a + 1)] = value

    def as_map(
        self, turn: tuple[bool, bool, bool]
    ) -> tuple[OccupancyMap, Callable[[tuple[float, float]], tuple[float, float]]]:
        """The plan in the world frame, and the transform of its points.

        Parameters
        ----------
        turn
            Whether x and y are exchanged, and then x and y mirrored.
        """
        swap, flip_x, flip_y = turn
        cells = self.cells.T if swap else self.cells
        high_y, high_x = (CELL_M * count - 2 * MARGIN_M for count in cells.shape)
        cells = cells[:: -1 if flip_y else 1, :: -1 if flip_x else 1]

        def place(point_m: tuple[float, float]) -> tuple[float, float]:
            x, y = point_m[::-1] if swap else point_m
            return high_x - x if flip_x else x, high_y - y if flip_y else y

        return OccupancyMap(np.ascontiguousarray(cells), CELL_M, (-MARGIN_M, -MARGIN_M, 0.0)), place


def draw_plan(rng: np.random.Generator) -> FloorPlan:
    """Two or three rooms with furniture; the table's room is reached through one doorway.

    Parameters
    ----------
    rng
        Source of randomness.
    """
    while True:
        plan = _rooms(rng)
        if _place_table(plan, rng):
            break
    for room in plan.rooms:
        count = int(rng.integers(4, 9))
        for _ in range(count):
            _furnish(plan, room, rng)
    plan.home_m = _place_to_stand(plan, plan.rooms[0], rng)
    return plan


def _snapped(rng: np.random.Generator, low_m: float, high_m: float) -> float:
    return CELL_M * round(float(rng.uniform(low_m, high_m)) / CELL_M)


def _rooms(rng: np.random.Generator) -> FloorPlan:
    """Walls: one with the doorway, and sometimes one that separates a third room from the first."""
    wide, deep = _snapped(rng, 7.0, 10.0), _snapped(rng, 4.5, 7.0)
    shape = tuple(round((side + 2 * MARGIN_M) / CELL_M) for side in (deep, wide))
    wall_x = _snapped(rng, 0.45 * wide, 0.62 * wide)
    width = _snapped(rng, 0.9, 1.2)
    y = _snapped(rng, 1.4, deep - 1.4)
    plan = FloorPlan(
        (wide, deep), np.full(shape, UNKNOWN, np.int8), (wall_x, y), width,
        [(0.0, 0.0, wall_x - 0.05, deep), (wall_x + 0.05, 0.0, wide, deep)],
    )  # fmt: skip
    plan.fill((-WALL_M, -WALL_M, wide + WALL_M, deep + WALL_M), OCCUPIED)
    plan.fill((0.0, 0.0, wide, deep), FREE)
    plan.fill((wall_x - 0.05, 0.0, wall_x + 0.05, deep), OCCUPIED)
    plan.fill((wall_x - 0.05, y - 0.5 * width, wall_x + 0.05, y + 0.5 * width), FREE)
    # The first metres before and behind the doorway stay free: objects are pushed there.
    plan.keep = [(wall_x - 1.6, y - 0.8, wall_x + 1.6, y + 0.8)]
    if wall_x > 3.6 and deep > 5.0 and rng.random() < 0.6:
        up = y < 0.5 * deep
        across = _snapped(rng, 2.2, 2.6)
        across = deep - across if up else across
        if abs(across - y) > 1.3:
            gap = _snapped(rng, 0.6, wall_x - 2.0)
            plan.fill((0.0, across - 0.05, wall_x, across + 0.05), OCCUPIED)
            plan.fill((gap, across - 0.05, gap + 1.1, across + 0.05), FREE)
            plan.keep.append((gap - 0.2, across - 1.0, gap + 1.3, across + 1.0))
            plan.rooms[0] = (
                (0.0, across + 0.05, wall_x - 0.05, deep) if up else (0.0, 0.0, wall_x - 0.05, across - 0.05)
            )
    return plan


def _place_table(plan: FloorPlan, rng: np.random.Generator) -> bool:
    """The table with the object, and a free position next to one of its sides."""
    x0, y0, x1, y1 = plan.rooms[1]
    a, b = (float(rng.uniform(*span)) for span in TABLE)
    if rng.random() < 0.5:
        a, b = b, a
    for _ in range(60):
        x, y = float(rng.uniform(x0 + 0.5 * a, x1 - 0.5 * a)), float(rng.uniform(y0 + 0.5 * b, y1 - 0.5 * b))
        box = (x - 0.5 * a, y - 0.5 * b, x + 0.5 * a, y + 0.5 * b)
        sides = [(x, box[1] - 0.45), (x, box[3] + 0.45), (box[0] - 0.45, y), (box[2] + 0.45, y)]
        if _stand_on_legs(plan, box):
            free = plan.reachable() & (plan.clearance_m() > STAND_M)
            able = [
                side for side in sides if x0 < side[0] < x1 and y0 < side[1] < y1 and free[plan.index(side)]
            ]
            if able:
                plan.table_m = able[int(rng.integers(len(able)))]
                plan.keep += [box, _around(plan.table_m, 0.5)]
                return True
            for corner in _legs(box):
                plan.fill(corner, FREE)
    return False


def _around(point_m: tuple[float, float], half_m: float) -> Box:
    return point_m[0] - half_m, point_m[1] - half_m, point_m[0] + half_m, point_m[1] + half_m


def _legs(box: Box) -> list[Box]:
    x0, y0, x1, y1 = box
    return [(x, y, x + CELL_M, y + CELL_M) for x in (x0, x1 - CELL_M) for y in (y0, y1 - CELL_M)]


def _stand_on_legs(plan: FloorPlan, box: Box) -> bool:
    """Draw four legs if there is space for the whole piece."""
    if not _room_for(plan, box):
        return False
    for leg in _legs(box):
        plan.fill(leg, OCCUPIED)
    return True


def _room_for(plan: FloorPlan, box: Box) -> bool:
    x0, y0, x1, y1 = box
    if any(x0 < k[2] and x1 > k[0] and y0 < k[3] and y1 > k[1] for k in plan.keep):
        return False
    (low_row, low_column), (row, column) = plan.index((x0, y0)), plan.index((x1 - 1e-6, y1 - 1e-6))
    return bool((plan.cells[low_row : row + 1, low_column : column + 1] == FREE).all())


def _furnish(plan: FloorPlan, room: Box, rng: np.random.Generator) -> None:
    """One piece of furniture where there is space, unless it would disconnect the free space."""
    x0, y0, x1, y1 = room
    before = plan.cells.copy()
    if rng.random() < 0.6:
        depth, span = WALL_FURNITURE[int(rng.integers(len(WALL_FURNITURE)))]
        length, side = float(rng.uniform(*span)), int(rng.integers(4))
        wide, deep = (length, depth) if side < 2 else (depth, length)
        if min(x1 - x0 - wide, y1 - y0 - deep) <= 0:
            return
        x, y = float(rng.uniform(x0, x1 - wide)), float(rng.uniform(y0, y1 - deep))
        x, y = ((x, y0), (x, y1 - deep), (x0, y), (x1 - wide, y))[side]
        if not _room_for(plan, (x, y, x + wide, y + deep)):
            return
        plan.fill((x, y, x + wide, y + deep), OCCUPIED)
    else:
        spans = LEGGED_FURNITURE[int(rng.integers(len(LEGGED_FURNITURE)))]
        wide, deep = (float(rng.uniform(*span)) for span in spans)
        if min(x1 - x0 - wide, y1 - y0 - deep) <= 0.6:
            return
        x, y = float(rng.uniform(x0 + 0.3, x1 - wide - 0.3)), float(rng.uniform(y0 + 0.3, y1 - deep - 0.3))
        if not _stand_on_legs(plan, (x, y, x + wide, y + deep)):
            return
    reach = plan.reachable()
    room_0 = reach & _inside(plan, plan.rooms[0])
    served = reach[plan.index(plan.table_m)] and reach[plan.index(plan.beside_door_m[1])]
    if not served or room_0.sum() * CELL_M**2 < 1.0:
        plan.cells[:] = before


def _inside(plan: FloorPlan, room: Box) -> Bool[np.ndarray, "rows columns"]:
    mask = np.zeros(plan.cells.shape, dtype=bool)
    (low_row, low_column), (row, column) = plan.index(room[:2]), plan.index(room[2:])
    mask[low_row:row, low_column:column] = True
    return mask


def _place_to_stand(plan: FloorPlan, room: Box, rng: np.random.Generator) -> tuple[float, float]:
    """A reachable position in a room with maximum clearance, up to ``STAND_M``."""
    reach, clear = plan.reachable() & _inside(plan, room), plan.clearance_m()
    need = min(STAND_M, float(clear[reach].max()) - CELL_M)
    rows, columns = np.nonzero(reach & (clear > need))
    k = int(rng.integers(len(rows)))
    return CELL_M * (columns[k] + 0.5) - MARGIN_M, CELL_M * (rows[k] + 0.5) - MARGIN_M
