"""Comparison of laser scans with an existing map: fit of a scan, and new objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap

#: Points in cells at least this far from all mapped obstacles are new [m]; groups of fewer points are noise.
NEW_M, MIN_POINTS = 0.10, 8
#: Points of one object are linked over gaps of up to three cells of this size [m].
LINK_CELL_M = 0.02
#: A beam fits the map if a mapped obstacle is within this distance of the hit [m].
FIT_M = 0.15


def new_objects(grid: OccupancyMap, points_m: Float[np.ndarray, "n 2"]) -> list[Float[np.ndarray, "k 2"]]:
    """Groups of laser points in cells that are free on the map and away from all mapped obstacles.

    Parameters
    ----------
    grid
        Map without the objects.
    points_m
        Hits of the laser, map frame [m].

    Returns
    -------
    list of (k, 2) arrays
        One group per object by single linkage, ordered by y; groups of fewer than 8 points are left out.
    """
    cells = grid.cell_from_world(points_m)
    inside = np.asarray(grid.inside(cells))
    points_m, cells = points_m[inside], cells[inside].astype(int)
    away = ndimage.distance_transform_edt(grid.cells == FREE) * grid.resolution_m > NEW_M
    points_m = points_m[away[cells[:, 0], cells[:, 1]]]
    if not len(points_m):
        return []
    cell = np.floor((points_m - points_m.min(axis=0)) / LINK_CELL_M).astype(int) + 4
    raster = np.zeros(cell.max(axis=0) + 5, dtype=bool)
    raster[cell[:, 0], cell[:, 1]] = True
    labels, count = ndimage.label(ndimage.binary_dilation(raster), np.ones((3, 3)))
    label = labels[cell[:, 0], cell[:, 1]]
    groups = [points_m[label == k] for k in range(1, count + 1)]
    return sorted((one for one in groups if len(one) >= MIN_POINTS), key=lambda one: float(one[:, 1].mean()))


def mark_points(grid: OccupancyMap, groups: Sequence[Float[np.ndarray, "k 2"]]) -> OccupancyMap:
    """The map with the cells of laser points occupied.

    Parameters
    ----------
    grid
        Map to copy.
    groups
        Points inside it, map frame [m].
    """
    cells = grid.cells.copy()
    for points_m in groups:
        rows, columns = grid.cell_from_world(points_m).astype(int).T
        cells[rows, columns] = OCCUPIED
    return OccupancyMap(cells, grid.resolution_m, grid.origin)


def scan_fit(grid: OccupancyMap, points_m: Float[np.ndarray, "n 2"]) -> float:
    """Fraction of the hits of a scan that are near a mapped obstacle.

    Parameters
    ----------
    grid
        The map.
    points_m
        Hits, in the map frame according to the pose to test [m].
    """
    near = ndimage.distance_transform_edt(grid.cells < 50) * grid.resolution_m <= FIT_M
    cells = grid.cell_from_world(points_m)
    cells = cells[np.asarray(grid.inside(cells))].astype(int)
    return float(near[cells[:, 0], cells[:, 1]].sum() / max(len(points_m), 1))


def map_agreement(found: OccupancyMap, truth: OccupancyMap) -> tuple[float, float]:
    """Fraction of free cells that are free in the truth, and of occupied cells without a true obstacle nearby.

    Parameters
    ----------
    found
        Map to test.
    truth
        Map to compare it with, in the same frame.

    Returns
    -------
    tuple
        Both fractions; the second is 0 for a perfect map.
    """
    rows, columns = np.indices(found.shape)
    true = truth.value_at(found.world_from_cell(np.stack([rows, columns], axis=-1)))
    near = ndimage.binary_dilation(true >= 50, iterations=2)
    free, occupied = found.cells == FREE, found.cells >= 50
    return float(np.mean(true[free] == 0)), float(np.mean(~near[occupied]))
