"""A furnished office of this project, and positions for obstacles in any occupancy map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core import InputError, compose_2d, wrap_angle
from ...io.maps.occupancy_map import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from .obstacles import SimulatedObstacle, box, cylinder, table

#: Clearance on both sides of a path, free gap between foam and obstacle at its start, and free length behind [m].
ROBOT_RADIUS_M, APPROACH_M, PUSH_M = 0.2, 0.35, 0.35


@dataclass(frozen=True, slots=True)
class ApproachPath:
    """A straight path to one obstacle, collision-free in the map, and its continuation behind the obstacle."""

    obstacle: SimulatedObstacle
    start: tuple[float, float, float]  #: initial platform pose (x [m], y [m], heading [rad])
    distance_m: float  #: from the platform's centre to that of the obstacle


@dataclass(frozen=True, slots=True, eq=False)
class Office:
    """Map and obstacles."""

    map: OccupancyMap
    paths: tuple[ApproachPath, ...]  #: light, heavy, fixed
    furniture: tuple[SimulatedObstacle, ...] = ()  #: already drawn in the map

    @property
    def obstacles(self) -> tuple[SimulatedObstacle, ...]:
        """The obstacles at the ends of the paths."""
        return tuple(path.obstacle for path in self.paths)


def furnished_office() -> Office:
    """An office of 8 m x 6 m with two rooms, desks, shelves and a meeting table."""
    resolution = 0.05
    cells = np.full((128, 168), UNKNOWN, dtype=np.int8)

    def fill(x0: float, y0: float, x1: float, y1: float, value: int) -> None:
        a, b = (round((v + 0.2) / resolution) for v in (x0, x1))
        c, d = (round((v + 0.2) / resolution) for v in (y0, y1))
        cells[c:d, a:b] = value

    fill(-0.1, -0.1, 8.1, 6.1, OCCUPIED)
    fill(0.0, 0.0, 8.0, 6.0, FREE)
    fill(4.95, 0.0, 5.05, 6.0, OCCUPIED)  # wall between the rooms
    fill(4.95, 2.4, 5.05, 3.5, FREE)  # its doorway
    shelves = ((0.0, 5.65, 2.4, 6.0), (7.65, 0.5, 8.0, 2.5), (5.05, 5.7, 6.6, 6.0), (0.0, 0.0, 0.45, 0.9))
    for shelf in shelves:
        fill(*shelf, OCCUPIED)
    desks = (
        table("desk 1", 0.45, 2.6, (0.8, 1.6, 0.72)),
        table("desk 2", 0.45, 4.4, (0.8, 1.6, 0.72)),
        table("desk 3", 6.4, 0.45, (1.6, 0.8, 0.72)),
        table("meeting table", 6.6, 4.2, (1.6, 0.9, 0.72), leg_m=0.05),
    )
    for desk in desks:
        for leg in desk.outlines:
            x, y = np.asarray(leg.vertices_m).mean(axis=0) + np.array([desk.x_m, desk.y_m])
            half = 0.5 * desk.leg_m
            fill(x - half, y - half, x + half, y + half, OCCUPIED)
    map = OccupancyMap(cells, resolution, (-0.2, -0.2, 0.0))
    return Office(map, obstacles_for_map(map), desks)


def obstacles_for_map(map: OccupancyMap) -> tuple[ApproachPath, ApproachPath, ApproachPath]:
    """Three reachable positions for a light, a heavy and a fixed obstacle, each at the end of a straight path.

    A corridor as wide as the platform, from behind the start of the path to the
    end of the push, is free of occupied and unknown cells and of the other
    obstacles. All starts are in the largest connected part of the free space.

    Parameters
    ----------
    map
        Any map.

    Raises
    ------
    InputError
        The map has no room for three obstacles.
    """
    import cv2

    resolution_m = map.resolution_m
    free = (map.cells == FREE).astype(np.uint8)
    # A border of obstacles: the world ends at the edge of the map.
    padded = np.pad(free, 1)
    clearance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * resolution_m
    wide = (clearance > ROBOT_RADIUS_M + resolution_m).astype(np.uint8)
    region = _region(wide)
    rows, columns = np.nonzero(region)
    if not len(rows):
        raise InputError(
            "map",
            f"no free place wider than {2 * ROBOT_RADIUS_M} m",
            remedy="check free_thresh and resolution",
        )
    rng = np.random.default_rng(0)
    order = rng.permutation(len(rows))
    # Positions with the largest clearance first, in random order within 10 cm.
    order = order[np.argsort(-np.floor(clearance[rows, columns] / 0.1)[order], kind="stable")]
    sample = order[:: max(1, len(order) // 4000)]
    found: list[ApproachPath] = []
    taken: list[tuple[float, float, float]] = []
    for obstacle in _three():
        reach = 0.5 * obstacle.length_m
        before = ROBOT_RADIUS_M + 0.03 + APPROACH_M + reach
        behind = reach + (PUSH_M if not obstacle.fixed else 0.05)
        for index in sample:
            place = (float(columns[index]) + 0.5, float(rows[index]) + 0.5)
            way = _way(clearance, region, place, before, behind, resolution_m, taken)
            if way is not None:
                break
        else:
            raise InputError(
                "map",
                f"no room for obstacle {obstacle.name!r}: found no free path of {before + behind:.2f} m",
                remedy="use a map with more free space",
            )
        heading, points = way
        taken += points
        x, y, yaw = compose_2d(map.origin, (place[0] * resolution_m, place[1] * resolution_m, heading))
        yaw = wrap_angle(yaw)
        start = (x - before * math.cos(yaw), y - before * math.sin(yaw), yaw)
        found.append(ApproachPath(obstacle.moved(x, y, yaw), start, before))
    return found[0], found[1], found[2]


def _three() -> tuple[SimulatedObstacle, SimulatedObstacle, SimulatedObstacle]:
    """Light, heavy and fixed obstacle of the demonstration, not yet positioned."""
    light = cylinder(
        "light bin", 0, 0, 0.09, 0.28, mass_kg=0.5, friction=0.35, grey=105, texture=7, seed=1, material="metal",
        bgr=(150.0, 105.0, 45.0),
    )  # fmt: skip
    # Maximum mass that a strip of foam can push over this width without densification.
    heavy = box(
        "heavy box", 0, 0, (0.16, 0.18, 0.3), mass_kg=1.6, friction=0.38, grey=95, texture=14, seed=2,
        bgr=(70.0, 105.0, 140.0),
    )  # fmt: skip
    leg = box(
        "fixed leg", 0, 0, (0.05, 0.05, 0.7), fixed=True, grey=70, texture=12, seed=3, material="wood",
        bgr=(45.0, 70.0, 100.0),
    )  # fmt: skip
    return light, heavy, leg


def _region(wide: np.ndarray) -> Bool[np.ndarray, "rows columns"]:
    """The largest connected part of the free space."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(wide, connectivity=4)
    if count < 2:
        return np.zeros(wide.shape, dtype=bool)
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _way(
    clearance: Float[np.ndarray, "rows columns"], region: Bool[np.ndarray, "rows columns"],
    place: tuple[float, float], before_m: float, behind_m: float, resolution_m: float,
    taken: list[tuple[float, float, float]],
) -> tuple[float, list[tuple[float, float, float]]] | None:  # fmt: skip
    """Heading of a free straight path to a position, and the discs it covers (cells, radius in cells)."""
    steps = np.arange(-before_m, behind_m + 1e-9, 0.5 * resolution_m) / resolution_m
    need = ROBOT_RADIUS_M / resolution_m
    for heading in np.arange(16) * math.pi / 8:
        x, y = place[0] + steps * math.cos(heading), place[1] + steps * math.sin(heading)
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        if (
            min(row.min(), column.min()) < 0
            or row.max() >= region.shape[0]
            or column.max() >= region.shape[1]
        ):
            continue
        # One cell of margin: the clearance is that of the cell's centre.
        if not region[row[0], column[0]] or (clearance[row, column] < ROBOT_RADIUS_M + resolution_m).any():
            continue
        if any((np.hypot(x - u, y - v) < r + need + 1).any() for u, v, r in taken):
            continue
        return float(heading), [(float(u), float(v), need) for u, v in zip(x[::4], y[::4], strict=True)]
    return None
