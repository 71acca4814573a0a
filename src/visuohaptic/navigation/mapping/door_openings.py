"""Narrow places of a map that may be doors: where they are, and what they look like.

A door is a narrow place between two wide ones. The narrow places are the
saddles of the distance to the nearest wall: the borders where the basins of
its watershed meet. Each gives a pair of jambs, and measures of their shape,
all in metres, so that they mean the same on every map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from ...io.maps.occupancy_map import OccupancyMap

__all__ = ["MEASURES", "DoorSpace", "Opening", "free_space", "measure", "narrow_places"]

#: Names of the measures of an opening, in the order of :attr:`Opening.measures`.
MEASURES = (
    "too_wide_m",  #: width above a single door's
    "too_narrow_m",
    "recess",  #: log of how far one wall, or both in turn, step back on both sides
    "crossed_recess",  #: the same, of opposite jambs
    "widening",  #: clearance reached within 2 m on the tighter side, by half the width
    "turn_rad",  #: against the directions of the building's walls
    "straightness",  #: coherence of the walls around, 0..1
    "thickness_m",  #: of the thinner wall beside the opening
    "wall_length",  #: root of the length of wall in line with the opening [m]
)

#: Gaps narrower than this are not passages: they are closed, like those in a wall of glass (m).
CLOSED_GAP_M = 0.56
#: A group of obstacles smaller than this stands alone: furniture, no wall (m).
ALONE_M = 1.2
#: Unknown patches smaller than this are free (m^2): the laser has missed them.
PATCH_M2 = 1.0
#: Width that needs no excuse (m): a single door between its frames as a laser sees it.
USUAL_WIDTH_M = (0.75, 1.0)

_DEPTH_M = (0.15, 0.85)  #: where the walls must step back, from the opening's middle line
_REACH_M = 2.6  #: half edge of the window that is looked at


@dataclass(frozen=True, slots=True, eq=False)
class DoorSpace:
    """A map as doors are looked for in it."""

    resolution_m: float
    occupied: Bool[np.ndarray, "rows columns"]
    free: Bool[np.ndarray, "rows columns"]  #: without lone furniture, gaps below ``CLOSED_GAP_M`` closed
    coherence: Float32[np.ndarray, "rows columns"]  #: 1 at straight walls, 0 in clutter
    direction_rad: float  #: of the walls, modulo 90 degrees, in the grid


@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """A narrow place between two jambs; places are (row, column)."""

    place: Int[np.ndarray, "2"]  #: free cell in its middle
    jambs: Float[np.ndarray, "2 2"]
    width_m: float
    measures: Float[np.ndarray, "9"]  #: see :data:`MEASURES`

    @property
    def middle(self) -> Float[np.ndarray, "2"]:
        """Between the jambs."""
        return np.asarray(self.jambs.mean(axis=0))

    @property
    def passage(self) -> Float[np.ndarray, "2"]:
        """Unit vector through the opening."""
        along = self.jambs[1] - self.jambs[0]
        return np.array([-along[1], along[0]]) / np.hypot(*along)


def distance_cells(free: Bool[np.ndarray, "rows columns"]) -> Float32[np.ndarray, "rows columns"]:
    """Distance to the nearest cell that is not free [cells]."""
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

    r, around = grid.resolution_m, np.ones((3, 3))
    occupied = grid.cells >= 50
    # Wall pieces with small gaps between them are one wall; what stays small by itself is furniture.
    groups, count = ndimage.label(distance_cells(~occupied) <= 0.5 * CLOSED_GAP_M / r, around)
    large = np.zeros(count + 1, dtype=bool)
    for number, (rows, columns) in enumerate(ndimage.find_objects(groups), start=1):
        extent = np.hypot(rows.stop - rows.start, columns.stop - columns.start) * r - CLOSED_GAP_M
        large[number] = extent > ALONE_M
    wall = occupied & large[groups]
    unknown = ~occupied & ~grid.free
    patches, _ = ndimage.label(unknown, around)
    small = np.bincount(patches.ravel()) * r * r < PATCH_M2
    small[0] = False
    blocked = wall | (unknown & ~small[patches])
    core = distance_cells(~blocked) > 0.5 * CLOSED_GAP_M / r
    free = ~blocked & (distance_cells(~core) < 0.5 * CLOSED_GAP_M / r)
    coherence, direction = _wall_directions(occupied, r)
    return DoorSpace(r, occupied, free, coherence, direction)


def _wall_directions(
    occupied: Bool[np.ndarray, "rows columns"], resolution_m: float
) -> tuple[Float32[np.ndarray, "rows columns"], float]:
    """Coherence of the structure tensor, and the direction that most walls have."""
    import cv2

    smooth = cv2.GaussianBlur(occupied.astype(np.float32), (0, 0), 1.0)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    sigma = max(0.15 / resolution_m, 1.0)
    xx, yy, xy = (cv2.GaussianBlur(product, (0, 0), sigma) for product in (gx * gx, gy * gy, gx * gy))
    strength = np.sqrt((xx - yy) ** 2 + 4 * xy * xy)
    coherence = strength / (xx + yy + 1e-9)
    normal = 0.5 * np.arctan2(2 * xy, xx - yy)
    mean = np.sum((strength * np.exp(4j * normal))[occupied])
    return coherence.astype(np.float32), float(np.angle(mean) / 4)


def narrow_places(space: DoorSpace, widest_m: float) -> Int[np.ndarray, "n 2"]:
    """Cells (row, column) in the middle of the narrow places, the narrowest first.

    Parameters
    ----------
    space
        Free space with walls only.
    widest_m
        Maximum width of an opening [m].
    """
    import cv2
    from scipy import ndimage
    from skimage.morphology import h_maxima
    from skimage.segmentation import watershed

    around = np.ones((3, 3))
    distance = distance_cells(space.free)
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    # One centimetre more clearance is no other room, a cell of noise neither.
    peaks, _ = ndimage.label(h_maxima(smooth, max(0.05 / space.resolution_m, 0.5)), around)
    basins = watershed(-smooth, peaks, mask=space.free)
    # Where each basin meets another of a higher number.
    other = np.where(basins > 0, basins, np.iinfo(basins.dtype).max)
    lowest = ndimage.minimum_filter(other, footprint=around)
    border = (basins > 0) & (lowest < basins)
    meeting = np.where(border, basins.astype(np.int64) * (int(basins.max()) + 1) + lowest, 0)
    _, codes = np.unique(meeting, return_inverse=True)
    pieces = _pieces(codes.reshape(meeting.shape), border)
    if pieces.max() == 0:
        return np.zeros((0, 2), dtype=np.int64)
    numbers = np.arange(1, int(pieces.max()) + 1)
    clearance = ndimage.maximum(distance, pieces, numbers) * space.resolution_m
    places = np.array(ndimage.maximum_position(distance, pieces, numbers)).reshape(-1, 2).astype(np.int64)
    kept = clearance < 0.75 * widest_m
    return places[kept][np.argsort(clearance[kept], kind="stable")]


def _pieces(
    codes: Int[np.ndarray, "rows columns"], border: Bool[np.ndarray, "rows columns"]
) -> Int[np.ndarray, "rows columns"]:
    """Connected cells of the same code get the same number, others another."""
    from scipy import ndimage

    around = np.ones((3, 3))
    joint, _ = ndimage.label(border, around)
    pieces = np.zeros(codes.shape, dtype=np.int64)
    last = 0
    for number, place in enumerate(ndimage.find_objects(joint), start=1):
        mine = joint[place] == number
        for code in np.unique(codes[place][mine]):
            part, found = ndimage.label(mine & (codes[place] == code), around)
            pieces[place] += np.where(part > 0, part + last, 0)
            last += found
    return pieces


def measure(
    space: DoorSpace, free: Bool[np.ndarray, "rows columns"], place: Int[np.ndarray, "2"]
) -> Opening | None:
    """Jambs and measures of the narrow place at a free cell; None where there is no pair of jambs.

    Parameters
    ----------
    space
        Free space with walls only.
    free
        The free cells of ``space``, or fewer where other doors are closed.
    place
        Free cell (row, column) in the middle of a narrow place.
    """
    r = space.resolution_m
    jambs = _jambs(free, place, r)
    if jambs is None:
        return None
    along = jambs[1] - jambs[0]
    width_m = (float(np.hypot(*along)) - 1.0) * r
    u = along / np.hypot(*along)
    n = np.array([-u[1], u[0]])
    middle = jambs.mean(axis=0)
    reach = round(_DEPTH_M[1] / r)
    offsets = np.arange(-reach, reach + 1)
    spread = np.array(
        [[_free_length(free, middle + t * n, sign * u, r) for sign in (-1, 1)] for t in offsets]
    )
    deep = np.arange(round(_DEPTH_M[0] / r), reach + 1)
    here = spread[reach]
    front = np.maximum(spread[reach + deep].max(axis=0) - here, 0.0)
    back = np.maximum(spread[reach - deep].max(axis=0) - here, 0.0)
    same = max(min(front[0], back[0]), min(front[1], back[1]))
    cross = max(min(front[0], back[1]), min(front[1], back[0]))
    turn = np.arctan2(u[0], u[1]) - space.direction_rad
    half = max(0.5 * width_m, 0.1)
    measures = [
        max(width_m - USUAL_WIDTH_M[1], 0.0),
        max(USUAL_WIDTH_M[0] - width_m, 0.0),
        np.log(max(same, cross, 0.03)),
        np.log(max(cross, 0.03)),
        min(_widening(free, middle, n, r) / half, 2.5),
        min(abs((turn + np.pi / 4) % (np.pi / 2) - np.pi / 4), 0.5),
        _straightness(space, middle, half + 0.6),
        min(
            *(_thickness(free, jamb, sign * u, n, r) for jamb, sign in zip(jambs, (-1, 1), strict=True)), 1.0
        ),
        np.sqrt(max(_wall_length(space, jamb, s * u, n) for jamb, s in zip(jambs, (-1, 1), strict=True))),
    ]
    return Opening(place, jambs, width_m, np.array(measures, dtype=np.float64))


def _window(shape: tuple[int, ...], place: np.ndarray, reach: int) -> tuple[slice, slice]:
    row, column = (round(float(value)) for value in place)
    return slice(max(row - reach, 0), row + reach + 1), slice(max(column - reach, 0), column + reach + 1)


def _jambs(
    free: Bool[np.ndarray, "rows columns"], place: Int[np.ndarray, "2"], resolution_m: float
) -> Float[np.ndarray, "2 2"] | None:
    """The nearest cell that is not free, the nearest on the other side, and then the pair that is closest."""
    window = _window(free.shape, place, round(_REACH_M / resolution_m))
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


def _look(
    mask: Bool[np.ndarray, "rows columns"], points: Float[np.ndarray, "*n 2"]
) -> Bool[np.ndarray, "*n"]:
    """Values at places (row, column); false outside."""
    cells = np.rint(points).astype(np.int64)
    inside = ((cells >= 0) & (cells < mask.shape)).all(axis=-1)
    cells = np.where(inside[..., None], cells, 0)
    return np.asarray(mask[cells[..., 0], cells[..., 1]] & inside)


def _free_length(free: np.ndarray, start: np.ndarray, towards: np.ndarray, resolution_m: float) -> float:
    """Free distance along a direction, at most 3 m [m]; 0 where the start is not free."""
    steps = np.arange(0, 3.0 / resolution_m, 0.7)
    blocked = np.flatnonzero(~_look(free, start + steps[:, None] * towards))
    return float(steps[blocked[0]] if len(blocked) else steps[-1]) * resolution_m


def _widening(free: np.ndarray, middle: np.ndarray, passage: np.ndarray, resolution_m: float) -> float:
    """Largest clearance along the passage within 2 m, on the side where it is smaller [m]."""
    window = _window(free.shape, middle, round(1.5 * _REACH_M / resolution_m))
    distance = distance_cells(free[window])
    corner = np.array([window[0].start, window[1].start])
    best = []
    for sign in (1.0, -1.0):
        steps = np.arange(0, 2.0 / resolution_m, 1.5)
        cells = np.rint(middle + sign * steps[:, None] * passage - corner).astype(np.int64)
        inside = ((cells >= 0) & (cells < distance.shape)).all(axis=1)
        cells = cells[: int(np.argmin(inside)) if not inside.all() else len(cells)]
        clearance = distance[cells[:, 0], cells[:, 1]]
        # Behind a wall in between is another room.
        stops = np.flatnonzero((clearance == 0) & (np.arange(len(cells)) * 1.5 * resolution_m > 0.3))
        best.append(
            float(clearance[: stops[0]].max(initial=0.0) if len(stops) else clearance.max(initial=0.0))
        )
    return min(best) * resolution_m


def _straightness(space: DoorSpace, middle: np.ndarray, reach_m: float) -> float:
    window = _window(space.occupied.shape, middle, round(reach_m / space.resolution_m))
    occupied = space.occupied[window]
    return float(space.coherence[window][occupied].mean()) if occupied.any() else 0.0


def _thickness(free: np.ndarray, jamb: np.ndarray, away: np.ndarray, passage: np.ndarray, r: float) -> float:
    """Thickness of what stands beside the opening, looked at up to 0.45 m from the jamb [m]."""
    reach = round(1.0 / r)
    steps = np.arange(-reach, reach + 1)
    thinnest = 2.0
    for aside_m in (0.15, 0.25, 0.35, 0.45):
        blocked = ~_look(free, jamb + aside_m / r * away + steps[:, None] * passage)
        if not blocked[reach - round(0.15 / r) : reach + round(0.15 / r) + 1].any():
            continue
        open_steps = steps[~blocked]
        above, below = open_steps[open_steps > 0], open_steps[open_steps < 0]
        if len(above) and len(below):
            thinnest = min(thinnest, float(above[0] - below[-1]) * r)
    return thinnest


def _wall_length(space: DoorSpace, jamb: np.ndarray, away: np.ndarray, passage: np.ndarray) -> float:
    """Length over which three quarters of the line beyond the jamb are occupied, at most 2.5 m [m]."""
    r = space.resolution_m
    steps, band = np.arange(0, 2.5 / r), np.arange(-round(0.15 / r), round(0.15 / r) + 1)
    points = jamb + steps[:, None, None] * away + band[None, :, None] * passage
    hit = np.asarray(_look(space.occupied, points).any(axis=1))
    covered = np.cumsum(hit) / (np.arange(len(hit)) + 1)
    good = np.flatnonzero((covered >= 0.75) & hit)
    return float(good[-1] + 1) * r if len(good) else 0.0
