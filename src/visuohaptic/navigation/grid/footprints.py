"""Footprints of potentially movable objects, from the map (Alt 2016, Sec. 4.4).

Connected regions of occupied cells, with the convex hull of each, because a laser
sees one side only. Sizes from 0.1 to 0.7 m are kept: larger objects
are too heavy, smaller ones tip over or are part of something larger.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int32

from ...core.ranges import NON_NEGATIVE, POSITIVE, check_order, check_ranges, within
from ...io.maps.occupancy_map import OccupancyMap


@dataclass(frozen=True, slots=True)
class FootprintSettings:
    """Criteria for candidate regions."""

    min_m: float = field(default=0.1, metadata=POSITIVE)  #: s_x and s_y of the dissertation
    max_m: float = 0.7
    join_m: float = field(default=0.06, metadata=NON_NEGATIVE)  #: maximum gap between cells of one object
    #: minimum free fraction of the ring around it: below this it is part of a wall
    free_fraction: float = field(default=0.5, metadata=within(0, 1))
    ring_m: float = 0.15

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_m", "max_m")


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """An isolated region, in the map frame."""

    outline_m: Float[np.ndarray, "p 2"]  #: convex hull of its cells, counter-clockwise
    size_m: tuple[float, float]  #: sides of the smallest rectangle around it, the longer first
    centre_m: Float[np.ndarray, "2"]  #: centroid of the hull
    cells: Int32[np.ndarray, "k 2"]  #: (row, column) of the occupied cells
    free_fraction: float  #: of the ring around it; the rest is unknown or occupied


def find_footprints(grid: OccupancyMap, settings: FootprintSettings | None = None) -> tuple[Footprint, ...]:
    """Candidates for movable obstacles, the largest first.

    Parameters
    ----------
    grid
        Occupancy map; cells of 50 and more form regions.
    settings
        Sizes and distances.

    Examples
    --------
    >>> cells = np.zeros((60, 60), np.int8)
    >>> cells[0] = 100  # a wall
    >>> cells[20:26, 30:36] = 100  # a bin of 0.3 m
    >>> [footprint.size_m for footprint in find_footprints(OccupancyMap(cells, 0.05))]
    [(0.3, 0.3)]
    """
    from scipy import ndimage

    settings = settings or FootprintSettings()
    r = grid.resolution_m
    occupied = grid.cells >= 50
    reach = max(1, round(settings.join_m / r))
    joined, _ = ndimage.label(
        occupied
        if reach == 1
        else ndimage.binary_closing(np.pad(occupied, reach), _disc(reach))[reach:-reach, reach:-reach],
        np.ones((3, 3)),
    )
    found = []
    limit = round(1.5 * settings.max_m / r) + 2
    for number, place in enumerate(ndimage.find_objects(joined), start=1):
        if max(part.stop - part.start for part in place) > limit:
            continue
        mine = (joined[place] == number) & occupied[place]
        cells = np.argwhere(mine) + np.array([part.start for part in place])
        footprint = _footprint(grid, cells, settings)
        if footprint is not None:
            found.append(footprint)
    return tuple(sorted(found, key=lambda footprint: -footprint.size_m[0] * footprint.size_m[1]))


def _disc(radius: int) -> Bool[np.ndarray, "n n"]:
    row, column = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return np.asarray(row * row + column * column <= radius * radius)


def _box_size(ring_m: Float[np.ndarray, "k 2"]) -> tuple[float, float]:
    """Longer and shorter side of the box around a closed hull.

    Of two sides of a box a laser sees a right triangle, and the smallest rectangle on its
    hypotenuse has the same area as the one on its legs: among rectangles of nearly
    minimum area the one with the shortest longer side is chosen.
    """
    step = np.diff(ring_m, axis=0)
    angle = np.arctan2(step[:, 1], step[:, 0])
    axis = np.column_stack([np.cos(angle), np.sin(angle)])
    along, across = ring_m @ axis.T, ring_m @ np.column_stack([-axis[:, 1], axis[:, 0]]).T
    sides = np.sort(np.column_stack([np.ptp(along, axis=0), np.ptp(across, axis=0)]), axis=1)
    area = sides.prod(axis=1)
    small = sides[area <= 1.1 * area.min()]
    shorter, longer = small[np.argmin(small[:, 1])]
    return float(longer), float(shorter)


def _footprint(
    grid: OccupancyMap, cells: Int32[np.ndarray, "k 2"], settings: FootprintSettings
) -> Footprint | None:
    """The footprint of a region; None where its size or its surroundings are wrong."""
    from scipy import ndimage
    from shapely import MultiPoint
    from shapely.geometry.polygon import orient

    # The corners of the cells, not their centres, so that one cell has a size.
    corners = (cells[:, None] + np.array([[0, 0], [0, 1], [1, 1], [1, 0]])).reshape(-1, 2)
    places = grid.world_from_cell(corners - 0.5)
    hull = MultiPoint(places).convex_hull
    size = _box_size(np.array(hull.exterior.coords))
    # Tolerance for rounding of the rectangle at the limits of the size.
    if size[1] < settings.min_m - 1e-6 or size[0] > settings.max_m + 1e-6:
        return None
    ring = max(1, round(settings.ring_m / grid.resolution_m))
    top, left = (max(int(v) - ring, 0) for v in cells.min(axis=0))
    bottom, right = (int(v) + ring + 1 for v in cells.max(axis=0))
    window = grid.cells[top:bottom, left:right]
    mask = np.zeros(window.shape, dtype=bool)
    mask[cells[:, 0] - top, cells[:, 1] - left] = True
    around = ndimage.binary_dilation(mask, _disc(ring)) & ~ndimage.binary_fill_holes(mask)
    free_fraction = float((window[around] == 0).mean()) if around.any() else 0.0
    if free_fraction < settings.free_fraction:
        return None
    outline_m = np.array(orient(hull).exterior.coords)[:-1]
    centre = np.array([hull.centroid.x, hull.centroid.y])
    rounded = (round(size[0], 6), round(size[1], 6))
    return Footprint(outline_m, rounded, centre, cells.astype(np.int32), free_fraction)
