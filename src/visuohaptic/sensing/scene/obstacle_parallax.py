"""Detection of upright faces on the floor from a moving camera: plane and parallax.

Between two frames with the motion (R, t) a plane ``n . X = d`` of the camera's frame moves by the
homography ``K (R + t n^T / d) K^-1``. A pixel is either on the floor, or on the face of an obstacle that stands
at the range x = r: both planes predict the pixel's position in the earlier frame. Joints, grain and
patterns follow the floor's homography, whatever their appearance; a face that rises from the floor does not,
except for its foot. The logarithm of the intensity, minus its local mean, is compared: a shadow
scales the intensity of floor and face equally.

Residuals e of a pixel follow Student's t, scaled by the noise of both images, a subpixel error of the registration, and that of
the local means: a square of the earlier frame covers more floor, so that flanks of a step keep their size, as on a face. Pixels share
this error, which counts once for all independent samples along a square. The evidence of the ratio ``p(e_face) / p(e_floor)`` is
summed over the pixels that see one cell of (range, lateral position) at the height of the lowest relevant obstacle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from ...core import POSITIVE, InputError, PlaneView, Ranged, above, at_least, normal_sigmas, within

#: Edge of the square whose mean is removed [bins]: a few times the maximum parallax, so that no texture that it
#: could show is removed, and smaller than the penumbra of moving shadows.
_MEAN_BINS = 15
#: At the border the mean is not that of the surroundings: nothing is compared there, and the strip must be larger.
_BORDER, _MIN_ROWS = _MEAN_BINS // 2, _MEAN_BINS + 1
#: Grey level that is added before the logarithm, which limits it for black.
_BLACK = 5.0
#: Degrees of freedom of the residuals: tails due to occlusions, highlights and the borders of cast shadows.
_FREEDOM = 4.0
#: Standard deviation of the registration [bins]: a third of a bin is a uniform error of half a bin each way.
_REGISTRATION_BINS = 0.3
#: A quarter of normal residuals is smaller than this many standard deviations: floor may be only a quarter of the image.
_QUARTER_SIGMAS = normal_sigmas(0.75)
#: Residuals of a noiseless image [grey levels]: rounding, 1 / sqrt(12), of both images.
_MIN_NOISE = 0.4
#: Tails of the residuals in the steps of the refinement: wide at first, since an edge that is displaced by its own width
#: looks like an outlier.
_TAILS = (64.0, 16.0, 4.0, 1.0)
#: Steps of the derivatives by (x, y, theta) [m, rad]: a small fraction of a bin; no motion is known more accurately.
_STEPS = np.array([2e-4, 2e-4, 5e-4], dtype=np.float32)
#: Error of a face's motion for a range error of one step of the cells [bins].
_STEP_BINS = 0.7
#: Half cells by which a face may be farther than the first estimate, or closer than the nearest cell.
_BEYOND_CELLS = 4
#: Slopes of a face, forward per lateral: steps that two outlines 10 cm apart resolve. Faces with larger slopes are not distinguished.
_SLOPES = np.linspace(-0.3, 0.3, 7)
#: Pixels of a strip in half bins from those in bins.
_HALF_BINS = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
#: Cells across the narrowest obstacle. What tells of a textureless face are its outlines, and floor beside them in the same cell
#: speaks against it: the sums over adjacent cells begin and end within 2 mm of an outline.
PARTS = 5
#: If the strip shows the horizon, ranges end after this number of steps.
_MAX_RANGES = 48


@dataclass(frozen=True, slots=True)
class ObstacleSettings(Ranged):
    """Settings of the separation of obstacles and floor."""

    #: height of the strip at the image's upper border [px]; it ends above the foam
    rows: int = field(default=450, metadata=at_least(8))
    #: pixels are averaged until the strip has at most this width [bins]
    max_columns: int = field(default=400, metadata=at_least(50))
    #: minimum height of obstacles: the foam's edge passes over lower ones
    height_m: float = field(default=0.05, metadata=POSITIVE)
    width_m: float = field(default=0.02, metadata=POSITIVE)  #: and minimum width
    #: motion of the lowest obstacle's top relative to the floor between two compared frames [bins]
    parallax_bins: float = field(default=4.0, metadata=above(1.0))
    #: declared rate of false alarms
    alarms_per_minute: float = field(default=0.2, metadata=POSITIVE)
    #: fraction of frames that may be arbitrarily disturbed
    disturbed: float = field(default=0.02, metadata=within(1e-6, 0.5))
    #: bins per independent sample: blur of the lens, and interpolation
    correlated_bins: float = field(default=4.0, metadata=at_least(1.0))
    stale_s: float = field(default=1.0, metadata=POSITIVE)  #: maximum age of a valid comparison


@dataclass(frozen=True, slots=True, eq=False)
class StripImage:
    """One frame of the strip, ready to be compared."""

    detail: Float32[np.ndarray, "rows columns"]  #: logarithm of the grey level minus its local mean
    finer: Float32[np.ndarray, "rows2 columns2"]  #: the same in half bins, for interpolation
    whole: Float32[np.ndarray, "rows2 columns2"]  #: the logarithm in half bins, with its mean
    level: Float32[np.ndarray, "rows columns"]  #: local mean grey level


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """Two frames of a moving camera."""

    now: StripImage
    before: StripImage
    #: rotation and translation [m] of the camera's axes from the current to the earlier frame
    view: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
    drive_sigma_m: float  #: standard deviation of the forward motion between them
    scale: Float32[np.ndarray, "rows columns"]  #: 1 / (degrees of freedom times variance of a residual)
    by_floor: Float32[np.ndarray, "rows columns"]  #: log(1 + scaled square of the floor's residual)


class FaceCells:
    """Hypothetical faces at equal steps of range across the strip, and the pixels that would see them.

    Parameters
    ----------
    floor_view
        The floor plane in the camera's view; x ahead, y to the left.
    rows
        Height of the strip at the image's upper border [px].
    settings
        Size of the cells and of the lowest face, and distance of compared frames.

    Attributes
    ----------
    binning
        Edge of a bin [px].
    range_m, lateral_m
        Centres of the cells along x and y [m].
    in_view
        Whether any pixel sees a cell, (ranges, laterals).
    baseline_m
        Distance driven between two compared frames.
    eye_x_m
        x of the camera.
    near_m
        First range of the floor in the strip.
    face_far_m
        Maximum range at which the lowest face is in view up to its top, now and a baseline before.
    """

    def __init__(self, floor_view: PlaneView, rows: int, settings: ObstacleSettings) -> None:
        self.settings, height_m, width_m = settings, settings.height_m, settings.width_m
        camera, pose = floor_view.camera, floor_view.T_camera_plane
        n = self.binning = -(-camera.width // settings.max_columns)
        self.shape = (min(max(rows, _MIN_ROWS * n), camera.height) // n, camera.width // n)
        self._rotation, self._origin = pose.rotation, pose.translation_m
        bins = np.array([[1 / n, 0, 0.5 / n - 0.5], [0, 1 / n, 0.5 / n - 0.5], [0, 0, 1.0]])
        self._matrix = bins @ camera.matrix
        self._inverse = np.linalg.inv(self._matrix)
        v, u = np.mgrid[0 : self.shape[0], 0 : self.shape[1]].astype(np.float64)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ self._inverse.T
        self._source = None
        if camera.distortion.any():
            self._source = ((camera.project(rays) + 0.5) / n - 0.5).astype(np.float32)
        eye, rays = -pose.rotation.T @ pose.translation_m, rays @ pose.rotation
        # Of each pixel: the lateral tangent, which is constant on a vertical line, and x of the floor.
        with np.errstate(divide="ignore", invalid="ignore"):
            self._tangent = np.where(rays[..., 0] > 0, rays[..., 1] / rays[..., 0], np.nan)
            self._floor_m = np.where(rays[..., 2] < 0, eye[0] - eye[2] * rays[..., 0] / rays[..., 2], np.inf)
        ground = self._floor_m[:, self.shape[1] // 2]
        seen = np.flatnonzero(np.isfinite(ground))
        if len(seen) < _MIN_ROWS or not eye[2] > height_m:
            raise InputError(
                "ObstacleDetector",
                f"found {len(seen)} rows of floor from a height of {eye[2]:.3g} m, expected a camera above "
                f"{height_m:g} m that looks at the floor",
                field="floor_view",
            )
        self.eye_x_m, self._eye_y_m, _ = eye.tolist()
        far_m, self.near_m = ground[[_BORDER, -_BORDER]].tolist()
        # At the middle row: size of a bin on the floor, and parallax of a face's top per distance driven.
        row = seen[len(seen) // 2]
        bin_m = abs(float(ground[row] - ground[row - 1]))
        rise = height_m / (eye[2] - height_m)
        self.baseline_m = settings.parallax_bins * bin_m / rise
        away = float(ground[row]) - self.eye_x_m
        step = _STEP_BINS * away * bin_m / (self.baseline_m * (1.0 + rise))
        self.range_m = np.arange(self.near_m, min(far_m, self.near_m + _MAX_RANGES * step), step)
        self.face_far_m = min(self.eye_x_m + (far_m - self.eye_x_m) / (1.0 + rise), float(self.range_m[-1]))
        self.face_far_m -= self.baseline_m
        half = math.ceil(0.5 * self.shape[1] / self._matrix[0, 0] * math.hypot(eye[2], away) / width_m)
        self.lateral_m = (np.arange(-half * PARTS, half * PARTS) + 0.5) * width_m / PARTS
        self._cells = [self._seen_by(x, eye, rays) for x in self.range_m]
        count = len(self.lateral_m)
        self.in_view = np.array([np.bincount(cell, minlength=count + 1)[:-1] > 0 for _, cell in self._cells])

    def _seen_by(
        self, x_m: float, eye: np.ndarray, rays: np.ndarray
    ) -> tuple[tuple[slice, slice], Int[np.ndarray, "pixels"]]:
        """Rows of the strip that see the face at one range, and the lateral cell of each of their pixels."""
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (x_m - eye[0]) / rays[..., 0]
            y, z = eye[1] + along * rays[..., 1], eye[2] + along * rays[..., 2]
            cell = np.floor((y - self.lateral_m[0]) / (self.settings.width_m / PARTS) + 0.5)
        count = len(self.lateral_m)
        inside = (along > 0) & (z > 0) & (z < self.settings.height_m) & (cell >= 0) & (cell < count)
        rows = np.flatnonzero(inside.any(axis=1))
        part = slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 1)
        return (part, slice(0, self.shape[1])), np.where(inside, cell, count)[part].astype(np.intp).ravel()

    def prepare(self, image: UInt8[np.ndarray, "rows columns *colour"]) -> StripImage:
        """Strip of one frame.

        Parameters
        ----------
        image
            Grey or colour image.
        """
        import cv2

        (rows, columns), n = self.shape, self.binning
        strip = image[: rows * n, : columns * n]
        grey = strip if strip.ndim == 2 else cv2.cvtColor(strip, cv2.COLOR_BGR2GRAY)
        binned = cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._source is not None:
            binned = cv2.remap(binned, self._source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        around = (_MEAN_BINS, _MEAN_BINS)
        whole = cv2.log(binned + np.float32(_BLACK))
        detail = whole - cv2.blur(whole, around)
        detail = np.pad(detail[_BORDER:-_BORDER, _BORDER:-_BORDER], _BORDER, constant_values=math.nan)
        # Linear interpolation between bins flattens a thin line by up to a quarter. On a line along the drive it would do
        # so alike in all frames, and differently for floor and face, which would count as evidence again and again.
        finer, twice = (cv2.resize(x, None, None, 2, 2, cv2.INTER_CUBIC) for x in (detail, whole))
        return StripImage(detail, finer, twice, cv2.blur(binned, around) + np.float32(_BLACK))

    def pair(
        self, now: StripImage, before: StripImage, motion: Float[np.ndarray, "3"], sigma: Float[np.ndarray, "3"],
        hidden: UInt8[np.ndarray, "rows columns"],
    ) -> FramePair:  # fmt: skip
        """Two frames, the motion between them with the best fit to the floor, and the residuals of each pixel.

        The floor in the strip refines the motion, since an odometry scale error of 3 % apparently lifts it by a
        centimetre: Gauss-Newton steps on the residuals, weighted by Student's t, with
        ``motion`` as the prior.

        Parameters
        ----------
        now, before
            Two frames.
        motion, sigma
            (x, y, theta) of the platform between them and its standard deviations [m, rad].
        hidden
            Nonzero where the floor is known to be hidden now.
        """
        import cv2

        variance = np.zeros(self.shape, np.float32)
        for axis in ((1, 0), (0, 1)):
            slope = cv2.Sobel(now.detail, cv2.CV_32F, *axis, scale=0.125)  # the weights sum to 8
            variance += _REGISTRATION_BINS**2 * slope * slope
        refined, spread = self._refine(now, before, motion, sigma, np.where(hidden, np.nan, variance))
        moved = self._floor_before(before.finer, refined)
        whole = self._floor_before(before.whole, refined)
        cv2.patchNaNs(whole, 1e9)  # unknown: a mean of pixels out of view
        error = whole - cv2.blur(whole, (_MEAN_BINS, _MEAN_BINS)) - moved
        variance += _MEAN_BINS / self.settings.correlated_bins * error**2
        floor = now.detail - moved
        scale = _scale(floor, variance, now.level)
        by_floor = cv2.log(1.0 + floor * floor * scale)
        return FramePair(now, before, self._view(refined), spread, scale, np.asarray(by_floor))

    def _refine(
        self, now: StripImage, before: StripImage, motion: np.ndarray, sigma: np.ndarray, variance: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Motion by the floor, NaN in ``variance`` where it is hidden, and the standard deviation of the forward motion."""
        refined, prior = np.array(motion, dtype=np.float64), np.diag(np.maximum(sigma, _STEPS) ** -2.0)
        information, slopes = prior, None
        # Every other bin in both directions, which represent all: neighbours are not independent.
        sparse, fraction = (slice(None, None, 2), slice(None, None, 2)), 4.0 / self.settings.correlated_bins
        for tail in _TAILS:
            moved = self._floor_before(before.finer, refined)
            if slopes is None:
                stepped = [self._floor_before(before.finer, refined + step) for step in np.diag(_STEPS)]
                slopes = np.stack([(m - moved)[sparse].ravel() for m in stepped]) / _STEPS[:, None]
                slopes[~np.isfinite(slopes)] = 0.0
            floor = (now.detail - moved)[sparse]
            scale = _scale(floor, variance[sparse], now.level[sparse])
            weight = fraction * (_FREEDOM + 1.0) * scale / (1.0 + floor * floor * scale / tail)
            known = np.isfinite(weight)
            weighted = slopes * np.where(known, weight, np.float32(0.0)).ravel()
            information = weighted @ slopes.T + prior
            pull = weighted @ np.where(known, floor, np.float32(0.0)).ravel() + prior @ (motion - refined)
            refined = refined + np.linalg.solve(information, pull)
        return refined, float(np.sqrt(np.linalg.inv(information)[0, 0]))

    def _view(self, motion: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
        """Rotation and translation of the camera's axes from the current to the earlier frame."""
        c, s = math.cos(motion[2]), math.sin(motion[2])
        turn = self._rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ self._rotation.T
        shift = self._rotation @ np.array([motion[0], motion[1], 0.0]) + self._origin - turn @ self._origin
        return turn, shift

    def _floor_before(self, before: np.ndarray, motion: Float[np.ndarray, "3"]) -> np.ndarray:
        """Half bins of the earlier frame warped to the current one by the floor's homography; NaN: not visible."""
        rows, columns = self.shape
        return self._moved(before, self._view(motion), 2, 0.0, (slice(0, rows), slice(0, columns)))

    def compare(self, pair: FramePair) -> Float[np.ndarray, "ranges laterals"]:
        """Logarithm of the evidence of a face in every cell, by two equally probable planes; see :mod:`.obstacle_mask`.

        Parameters
        ----------
        pair
            Result of :meth:`pair`.
        """
        import cv2

        count = len(self.lateral_m)
        sums = np.zeros((len(self.range_m), count))
        for k, (part, cell) in enumerate(self._cells):
            floor = cv2.exp(-self._ratio(pair, float(self.range_m[k]), part))
            sums[k] = np.bincount(cell, cv2.log(0.5 + 0.5 * floor).ravel(), count + 1)[:-1]
        return -sums / self.settings.correlated_bins

    def locate(self, pair: FramePair, at: int, laterals: Int[np.ndarray, "cells"]) -> tuple[float, float]:
        """Range of a face at its centre and the standard deviation of its random part [m], by its likelihood over the same pixels.

        The floor ends at the foot of the face: pixels below are floor, those above are face. The face is the most likely run of
        vertical lines, with floor beside it, and may be rotated.

        Parameters
        ----------
        pair
            Result of :meth:`pair`.
        at
            Index of the range at which the search starts.
        laterals
            Indices of the lateral cells that show the face.
        """
        step = float(self.range_m[1] - self.range_m[0])
        # The same pixels for all ranges: up to the top of the next cell, with one more cell on both sides, where the outlines are.
        top, size = self._cells[min(at + 1, len(self._cells) - 1)][0][0].start, 1.0 / self._matrix[0, 0]
        away_m, sides = self.range_m[at] - self.eye_x_m, self.settings.width_m * np.array([-1.5, 1.5])
        lateral_m = self.lateral_m[laterals] - self._eye_y_m
        right, left = (np.array([lateral_m.min(), lateral_m.max()]) + sides) / away_m
        tangent = np.arange(right, left, size) + 0.5 * size
        line, count = np.floor((self._tangent[top:] - right) / size), len(tangent)
        line = np.where((line >= 0) & (line < count), line, count).astype(np.intp)
        shown = np.flatnonzero((line < count).any(axis=0))
        part = slice(top, self.shape[0]), slice(int(shown[0]), int(shown[-1]) + 1)
        line, floor_m = line[:, part[1]].ravel(), self._floor_m[part]
        ranges = self.range_m[0] + 0.5 * step * np.arange(-_BEYOND_CELLS, 2 * at + _BEYOND_CELLS + 1)
        ratios = ((self._ratio(pair, float(x), part) * (floor_m > x)).ravel() for x in ranges)
        lines = np.array([np.bincount(line, ratio, count + 1)[:-1] for ratio in ratios])
        away = (tangent * away_m - lateral_m.mean()) / (0.5 * step)
        each = _over_slopes(lines / self.settings.correlated_bins, away)
        weight = np.exp(each - each.max())
        found = float(np.average(ranges, weights=weight))
        spread = math.sqrt(np.average((ranges - found) ** 2, weights=weight))
        best = int(each.argmax())
        if spread < 0.5 * step and 0 < best < len(ranges) - 1:
            below, middle, beyond = each[best - 1 : best + 2]
            bend = max(2.0 * middle - below - beyond, 1.0)
            found = float(ranges[best]) + 0.25 * step * (beyond - below) / bend
            spread = math.hypot(spread, 0.5 * step / math.sqrt(bend))
        return found, spread

    def _ratio(self, pair: FramePair, x_m: float, part: tuple[slice, slice]) -> Float32[np.ndarray, "a b"]:
        """Log-likelihood ratio of every pixel of a part; 0 where a plane was out of view in the earlier frame."""
        import cv2

        face = pair.now.detail[part] - self._moved(pair.before.finer, pair.view, 0, x_m, part)
        better = pair.by_floor[part] - cv2.log(1.0 + face * face * pair.scale[part])
        better *= 0.5 * (_FREEDOM + 1.0)
        return np.asarray(cv2.patchNaNs(better, 0.0))

    def _moved(
        self, before: np.ndarray, view: tuple[np.ndarray, np.ndarray], axis: int, x_m: float,
        part: tuple[slice, slice],
    ) -> Float32[np.ndarray, "rows columns"]:  # fmt: skip
        """Half bins of the earlier frame warped by the plane at ``x_m`` along an axis; NaN: not visible."""
        import cv2

        normal, (turn, shift), (rows, columns) = self._rotation[:, axis], view, part
        bent = turn + np.outer(shift, normal) / (normal @ self._origin + x_m)
        plane = _HALF_BINS @ self._matrix @ bent @ self._inverse
        plane[:, 2] += plane[:, 1] * rows.start + plane[:, 0] * columns.start
        size = columns.stop - columns.start, rows.stop - rows.start
        flags, border = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_CONSTANT
        moved = cv2.warpPerspective(before, plane, size, None, flags, border, math.nan)
        return np.asarray(moved)


def _over_slopes(lines: Float[np.ndarray, "ranges lines"], away: Float[np.ndarray, "lines"]) -> np.ndarray:
    """Log likelihood of ranges at the centre of a face: over :data:`_SLOPES`, of the most likely run of vertical lines.

    The lines are ``away`` from the centre [steps of ranges]; floor instead of face would be 0.
    """
    count, across = len(lines), np.arange(len(away))
    place = np.clip(np.arange(count)[:, None] + _SLOPES[:, None, None] * away, 0.0, count - 1.000001)
    whole = place.astype(np.intp)
    part = place - whole
    each = lines[whole, across] * (1.0 - part) + lines[whole + 1, across] * part
    # The maximum sum of a run of lines: the cumulative sum at its end, minus the minimum before its start.
    upto = np.pad(np.cumsum(each, axis=-1), ((0, 0), (0, 0), (1, 0)))
    runs = (upto - np.minimum.accumulate(upto, axis=-1)).max(axis=-1)
    return np.asarray(np.logaddexp.reduce(runs))


def _scale(residual: np.ndarray, variance: np.ndarray, level: np.ndarray) -> np.ndarray:
    """1 / (degrees of freedom times variance) of residuals, with their measured noise."""
    known = np.isfinite(residual + variance)
    quarter = np.quantile(np.abs(residual * level)[known][::4], 0.25) if known.any() else 0.0
    noise = max(float(quarter) / _QUARTER_SIGMAS, _MIN_NOISE)
    return np.asarray(1.0 / (_FREEDOM * (variance + (noise / level) ** 2)), dtype=np.float32)
