"""A map that follows its edits: when an obstacle moves, only its neighbourhood is worked out again."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Int32

from ...core.errors import InputError
from ...core.geometry import rotation_2d
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from ..grid.cost_grid import OBSTACLE_FROM, GridLayers, SpeedLimits, grid_layers
from .navigation_graph import Decisions, NavigationGraph, decisions_from_lines, graph_from_decisions
from .regions import SQUARE, Regions, assign_regions, step_bounds
from .tracing._lines import SkeletonLines
from .tracing.skeletonize import skeleton_marks

__all__ = ["NavigationMap", "footprint_cells"]

#: Edits whose boxes are at most so many cells apart are worked out in one window.
_ONE_WINDOW = 20
#: At most so many cells, and those that changed, are taken back one by one.
_MANY = 8000
#: So few cells are done sooner by the queue than by further passes, of which there are at most so many.
_FEW = 24
_MORE_SWEEPS = 6
#: Where values go on from, so many tiles around are worked on.
_GROW = 3


def footprint_cells(map: OccupancyMap, polygon_m: Float[np.ndarray, "k 2"]) -> Int32[np.ndarray, "c 2"]:
    """Cells (row, column) of a map that a polygon (x, y) [m] in the map frame touches.

    Parameters
    ----------
    map
        The grid.
    polygon_m
        Corners x, y [m], map frame.
    """
    from ._footprint_kernels import footprint

    polygon_m = np.asarray(polygon_m, dtype=np.float64)
    if polygon_m.ndim != 2 or polygon_m.shape[1:] != (2,) or len(polygon_m) < 3:
        raise InputError(
            "footprint_cells", f"found shape {polygon_m.shape}, expected at least 3 corners (x, y)"
        )
    if not np.isfinite(polygon_m).all():
        raise InputError("footprint_cells", "found a corner that is not finite")
    grid = (polygon_m - np.array(map.origin[:2])) @ rotation_2d(map.origin[2]) / map.resolution_m
    rows, columns = map.shape
    low = np.clip(np.floor(grid.min(axis=0)), 0, [columns, rows]).astype(int)
    high = np.clip(np.floor(grid.max(axis=0)), -1, [columns - 1, rows - 1]).astype(int)
    if (high < low).any():
        return np.empty((0, 2), np.int32)
    found = footprint(grid, low[1], high[1], low[0], high[0])
    return (np.argwhere(found) + low[::-1]).astype(np.int32)


class NavigationMap:
    """Map, layers, graph and regions that stay up to date while obstacles come, move and go.

    After every edit all of them are equal to those of a map that is built anew with the same cells:
    distance and skeleton depend on a neighbourhood only, ties are settled by the index of the cell,
    and costs are whole numbers.

    Parameters
    ----------
    map
        Occupancy; it is copied.
    limits
        Radius and speeds of the robot.
    unknown_is_free
        Whether the robot may enter cells that were never seen.
    stub_length_m, spacing_m
        As for :func:`visuohaptic.navigation.graph.navigation_graph.build_graph`.
    """

    def __init__(
        self,
        map: OccupancyMap,
        limits: SpeedLimits,
        *,
        unknown_is_free: bool = False,
        stub_length_m: float | None = None,
        spacing_m: float | None = None,
    ) -> None:
        from ._sweep_kernels import TILE

        self._base = np.array(map.cells, dtype=np.int8, order="C")
        self._covered = np.zeros(map.shape, np.uint16)  # obstacles on each cell
        self._obstacles: dict[str, Int[np.ndarray, "c"]] = {}
        self._stub_length_m = stub_length_m
        self._spacing_m = spacing_m
        live = OccupancyMap(self._base.copy(), map.resolution_m, map.origin)
        self.layers: GridLayers = grid_layers(
            live, limits, unknown_is_free=unknown_is_free, keep_vertical=True
        )
        self._bounds = step_bounds(self.layers)
        self._steps = limits.step_table(map.resolution_m)[0]
        self._queued = np.zeros(self._base.size, np.uint8)  # for the search of regions, all 0 between edits
        self._tiles = np.zeros([-(-side // TILE) for side in map.shape], np.uint8)
        self._mark = skeleton_marks(self.layers)
        self._lines = SkeletonLines(map.shape)
        cells = np.flatnonzero(self._mark.view(np.bool_)).astype(np.int32)
        self._decisions = self._traced(cells)
        self._graph: NavigationGraph | None = None
        first = assign_regions(self.layers, self.graph)
        self._potential, self._seed = first.potential, first.seed
        self._regions: Regions | None = first

    @property
    def graph(self) -> NavigationGraph:
        """The graph as the map is now; made when it is first asked for after an edit, and never changed."""
        if self._graph is None:
            self._graph = graph_from_decisions(self.layers, self._decisions)
        return self._graph

    @property
    def regions(self) -> Regions:
        """The regions as the map is now; their arrays change with the next edit."""
        if self._regions is None:
            self._regions = Regions(self._potential, self._seed, self.layers.unit_s, self.layers, self.graph)
        return self._regions

    @property
    def map(self) -> OccupancyMap:
        """The map with all obstacles on it; its cells change with the next edit."""
        return self.layers.map

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the obstacles that were set."""
        return tuple(self._obstacles)

    def set_obstacle(self, name: str, polygon_m: Float[np.ndarray, "k 2"]) -> None:
        """Put an obstacle on the map, or move the one of that name.

        Parameters
        ----------
        name
            By which it is moved and removed.
        polygon_m
            Corners (x, y) in the map frame [m]; every cell that it touches is occupied.
        """
        self._place(name, self._flat(footprint_cells(self.map, polygon_m)))

    def move_obstacle(self, name: str, polygon_m: Float[np.ndarray, "k 2"]) -> None:
        """Move an obstacle that is on the map.

        Parameters
        ----------
        name
            Of the obstacle.
        polygon_m
            Corners x, y [m], map frame.
        """
        self._known(name)
        self.set_obstacle(name, polygon_m)

    def remove_obstacle(self, name: str) -> None:
        """Take an obstacle off the map; what the map showed below it comes back.

        Parameters
        ----------
        name
            Of the obstacle.
        """
        self._known(name)
        self._place(name, np.empty(0, np.int64))
        del self._obstacles[name]

    def set_cells(self, cells: Int[np.ndarray, "c 2"], values: Int[np.ndarray, "c"] | int) -> None:
        """Change what the map itself shows: occupancy -1 to 100 of cells (row, column).

        Under an obstacle that is set, a cell stays occupied until that leaves.

        Parameters
        ----------
        cells
            (row, column).
        values
            Occupancy -1 to 100, one for all or one each.
        """
        cells = np.asarray(cells, dtype=np.int64).reshape(-1, 2)
        target = np.broadcast_to(np.asarray(values), (len(cells),))
        if not self.map.inside(cells).all():
            raise InputError("set_cells", "found cells outside the map", field="cells")
        if len(target) and not (target.min() >= -1 and target.max() <= OCCUPIED):
            raise InputError("set_cells", "found values outside -1 to 100", field="values")
        flat = self._flat(cells)
        self._base.ravel()[flat] = target.astype(np.int8)
        self._follow(np.unique(flat))

    def _known(self, name: str) -> None:
        if name not in self._obstacles:
            names = ", ".join(self._obstacles) or "none"
            raise InputError("NavigationMap", f"found no obstacle '{name}', expected one of: {names}")

    def _flat(self, cells: Int[np.ndarray, "c 2"]) -> Int[np.ndarray, "c"]:
        return cells[:, 0].astype(np.int64) * self.map.shape[1] + cells[:, 1]

    def _place(self, name: str, cells: Int[np.ndarray, "c"]) -> None:
        before = self._obstacles.get(name, np.empty(0, np.int64))
        covered = self._covered.ravel()
        covered[before] -= 1
        covered[cells] += 1
        self._obstacles[name] = cells
        self._follow(np.union1d(before, cells))

    def _follow(self, touched: Int[np.ndarray, "c"]) -> None:
        """Bring everything up to date after cells (flat, ascending) were touched."""
        live = self.map.cells.ravel()
        now = np.where(self._covered.ravel()[touched] > 0, np.int8(OCCUPIED), self._base.ravel()[touched])
        turned = touched[self._blocks(now) != self._blocks(live[touched])]
        live[touched] = now
        if len(turned) == 0:
            return
        more_expensive, near = self._update_distance(turned)
        if len(near) == 0:
            return
        self._update_skeleton(near)
        self._update_regions(more_expensive)

    def _blocks(self, values: np.ndarray) -> np.ndarray:
        blocked = values >= OBSTACLE_FROM
        return blocked if self.layers.unknown_is_free else blocked | (values < 0)

    def _update_distance(self, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances and steps; returns cells whose step changed, and those that have to be thinned again."""
        from ..grid._distance_kernels import distance_update, vertical_update
        from ._update_kernels import distance_window, queue_near

        layers = self.layers
        resolution_m = layers.map.resolution_m
        assert layers.vertical is not None
        boxes = _boxes(np.column_stack(np.divmod(turned, layers.shape[1])))
        windows = [distance_window(layers.distance_m, resolution_m, *box) for box in boxes]
        for box in boxes:
            vertical_update(
                layers.map.cells, OBSTACLE_FROM, not layers.unknown_is_free, layers.vertical, *box
            )
        found = [
            distance_update(
                layers.vertical,
                *window,
                resolution_m,
                self._steps,
                not layers.unknown_is_free,
                layers.distance_m,
                layers.step,
            )
            for window in windows
        ]
        changed, more_expensive = (np.concatenate(cells) for cells in zip(*found, strict=True))
        return more_expensive, queue_near(changed, self._mark)

    def _update_skeleton(self, near: np.ndarray) -> None:
        """Thin again what the new distances reach, and follow the lines."""
        from ._update_kernels import on_skeleton, with_neighbours
        from .tracing._skeleton_kernels import refine

        # Small distances first: few cells are then looked at more than once.
        order = near[np.argsort(self.layers.distance_m.ravel()[near])]
        turned = refine(self.layers.distance_m, self.layers.step, self._mark, order)
        # Cells that have left the skeleton are beside a changed mark, their own.
        beside = with_neighbours(turned, *self.map.shape)
        self._before = self._decisions.cells
        self._decisions = self._traced(np.concatenate([on_skeleton(near, self._mark), beside]))
        self._graph = self._regions = None

    def _traced(self, touched: Int32[np.ndarray, "c"]) -> Decisions:
        raw = self._lines.follow(self.layers, self._mark, touched)
        return decisions_from_lines(self.layers, raw, self._stub_length_m, self._spacing_m)

    def _update_regions(self, changed: np.ndarray) -> None:
        """Take back potentials that rest on changed cells or removed nodes, and fill the gap."""
        from ._region_kernels import spread
        from ._sweep_kernels import sweep, touch
        from ._update_kernels import differences, forget, release

        layers = self.layers
        columns = layers.shape[1]
        potential, seed = self._potential, self._seed
        seeds = self._decisions.cells
        removed, added = differences(self._before, seeds)
        release(potential, seed, removed, self._tiles)
        if not forget(layers.step, self._mark, potential, seed, changed, self._tiles, _MANY):
            # Whole regions are taken back faster than so many cells one by one.
            owners = np.unique(seed.ravel()[changed])
            release(potential, seed, owners[owners >= 0], self._tiles)
            forget(layers.step, self._mark, potential, seed, changed, self._tiles, seed.size)
        # Nodes that are new, and those on cells that were taken back.
        lost = np.concatenate([added, seeds[seed.ravel()[seeds] < 0]])
        potential.ravel()[lost] = 0
        seed.ravel()[lost] = lost
        touch(self._tiles, lost, columns, 0)
        left = sweep(layers.step, potential, seed, self._tiles)
        for _ in range(_MORE_SWEEPS):
            if len(left) < _FEW:
                break
            # Ways that turn back need more passes, and those that leave the tiles more of them.
            touch(self._tiles, left, columns, _GROW)
            left = sweep(layers.step, potential, seed, self._tiles)
        if len(left):
            spread(layers.step, potential, seed, left, *self._bounds, SQUARE, self._queued)


def _boxes(cells: Int[np.ndarray, "c 2"]) -> list[tuple[int, int, int, int]]:
    """Boxes (first and last row, first and last column) round cells; two when they are in two places."""
    axis = int(np.argmax(np.ptp(cells, axis=0)))
    order = cells[np.argsort(cells[:, axis], kind="stable")]
    gaps = np.diff(order[:, axis])
    parts = [order]
    if len(gaps) and gaps.max() > _ONE_WINDOW:
        cut = int(np.argmax(gaps)) + 1
        parts = [order[:cut], order[cut:]]
    found = []
    for part in parts:
        low, high = part.min(axis=0), part.max(axis=0)
        found.append((int(low[0]), int(high[0]), int(low[1]), int(high[1])))
    return found
