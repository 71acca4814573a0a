"""A map from laser scans: log-odds ray casting, with every scan matched to the map before it is added.

Deliberately simple, without a pose graph: a loop closes only as long as the
drift stays within the search window of the matching. Maps of any SLAM system
are the normal input; this mapper serves robots without one.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...core import MAX_PIXELS, InputError, LaserScan, Reason, compose_2d, finite_array, relative_2d
from ...io.maps.occupancy_map import FREE, OccupancyMap
from ._mapper_kernels import add_beams
from .scan_matching import FREE_LOG_ODDS as _SURELY_FREE
from .scan_matching import HitGrid, MatchSettings, PlanarPose, ScanMatch, match_scan

#: Probability below which a cell is free: passed by two beams.
_FREE_BELOW = 0.35

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """Grid, sensor model and odometry."""

    resolution_m: float = 0.05
    hit: float = 0.85  #: log-odds of a cell where a beam ends: probability 0.7
    miss: float = -0.4  #: of a cell that a beam passes: 0.4; two make a cell free
    bound: float = 5.0  #: maximum magnitude of the log-odds
    odometry_sigma_per_m: float = 0.1  #: drift of the odometry: standard deviation per path length
    odometry_sigma_rad_per_rad: float = 0.1
    odometry_sigma_rad_per_m: float = 0.05
    odometry_floor: tuple[float, float] = (0.02, 0.02)  #: standard deviation per scan [m, rad]
    match: MatchSettings = field(default_factory=MatchSettings)
    #: after this number of consecutive scans that do not fit, the map is considered wrong here
    patience: int = 15
    warm_up_scans: int = 2  #: number of scans that are added at the odometry pose
    add_every_m: float = 0.15  #: scans in between are matched and not added: each adds its error to the map
    add_every_rad: float = 0.03
    well_known: float = 0.9  #: a scan with fewer points near hits is added, however near the last one

    def __post_init__(self) -> None:
        if not (0 < self.resolution_m <= 1 and self.hit > 0 > self.miss and self.bound > self.hit):
            found = f"resolution {self.resolution_m:g} m, hit {self.hit:g}, miss {self.miss:g}, bound {self.bound:g}"
            expected = "a resolution above 0 up to 1 m, hit > 0 > miss, bound > hit"
            raise InputError("MapperSettings", f"found {found}, expected {expected}")


class OccupancyMapper:
    """Incremental mapper that adds one scan at a time.

    The map frame is that of the first odometry pose.

    Parameters
    ----------
    settings
        Grid, sensor model and odometry.

    Examples
    --------
    >>> import numpy as np
    >>> mapper = OccupancyMapper()
    >>> scan = LaserScan(0.0, np.full(360, 2.0), -np.pi, np.pi / 180)
    >>> mapper.add(scan, (0.0, 0.0, 0.0)).valid
    True
    >>> int(mapper.map().value_at(np.array([1.0, 0.0])))
    0
    """

    def __init__(self, settings: MapperSettings | None = None) -> None:
        self.settings = settings or MapperSettings()
        self.matches: list[ScanMatch] = []  #: one per scan
        self._r = self.settings.resolution_m
        self._odometry: PlanarPose | None = None
        self._pose = (0.0, 0.0, 0.0)
        self._spread = np.zeros((3, 3))
        self._added_at: PlanarPose | None = None
        self._added = 0
        self._refused = 0
        self._grid = HitGrid.unknown((1, 1), self._r, np.zeros(2))

    @classmethod
    def from_map(
        cls,
        grid: OccupancyMap,
        pose: PlanarPose,
        odometry: PlanarPose,
        settings: MapperSettings | None = None,
        hits_m: Float[np.ndarray, "k 2"] | None = None,
    ) -> OccupancyMapper:
        """Continue with an existing map: to localise in it, or to refine it.

        Parameters
        ----------
        grid
            The map; its axes are those of its frame. Walls are assumed to be in the middle of those of their cells that
            a beam can reach: no beam ends behind them, inside a thick wall.
        pose
            Pose of the scanner (x, y, yaw) in the map [m, rad].
        odometry
            Pose of the scanner by odometry at the same time [m, rad].
        settings
            Settings of sensor model and odometry; the resolution is the map's.
        hits_m
            Mean hits of the mapper that made the map, from :meth:`mean_hits_m`: scans are then matched as accurately as
            by that mapper. The cells alone leave an error of half a cell (2 cm) in every pose.

        Raises
        ------
        InputError
            The map is rotated in its frame.
        """
        if abs(grid.origin[2]) > 1e-9:
            raise InputError("map", f"found an origin turned by {grid.origin[2]:g} rad, expected 0")
        mapper = cls(replace(settings or MapperSettings(), resolution_m=grid.resolution_m))
        # A map may end at its outer walls: points are matched to cells at a distance from the edge of the grid.
        rim = mapper.settings.match.reach_cells + 2
        cells = np.pad(grid.cells, rim, constant_values=-1)
        corner_m = np.array(grid.origin[:2]) - rim * grid.resolution_m
        hits = mapper._grid = HitGrid.unknown(cells.shape, grid.resolution_m, corner_m)
        bound = mapper.settings.bound
        occupied, free = cells >= 50, cells == FREE
        hits.log_odds[occupied], hits.log_odds[free] = bound, -bound
        if hits_m is None:
            places = np.argwhere(occupied & ndimage.binary_dilation(free)) + 0.5
        else:
            places = ((hits_m - corner_m) / grid.resolution_m)[:, ::-1]
            places = places[((places >= 0.0) & (places < cells.shape)).all(axis=1)]
        hit = tuple(places.astype(np.int64).T)
        hits.count[hit] = 1.0
        hits.mean_row[hit], hits.mean_column[hit] = places.T
        mapper._pose, mapper._odometry = pose, odometry
        mapper._added = mapper.settings.warm_up_scans
        return mapper

    @property
    def pose(self) -> PlanarPose:
        """(x [m], y [m], yaw [rad]) of the scanner at the last scan, in the map."""
        return self._pose

    @property
    def trajectory(self) -> Float[np.ndarray, "n 3"]:
        """Poses of all scans."""
        return np.array([match.pose for match in self.matches]).reshape(-1, 3)

    def add(self, scan: LaserScan, odometry: PlanarPose) -> ScanMatch:
        """Match a scan to the map and add it.

        Parameters
        ----------
        scan
            One revolution of the scanner.
        odometry
            Pose of the scanner (x, y, yaw) by odometry, in any fixed frame [m, rad].

        Returns
        -------
        ScanMatch
            A scan that is not valid, has too few points or does not fit is not
            added; the pose is then propagated by odometry.
        """
        match = self._match(scan, odometry)
        self._refused = 0 if match.valid else self._refused + 1
        if self._refused > self.settings.patience and scan.valid:
            # The map is wrong here, and the robot would stay lost: restart from the odometry.
            _log.warning(
                "%d scans in a row do not fit the map, scan at %.2f s is added", self._refused, scan.t_s
            )
            match, self._refused = replace(match, valid=True), 0
        self._take(match)
        if match.valid and (match.inliers < self.settings.well_known or self._has_moved()):
            self._cast(scan)
        return match

    def locate(self, scan: LaserScan, odometry: PlanarPose) -> ScanMatch:
        """Match a scan to the map without adding it, for localisation only.

        Parameters
        ----------
        scan
            One revolution of the scanner.
        odometry
            Pose of the scanner (x, y, yaw) by odometry, in the frame of the last call [m, rad].

        Returns
        -------
        ScanMatch
            If the scan does not fit, the pose is propagated by odometry.
        """
        match = self._match(scan, odometry)
        self._take(match)
        return match

    def _take(self, match: ScanMatch) -> None:
        self._pose = match.pose
        if match.valid:
            self._spread = np.zeros((3, 3))
        self.matches.append(match)

    def _predict(self, odometry: PlanarPose) -> PlanarPose:
        """Pose by odometry since the last scan; its covariance grows until a scan fits again."""
        s = self.settings
        before, self._odometry = self._odometry, odometry
        if before is None:
            self._pose = odometry
            self._spread = np.diag([1e-6, 1e-6, 1e-6])
            return odometry
        step = relative_2d(before, odometry)
        path_m, turn = math.hypot(step[0], step[1]), step[2]
        place = (s.odometry_sigma_per_m * path_m) ** 2 + s.odometry_floor[0] ** 2
        angle = s.odometry_sigma_rad_per_rad * abs(turn) + s.odometry_sigma_rad_per_m * path_m
        self._spread = self._spread + np.diag([place, place, angle**2 + s.odometry_floor[1] ** 2])
        return compose_2d(self._pose, step)

    def _match(self, scan: LaserScan, odometry: PlanarPose) -> ScanMatch:
        finite_array("odometry", odometry, 3)
        guess = self._predict(odometry)
        points = scan.points_m
        if not scan.valid or len(points) < self.settings.match.min_points:
            reason = scan.reason if not scan.valid else Reason.LOST
            return ScanMatch(scan.t_s, False, reason, guess, self._spread, 0.0, float("nan"))
        if self._added < self.settings.warm_up_scans:
            return ScanMatch(scan.t_s, True, Reason.OK, guess, self._spread, 1.0, 0.0)
        return match_scan(self._grid, points, guess, self._spread, scan.t_s, self.settings.match)

    def _has_moved(self) -> bool:
        """Whether the scanner has moved since the last scan that was added."""
        last, now, s = self._added_at, self._pose, self.settings
        if last is None or self._added < s.warm_up_scans:
            return True
        turn = abs((now[2] - last[2] + math.pi) % (2 * math.pi) - math.pi)
        return math.hypot(now[0] - last[0], now[1] - last[1]) >= s.add_every_m or turn >= s.add_every_rad

    def _cast(self, scan: LaserScan) -> None:

        s, pose = self.settings, np.array(self._pose)
        seen = scan.hits | np.isposinf(scan.ranges_m) | (scan.ranges_m >= scan.range_max_m)
        hits = scan.hits[seen]
        ranges = np.where(hits, scan.ranges_m[seen], scan.range_max_m)
        angles = scan.angles_rad[seen] + pose[2]
        ends_m = pose[:2] + ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        self._make_room(np.vstack([ends_m, pose[None, :2]]))
        grid = self._grid
        start = (pose[:2] - grid.corner_m) / self._r
        ends = ((ends_m - grid.corner_m) / self._r)[:, ::-1].copy()
        self._added += 1
        self._added_at = self._pose
        add_beams(
            grid.log_odds, grid.stamp, self._added, start[1], start[0], ends, hits, s.hit, s.miss, s.bound
        )
        self._count_hits(ends[hits])

    def _count_hits(self, ends: Float[np.ndarray, "n 2"]) -> None:
        """Running means of the hits in every cell; cells that have become free lose theirs."""
        cells = np.floor(ends).astype(np.int64)
        grid, (_, columns) = self._grid, self._grid.count.shape
        flat = cells[:, 0] * columns + cells[:, 1]
        unique, first = np.unique(flat, return_inverse=True)
        fresh = np.bincount(first).astype(np.float32)
        old = grid.count.ravel()[unique]
        for mean, axis in ((grid.mean_row, 0), (grid.mean_column, 1)):
            total = np.bincount(first, weights=ends[:, axis])
            # The weight of new hits in an old cell decreases, but is bounded below.
            mean.ravel()[unique] = (mean.ravel()[unique] * old + total) / (old + fresh)
        grid.count.ravel()[unique] = np.minimum(old + fresh, 50.0)
        if len(cells):
            low, high = cells.min(axis=0), cells.max(axis=0) + 1
            box = slice(low[0], high[0]), slice(low[1], high[1])
            grid.count[box][grid.log_odds[box] < _SURELY_FREE] = 0.0

    def _make_room(self, points_m: Float[np.ndarray, "n 2"]) -> None:
        """Grow the grid so that it holds the points, by at least half its size."""
        low, high = (
            # No map has cells farther away, and an integer cannot hold every distance.
            np.floor(np.clip((corner_m - self._grid.corner_m) / self._r, -MAX_PIXELS, MAX_PIXELS)).astype(int)
            for corner_m in (points_m.min(axis=0), points_m.max(axis=0))
        )
        low, high = low - 5, high + 6
        size = np.array(self._grid.count.shape)[::-1]
        if (low >= 0).all() and (high <= size).all():
            return
        spare = np.maximum(size // 2, round(5.0 / self._r))
        before = np.where(low < 0, np.maximum(-low, spare), 0)
        after = np.where(high > size, np.maximum(high - size, spare), 0)
        wide, tall = (int(v) for v in size + before + after)
        if wide * tall > MAX_PIXELS:
            raise InputError(
                "scan",
                f"the map would grow to {tall} x {wide} cells, expected at most {MAX_PIXELS}",
                remedy="a coarser resolution_m or a smaller range_max_m",
            )
        self._grid = self._grid.grown(before, after)

    def mean_hits_m(self) -> Float[np.ndarray, "k 2"]:
        """Mean position of the hits in every cell that has hits (x, y), map frame [m]."""
        grid, hit = self._grid, self._grid.count > 0
        places = np.column_stack([grid.mean_column[hit], grid.mean_row[hit]]).astype(np.float64)
        return grid.corner_m + self._r * places

    def map(self) -> OccupancyMap:
        """The map so far: occupied above a probability of 0.65, free below 0.35, cropped to the observed area."""
        seen = np.argwhere(self._grid.log_odds != 0.0)
        if len(seen) == 0:
            raise InputError("OccupancyMapper", "no scan was added, there is no map")
        (top, left), (bottom, right) = seen.min(axis=0), seen.max(axis=0) + 1
        part = self._grid.log_odds[top:bottom, left:right]
        probability = np.where(part == 0.0, np.nan, 1.0 / (1.0 + np.exp(-part.astype(np.float64))))
        corner = self._grid.corner_m + np.array([left, top]) * self._r
        return OccupancyMap.from_probability(
            probability, self._r, origin=(float(corner[0]), float(corner[1]), 0.0), free_thresh=_FREE_BELOW
        )


def build_map(
    scans: Iterable[tuple[LaserScan, PlanarPose]], settings: MapperSettings | None = None
) -> OccupancyMapper:
    """Map a whole recording.

    Parameters
    ----------
    scans
        Laser scans with the odometry pose of each: x, y [m], yaw [rad].
    settings
        Grid, sensor model and odometry.
    """
    mapper = OccupancyMapper(settings)
    for scan, odometry in scans:
        mapper.add(scan, odometry)
    return mapper
