"""Narrow places of a map that may be doors: their positions and shape measures.

A door is a narrow place between two wide ones. The narrow places are the
saddles of the distance to the nearest wall: the borders where the basins of
its watershed meet. Each defines a pair of jambs, and shape measures
that have the same meaning on every map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped

from ...io.maps.occupancy_map import OccupancyMap

#: Names of the measures of an opening, in the order of :attr:`Opening.measures`: log-ratios, metres and radians.
MEASURES = (
    "width",  #: log of the ratio of the width to that of a single door
    "clearance_m",  #: clearance within 2 m on the tighter side, above half the width
    "recess",  #: log of the distance by which opposite jambs step back on the two sides [m]
    "end",  #: the same of one jamb on both sides: the end of a wall
    "wall",  #: log of the extent of the smaller wall at a jamb, without gaps [m]
    "bridged_wall",  #: the same, with gaps of scans bridged
    "turn_rad",  #: angle to the directions of the building's walls
)

#: Width of a single door between its frames as measured by a laser (m).
SINGLE_WIDTH_M = 0.8
#: Narrower gaps are closed, like those in a glass wall: they are not passages (m). A door of 0.7 m
#: between walls that noise has thickened by two to three cells of 5 cm keeps half a metre on the map.
CLOSED_GAP_M = 0.42
#: A wall or room that is longer than this is no more likely beside a door (m).
LONG_M = 6.0
#: Maximum width of gaps that scans leave in one wall (m).
_BRIDGED_M = 0.2
#: An isolated group of obstacles smaller than this is furniture, not a wall (m).
ALONE_M = 1.2
#: Unknown patches smaller than this are free (m^2): they were missed by the laser.
PATCH_M2 = 1.0
_DEPTH_M = (0.15, 0.85)  #: range in which the walls must step back, from the opening's middle line
_REACH_M = 2.6  #: half edge length of the window that is evaluated


@dataclass(frozen=True, slots=True, eq=False)
class DoorSpace:
    """A map prepared for the search for doors."""

    resolution_m: float
    free: Bool[np.ndarray, "rows columns"]  #: without isolated furniture, gaps below ``CLOSED_GAP_M`` closed
    #: diagonal of the non-free group at each cell, unchanged and with the gaps of scans bridged: laser maps show walls as
    #: dashed lines of occupied cells with unknown ones between and behind
    extent_m: tuple[Float32[np.ndarray, "rows columns"], ...]
    direction_rad: float  #: of the walls, modulo 90 degrees, in the grid


@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """A narrow place between two jambs; positions are (row, column)."""

    jambs: Float[np.ndarray, "2 2"]
    width_m: float
    measures: Float[np.ndarray, "7"]  #: see :data:`MEASURES`

    @property
    def middle(self) -> Float[np.ndarray, "2"]:
        """Point midway between the jambs."""
        return np.asarray(self.jambs.mean(axis=0))

    @property
    def passage(self) -> Float[np.ndarray, "2"]:
        """Unit vector through the opening."""
        along = self.jambs[1] - self.jambs[0]
        return np.array([-along[1], along[0]]) / np.hypot(*along)


def distance_cells(free: Bool[np.ndarray, "rows columns"]) -> Float32[np.ndarray, "rows columns"]:
    """Distance to the nearest non-free cell [cells].

    Parameters
    ----------
    free
        Whether a cell is free, (R, C).
    """
    import cv2

    return np.asarray(
        cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), dtype=np.float32
    )


def free_space(grid: OccupancyMap) -> DoorSpace:
    """Free space with walls only.

    Parameters
    ----------
    grid
        Occupancy map.
    """
    from scipy import ndimage

    r = grid.resolution_m
    occupied = grid.cells >= 50
    # Wall pieces with small gaps between them are one wall; whatever remains small is furniture.
    wall = occupied & (_extent_m(occupied, CLOSED_GAP_M, r) > ALONE_M)
    unknown = ~occupied & ~grid.free
    patches, _ = ndimage.label(unknown, np.ones((3, 3)))
    small = np.bincount(patches.ravel()) * r * r < PATCH_M2
    small[0] = False
    blocked = wall | (unknown & ~small[patches])
    free = without_gaps(~blocked, CLOSED_GAP_M, r)
    extent_m = tuple(_extent_m(~grid.free, gap_m, r) for gap_m in (0.0, _BRIDGED_M))
    return DoorSpace(r, free, extent_m, _wall_direction(occupied))


def without_gaps(
    free: Bool[np.ndarray, "rows columns"], gap_m: float, resolution_m: float
) -> Bool[np.ndarray, "rows columns"]:
    """Free cells that are covered by a disc of diameter ``gap_m`` in free space (morphological opening).

    Parameters
    ----------
    free
        Whether a cell is free, (R, C).
    gap_m, resolution_m
        Diameter of the disc, size of a cell [m].
    """
    core = distance_cells(free) > 0.5 * gap_m / resolution_m
    return free & (distance_cells(~core) < 0.5 * gap_m / resolution_m)


def _extent_m(
    occupied: Bool[np.ndarray, "rows columns"], gap_m: float, resolution_m: float
) -> Float32[np.ndarray, "rows columns"]:
    """Diagonal of the group of occupied cells around each cell, gaps bridged [m]; 0 without a group."""
    from scipy import ndimage

    near = distance_cells(~occupied) <= 0.5 * gap_m / resolution_m
    groups, _ = ndimage.label(near, np.ones((3, 3)))
    boxes = ndimage.find_objects(groups)
    extent = [np.hypot(*(side.stop - side.start for side in box)) * resolution_m - gap_m for box in boxes]
    return np.array([0.0, *extent], dtype=np.float32)[groups]


def _wall_direction(occupied: Bool[np.ndarray, "rows columns"]) -> float:
    """Dominant direction of the walls, modulo 90 degrees [rad]: angle of the mean of the gradients' fourth powers."""
    import cv2

    smooth = cv2.GaussianBlur(occupied.astype(np.float64), (0, 0), 1.5)
    gradient = cv2.Sobel(smooth, cv2.CV_64F, 1, 0) + 1j * cv2.Sobel(smooth, cv2.CV_64F, 0, 1)
    return float(np.angle(np.sum(gradient**4 / np.maximum(np.abs(gradient) ** 2, 1e-12))) / 4)


def narrow_places(space: DoorSpace, max_width_m: float) -> Int[np.ndarray, "n 2"]:
    """Cells (row, column) in the middle of the narrow places.

    Parameters
    ----------
    space
        Free space with walls only.
    max_width_m
        Maximum width of an opening [m].
    """
    import cv2
    from scipy import ndimage
    from skimage.measure import label
    from skimage.morphology import h_maxima
    from skimage.segmentation import watershed

    around = np.ones((3, 3))
    distance = distance_cells(space.free)
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    # A room must have at least one centimetre more clearance, and more than the noise of a cell.
    peaks, _ = ndimage.label(h_maxima(smooth, max(0.05 / space.resolution_m, 0.5)), around)
    basins = watershed(-smooth, peaks, mask=space.free)
    # Cells where each basin meets another with a higher number.
    other = np.where(basins > 0, basins, np.iinfo(basins.dtype).max)
    lowest = ndimage.minimum_filter(other, footprint=around)
    border = (basins > 0) & (lowest < basins)
    meeting = np.where(border, basins.astype(np.int64) * (int(basins.max()) + 1) + lowest, 0)
    # Connected cells where the same two basins meet are one place.
    pieces = label(meeting, background=0, connectivity=2)
    numbers = np.arange(1, int(pieces.max()) + 1)
    places = np.array(ndimage.maximum_position(distance, pieces, numbers)).reshape(-1, 2).astype(np.int64)
    return places[distance[tuple(places.T)] * space.resolution_m < 0.75 * max_width_m]


def measure(space: DoorSpace, place: Int[np.ndarray, "2"]) -> Opening | None:
    """Jambs and measures of the narrow place at a free cell; None if there is no pair of jambs.

    Parameters
    ----------
    space
        Free space with walls only.
    place
        Free cell (row, column) in the middle of a narrow place.
    """
    r, free = space.resolution_m, space.free
    jambs = _jambs(free, place, r)
    if jambs is None:
        return None
    along = jambs[1] - jambs[0]
    width_m = (float(np.hypot(*along)) - 1.0) * r
    u = along / np.hypot(*along)
    n = np.array([-u[1], u[0]])
    middle = jambs.mean(axis=0)
    depth = np.arange(round(_DEPTH_M[0] / r), round(_DEPTH_M[1] / r) + 1)
    here, front, back = (
        np.array([[_free_length(free, middle + t * n, s * u, r) for s in (-1, 1)] for t in side]).max(axis=0)
        for side in ([0], depth, -depth)
    )
    recess, end = (np.minimum(front - here, other).max() for other in ((back - here)[::-1], back - here))
    width, half = np.log(max(width_m, r) / SINGLE_WIDTH_M), max(0.5 * width_m, 0.1)
    turn = np.arctan2(u[0], u[1]) - space.direction_rad
    ends = [_window(jamb, 2) for jamb in jambs]
    wall, bridged = (min(float(extent[end].max()) for end in ends) for extent in space.extent_m)
    measures = [
        width,
        min(_widening(free, middle, n, r), 2.5 * half) - half,
        np.log(max(recess, 0.03)),
        np.log(max(end, 0.03)),
        np.log(np.clip(wall, r, LONG_M)),
        np.log(np.clip(bridged, r, LONG_M)),
        min(abs((turn + np.pi / 4) % (np.pi / 2) - np.pi / 4), 0.5),
    ]
    return Opening(jambs, width_m, np.array(measures, dtype=np.float64))


def _window(place: np.ndarray, reach: int) -> tuple[slice, slice]:
    row, column = (round(float(value)) for value in place)
    return slice(max(row - reach, 0), row + reach + 1), slice(max(column - reach, 0), column + reach + 1)


def _jambs(
    free: Bool[np.ndarray, "rows columns"], place: Int[np.ndarray, "2"], resolution_m: float
) -> Float[np.ndarray, "2 2"] | None:
    """The nearest non-free cell, the nearest on the other side, and from these the closest pair."""
    window = _window(place, round(_REACH_M / resolution_m))
    walls = np.argwhere(~free[window]) + np.array([window[0].start, window[1].start])
    if len(walls) == 0:
        return None
    towards = (walls - place).astype(np.float64)
    far = np.hypot(towards[:, 0], towards[:, 1])
    first = int(np.argmin(far))
    if far[first] == 0:
        return None
    opposite = (towards @ towards[first] < -0.5 * far * far[first]) & (far < 2.2 * far[first] + 4)
    if not opposite.any():
        return None
    second = int(np.flatnonzero(opposite)[np.argmin(far[opposite])])
    near = max(0.25 / resolution_m, 1.5)
    groups = [walls[np.hypot(*(walls - walls[end]).T) < near] for end in (first, second)]
    gaps = np.hypot(*(groups[0][:, None] - groups[1][None]).transpose(2, 0, 1))
    a, b = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    if gaps[a, b] < 2.0:
        return None
    return np.array([groups[0][a], groups[1][b]], dtype=np.float64)


def look(
    values: Shaped[np.ndarray, "rows columns"], points: Float[np.ndarray, "n 2"]
) -> Shaped[np.ndarray, "n"]:
    """Values of the nearest cells; 0 outside the map.

    Parameters
    ----------
    values
        One of each cell, (R, C).
    points
        (row, column), (n, 2).
    """
    cells = np.rint(points).astype(np.int64)
    inside = ((cells >= 0) & (cells < values.shape)).all(axis=1)
    cells[~inside] = 0
    return np.where(inside, values[cells[:, 0], cells[:, 1]], values.dtype.type(0))


def _free_length(free: np.ndarray, start: np.ndarray, towards: np.ndarray, resolution_m: float) -> float:
    """Free distance along a direction, at most 3 m [m]; 0 if the start is not free."""
    steps = np.arange(0, 3.0 / resolution_m, 0.7)
    blocked = np.flatnonzero(~look(free, start + steps[:, None] * towards))
    return float(steps[blocked[0]] if len(blocked) else steps[-1]) * resolution_m


def _widening(free: np.ndarray, middle: np.ndarray, passage: np.ndarray, resolution_m: float) -> float:
    """Maximum clearance along the passage within 2 m, on the side where it is smaller [m]."""
    window = _window(middle, round(1.5 * _REACH_M / resolution_m))
    distance = distance_cells(free[window])
    start = middle - np.array([window[0].start, window[1].start])
    steps = np.arange(0, 2.0 / resolution_m, 1.5)
    best = []
    for towards in (passage, -passage):
        clearance = look(distance, start + steps[:, None] * towards)
        # Behind a wall in between is another room.
        behind = np.logical_or.accumulate((clearance == 0) & (steps * resolution_m > 0.3))
        best.append(float(clearance[~behind].max(initial=0.0)))
    return min(best) * resolution_m
