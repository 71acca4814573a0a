"""Layers of a map: distance to obstacles, cost of driving, reachable cells (Alt 2016, Sec. 4.2 a-c)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt16

from ...core import POSITIVE, InputError, check_ranges
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from ._distance_kernels import SWEPT_REACH, distance_rows, exact_distance, swept_distance, vertical_cells

#: Minimum occupancy of an obstacle: occupied is then more likely than free.
OBSTACLE_FROM = OCCUPIED // 2

#: Maximum ratio of the speeds: above it, integer costs overflow or lose the resolution at full speed.
MAX_SPEED_RATIO = 1000.0

#: Cost of a straight step at full speed [units]; less if v_min is below v_max / 15.
_FAST_STEP = 4096
#: Rows of which distances are computed at a time: those of 4000 columns stay in a cache of 2 MB.
_BAND_ROWS = 256
#: Tolerance for a robot that touches the border of an obstacle exactly, against rounding of radius / resolution.
_TOUCH = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """Radius of the robot, and its speeds near to and far from obstacles.

    Distances are measured from the border of the occupied cells, which are closed squares: a disc of the radius
    overlaps none of them if the distance of its centre is at least the radius.
    The cost of a cell is the inverse of the possible speed (Alt 2016, Eq. (4.1)): infinite
    below ``radius_m``, ``1 / v_min`` there, decreasing linearly to ``1 / v_max`` at
    three times the radius.
    """

    radius_m: float = field(metadata=POSITIVE)  #: of the circle around the robot [m]
    v_max_m_s: float = field(default=0.3, metadata=POSITIVE)  #: far from obstacles [m/s]
    v_min_m_s: float = field(default=0.05, metadata=POSITIVE)  #: at an obstacle [m/s]

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.v_max_m_s < self.v_min_m_s:
            raise InputError(
                type(self).__name__,
                f"found {self.v_min_m_s}, expected at most v_max_m_s ({self.v_max_m_s})",
                field="v_min_m_s",
            )
        if self.v_max_m_s > MAX_SPEED_RATIO * self.v_min_m_s:
            raise InputError(
                type(self).__name__,
                f"found {self.v_min_m_s}, expected at least v_max_m_s / {MAX_SPEED_RATIO:g}"
                f" ({self.v_max_m_s / MAX_SPEED_RATIO:g})",
                field="v_min_m_s",
            )

    def cost_s_per_m(self, distance_m: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """Travel cost at a clearance [s/m], Eq. (4.1).

        Parameters
        ----------
        distance_m
            Clearance: distance to the nearest obstacle [m].
        """
        distance_m = np.asarray(distance_m, dtype=np.float64)
        fraction = np.clip((distance_m / self.radius_m - 1.0) / 2.0, 0.0, 1.0)
        cost = 1.0 / self.v_min_m_s + fraction * (1.0 / self.v_max_m_s - 1.0 / self.v_min_m_s)
        return np.where(distance_m >= self.radius_m * _TOUCH, cost, np.inf)

    def step_table(self, resolution_m: float) -> tuple[UInt16[np.ndarray, "d2"], float]:
        """Cost of a straight step by squared distance [cells^2 / 4], and the seconds of one unit.

        Integers, so that sums do not depend on their order. 0 denotes an unreachable cell.

        Parameters
        ----------
        resolution_m
            Edge length of a cell [m].
        """
        fast_s = resolution_m / self.v_max_m_s
        fast = min(float(_FAST_STEP), 65535.0 * self.v_min_m_s / self.v_max_m_s)
        unit_s = fast_s / max(fast, 1.0)
        far = math.ceil((6.0 * self.radius_m / resolution_m) ** 2) + 1
        if far > 16_000_000:
            raise InputError(
                "SpeedLimits",
                f"found {self.radius_m} m on cells of {resolution_m} m, expected a radius of at most 666 cells",
                field="radius_m",
            )
        distance_m = np.sqrt(np.arange(far + 1)) * (0.5 * resolution_m)
        cost_s = self.cost_s_per_m(distance_m) * resolution_m
        blocked = ~np.isfinite(cost_s)
        table = np.clip(np.rint(np.where(blocked, 0.0, cost_s) / unit_s), 1, 65535)
        return np.where(blocked, 0, table).astype(np.uint16), unit_s


@dataclass(frozen=True, slots=True, eq=False)
class GridLayers:
    """Distance, cost and reachable cells of a map."""

    map: OccupancyMap  #: source of the layers
    limits: SpeedLimits  #: robot of the layers
    unknown_is_free: bool  #: whether unknown cells were treated as free
    #: from a cell's centre to the border of the nearest obstacle's cell, including unknown cells and the outside
    distance_m: Float32[np.ndarray, "rows columns"]
    step: UInt16[np.ndarray, "rows columns"]  #: straight step onto a cell [units]; 0 if unreachable
    unit_s: float  #: seconds of one unit of ``step``

    @property
    def radius_m(self) -> float:
        """Radius of the robot [m]."""
        return self.limits.radius_m

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.map.shape

    @property
    def reachable(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells that the robot's centre can occupy: distance at least the radius."""
        return self.step > 0

    @property
    def cost_s_per_m(self) -> Float32[np.ndarray, "rows columns"]:
        """Cost of driving on a cell [s/m], Eq. (4.1); infinite if unreachable.

        Computed on every access: store the result.
        """
        return self.limits.cost_s_per_m(self.distance_m).astype(np.float32)


def grid_layers(map: OccupancyMap, limits: SpeedLimits, *, unknown_is_free: bool = False) -> GridLayers:
    """Distance, cost and reachable cells of a map (Alt 2016, Sec. 4.2 a-c and Eq. (4.1)).

    Parameters
    ----------
    map
        Occupancy; a cell is an obstacle if occupied is more likely than free.
        The outside of the map is unknown: it is not displayed as an obstacle, but no path leads there,
        and the robot keeps the same distance from the border as from an unknown cell beyond it.
    limits
        Radius and speeds of the robot.
    unknown_is_free
        Whether the robot may enter unknown cells; then the border is not an obstacle either.

    Returns
    -------
    GridLayers
        Distances are exact (Felzenszwalb and Huttenlocher 2012); infinite on a map without obstacles
        if unknown is free.
    """

    steps, unit_s = limits.step_table(map.resolution_m)
    vertical = np.zeros(map.shape, np.uint16)
    vertical_cells(np.ascontiguousarray(map.cells), OBSTACLE_FROM, not unknown_is_free, vertical)
    distance_m = np.zeros(map.shape, np.float32)
    step = np.zeros(map.shape, np.uint16)
    distance_rows(vertical, map.resolution_m, steps, not unknown_is_free, distance_m, step)
    return GridLayers(map, limits, unknown_is_free, distance_m, step, unit_s)


def window_distance(
    blocked: Bool[np.ndarray, "r c"],
    window: tuple[slice, slice],
    shape: tuple[int, int],
    *,
    outside_blocks: bool,
) -> Float32[np.ndarray, "r c"]:
    """Distance to the border of the nearest blocked cell [cells] in a window, as in :func:`grid_layers`.

    Parameters
    ----------
    blocked
        Blocked cells of the window.
    window, shape
        Rows and columns of the window in the map, and shape of the whole map.
    outside_blocks
        Whether the outside of the map counts as blocked.
    """
    (rows, columns), (last_row, last_column) = window, shape
    sides = (
        (int(rows.start == 0), int(rows.stop == last_row)),
        (int(columns.start == 0), int(columns.stop == last_column)),
    )
    # The outside of the map is one row of blocked cells; beyond the window nothing is known.
    padded = np.pad(blocked, sides, constant_values=outside_blocks)
    (top, _), (left, _) = sides
    distance = cell_distance(padded, outside_blocks=False)
    return distance[top : top + blocked.shape[0], left : left + blocked.shape[1]]


def cell_distance(
    blocked: Bool[np.ndarray, "rows columns"], reach: float = np.inf, *, outside_blocks: bool = True
) -> Float32[np.ndarray, "rows columns"]:
    """Distance to the border of the nearest blocked cell [cells].

    Parameters
    ----------
    blocked
        Mask of blocked cells.
    reach
        Maximum distance; larger ones are clipped [cells].
    outside_blocks
        Whether the outside counts as blocked.
    """
    distance = np.zeros(blocked.shape, np.float32)
    swept = reach <= SWEPT_REACH
    # Obstacles beyond the rows around a band are out of reach.
    rows, margin = (_BAND_ROWS, math.ceil(reach)) if swept else (len(blocked), 0)
    for first in range(0, len(blocked), rows):
        low, last = max(first - margin, 0), first + rows
        band = np.ascontiguousarray(blocked[low : last + margin])
        vertical = np.zeros(band.shape, np.uint16)
        vertical_cells(band.view(np.int8), 1, outside_blocks, vertical)
        if swept:
            swept_distance(
                vertical[first - low : last - low], float(reach), outside_blocks, distance[first:last]
            )
        else:
            exact_distance(vertical, outside_blocks, distance)
            np.minimum(distance, np.float32(reach), out=distance)
    return distance
