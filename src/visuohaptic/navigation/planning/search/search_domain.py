"""The domain of the search over pushes: static obstacles with their clearance, and the pushable objects.

Everything here is in grid coordinates: cells, x along the columns and y along the rows of the map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Int32

from ....io.maps.occupancy_map import OccupancyMap
from ...problem.passages import Passage
from ...problem.planning_problem import MovableObject, PlanningProblem
from ...problem.push_costs import PushCosts
from ...problem.robot_model import RobotModel
from ...pushing._outline_kernels import clear_straight, distance_patch, obstacle_distances
from ...pushing.push_model import PushModel
from ..arrays import Among, Clearance, Labels, Nodes, Outline, Path, Point, Shifts
from ._push_search_kernels import block_patch
from ._travel_kernels import UNITS, nodes_around
from .bodies import Body, joined_outlines, lower_window, sampled
from .bodies import grid_from_world as grid_from_world
from .bodies import world_from_grid as world_from_grid
from .push_states import full_speed_clearance

#: Tolerance of a clearance for rounding errors of coordinates [m].
CLEAR_SLACK_M = 1e-6
#: Spacing of the samples along a path where its cost is summed [radii]: the error of a midpoint is of second order.
SAMPLE = 0.125
#: Maximum number of cached distance patches.
MAX_PATCHES = 5000
#: Bytes of the arrays on which a cached result depends.
Key = tuple[bytes, ...]
#: Maximum distance from a body in the blocks around it, and the first row and column.
Patch = tuple[Clearance, int, int]
#: Model, maximum length [m], pushes by rows by x, y, rotation.
PushEnds = tuple[PushModel, float, Float[np.ndarray, "n k 3"]]
#: Cells along a path, the clearance around it, the cell (x, y) at which both start, and the cost of the path [cells].
Corridor = tuple[Path, Clearance, Point, float]


@dataclass(frozen=True, eq=False, repr=False)
class SearchDomain:
    """Static map and pushable bodies, with the lattice on which drives between pushes are searched.

    A node of the lattice is a block of cells with the clearance of its clearest cell, so that whatever is disconnected on
    the lattice is also disconnected on the map. The drives of a plan are computed on the map itself.
    """

    problem: PlanningProblem
    costs: PushCosts  #: with which the plans' durations are computed
    map: OccupancyMap
    robot: RobotModel
    radius: float  #: clearance that the robot needs: its radius and the interpolation error [cells]
    slow: float  #: v_max / v_min
    occupied: Bool[np.ndarray, "rows columns"]  #: static obstacles that are not objects
    #: of a cell's centre from the border of such cells, and from the outlines of immovable objects [cells]
    clearance: Clearance
    bodies: tuple[Body, ...]
    immovable: tuple[MovableObject | Passage, ...]  #: fixed, tipping, too heavy or locked
    why_immovable: dict[str, str]  #: reasons by id
    block: int  #: edge length of a node of the lattice [cells]
    lattice: Clearance  #: maximum clearance in each block [cells]
    immovable_outlines: tuple[Outline, ...]
    passages: tuple[tuple[Passage, Outline, float], ...] = ()  #: outline, seconds
    places: Clearance | None = None  #: cost of an object that ends in a cell [s]
    patient: bool = True  #: whether a search continues where a plan may exist beside the centres of cells
    divided: bool = False  #: whether the cells are parts of those of the map, on which no plan was found
    #: how much less than the radius the clearance of a node may be; then it counts as :attr:`widest` [cells]
    slack: float = 0.0
    widest: float = 0.0
    #: distances around bodies, cached because most bodies do not move
    patches: dict[tuple[int, int, float, float], Patch] = field(default_factory=dict, init=False)
    #: cached drives, by displacements, start and goal: block size, blocks, cost, cells
    drives: dict[Key, tuple[int, Path, float, Path]] = field(default_factory=dict, init=False)
    #: the same over the lattice: blocks, cost
    paths: dict[Key, tuple[Path, float]] = field(default_factory=dict, init=False)
    #: poses of a body along simulated pushes, by body and contact
    ends: dict[tuple[int, int], PushEnds] = field(default_factory=dict, init=False)
    #: labels of the passages, by block size
    marked: dict[int, Labels] = field(default_factory=dict, init=False)

    @cached_property
    def counts(self) -> Int32[np.ndarray, "rows columns"]:
        """Number of :attr:`occupied` cells of a row before each column, the last one included."""
        return np.pad(np.cumsum(self.occupied, axis=1, dtype=np.int32), ((0, 0), (1, 0)))

    @cached_property
    def start(self) -> Point:
        """Start of the problem [cells]."""
        return grid_from_world(self.map, self.problem.start_m)

    @cached_property
    def goal(self) -> Point:
        """Goal of the problem [cells]."""
        return grid_from_world(self.map, self.problem.goal_m)

    @cached_property
    def relaxed(self) -> SearchDomain:
        """The domain of bounds and proofs: its lattice is open wherever a robot's centre fits.

        The centre of the cell that a point lies in is at most half a diagonal from the point.
        """
        radius, half = self.robot.radius_m / self.map.resolution_m, 0.5 * math.sqrt(2.0)
        loose = replace(
            self, slack=self.radius - max(radius - half, 1e-6), widest=max(radius + half, self.radius)
        )
        return replace(loose, lattice=loose.loosened(self.lattice))

    def loosened(self, layer: Clearance) -> Clearance:
        """A layer of clearances [cells] with the greatest that a robot may have where it may fit beside the centre of a cell.

        Parameters
        ----------
        layer
            Clearance at the centres of cells [cells].
        """
        if not self.slack:
            return layer
        near = (layer >= self.closed_below) & (layer < self.widest)
        return np.where(near, np.float32(self.widest), layer)

    @property
    def closed_below(self) -> float:
        """Clearance of a cell's centre below which the robot fits nowhere in the cell [cells]."""
        return self.radius - self.slack

    @property
    def reach(self) -> float:
        """Clearance above which the robot drives at full speed [cells]."""
        return full_speed_clearance(self.radius)

    def clearance_with(self, shifts: Shifts, without: int = -1) -> Clearance:
        """Distance to the nearest obstacle [cells] with displaced bodies, optionally without one of them.

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        without
            Index of the body left out; -1 for none.
        """
        return self.lowered(self.clearance, shifts, [i for i in range(len(self.bodies)) if i != without], 1)

    def lattice_with(self, shifts: Shifts) -> Clearance:
        """:meth:`clearance_with` of the lattice's nodes.

        Parameters
        ----------
        shifts
            See :meth:`clearance_with`.
        """
        return self.lowered(self.lattice, shifts, range(len(self.bodies)), self.block)

    def seeds(
        self, layer: Clearance, point: Point, *, reach: int = 1, block: int | None = None
    ) -> tuple[Nodes, Nodes]:
        """Free nodes of a layer around a point (flat indices), and the costs from the point to them [units].

        Parameters
        ----------
        layer
            Clearance [cells].
        point
            Point from the layer's corner [cells].
        reach
            Half width of the window around the point's node [nodes].
        block
            Edge length of a node [cells]; that of the lattice by default.
        """

        found: tuple[Nodes, Nodes] = nodes_around(
            layer, float(point[0]), float(point[1]), self.radius, self.slow, reach, block or self.block
        )
        return found

    def lowered(self, layer: Clearance, shifts: Shifts, chosen: Sequence[int], block: int) -> Clearance:
        """A copy of a clearance layer with some bodies added, by cells (block 1) or by blocks.

        Parameters
        ----------
        layer
            Clearance [cells].
        shifts
            Displacements of the bodies from their mapped positions [cells].
        chosen
            Indices of the bodies.
        block
            Edge length of an element of the layer [cells].
        """
        layer = layer.copy()
        for index in chosen:
            self._lower(layer, np.zeros(2, np.int64), index, shifts[index], block)
        return layer

    def part(
        self,
        layer: Clearance,
        low: Int[np.ndarray, "2"],
        high: Int[np.ndarray, "2"],
        shifts: Shifts,
        block: int,
        among: Among | None = None,
    ) -> Clearance:
        """A copy of a window of a layer, ``low`` <= (x, y) < ``high``, with the bodies added.

        Parameters
        ----------
        layer, shifts, block
            See :meth:`lowered`.
        low, high
            Corners of the window [elements of the layer].
        among
            Mask of the bodies; all by default.
        """
        part = layer[low[1] : high[1], low[0] : high[0]].copy()
        for index in self._near(shifts, low * block - self.reach, high * block + self.reach, among):
            self._lower(part, low, index, shifts[index], block)
        return part

    def _lower(
        self, part: Clearance, low: Int[np.ndarray, "2"], index: int, shift: Point, block: int
    ) -> None:
        """Add a body to a window of a layer that starts at ``low`` (x, y), in place."""
        # A patch of cells can be shifted by whole cells; a patch of blocks depends on the cells in each block.
        whole = np.floor(shift + 1e-9) if block == 1 else np.zeros(2)
        patch, row, column = self.patch(index, shift - whole, block)
        lower_window(part, patch, row + int(whole[1] - low[1]), column + int(whole[0] - low[0]))

    def _near(self, shifts: Shifts, low: Point, high: Point, among: Among | None) -> list[int]:
        """Bodies in a box, of those among which it is asked for."""
        lows, highs = self.extents
        near = (lows + shifts < high).all(axis=1) & (highs + shifts > low).all(axis=1)
        found: list[int] = np.flatnonzero(near if among is None else near & among).tolist()
        return found

    @cached_property
    def extents(self) -> tuple[Shifts, Shifts]:
        """Minimum and maximum x, y of every body at its mapped position [cells]."""
        boxes = np.array([(o.min(axis=0), o.max(axis=0)) for o in (body.kept_clear for body in self.bodies)])
        low, high = boxes.reshape(-1, 2, 2).swapaxes(0, 1)
        return low, high

    def patch(self, index: int, shift: Point, block: int) -> Patch:
        """Maximum distance from a body in the blocks around it, and the first row and column.

        Parameters
        ----------
        index, shift
            Index of the body, and its displacement [cells].
        block
            Edge length of a block [cells].
        """

        key = (block, index, round(float(shift[0]), 9), round(float(shift[1]), 9))
        if key not in self.patches:
            if len(self.patches) >= MAX_PATCHES:
                self.patches.clear()
            outline = self.bodies[index].kept_clear + shift
            self.patches[key] = (
                distance_patch(outline, self.reach) if block == 1
                else block_patch(self.clearance, outline, self.closed_below, self.reach, block)
            )  # fmt: skip
            patch, row, column = self.patches[key]
            self.patches[key] = self.loosened(patch), row, column
        return self.patches[key]

    def obstacle_outlines(
        self, shifts: Shifts, without: int, low: Point, high: Point, among: Among | None = None
    ) -> tuple[Float[np.ndarray, "v 2"], Int32[np.ndarray, "o"]]:
        """Concatenated outlines of all objects in a box except one, and the start index of each.

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        without
            Index of the body left out.
        low, high
            Corners of the box; static obstacles are included everywhere [cells].
        among
            Mask of the bodies; all by default.
        """
        near = self._near(shifts, low, high, among)
        outlines = [self.bodies[k].outline + shifts[k] for k in near if k != without]
        # Doors are obstacles for pushed objects.
        outlines += [*self.immovable_outlines, *(outline for _, outline, _ in self.passages)]
        return joined_outlines(outlines)

    def clear_straight(
        self, shifts: Shifts, begin: Point, ends: Path, among: Among | None = None
    ) -> Bool[np.ndarray, "n"]:
        """Whether the straight drives from a point to each of the ends have sufficient clearance.

        Exact with respect to the squares of occupied cells and the outlines of objects, unlike the interpolated :attr:`clearance`.

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        begin, ends
            Grid coordinates [cells].
        among
            Mask of the bodies that count as obstacles; all by default.
        """

        radius = (self.robot.radius_m - CLEAR_SLACK_M) / self.map.resolution_m
        low, high = np.minimum(ends.min(axis=0), begin), np.maximum(ends.max(axis=0), begin)
        chosen = self._near(shifts, low - radius, high + radius, among)
        outlines = [*(self.bodies[k].outline + shifts[k] for k in chosen), *self.immovable_outlines]
        found: Bool[np.ndarray, "n"] = clear_straight(
            self.occupied, *joined_outlines(outlines), float(begin[0]), float(begin[1]), ends, radius
        )
        return found

    def driving_cost(self, shifts: Shifts, path: Path) -> float:
        """Cost (4.1) of a path on exact distances from occupied squares and outlines [cells at full speed].

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        path
            Corners in grid coordinates [cells].
        """
        resolution_m, robot = self.map.resolution_m, self.robot
        places, lengths = sampled(path, SAMPLE * robot.radius_m / resolution_m)
        outlines = [body.outline + shift for body, shift in zip(self.bodies, shifts, strict=True)]
        distance_m = resolution_m * obstacle_distances(
            self.occupied, self.clearance, *joined_outlines([*outlines, *self.immovable_outlines]), places,
            3.0 * robot.radius_m / resolution_m,
        )  # fmt: skip
        # Where a robot leaves an obstacle that it is too near to, it drives as at its radius.
        return float(robot.cost_s_per_m(np.maximum(distance_m, robot.radius_m)) @ lengths) * robot.v_max_m_s

    def labels(self, block: int) -> Labels:
        """Blocks that passages touch: their index + 1; empty without passages. Not to be changed in place.

        Parameters
        ----------
        block
            Edge length of a block [cells].
        """
        from ..object_cells import fill_cells

        if not self.passages:
            return np.zeros((0, 0), np.int16)
        if block not in self.marked:
            rows, columns = self.clearance.shape
            found = np.zeros((-(-rows // block), -(-columns // block)), np.int16)
            for number, (_, outline, _) in enumerate(self.passages, start=1):
                inside = np.zeros(found.shape, dtype=bool)
                fill_cells(inside, outline / block)
                found[inside] = number
            self.marked[block] = found
        return self.marked[block]

    def charges(self, block: int) -> Int32[np.ndarray, "labels"]:
        """Costs of the passage of each label [units of the travel field].

        Parameters
        ----------
        block
            See :meth:`labels`.
        """

        scale = UNITS * self.robot.v_max_m_s / (self.map.resolution_m * block)
        return np.array([0.0, *(seconds * scale for *_, seconds in self.passages)]).astype(np.int32)

    def seconds(self, cells_at_full_speed: float) -> float:
        """Cost in seconds of a cost in cells at full speed.

        Parameters
        ----------
        cells_at_full_speed
            Cost in the unit of the grid search [cells].
        """
        return cells_at_full_speed * self.map.resolution_m / self.robot.v_max_m_s
