"""Pose of a scan in a map: search over shifts and rotations, then point-to-line refinement, with a covariance.

The search (Olson 2009, correlative scan matching, here in one resolution)
finds the right optimum even with an odometry error of decimetres; the
refinement uses the mean hit of every cell, which is finer than the cell,
and the line through the means around it. The odometry is included as a
measurement: in a bare corridor, which does not constrain the position along it,
that component comes from the odometry, and the covariance shows it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from ...core import POSITIVE, Reason, check_ranges, rotation_2d, wrap_angle
from ._mapper_kernels import correlate, nearest_lines

#: x [m], y [m], yaw [rad] in the map.
PlanarPose = tuple[float, float, float]
#: Of a pose [m, m, rad].
Covariance = Float[np.ndarray, "3 3"]
#: x, y of the points of a scan, in its frame [m].
Points = Float[np.ndarray, "n 2"]

#: Log-odds below which a point in a cell contradicts the map: passed by three beams or more.
FREE_LOG_ODDS = -1.0


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """Parameters of scan matching."""

    window_m: float = field(default=0.3, metadata=POSITIVE)  #: maximum shift in each direction
    window_rad: float = field(default=0.15, metadata=POSITIVE)  #: maximum rotation
    turn_step_rad: float = field(default=0.015, metadata=POSITIVE)
    points: int = 180  #: number of points of the scan that are used in the search
    reach_cells: int = 3  #: maximum distance of an inlier from a hit
    #: standard deviation of a point from its line: scanner, cells and walls that are not straight
    sigma_m: float = field(default=0.02, metadata=POSITIVE)
    iterations: int = 12
    min_points: int = 40  #: minimum number of points of a scan
    min_known: int = 25  #: minimum number of points on the known part of the map
    min_inliers: float = 0.35  #: fraction of these points that must be near a hit

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Pose of a scan in the map."""

    t_s: float
    valid: bool
    reason: Reason
    pose: PlanarPose  #: (x [m], y [m], yaw [rad]) of the scanner; by odometry alone if not valid
    covariance: Covariance  #: of the pose [m, rad], given the map
    inliers: float  #: fraction of the points on the known part of the map that are near a hit
    residual_m: float  #: root mean square distance of the inliers from their lines


@dataclass(frozen=True, slots=True, eq=False)
class HitGrid:
    """The map for matching: the mean hit of each cell, in grid coordinates; everywhere unknown where it begins."""

    mean_row: Float32[np.ndarray, "rows columns"]
    mean_column: Float32[np.ndarray, "rows columns"]
    count: Float32[np.ndarray, "rows columns"]
    log_odds: Float32[np.ndarray, "rows columns"]  #: 0 where unknown
    stamp: Int32[np.ndarray, "rows columns"]  #: number of the last scan that changed a cell
    resolution_m: float
    corner_m: Float[np.ndarray, "2"]  #: (x, y) of the corner of cell (0, 0); the grid's axes are the map's

    @classmethod
    def unknown(
        cls, shape: tuple[int, int], resolution_m: float, corner_m: Float[np.ndarray, "2"]
    ) -> HitGrid:
        """A grid without a hit.

        Parameters
        ----------
        shape
            Rows and columns.
        resolution_m, corner_m
            Size of a cell, and (x, y) of the corner of cell (0, 0) [m].
        """
        row, column, count, log_odds = (np.zeros(shape, dtype=np.float32) for _ in range(4))
        return cls(row, column, count, log_odds, np.zeros(shape, dtype=np.int32), resolution_m, corner_m)

    def grown(self, before: Int[np.ndarray, "2"], after: Int[np.ndarray, "2"]) -> HitGrid:
        """The same map in a larger grid.

        Parameters
        ----------
        before, after
            Number of columns and rows to add at the corner of cell (0, 0) and opposite to it.
        """
        pad = tuple(zip(before[::-1].tolist(), after[::-1].tolist(), strict=True))
        return HitGrid(
            np.pad(self.mean_row, pad) + np.float32(before[1]),
            np.pad(self.mean_column, pad) + np.float32(before[0]),
            np.pad(self.count, pad),
            np.pad(self.log_odds, pad),
            np.pad(self.stamp, pad),
            self.resolution_m,
            self.corner_m - before * self.resolution_m,
        )


def match_scan(
    grid: HitGrid,
    points_m: Points,
    guess: PlanarPose,
    guess_covariance: Covariance,
    t_s: float,
    settings: MatchSettings | None = None,
) -> ScanMatch:
    """Match a scan to a map.

    Parameters
    ----------
    grid
        The map so far.
    points_m
        Hits in the frame of the scanner.
    guess, guess_covariance
        Pose by odometry (x, y, yaw) [m, rad] and its covariance.
    t_s
        Time of the scan.
    settings
        Search window and tolerances.

    Returns
    -------
    ScanMatch
        Not valid, with the guess as its pose, if the scan has too few points
        or contradicts the map. A scan of mostly unknown space is valid at the
        odometry pose.
    """
    settings = settings or MatchSettings()
    cannot = ScanMatch(t_s, False, Reason.LOST, guess, guess_covariance, 0.0, float("nan"))
    if len(points_m) < settings.min_points:
        return cannot
    start = _search(grid, points_m, guess, guess_covariance, settings)
    pose, covariance, residual_m = _refine(grid, points_m, start, guess, guess_covariance, settings)
    known, near = _agreement(grid, points_m, pose, settings)
    inliers = near / max(known, 1)
    if known < settings.min_known:
        return ScanMatch(t_s, True, Reason.OK, guess, guess_covariance, inliers, residual_m)
    if inliers < settings.min_inliers:
        return ScanMatch(t_s, False, Reason.LOST, guess, guess_covariance, inliers, residual_m)
    return ScanMatch(t_s, True, Reason.OK, pose, covariance, inliers, residual_m)


def _near_lines(
    grid: HitGrid, points_m: Points, pose: PlanarPose, reach_cells: int
) -> tuple[Points, Points, Float[np.ndarray, "n 5"]]:
    """Points rotated into the map's axes [m], their positions in the grid (row, column) [cells], the lines near them."""
    turned = points_m @ rotation_2d(pose[2]).T
    places = ((turned + np.array(pose[:2]) - grid.corner_m) / grid.resolution_m)[:, ::-1].copy()
    return turned, places, nearest_lines(grid.mean_row, grid.mean_column, grid.count, places, reach_cells)


def _agreement(grid: HitGrid, points_m: Points, pose: PlanarPose, settings: MatchSettings) -> tuple[int, int]:
    """Number of points in the known part of the map, and number of those near a hit."""

    _, places, lines = _near_lines(grid, points_m, pose, settings.reach_cells)
    cells = np.floor(places).astype(np.int64)
    inside = ((cells >= 0) & (cells < grid.count.shape)).all(axis=1)
    cells = np.where(inside[:, None], cells, 0)
    near = lines[:, 4] != 0
    known = near | (inside & (grid.log_odds[cells[:, 0], cells[:, 1]] < FREE_LOG_ODDS))
    return int(known.sum()), int(near.sum())


def _search(
    grid: HitGrid, points_m: Points, guess: PlanarPose, guess_covariance: Covariance, settings: MatchSettings
) -> PlanarPose:
    """Best of all shifts and rotations in the window by the number of points near hits, and by the odometry."""

    r = grid.resolution_m
    chosen = points_m[:: max(len(points_m) // settings.points, 1)]
    points = chosen[:, ::-1] / r
    # Only a window around the scan is blurred, to save time.
    reach = float(np.abs(points).max()) * 1.5 + settings.window_m / r + 4
    row, column = (guess[1] - grid.corner_m[1]) / r, (guess[0] - grid.corner_m[0]) / r
    top, left = max(int(row - reach), 0), max(int(column - reach), 0)
    window = slice(top, int(row + reach) + 1), slice(left, int(column + reach) + 1)
    field = _near_hits(grid.count[window], grid.stamp[window])
    if field.size == 0:
        return guess
    steps = np.arange(-round(settings.window_m / r), round(settings.window_m / r) + 1)
    half = round(settings.window_rad / settings.turn_step_rad)
    turns = np.arange(-half, half + 1) * settings.turn_step_rad
    angles = guess[2] + turns
    score = correlate(field, points, row - top + steps, column - left + steps, np.cos(angles), np.sin(angles))
    # The odometry as a prior, in the scale of a mean log-likelihood per point.
    information = np.linalg.inv(guess_covariance)
    shift = np.stack(np.meshgrid(turns, steps * r, steps * r, indexing="ij"), axis=-1)[..., ::-1]
    prior = np.einsum("...i,ij,...j->...", shift, information, shift) / (2.0 * len(chosen))
    best = np.unravel_index(int(np.argmax(score - 0.2 * prior)), score.shape)
    return (
        guess[0] + float(steps[best[2]]) * r,
        guess[1] + float(steps[best[1]]) * r,
        guess[2] + float(turns[best[0]]),
    )


def _near_hits(
    count: Float32[np.ndarray, "rows columns"], stamp: Int32[np.ndarray, "rows columns"]
) -> Float32[np.ndarray, "rows columns"]:
    """1 at cells with hits, decreasing to 0 two cells away; where no beam has been, what a point beside its hit has.

    New points would otherwise count as misses, and of equal places, as between posts, the one with most overlap would be best.
    """
    import cv2

    if count.size == 0:
        return count
    distance = cv2.distanceTransform((count == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
    near = np.exp(-0.5 * np.minimum(distance, 9.0) ** 2).astype(np.float32)
    return np.where(stamp == 0, np.maximum(near, np.float32(np.exp(-0.5))), near)


def _refine(
    grid: HitGrid,
    points_m: Points,
    start: PlanarPose,
    guess: PlanarPose,
    guess_covariance: Covariance,
    settings: MatchSettings,
) -> tuple[PlanarPose, Covariance, float]:
    """Pose, covariance and residual [m]: Gauss-Newton on point-to-line distances with Huber weights, and on the odometry."""

    r = grid.resolution_m
    prior = np.linalg.inv(guess_covariance)
    pose = np.array(start)
    information = prior
    residual_m = float("nan")
    for _ in range(settings.iterations):
        turned, places, lines = _near_lines(grid, points_m, (pose[0], pose[1], pose[2]), settings.reach_cells)
        found = lines[:, 4] > 0
        normal = lines[found][:, [3, 2]]
        away = places[found] - lines[found][:, :2]
        residual = np.einsum("ij,ij->i", away[:, ::-1], normal) * r
        lever = np.einsum("ij,ij->i", normal, np.column_stack([-turned[found][:, 1], turned[found][:, 0]]))
        jacobian = np.column_stack([normal, lever])
        huber = np.minimum(1.0, 1.5 * settings.sigma_m / np.maximum(np.abs(residual), 1e-12))
        weight = lines[found][:, 4] * huber / settings.sigma_m**2
        off = pose - np.array(guess)
        off[2] = wrap_angle(off[2])
        information = jacobian.T @ (weight[:, None] * jacobian) + prior
        step = np.linalg.solve(information, -(jacobian.T @ (weight * residual) + prior @ off))
        pose = pose + step
        residual_m = float(np.sqrt(np.mean(residual**2))) if len(residual) else float("nan")
        if np.abs(step[:2]).max() < 1e-4 and abs(step[2]) < 1e-5:
            break
    return (float(pose[0]), float(pose[1]), float(pose[2])), np.linalg.inv(information), residual_m
