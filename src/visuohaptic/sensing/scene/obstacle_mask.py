"""Detection of approaching obstacles by their height above the floor, and their distance.

The dissertation (Alt 2016, Sec. 3.5) names two cues of an obstacle, its appearance and its height, and uses the
appearance because a floor could not be tracked in blurred images. Appearance fails on tiles, brick and
shadows; here the height is used, without tracks: :mod:`.obstacle_parallax` compares frames along the drive.

Evidence is a sequential test of each cell of the floor. A pixel has the likelihood ratio ``r = p_face / p_floor``. On the
floor the mean of r is 1, and that of its concave function

    2 r / (1 + r)

is 1 at most; the same holds for residuals with other tails than assumed, as long as ``log r`` is symmetric. No single pixel counts more
than twofold, so that the outlines of a textureless face add up, and one highlight does not. The sum e of its logarithms over the
pixels of a cell, divided by ``correlated_bins``, the number of pixels per independent sample, is
the logarithm of a supermartingale (Ramdas et al., Stat. Sci. 38, 2023). e is limited to ``log(1 / disturbed)`` in both directions, as in
Huber's robust test (Ann. Math. Statist. 36, 1965), since a fraction of the frames may be disturbed, and summed along the drive, never
below 0 (Page's test): the alarm rate is at most the number of cells times that of comparisons times
``exp(-threshold)`` (Lorden 1971). The threshold follows from ``alarms_per_minute``.

A face is wider than a cell, and on a textureless face only the outlines contain information: the sums over adjacent cells of the
narrowest faces, and of faces of twice, four times the width and more, are tested in parallel, and share the alarm rate.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from ...core import InputError, Motion, PlaneView, Reason, compose_2d, relative_2d, rotation_2d
from ...core.camera.frame import USUAL_RATE_Hz
from .obstacle_parallax import PARTS, FaceCells, FramePair, ObstacleSettings, StripImage

#: Number of comparisons per baseline: closer frames show the same pixels again.
_COMPARISONS = 6
#: Standard deviation of a range that is common to all frames of a face [steps of the ranges]: faces are not exactly perpendicular
#: to the drive, and interpolation blurs the two frames differently. Measured: rms of the mean errors of 21 open drives of
#: ``benchmarks.scene_evidence``, 0.86 mm for a step of 8.7 mm; of plain boxes on brick, up to 7 mm.
_SYSTEMATIC_STEPS = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """Obstacles in the strip, and their distance."""

    mask: UInt8[np.ndarray, "rows columns"]  #: 255 = not floor; bins of the strip at the upper border
    binning: int  #: edge of a bin of ``mask`` [px]
    valid: bool  #: the mask is valid
    reason: Reason
    proximity_m: float  #: from the front of the foam to the nearest obstacle; inf = free
    proximity_sigma_m: float
    y_m: float  #: lateral position of the nearest obstacle; NaN when free
    at_border: bool  #: it reaches the lower border of the strip: it may be closer than ``proximity_m``
    remembered: bool = False  #: not from this frame: seen before, and propagated with the platform's motion


def _summed(cells: np.ndarray, width: int) -> np.ndarray:
    """Sums over ``width`` adjacent cells across, (ranges, laterals), each at the position of the middle one."""
    import cv2

    return np.asarray(cv2.boxFilter(cells, -1, (width, 1), normalize=False, borderType=cv2.BORDER_CONSTANT))


class ObstacleDetector:
    """Detects approaching obstacles in the upper strip of the camera's image by their parallax.

    There is no parallax at standstill: after ``stale_s`` without a comparison, obstacles are not valid
    (``stale``); before the first comparisons they are not valid either (``not_zeroed``).

    Parameters
    ----------
    floor_view
        The floor plane in the camera's view, its axes along those of the sensor frame F.
    front_m
        x of the foam's undeformed front contour.
    settings
        Size of the strip and the cells, and the rate of false alarms.
    """

    def __init__(
        self, floor_view: PlaneView, front_m: float = 0.02, settings: ObstacleSettings | None = None
    ) -> None:
        self.settings = s = settings or ObstacleSettings()
        self.floor_view, self.front_m = floor_view, float(front_m)
        edge = floor_view.T_camera_plane.apply(np.array([self.front_m, 0.0, s.height_m]))
        foam = floor_view.camera.project(edge)[1]
        rows = s.rows if not foam >= 8 else min(s.rows, int(foam))
        self._cells = FaceCells(floor_view, rows, s)
        shape = (len(self._cells.range_m), len(self._cells.lateral_m))
        #: maximum change of the evidence by one frame
        self._limit = math.log(1.0 / s.disturbed)
        # The narrowest faces, those of twice, four times the width and so on: every face is covered by at least half.
        self._widths = tuple(PARTS * 2**k for k in range((shape[1] // PARTS).bit_length() - 1))
        self._in_view = _summed(self._cells.in_view.astype(np.float64), PARTS) > 0
        # Every frame of the usual camera is compared. Half of the alarms are those of the narrowest faces, a quarter of the next, and so on.
        self._thresholds = math.log(
            shape[0] * shape[1] * 60.0 * USUAL_RATE_Hz / s.alarms_per_minute
        ) + math.log(2.0) * np.arange(1, len(self._widths) + 1)
        self._needed = math.ceil(self._thresholds[0] / self._limit)
        self._step_m = self._cells.baseline_m / _COMPARISONS
        self._evidence = np.zeros((len(self._widths), *shape))
        self._keys: deque[tuple[StripImage, np.ndarray, np.ndarray]] = deque(maxlen=3 * _COMPARISONS)
        #: errors of the last ranges of the nearest face, predicted from the previous one [m]
        self._misses: deque[float] = deque(maxlen=_COMPARISONS)
        self._restart()

    def _restart(self) -> None:
        self._keys.clear()
        self._evidence[:] = 0.0
        self._pose, self._compared_at = np.zeros(3), np.zeros(3)
        self._comparisons, self._compared_s = 0, -math.inf
        self._sigma = np.zeros(3)
        self._standing, self._at_border = np.zeros((0, 2)), False
        self._range_m = self._sigma_m = self._y_m = math.nan
        self._misses.clear()

    @property
    def sight_m(self) -> float:
        """Distance in front of the foam at which the lowest obstacle has been in view for long enough to be detected."""
        return max(self._cells.face_far_m - self._needed * self._step_m - self.front_m, 0.0)

    @property
    def blind_m(self) -> float:
        """Distance in front of the foam at which the strip starts: closer obstacles are not monitored."""
        return max(self._cells.near_m - self.front_m, 0.0)

    def update(self, image: UInt8[np.ndarray, "rows columns *colour"], motion: Motion) -> Obstacle:
        """Nearest obstacle in one frame.

        Parameters
        ----------
        image
            Grey or colour image.
        motion
            Motion of frame F since the previous frame; if it is not valid, the detection restarts.
        """
        camera, cells = self.floor_view.camera, self._cells
        if image.shape[:2] != (camera.height, camera.width):
            raise InputError(
                "ObstacleDetector.update",
                f"found an image of {image.shape[1]} x {image.shape[0]}, "
                f"expected {camera.width} x {camera.height}",
            )
        if not motion.valid:
            self._restart()
        else:
            step = np.array([*motion.translation_m, motion.rotation_rad])
            self._pose = np.array(compose_2d(self._pose, step))
            self._standing = (self._standing - step[:2]) @ rotation_2d(step[2])
            self._range_m -= step[0]
            # Odometry has a scale error: errors of successive frames add linearly.
            self._sigma = self._sigma + np.sqrt(np.diag(motion.covariance))
        way = np.linalg.norm((self._pose - self._compared_at)[:2])
        if not self._keys or way >= self._step_m:
            now, hidden = cells.prepare(image), self._mask()
            self._carry()
            self._compare(now, hidden, motion.t_s)
            self._keys.append((now, self._pose, self._sigma))
        if self._comparisons < self._needed or motion.t_s - self._compared_s > self.settings.stale_s:
            reason = Reason.STALE if self._comparisons >= self._needed else Reason.NOT_ZEROED
            mask = np.zeros(cells.shape, np.uint8)
            return Obstacle(mask, cells.binning, False, reason, np.nan, np.inf, np.nan, False)
        return self._nearest()

    def _compare(self, now: StripImage, hidden: UInt8[np.ndarray, "rows columns"], t_s: float) -> None:
        """Evidence of the newest frame, compared with the one a baseline before."""
        ahead = self._cells.baseline_m
        while len(self._keys) > 1 and np.linalg.norm((self._pose - self._keys[1][1])[:2]) >= ahead:
            self._keys.popleft()
        if not self._keys or np.linalg.norm((self._pose - self._keys[0][1])[:2]) < ahead:
            return
        before, pose, sigma = self._keys[0]
        motion = np.array(relative_2d(pose, self._pose))
        pair = self._cells.pair(now, before, motion, self._sigma - sigma, hidden)
        single = self._cells.compare(pair)
        # A face is the sum of its cells: on a textureless one only the outlines contain information.
        evidence = np.stack([_summed(single, width) for width in self._widths])
        # The same factor for all ranges of a direction preserves their order.
        evidence *= np.minimum(1.0, self._limit / np.maximum(evidence.max(axis=1, keepdims=True), 1e-9))
        self._evidence = np.maximum(self._evidence + np.maximum(evidence, -self._limit), 0.0)
        self._comparisons, self._compared_s = self._comparisons + 1, t_s
        self._locate(pair)

    def _carry(self) -> None:
        """Propagate the evidence with the floor, from its previous to the current platform pose."""
        import cv2

        x, y, turn = relative_2d(self._compared_at, self._pose)
        self._compared_at = self._pose
        cells, (c, s) = self._cells, (math.cos(turn), math.sin(turn))
        # From current (lateral, range) indices to previous ones.
        size = np.array([self.settings.width_m / PARTS, cells.range_m[1] - cells.range_m[0]])
        start = np.array([cells.lateral_m[0], cells.range_m[0]])
        turned = np.array([[c, s], [-s, c]])
        offset = (turned @ start + np.array([y, x]) - start) / size
        moved = np.column_stack([turned * size / size[:, None], offset])
        flags, shape = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cells.in_view.shape[::-1]
        for k, evidence in enumerate(self._evidence):
            self._evidence[k] = self._in_view * cv2.warpAffine(evidence, moved, shape, flags=flags)

    def _locate(self, pair: FramePair) -> None:
        """Cells above the threshold, and the range of the nearest ones."""
        cells = self._cells
        found = self._evidence[0] > self._thresholds[0]
        wider = zip(self._evidence[1:], self._thresholds[1:], self._widths[1:], strict=True)
        for evidence, threshold, width in wider:
            # Of the cells of a wide face, those with their own evidence are occupied.
            wide = _summed((evidence > threshold).astype(np.float64)[:, ::-1], width)[:, ::-1] > 0
            found |= wide & (self._evidence[0] > 0.0)
        standing = np.flatnonzero(found.any(axis=0))
        best = np.where(found, self._evidence[0], -1.0)[:, standing].argmax(axis=0)
        self._standing = np.column_stack([cells.range_m[best], cells.lateral_m[standing]])
        self._at_border = False
        if not len(standing):
            self._range_m = math.nan
            self._misses.clear()
            return
        # One face consists of the cells consistent with the range of the nearest one: on a textureless face all have little evidence.
        around = slice(max(int(best.min()) - 1, 0), int(best.min()) + 2)
        one = (self._evidence[0][around][:, standing] > 0.0).any(axis=0)
        nearest, face = int(np.median(best[one])), standing[one]
        found, spread = cells.locate(pair, nearest, face)
        if math.isfinite(self._range_m):
            self._misses.append(found - self._range_m)
        # Two ranges of one face differ by both their errors; the spread of the likelihood counts as one range.
        squares = spread**2 + 0.5 * sum(miss**2 for miss in self._misses)
        random_m = math.sqrt(squares / (1 + len(self._misses)))
        # The range is measured in units of the drive.
        drive_m = pair.drive_sigma_m * (found - cells.eye_x_m) / cells.baseline_m
        common_m = _SYSTEMATIC_STEPS * (cells.range_m[1] - cells.range_m[0])
        self._standing[one, 0] = found
        self._range_m, self._sigma_m = found, math.hypot(random_m, common_m, drive_m)
        self._y_m, self._at_border = float(cells.lateral_m[face].mean()), nearest == 0

    def _nearest(self) -> Obstacle:
        """Result of the last comparison, relative to the current platform pose."""
        near, sigma, y = self._range_m - self.front_m, self._sigma_m, self._y_m
        if not len(self._standing):
            near, sigma, y = np.inf, np.inf, np.nan
        return Obstacle(self._mask(), self._cells.binning, True, Reason.OK, near, sigma, y, self._at_border)

    def _mask(self) -> UInt8[np.ndarray, "rows columns"]:
        """255 from the upper border down to the foot of the obstacles, from the current platform pose."""
        half, mask = 0.5 * self.settings.width_m, np.zeros(self._cells.shape, np.uint8)
        for x, y in self._standing:
            foot = self.floor_view.project(np.array([[x, y - half], [x, y + half]])) / self._cells.binning
            u, v = np.clip(np.rint(np.nan_to_num(foot)), 0, mask.shape[::-1]).astype(int).T
            mask[: v.max(), u.min() : u.max()] = 255
        return mask
