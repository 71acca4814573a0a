"""Local costmap of one object: a window of the map without it, with the clearance of every cell, and collision tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core import InputError, compose_2d, finite_array
from ...io.maps.occupancy_map import FREE, OccupancyMap
from ...navigation.grid.cost_grid import OBSTACLE_FROM, window_distance


@dataclass(frozen=True, slots=True, eq=False)
class FootprintSamples:
    """Samples of an outline at the spacing of a map, in the object's frame (reference point at the origin)."""

    outline_m: Float[np.ndarray, "m 2"]  #: corners
    border_m: Float[np.ndarray, "b 2"]  #: along the outline, one cell apart
    inner_m: Float[np.ndarray, "i 2"]  #: on and inside the outline, one cell apart
    ring_m: Float[np.ndarray, "r 2"]  #: pi of Sec. 4.3.1: the platform's radius away from the outline
    inside_m: (
        float  #: radius of a circle that is inside the outline, about any point of the reference point's cell
    )

    @classmethod
    def of(cls, outline_m: Float[np.ndarray, "m 2"], radius_m: float, cell_m: float) -> FootprintSamples:
        """Sample an outline for a round platform and a grid.

        Parameters
        ----------
        outline_m
            Corners in the object's frame [m].
        radius_m
            Of the platform [m].
        cell_m
            Edge length of a cell [m].

        Raises
        ------
        InputError
            The outline intersects itself or has no area.
        """
        import shapely

        outline = np.asarray(outline_m, dtype=np.float64)
        shape = shapely.Polygon(outline) if len(outline) > 2 else shapely.Polygon()
        if not shape.is_valid or not shape.area > 0:
            raise InputError(
                "footprint",
                f"found {len(outline)} corners, area {shape.area:.3g} m^2; expected a simple outline",
            )
        corners = np.array(shapely.geometry.polygon.orient(shape).exterior.coords)[:-1]
        border = _along(shape.exterior, cell_m)
        x0, y0, x1, y1 = shape.bounds
        grid = np.stack(
            np.meshgrid(np.arange(x0 + 0.5 * cell_m, x1, cell_m), np.arange(y0 + 0.5 * cell_m, y1, cell_m)),
            axis=-1,
        ).reshape(-1, 2)
        inner = grid[shapely.contains_xy(shape, grid[:, 0], grid[:, 1])]
        ring = shape.buffer(radius_m)
        origin = shapely.Point(0.0, 0.0)
        inside = shape.exterior.distance(origin) if shape.contains(origin) else 0.0
        half_diagonal = math.sqrt(0.5) * cell_m  # distances are evaluated at the centre of the point's cell
        return cls(
            corners,
            border,
            np.concatenate([border, inner]),
            _along(ring.exterior, 0.5 * cell_m),
            max(float(inside) - half_diagonal, 0.0),
        )


@dataclass(frozen=True, slots=True, eq=False)
class LocalCostmap:
    """A window of a map around an object, and the clearance of each cell: its distance to the nearest obstacle."""

    map: OccupancyMap
    #: from a cell's centre to the border of the nearest obstacle's cell
    distance_m: Float32[np.ndarray, "rows columns"]

    @classmethod
    def around(cls, map: OccupancyMap, footprint_m: Float[np.ndarray, "p 2"], reach_m: float) -> LocalCostmap:
        """Cut out the surroundings of an object and remove the object.

        Parameters
        ----------
        map
            With or without the object's cells.
        footprint_m
            Outline of the object, map frame.
        reach_m
            Planning range around the outline, including the platform's diameter [m].

        Raises
        ------
        InputError
            The outline has fewer than three corners, is not finite, or lies outside the map.
        """
        outline = finite_array("LocalCostmap.around", footprint_m, None, 2, least=3)
        corners = np.concatenate(
            [outline + np.array(d) * reach_m for d in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        )
        cells = map.cell_from_world(corners)
        low = np.maximum(cells.min(axis=0), 0)
        high = np.minimum(cells.max(axis=0) + 1, np.array(map.shape))
        if (high <= low).any():
            raise InputError(
                "LocalCostmap.around",
                f"found a footprint about {outline.mean(axis=0).round(2)}, expected one on the map",
                remedy="check the frame of the footprint",
            )
        corner = (low[1] * map.resolution_m, low[0] * map.resolution_m, 0.0)
        window = OccupancyMap(
            map.cells[low[0] : high[0], low[1] : high[1]].copy(),
            map.resolution_m,
            compose_2d(map.origin, corner),
        )
        near = _covered_cells(window, outline)
        window.cells[near] = FREE
        blocked = (window.cells >= OBSTACLE_FROM) | (window.cells < 0)
        rows, columns = slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
        distance = window_distance(blocked, (rows, columns), map.shape, outside_blocks=True)
        return cls(window, distance * np.float32(map.resolution_m))

    @property
    def margin_m(self) -> float:
        """Distance at which a sample of a footprint, one cell from the next, is collision-free: in no obstacle's cell.

        Interpolated from 0 in an obstacle to half a cell beside it.
        """
        return 0.25 * self.map.resolution_m

    def distance_at(self, points_m: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch"]:
        """Distance to the nearest obstacle [m]; 0 outside the window.

        Parameters
        ----------
        points_m
            x, y in the map frame [m].
        """
        cells = self.map.cell_from_world(points_m)
        inside = self.map.inside(cells)
        values = self.distance_m[np.where(inside, cells[..., 0], 0), np.where(inside, cells[..., 1], 0)]
        return np.where(inside, values, 0.0).astype(np.float64)


def _along(line: object, spacing_m: float) -> Float[np.ndarray, "n 2"]:
    """Points on a closed line, at most ``spacing_m`` apart, including its corners."""
    import shapely

    dense = shapely.segmentize(line, spacing_m)
    return np.array(dense.coords)[:-1]


def _covered_cells(
    map: OccupancyMap, footprint_m: Float[np.ndarray, "p 2"]
) -> Bool[np.ndarray, "rows columns"]:
    """Cells that an outline partially covers, and those within half a cell of its border."""
    import shapely

    polygon = shapely.Polygon(footprint_m).buffer(0.75 * map.resolution_m)
    cells = map.cell_from_world(np.array(polygon.exterior.coords))
    low, high = np.maximum(cells.min(axis=0), 0), np.minimum(cells.max(axis=0) + 1, np.array(map.shape))
    burnt = np.zeros(map.shape, dtype=bool)
    if (high <= low).any():
        return burnt
    index = np.moveaxis(np.mgrid[low[0] : high[0], low[1] : high[1]], 0, -1)
    centre = map.world_from_cell(index)
    burnt[low[0] : high[0], low[1] : high[1]] = shapely.contains_xy(polygon, centre[..., 0], centre[..., 1])
    return burnt


def distance_from(
    map: OccupancyMap, blocked: Bool[np.ndarray, "rows columns"]
) -> Float32[np.ndarray, "rows columns"]:
    """Distance of every cell from the nearest occupied one [m]; infinite if there is none.

    Parameters
    ----------
    map
        Map of the cells.
    blocked
        Occupied cells, (rows, columns).
    """
    import cv2

    if not blocked.any():
        return np.full(map.shape, np.inf, dtype=np.float32)
    free = np.where(blocked, 0, 255).astype(np.uint8)
    exact = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return (exact * np.float32(map.resolution_m)).astype(np.float32)
