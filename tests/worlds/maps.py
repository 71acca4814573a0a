"""Floors with walls, doors and movable bodies: exact polygons, rasterised into occupancy grids of any cell size.

A world consists of polygons in metres; ``raster`` creates the map that a planner is given. A cell is occupied where its
square overlaps a wall, so that a grid that refines another one has at least as much free space:
the optimal plan on the finer map cannot be more expensive. Bodies are rasterised by the centres of their cells, as by a
mapper. Bodies keep ``BODY_GAP_M`` from walls, so that rasterisation does not merge the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

__all__ = [
    "BODY_GAP_M", "Body", "Robot", "World", "at", "bar", "box", "disc", "draw", "ell", "overlapped_cells", "place_bodies",
    "raster", "walled",
]  # fmt: skip

GRAVITY_M_S2 = 9.81
#: Minimum initial distance of bodies from walls and each other [m]: more than a cell of 10 cm.
BODY_GAP_M = 0.16
FREE, OCCUPIED, UNKNOWN = 0, 100, -1


@dataclass(frozen=True, slots=True)
class Robot:
    """A disc that drives and pushes; the dissertation's defaults."""

    radius_m: float = 0.17
    v_max_m_s: float = 0.3
    v_min_m_s: float = 0.05
    v_push_m_s: float = 0.05
    push_force_max_N: float = 20.0
    setup_time_s: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body on the floor: outline in the map frame, mass, friction, and centre of mass."""

    id: str
    outline_m: np.ndarray  #: (p, 2), counter-clockwise
    mass_kg: float = 2.0
    friction: float = 0.3  #: with the floor
    fixed: bool = False
    round_m: float = 0.0  #: radius of a disc, whose outline is a polygon around it
    centre_offset_m: tuple[float, float] = (0.0, 0.0)  #: of the mass from the outline's centroid, map frame

    @property
    def polygon(self) -> shapely.Polygon:
        """The outline."""
        return shapely.Polygon(self.outline_m)

    @property
    def centre_m(self) -> np.ndarray:
        """Centroid of the outline's area."""
        centre = self.polygon.centroid
        return np.array([centre.x, centre.y])

    @property
    def force_N(self) -> float:
        """Friction that a push has to overcome."""
        return self.mass_kg * GRAVITY_M_S2 * self.friction

    def moved(self, shift_m: Sequence[float], turn_rad: float = 0.0) -> Body:
        """The body shifted, and turned about its centroid."""
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        turn = np.array([[c, s], [-s, c]])
        centre = self.centre_m
        offset = np.array(self.centre_offset_m) @ turn
        return replace(
            self,
            outline_m=(self.outline_m - centre) @ turn + centre + np.asarray(shift_m, dtype=float),
            centre_offset_m=(float(offset[0]), float(offset[1])),
        )


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A floor from (0, 0) to ``size_m``, its bodies, and a task."""

    name: str
    size_m: tuple[float, float]
    walls: tuple[shapely.Polygon, ...]  #: solid; the border of the floor is one of them
    bodies: tuple[Body, ...]
    start_m: tuple[float, float]
    goal_m: tuple[float, float]
    robot: Robot = field(default_factory=Robot)
    notes: dict[str, object] = field(default_factory=dict)

    @property
    def solid(self) -> BaseGeometry:
        """All walls as one shape."""
        return shapely.union_all(list(self.walls))


def bar(x0: float, y0: float, x1: float, y1: float) -> shapely.Polygon:
    """A wall along the axes [m]."""
    return shapely.box(x0, y0, x1, y1)


def walled(width_m: float, height_m: float, thickness_m: float = 0.1) -> list[shapely.Polygon]:
    """The four walls around a floor, inside it."""
    t = thickness_m
    return [
        bar(0, 0, width_m, t),
        bar(0, height_m - t, width_m, height_m),
        bar(0, 0, t, height_m),
        bar(width_m - t, 0, width_m, height_m),
    ]


def at(outline_m: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    """An outline about the origin, moved to a pose."""
    return outline_m + np.array([x_m, y_m])


def box(width_m: float, depth_m: float, turn_rad: float = 0.0) -> np.ndarray:
    """Corners of a box about its middle."""
    half = 0.5 * np.array([width_m, depth_m])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return _turned(corners, turn_rad)


def disc(radius_m: float, corners: int = 24) -> np.ndarray:
    """A regular polygon that contains the disc."""
    angle = (np.arange(corners) + 0.5) * (2 * np.pi / corners)
    return radius_m / np.cos(np.pi / corners) * np.column_stack([np.cos(angle), np.sin(angle)])


def ell(width_m: float, depth_m: float, arm_m: float, turn_rad: float = 0.0) -> np.ndarray:
    """An L of two arms of the same width, about its centroid."""
    a, b, t = width_m, depth_m, arm_m
    corners = np.array([[0, 0], [a, 0], [a, t], [t, t], [t, b], [0, b]], dtype=float)
    centre = shapely.Polygon(corners).centroid
    return _turned(corners - (centre.x, centre.y), turn_rad)


def _turned(points: np.ndarray, turn_rad: float) -> np.ndarray:
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return points @ np.array([[c, s], [-s, c]])


def overlapped_cells(shape: BaseGeometry, resolution_m: float, size: tuple[int, int]) -> np.ndarray:
    """Rows and columns (n, 2) of the cells whose square overlaps a shape by some area."""
    shape = shapely.intersection(shape, shapely.box(0, 0, size[1] * resolution_m, size[0] * resolution_m))
    if shape.is_empty:
        return np.zeros((0, 2), dtype=int)
    x0, y0, x1, y1 = np.array(shape.bounds) / resolution_m
    # A wall that ends on a cell's border, up to rounding, does not reach into the next cell.
    first = np.floor([y0 + 1e-6, x0 + 1e-6]).astype(int)
    last = np.ceil([y1 - 1e-6, x1 - 1e-6]).astype(int)
    grid = np.mgrid[first[0] : last[0], first[1] : last[1]].reshape(2, -1).T
    if abs(shape.area - shapely.box(*shape.bounds).area) < 1e-9:
        return grid
    inner = 1e-6 * resolution_m
    low = grid[:, ::-1] * resolution_m + inner
    high = (grid[:, ::-1] + 1) * resolution_m - inner
    shapely.prepare(shape)
    return grid[shapely.intersects(shape, shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))]


def draw(cells: np.ndarray, outline_m: np.ndarray, resolution_m: float) -> None:
    """Occupy the cells whose centre is in an outline, in place."""
    low = np.maximum(np.floor(outline_m.min(axis=0) / resolution_m).astype(int), 0)
    high = np.ceil(outline_m.max(axis=0) / resolution_m).astype(int)
    rows = np.arange(low[1], min(high[1], cells.shape[0]))
    columns = np.arange(low[0], min(high[0], cells.shape[1]))
    if not (len(rows) and len(columns)):
        return  # beside the map
    x, y = np.meshgrid((columns + 0.5) * resolution_m, (rows + 0.5) * resolution_m)
    inside = shapely.contains_xy(shapely.Polygon(outline_m), x, y)
    part = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    part[inside] = OCCUPIED


def raster(world: World, resolution_m: float, *, bodies: bool = True) -> np.ndarray:
    """Occupancy of a world, int8 (rows, columns); row 0 is at y = 0, cell (0, 0) begins at the origin."""
    width, height = world.size_m
    size = (round(height / resolution_m), round(width / resolution_m))
    if abs(size[0] * resolution_m - height) + abs(size[1] * resolution_m - width) > 1e-6:
        raise ValueError(f"a floor of {width} x {height} m is no whole number of cells of {resolution_m} m")
    cells = np.full(size, FREE, np.int8)
    for wall in world.walls:
        found = overlapped_cells(wall, resolution_m, size)
        cells[found[:, 0], found[:, 1]] = OCCUPIED
    if bodies:
        for body in world.bodies:
            draw(cells, body.outline_m, resolution_m)
    return cells


def place_bodies(
    rng: np.random.Generator,
    outlines: Sequence[tuple[np.ndarray, float]],
    where: Sequence[tuple[float, float, float, float]],
    walls: Sequence[shapely.Polygon],
    keep_m: Sequence[tuple[float, float]],
    gap_m: float = BODY_GAP_M,
) -> list[tuple[np.ndarray, float]] | None:
    """Put outlines (about their middles, with the radius of discs) at random places that touch nothing.

    Parameters
    ----------
    outlines, where
        What to place, and a rectangle (x0, y0, x1, y1) for the middle of each [m].
    walls, keep_m
        What to stay away from: walls, and points (start, goal) from which a robot has to get away.

    Returns
    -------
    Outlines in the map frame, or None where one found no place.
    """
    tree = shapely.STRtree(list(walls))
    placed: list[tuple[np.ndarray, float]] = []
    for (outline, round_m), (x0, y0, x1, y1) in zip(outlines, where, strict=True):
        for _ in range(200):
            there = np.round(at(outline, rng.uniform(x0, x1), rng.uniform(y0, y1)), 4)
            shape = shapely.Polygon(there)
            if tree.query(shape, predicate="dwithin", distance=gap_m).size:
                continue
            if any(shape.distance(shapely.Point(p)) < 0.45 for p in keep_m):
                continue
            if any(shape.distance(shapely.Polygon(other)) < gap_m for other, _ in placed):
                continue
            placed.append((there, round_m))
            break
        else:
            return None
    return placed
