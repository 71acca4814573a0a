"""Point tracking from frame to frame (Alt 2016, Sec. 3.5: KLT on floor and object).

The structure tensor G = sum of grad I grad I^T over a window bounds how accurately a point can be located:
with noise of standard deviation s in both images, its variance along an eigenvector
is at least 2 s^2 / lambda. Points are selected by the smaller eigenvalue [Shi, Tomasi 1994]
and store this bound. A point is kept while backward tracking returns to its start, its
window remains similar, and it is inside the image.

The pyramidal Lucas-Kanade step itself is from OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ...core import InputError, at_least, check_ranges, within

#: A label image, or a function that returns one.
Regions = UInt8[np.ndarray, "rows columns"] | Callable[[], UInt8[np.ndarray, "rows columns"]]

#: Offset of the start of backward tracking, in both directions [bins]: a few times the allowed distance.
_ASIDE = 1.0


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """Selection and tracking of points."""

    #: edge of the pixel squares that are averaged first; all other lengths are in these bins
    binning: int = field(default=1, metadata=within(1, 8))
    window_px: int = field(default=21, metadata=at_least(5))  #: edge of the window around a point, odd
    levels: int = field(default=3, metadata=within(0, 6))  #: pyramid levels above the image itself
    points: int = field(default=120, metadata=at_least(4))  #: maximum number per region
    spacing_px: float = field(default=12.0, metadata=at_least(1.0))  #: minimum distance between points
    #: smallest eigenvalue, as a fraction of the region's largest
    quality: float = field(default=0.005, metadata=within(0.0, 1.0))
    noise_grey: float = 2.0  #: standard deviation of the image noise
    max_sigma_px: float = 0.3  #: points with a larger uncertainty are not stable
    forward_backward_px: float = 0.4  #: maximum distance after forward and backward tracking
    max_residual_grey: float = 25.0  #: maximum mean absolute difference of a matching window
    refill_fraction: float = 0.7  #: new points are selected below this remaining fraction
    retry_frames: int = 4  #: a region without further points is searched again after this number of frames

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.window_px % 2 == 0:
            raise InputError(
                "FlowSettings", f"found {self.window_px}, expected an odd number", field="window_px"
            )


@dataclass(frozen=True, slots=True, eq=False)
class FlowStep:
    """Tracked points between two frames; n were tracked successfully."""

    ids: Int[np.ndarray, "n"]  #: constant along a track
    label: Int[np.ndarray, "n"]  #: region in which the track started
    before_px: Float[np.ndarray, "n 2"]
    after_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n"]  #: lower bound of the standard deviation per axis
    tried: dict[int, int] = field(default_factory=dict)  #: number of points before tracking, by label

    def of(self, label: int) -> FlowStep:
        """The points of one region.

        Parameters
        ----------
        label
            Label of the region.
        """
        keep = self.label == label
        return FlowStep(
            self.ids[keep],
            self.label[keep],
            self.before_px[keep],
            self.after_px[keep],
            self.sigma_px[keep],
            {label: self.tried.get(label, 0)},
        )

    def without(self, wrong: Bool[np.ndarray, "n"]) -> FlowStep:
        """All points except those that are ``wrong``.

        Parameters
        ----------
        wrong
            Points to exclude.
        """
        keep = ~wrong
        return FlowStep(
            self.ids[keep], self.label[keep], self.before_px[keep], self.after_px[keep], self.sigma_px[keep],
            self.tried,
        )  # fmt: skip


def location_sigma_px(
    image: UInt8[np.ndarray, "rows columns"],
    points_px: Float[np.ndarray, "n 2"],
    window_px: int,
    noise_grey: float,
) -> Float[np.ndarray, "n"]:
    """Lower bound of the standard deviation of re-located points, in the less accurate direction.

    Parameters
    ----------
    image
        Grey image.
    points_px
        Points, rounded to pixels; windows are cropped at the border.
    window_px
        Edge of the window around a point [px].
    noise_grey
        Standard deviation of the image noise [grey levels].
    """
    half = window_px // 2
    padded = np.pad(image, half + 1, mode="edge").astype(np.float32)
    # Required padding around the window and its neighbours.
    at = np.rint(points_px).astype(int)
    offsets = np.arange(window_px + 2)
    rows = at[:, 1, None] + offsets
    columns = at[:, 0, None] + offsets
    patches = padded[rows[:, :, None], columns[:, None, :]]
    dx = 0.5 * (patches[:, 1:-1, 2:] - patches[:, 1:-1, :-2])
    dy = 0.5 * (patches[:, 2:, 1:-1] - patches[:, :-2, 1:-1])
    xx, yy, xy = ((a * b).sum(axis=(1, 2)) for a, b in ((dx, dx), (dy, dy), (dx, dy)))
    smaller = 0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4 * xy**2))
    # Noise alone causes gradients: each pixel adds s^2 / 2 to the eigenvalues.
    smaller = np.maximum(smaller - 0.5 * noise_grey**2 * window_px**2, 1e-9)
    return np.sqrt(2.0 / smaller) * noise_grey


class PointTracker:
    """Tracks points in regions of an image and selects new ones.

    Parameters
    ----------
    settings
        Selection and tracking of points.
    rows
        First and last row (exclusive) to process. None: all.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(0, 1, (160, 200))
    >>> import cv2
    >>> image = np.clip(128 + 200 * cv2.GaussianBlur(noise, (0, 0), 2), 0, 255).astype(np.uint8)
    >>> tracker = PointTracker()
    >>> regions = np.ones((160, 200), np.uint8)
    >>> step = tracker.update(image, regions)
    >>> step = tracker.update(np.roll(image, 3, axis=1), regions)
    >>> float(np.round(np.median(step.after_px - step.before_px, axis=0)[0], 1))
    3.0
    """

    def __init__(self, settings: FlowSettings | None = None, rows: tuple[int, int] | None = None) -> None:
        self.settings = settings or FlowSettings()
        self._rows = rows
        self._band: UInt8[np.ndarray, "rows columns"] | None = None
        self._shape: tuple[int, ...] = ()
        self._next_id = 0
        #: By label: number of points after the last selection, and frames since then.
        self._chosen: dict[int, tuple[int, int]] = {}
        self._clear()

    def _clear(self) -> None:
        self._ids = np.zeros(0, np.int64)
        self._label = np.zeros(0, np.int64)
        self._points = np.zeros((0, 2), np.float32)
        self._moved = np.zeros((0, 2), np.float32)
        self._sigma = np.zeros(0)

    def forget(self, label: int, *, outside: UInt8[np.ndarray, "rows columns"] | None = None) -> None:
        """Discard the points of a region.

        Parameters
        ----------
        label
            Label of the region.
        outside
            Label image: only points that are not inside the region in it are discarded.
        """
        keep = self._label != label
        if outside is not None and len(self._points):
            where = self._binned(outside[slice(*(self._rows or (0, outside.shape[0])))], nearest=True)
            at = np.clip(np.rint(self._points).astype(int), 0, np.array(where.shape[::-1]) - 1)
            keep |= where[at[:, 1], at[:, 0]] == label
        self._keep(keep)
        self._chosen.pop(label, None)

    def choose(self, regions: UInt8[np.ndarray, "rows columns"]) -> None:
        """Select points in the latest image in regions that have too few.

        Parameters
        ----------
        regions
            Label image, 0 = no region.
        """
        if self._band is not None:
            self._chosen = {}
            rows = slice(*(self._rows or (0, regions.shape[0])))
            self._refill(self._band, self._binned(regions[rows], nearest=True))

    def drop(self, ids: Int[np.ndarray, "k"]) -> None:
        """Discard selected points.

        Parameters
        ----------
        ids
            Ids of the tracks; unknown ones are ignored.
        """
        self._keep(~np.isin(self._ids, ids))

    def update(
        self,
        image: UInt8[np.ndarray, "rows columns"],
        regions: Regions,
        *,
        labels: Sequence[int] | None = None,
        shift_px: dict[int, Float[np.ndarray, "2"]] | None = None,
    ) -> FlowStep:
        """Track all points into a new image, then select new ones where too few remain.

        Parameters
        ----------
        image
            Grey image of the same size as the first.
        regions
            Where to select points: 0 = none, otherwise a region's label. Points that leave their region are
            still tracked. May be a function that returns this; it is called only if one of the ``labels`` needs
            points.
        labels
            Required regions; all if omitted.
        shift_px
            Expected motion of a region's points; by default their last motion.

        Raises
        ------
        InputError
            The image has another size than before, or is not grey.
        """
        if image.ndim != 2 or image.dtype != np.uint8:
            raise InputError(
                "PointTracker.update", f"found {image.dtype} {image.shape}, expected uint8 (rows, columns)"
            )
        if not callable(regions):
            self._same_size(regions, image)
        if self._shape and image.shape != self._shape:
            raise InputError("PointTracker.update", f"found {image.shape}, expected {self._shape} as before")
        self._shape = image.shape
        first, last = self._rows or (0, image.shape[0])
        band = self._binned(image[first:last])
        step = self._follow(band, shift_px or {}, float(first))
        self._band = band
        self._chosen = {label: (count, age + 1) for label, (count, age) in self._chosen.items()}
        if not callable(regions):
            self._refill(band, self._binned(regions[first:last], nearest=True))
        elif labels is None or any(self._is_poor(label) for label in labels):
            asked = regions()
            self._same_size(asked, image)
            self._refill(band, self._binned(asked[first:last], nearest=True))
        return step

    @staticmethod
    def _same_size(regions: np.ndarray, image: np.ndarray) -> None:
        if regions.shape != image.shape:
            raise InputError(
                "PointTracker.update",
                f"found {image.dtype} {image.shape} and regions {regions.shape}, "
                "expected uint8 images of the same size",
            )

    def _is_poor(self, label: int) -> bool:
        """Whether a region has too few points and may contain others."""
        have, s = int(np.count_nonzero(self._label == label)), self.settings
        if have >= s.refill_fraction * s.points:
            return False
        before, age = self._chosen.get(label, (s.points, s.retry_frames))
        return have < s.refill_fraction * before or age >= s.retry_frames

    def _binned(self, image: np.ndarray, *, nearest: bool = False) -> UInt8[np.ndarray, "rows columns"]:
        import cv2

        n = self.settings.binning
        if n == 1:
            return np.ascontiguousarray(image)
        rows, columns = image.shape[0] // n, image.shape[1] // n
        if nearest:
            return np.ascontiguousarray(image[: rows * n : n, : columns * n : n])
        whole = image[: rows * n, : columns * n]
        return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def _follow(
        self,
        band: UInt8[np.ndarray, "rows columns"],
        shift_px: dict[int, Float[np.ndarray, "2"]],
        top: float,
    ) -> FlowStep:
        import cv2

        s = self.settings
        labels, counts = np.unique(self._label, return_counts=True)
        tried = dict(zip(labels.tolist(), counts.tolist(), strict=True))
        if self._band is None or len(self._points) == 0:
            nothing = np.zeros((0, 2))
            return FlowStep(self._ids, self._label, nothing, nothing, self._sigma, tried)
        guess = self._moved.copy()
        for label, shift in shift_px.items():
            guess[self._label == label] = np.asarray(shift) / s.binning
        before = self._points
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.005)
        options: dict[str, Any] = {
            "winSize": (s.window_px, s.window_px),
            "maxLevel": s.levels,
            "criteria": criteria,
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        }
        after, found, residual = cv2.calcOpticalFlowPyrLK(self._band, band, before, before + guess, **options)
        # Backward tracking needs no pyramid. It starts with an offset: points without texture would stay there.
        options |= {"maxLevel": 0, "criteria": (criteria[0], 15, 0.05 * s.forward_backward_px)}
        aside = before + np.float32(_ASIDE)
        back, returned, _ = cv2.calcOpticalFlowPyrLK(band, self._band, after, aside, **options)
        after = np.asarray(after, dtype=np.float32)
        inside = (after >= 0).all(axis=1) & (after <= [band.shape[1] - 1, band.shape[0] - 1]).all(axis=1)
        good = (found.ravel() > 0) & (returned.ravel() > 0) & inside
        good &= np.linalg.norm(back - before, axis=1) < s.forward_backward_px
        good &= residual.ravel() < s.max_residual_grey
        self._moved = after - before
        self._points = after
        start = before[good]
        self._keep(good)
        n, lift = s.binning, np.array([0.0, top])
        # The centre of the first bin is (n - 1) / 2 pixels from that of the first pixel.
        pixels = [(p.astype(np.float64) + 0.5) * n - 0.5 + lift for p in (start, self._points)]
        return FlowStep(self._ids, self._label, pixels[0], pixels[1], self._sigma * n, tried)

    def _keep(self, good: np.ndarray) -> None:
        self._ids, self._label, self._sigma = self._ids[good], self._label[good], self._sigma[good]
        self._points, self._moved = self._points[good], self._moved[good]

    def _refill(self, band: np.ndarray, regions: np.ndarray) -> None:
        """Select points where a region has too few: the best corners with a minimum distance from existing ones."""
        import cv2

        s = self.settings
        for label in np.flatnonzero(np.bincount(regions.ravel(), minlength=2)).tolist():
            have = int(np.count_nonzero(self._label == label))
            if label == 0 or not self._is_poor(label):
                continue
            self._chosen[label] = (have, 0)
            mask = np.where(regions == label, np.uint8(255), np.uint8(0))
            x, y, width, height = cv2.boundingRect(mask)
            for point in self._points:
                centre = (round(float(point[0])), round(float(point[1])))
                cv2.circle(mask, centre, round(s.spacing_px), 0, -1)
            window = (slice(y, y + height), slice(x, x + width))
            corners = cv2.goodFeaturesToTrack(
                band[window],
                s.points - have,
                s.quality,
                s.spacing_px,
                mask=np.ascontiguousarray(mask[window]),
                blockSize=7,
            )
            if corners is None:
                continue
            new = np.asarray(corners, dtype=np.float32).reshape(-1, 2) + np.array([x, y], np.float32)
            sigma = location_sigma_px(band, new, s.window_px, s.noise_grey)
            stable = sigma < s.max_sigma_px
            new, sigma = new[stable], sigma[stable]
            same = self._label == label
            moved = np.median(self._moved[same], axis=0) if same.any() else np.zeros(2, np.float32)
            self._points = np.concatenate([self._points, new])
            self._moved = np.concatenate([self._moved, np.tile(moved, (len(new), 1))]).astype(np.float32)
            self._sigma = np.concatenate([self._sigma, sigma])
            self._label = np.concatenate([self._label, np.full(len(new), label)])
            self._ids = np.concatenate([self._ids, self._next_id + np.arange(len(new))])
            self._next_id += len(new)
            # A region that may contain further points is searched again at once.
            self._chosen[label] = (have + len(new), s.retry_frames if len(new) else 0)
