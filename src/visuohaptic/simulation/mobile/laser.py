"""A laser scanner in an occupancy map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from ...core import InputError, LaserScan, Ranged, above, at_least, rotation_2d, within
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap


@dataclass(frozen=True, slots=True)
class LaserConfig(Ranged):
    """The scanner of Alt 2016, Sec. 4.2: 240 degrees; number, noise and range of a small Hokuyo."""

    beams: int = field(default=341, metadata=at_least(2))
    field_of_view_rad: float = field(default=4.18879, metadata=above(0, 2 * np.pi))
    range_min_m: float = 0.05
    range_max_m: float = 8.0
    sigma_m: float = 0.01
    #: fraction of beams that randomly lack an echo
    lost_fraction: float = field(default=0.01, metadata=within(0, 1))


class SimulatedLaser:
    """Scans of a map from any pose.

    Occupied cells (50 and more) return an echo at their border; unknown cells end
    a beam without one, so that unobserved space is not visible.

    Parameters
    ----------
    grid
        The world.
    config
        The scanner.
    rng
        Source of noise and lost beams.
    """

    def __init__(self, grid: OccupancyMap, config: LaserConfig | None, rng: np.random.Generator) -> None:
        self.config = config or LaserConfig()
        self._grid = grid
        self._rng = rng
        opaque: UInt8[np.ndarray, "rows columns"] = np.where(grid.unknown, 2, 0).astype(np.uint8)
        opaque[grid.cells >= 50] = 1
        self._opaque = opaque

    def scan(self, pose: tuple[float, float, float], t_s: float) -> LaserScan:
        """The scan from a pose in the map frame.

        Parameters
        ----------
        pose
            (x [m], y [m], yaw [rad]).
        t_s
            Time of the scan [s].

        Raises
        ------
        InputError
            The pose is not on the map.
        """
        from ._laser_kernels import cast

        config, grid = self.config, self._grid
        place = np.array(pose[:2])
        if not bool(grid.inside(grid.cell_from_world(place))):
            raise InputError("pose", f"found {pose}, expected a place on the map")
        step = config.field_of_view_rad / (config.beams - 1)
        first = -0.5 * config.field_of_view_rad
        angles = first + step * np.arange(config.beams) + pose[2] - grid.origin[2]
        local = (place - np.array(grid.origin[:2])) @ rotation_2d(grid.origin[2]) / grid.resolution_m
        directions = np.column_stack([np.sin(angles), np.cos(angles)])
        longest = config.range_max_m / grid.resolution_m
        ranges = cast(self._opaque, float(local[1]), float(local[0]), directions, longest) * grid.resolution_m
        ranges = ranges + config.sigma_m * self._rng.standard_normal(config.beams)
        ranges[ranges >= config.range_max_m] = np.inf
        ranges[self._rng.random(config.beams) < config.lost_fraction] = np.nan
        with np.errstate(invalid="ignore"):
            ranges[ranges < config.range_min_m] = np.nan
        return LaserScan(
            t_s, ranges, first, step, config.range_min_m, config.range_max_m, max(config.sigma_m, 1e-4)
        )


def with_outlines(grid: OccupancyMap, outlines_m: Iterable[Float[np.ndarray, "k 2"]]) -> OccupancyMap:
    """The map with objects on its floor.

    Parameters
    ----------
    grid
        The floor without them.
    outlines_m
        Corners (x, y) of the outline of each, map frame [m]. What is outside of the map is left out.
    """
    import shapely

    cells = grid.cells.copy()
    for outline in outlines_m:
        # Cells whose centre is inside: with every cell that the outline touches, a side would be half a cell further out.
        corners = grid.cell_from_world(outline).astype(int)
        low, end = (np.clip(part, 0, grid.shape) for part in (corners.min(axis=0), corners.max(axis=0) + 1))
        window = np.ix_(*(np.arange(first, last) for first, last in zip(low, end, strict=True)))
        x, y = grid.world_from_cell(np.stack(np.broadcast_arrays(*window), axis=-1)).transpose(2, 0, 1)
        cells[window] = np.where(shapely.contains_xy(shapely.Polygon(outline), x, y), OCCUPIED, cells[window])
    return OccupancyMap(cells, grid.resolution_m, grid.origin)
