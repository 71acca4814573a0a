"""The domain of the search over pushes: static obstacles with their clearance, and where each object is.

Everything here is in grid coordinates: cells, x along the columns and y along
the rows of the map, so that a turned origin needs no thought further in.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ....core.geometry import rotation_2d
from ....io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ...grid.cost_grid import OBSTACLE_FROM, SpeedLimits, grid_layers
from ...problem.planning_problem import MovableObject, PlanningProblem, RobotModel
from ...problem.push_costs import Manipulability, PushCosts, manipulability
from ...pushing.contact_candidates import PushContact, push_contacts

__all__ = [
    "Body",
    "SearchDomain",
    "build_search_domain",
    "clear_cells",
    "fill_cells",
    "grid_from_world",
    "world_from_grid",
]

#: Outlines are looked at in steps of so many cells when they are pushed.
OUTLINE_STEP = 0.45
#: ... and so far inside the outline, so that an object flush with a wall may slide along it [cells].
OUTLINE_INSET = 0.15
#: Distance patches that are kept.
MAX_PATCHES = 5000


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A pushable object in grid coordinates, where the map has it."""

    obj: MovableObject
    outline: Float[np.ndarray, "p 2"]
    samples: Float[np.ndarray, "k 2"]  #: points along the outline, a little inside
    around: Float[np.ndarray, "m 2"]  #: points the robot's ``push_margin_m`` outside; none without a margin
    centre: Float[np.ndarray, "2"]
    contacts: tuple[PushContact, ...]
    allowed: Manipulability


@dataclass(frozen=True, slots=True, eq=False)
class SearchDomain:
    """Static map and pushable bodies."""

    map: OccupancyMap
    robot: RobotModel
    radius: float  #: of the robot [cells]
    slow: float  #: v_max / v_min
    occupied: Bool[np.ndarray, "rows columns"]  #: what never moves
    #: of a cell's centre from the border of such cells, and from the outline of objects that never move [cells]
    clearance: Float32[np.ndarray, "rows columns"]
    bodies: tuple[Body, ...]
    immovable: tuple[MovableObject, ...]  #: fixed, falling or too heavy: part of ``occupied``
    why_immovable: dict[str, str]  #: reasons by id
    #: distances around bodies, kept because most bodies stay where they are
    patches: dict[tuple[int, float, float], tuple[Float32[np.ndarray, "r c"], int, int]] = field(
        default_factory=dict, repr=False
    )

    @property
    def reach(self) -> float:
        """Beyond this clearance nothing is slowed down [cells]."""
        return _reach(self.radius)

    def clearance_with(
        self, shifts: Float[np.ndarray, "bodies 2"], without: int = -1
    ) -> Float32[np.ndarray, "rows columns"]:
        """Distance to the nearest obstacle [cells] with every body shifted, one of them left out.

        Parameters
        ----------
        shifts
            Of the bodies from where the map has them [cells].
        without
            Index of the body left out; -1 for none.
        """
        layer = self.clearance.copy()
        for index in range(len(self.bodies)):
            if index != without:
                patch, row, column = self._patch(index, shifts[index])
                part = layer[row : row + patch.shape[0], column : column + patch.shape[1]]
                np.minimum(part, patch, out=part)
        return layer

    def clearance_of(self, index: int, shift: Float[np.ndarray, "2"]) -> Float32[np.ndarray, "rows columns"]:
        """Distance to the nearest obstacle [cells] with one body alone.

        Parameters
        ----------
        index
            Of the body.
        shift
            From where the map has it [cells].
        """
        layer = self.clearance.copy()
        patch, row, column = self._patch(index, shift)
        part = layer[row : row + patch.shape[0], column : column + patch.shape[1]]
        np.minimum(part, patch, out=part)
        return layer

    def _patch(
        self, index: int, shift: Float[np.ndarray, "2"]
    ) -> tuple[Float32[np.ndarray, "r c"], int, int]:
        from ...pushing._outline_kernels import distance_patch

        key = (index, float(shift[0]), float(shift[1]))
        if key not in self.patches:
            if len(self.patches) >= MAX_PATCHES:
                self.patches.clear()
            rows, columns = self.clearance.shape
            self.patches[key] = distance_patch(rows, columns, self.bodies[index].outline + shift, self.reach)
        return self.patches[key]

    def seconds(self, cells_at_full_speed: float) -> float:
        """Cost [s] of a cost in cells at full speed.

        Parameters
        ----------
        cells_at_full_speed
            Cost in the unit of the grid search [cells].
        """
        return cells_at_full_speed * self.map.resolution_m / self.robot.v_max_m_s


def grid_from_world(
    map: OccupancyMap, points_m: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Grid coordinates [cells] of points in the map frame.

    Parameters
    ----------
    map
        The grid.
    points_m
        x, y in the map frame [m].
    """
    x, y, yaw = map.origin
    return (np.asarray(points_m, dtype=np.float64) - (x, y)) @ rotation_2d(yaw) / map.resolution_m


def world_from_grid(
    map: OccupancyMap, points: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Points in the map frame [m] of grid coordinates.

    Parameters
    ----------
    map
        The grid.
    points
        x along the columns, y along the rows [cells].
    """
    x, y, yaw = map.origin
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(points) * map.resolution_m @ np.array([[c, s], [-s, c]]) + (x, y)


def build_search_domain(
    problem: PlanningProblem,
    costs: PushCosts | None = None,
    *,
    pushes: bool = True,
    unknown: bool = True,
    oblique: bool = False,
) -> SearchDomain:
    """Separate a map into what never moves and the bodies that may be pushed.

    Parameters
    ----------
    problem
        Map, objects and robot.
    costs
        Limits that decide what may be pushed.
    pushes
        ``False``: every object stays where it is.
    unknown
        Whether objects that were never touched may be pushed after exploration.
    oblique
        Whether pushes may be oblique to a face, which friction has to hold.
    """
    costs = costs or PushCosts()
    grid, robot = problem.map, problem.robot
    radius = robot.radius_m / grid.resolution_m
    margin = robot.push_margin_m / grid.resolution_m
    # Cells that were never seen are obstacles, too.
    occupied = (grid.cells >= OBSTACLE_FROM) | (grid.cells < 0)
    mapped = occupied.copy()
    movable: list[Body] = []
    fixed: list[MovableObject] = []
    why: dict[str, str] = {}
    for obj in problem.objects:
        outline = grid_from_world(grid, obj.footprint_m)
        clear_cells(occupied, outline)
        allowed = manipulability(obj.tag, robot, costs)
        if not pushes or not allowed.possible or (allowed.unknown and not unknown):
            fixed.append(obj)
            why[obj.id] = allowed.reason or "objects stay where they are"
            continue
        centre = grid_from_world(grid, obj.centre_m)
        movable.append(
            Body(
                obj,
                outline,
                _samples(outline, -OUTLINE_INSET),
                _samples(outline, margin) if margin > 0 else np.zeros((0, 2)),
                centre,
                _contacts(obj, grid, outline, centre, radius, oblique),
                allowed,
            )
        )
    # An object is as large as its outline, whether it may be moved or not.
    clearance = _distance(occupied, radius)
    for obj in fixed:
        outline = grid_from_world(grid, obj.footprint_m)
        lower_clearance(clearance, outline, _reach(radius))
        _keep_cells(occupied, mapped, outline)
    return SearchDomain(
        grid,
        robot,
        radius * (1.0 - 1e-9),
        robot.v_max_m_s / robot.v_min_m_s,
        occupied,
        clearance,
        tuple(movable),
        tuple(fixed),
        why,
    )


def _contacts(
    obj: MovableObject,
    grid: OccupancyMap,
    outline: Float[np.ndarray, "p 2"],
    centre: Float[np.ndarray, "2"],
    radius: float,
    oblique: bool,
) -> tuple[PushContact, ...]:
    """Stable pushes through the centre of friction, report_costs from the centroid."""
    aside = grid_from_world(grid, obj.centre_m + np.array(obj.friction_offset_m)) - centre
    found = push_contacts(outline, centre + aside, radius, oblique=oblique)
    if not aside.any():
        return found
    return tuple(replace(push, contact=push.contact + aside, robot=push.robot + aside) for push in found)


def _distance(
    occupied: Bool[np.ndarray, "rows columns"], radius: float
) -> Float32[np.ndarray, "rows columns"]:
    """Distance to the border of the nearest occupied cell, of those outside too [cells]."""
    cells = np.where(occupied, OCCUPIED, FREE).astype(np.int8)
    return grid_layers(OccupancyMap(cells, 1.0), SpeedLimits(radius)).distance_m


def _reach(radius: float) -> float:
    """Clearance from which on nothing is slowed down, with a cell to spare [cells]."""
    return 3.0 * radius + 1.0


def lower_clearance(
    clearance: Float32[np.ndarray, "rows columns"], outline: Float[np.ndarray, "p 2"], reach: float
) -> None:
    """Bring an object at an outline [cells] into a clearance layer, in place, as far as ``reach``."""
    from ...pushing._outline_kernels import distance_patch

    patch, row, column = distance_patch(*clearance.shape, outline, reach)
    part = clearance[row : row + patch.shape[0], column : column + patch.shape[1]]
    np.minimum(part, patch, out=part)


def _samples(outline: Float[np.ndarray, "p 2"], outside: float) -> Float[np.ndarray, "k 2"]:
    """Points along the outline, a little outside (inside where negative) [cells]."""
    import shapely

    body = shapely.Polygon(outline)
    inner = body.buffer(outside, join_style="mitre")
    rings = [part.exterior for part in getattr(inner, "geoms", [inner]) if not part.is_empty] or [
        body.exterior
    ]
    points = []
    for ring in rings:
        corners = np.array(ring.coords)[:-1]
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            count = max(1, int(np.ceil(np.hypot(*(b - a)) / OUTLINE_STEP)))
            points.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(points)


def _keep_cells(
    occupied: Bool[np.ndarray, "rows columns"],
    mapped: Bool[np.ndarray, "rows columns"],
    outline: Float[np.ndarray, "p 2"],
) -> None:
    """Occupy the cells of an object that stays as the map draws it, for what is pushed beside it.

    Where the map does not show all of it, every cell that it touches is taken.
    """
    window = _window(occupied.shape, outline, 1.0)
    if not occupied[window].size:
        return
    touched = _touched(outline, window)
    shown = mapped[window] | ~_covered(outline, window)
    occupied[window] |= touched & mapped[window] if shown.all() else touched


def _covered(outline: Float[np.ndarray, "p 2"], window: tuple[slice, slice]) -> Bool[np.ndarray, "r c"]:
    """Cells of a window whose centre is inside the outline."""
    import shapely

    r, c = np.mgrid[window]
    return np.asarray(shapely.contains_xy(shapely.Polygon(outline), c + 0.5, r + 0.5))


def _window(shape: tuple[int, int], outline: Float[np.ndarray, "p 2"], grow: float) -> tuple[slice, slice]:
    c0, r0 = np.maximum(np.floor(outline.min(axis=0) - grow).astype(int), 0)
    c1, r1 = np.ceil(outline.max(axis=0) + grow).astype(int)
    return slice(min(r0, shape[0]), max(min(r1, shape[0]), 0)), slice(
        min(c0, shape[1]), max(min(c1, shape[1]), 0)
    )


def _touched(outline: Float[np.ndarray, "p 2"], window: tuple[slice, slice]) -> Bool[np.ndarray, "r c"]:
    """Cells of a window whose square meets the outline's inside."""
    import shapely

    r, c = np.mgrid[window]
    body = shapely.Polygon(outline).buffer(-1e-6)  # a square that the outline only touches is not its own
    shapely.prepare(body)
    return np.asarray(shapely.intersects(body, shapely.box(c, r, c + 1, r + 1)))


def clear_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Float[np.ndarray, "p 2"]) -> None:
    """Free an object's cells in place: those it covers, and spurious components beside it.

    Parameters
    ----------
    occupied
        Whether a cell is an obstacle; changed in place.
    outline
        Corners in grid coordinates [cells].
    """
    from .._joint_kernels import free_object

    window = _window(occupied.shape, outline, 4.0)
    part = np.ascontiguousarray(occupied[window])
    if part.size:
        free_object(part, outline, window[0].start, window[1].start)
        occupied[window] = part


def fill_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Float[np.ndarray, "p 2"]) -> None:
    """Occupy the cells that an object covers, in place.

    Parameters
    ----------
    occupied
        Whether a cell is an obstacle; changed in place.
    outline
        Corners in grid coordinates [cells].
    """
    window = _window(occupied.shape, outline, 1.0)
    if occupied[window].size:
        occupied[window] |= _touched(outline, window)
