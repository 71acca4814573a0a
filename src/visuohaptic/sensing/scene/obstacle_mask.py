"""Obstacles that come near: what does not look like the floor, and how far it is (Alt 2016, Sec. 3.5).

Every pixel of the upper part of the image keeps a mixture of K Gaussians of
its level [Zivkovic, Improved adaptive Gaussian mixture model for background
subtraction, ICPR 2004]. Weights w_k follow the observations with the rate alpha,

    w_k <- w_k + alpha (o_k - w_k) - alpha c_T ,

where o_k = 1 for the mode that the pixel matches; the negative prior c_T lets modes
without evidence die out. The heaviest modes, which together hold the fraction 1 - c_f, are the floor.

What differs from the text: no mode is narrower than a part of the floor's spread over the whole
strip, since a moving platform brings to each pixel what its neighbours have seen before; pixels of the image are binned first (texture finer
than a bin is noise to the mixture, and half the size is a quarter of the work), and
foreground learns slower than floor as long as it is a part of the strip only, so
that an obstacle which is being pushed is not taken for a new floor within a few frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, UInt8

from ...core.camera.plane import PlaneView
from ...core.errors import InputError
from ...core.measurement import Reason
from ...core.ranges import at_least, check_ranges, within

__all__ = ["FloorMixture", "MixtureSettings", "Obstacle", "ObstacleDetector"]

#: Edge of the square of bins that vote on each.
_VOTE = 9


@dataclass(frozen=True, slots=True)
class MixtureSettings:
    """How the floor is learnt and obstacles are separated from it."""

    #: height of the strip at the image's upper border [px]
    rows: int = field(default=300, metadata=at_least(8))
    #: edge of the squares of pixels that are averaged first
    binning: int = field(default=2, metadata=within(1, 8))
    modes: int = field(default=3, metadata=within(2, 8))  #: K, Gaussians of a pixel at most
    memory_frames: float = field(default=12.0, metadata=at_least(2.0))  #: 1 / alpha once the floor is known
    memory_foreground_frames: float = 1500.0  #: 1 / alpha of foreground that covers a part of the strip
    changed_fraction: float = (
        0.7  #: foreground that covers more than this is a new floor: learnt at 1 / alpha
    )
    relearn_frames: int = 3  #: so many frames are learnt at that rate after a change
    foreground_fraction: float = 0.1  #: c_f: modes that hold less than this are not the floor
    prior: float = 0.01  #: c_T, evidence that a mode needs
    gate_sigmas: float = 3.0  #: distance at which a level still belongs to a mode
    start_sigma: float = 8.0  #: of a new mode [grey levels]
    min_sigma: float = 3.0
    spatial_fraction: float = (
        0.8  #: nor is a sigma smaller than this part of the floor's spread over the strip
    )
    max_sigma: float = 25.0
    min_width_m: float = 0.01  #: an obstacle narrower than this is noise
    min_height_px: int = 6  #: and so is one lower than this in the image, in pixels of the camera
    edge_sigma_px: float = 2.0  #: standard deviation of the lowest edge of the foreground, in pixels

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.memory_foreground_frames < self.memory_frames:
            raise InputError(
                "MixtureSettings",
                f"found {self.memory_foreground_frames}, expected at least the {self.memory_frames} of memory_frames",
                field="memory_foreground_frames",
            )


class FloorMixture:
    """Mixture of every pixel of an image whose size stays the same.

    Parameters
    ----------
    settings
        Rates and thresholds of the mixture.

    Examples
    --------
    >>> import numpy as np
    >>> mixture = FloorMixture()
    >>> floor = np.full((20, 30), 100, np.uint8)
    >>> for _ in range(5):
    ...     mask = mixture.update(floor)
    >>> floor[5:10, 5:10] = 180
    >>> int((mixture.update(floor) > 0).sum())
    25
    """

    def __init__(self, settings: MixtureSettings | None = None) -> None:
        self.settings = settings or MixtureSettings()
        self.frames = 0
        self._modes: Float32[np.ndarray, "rows modes values columns"] | None = None
        self._floor_spread = 0.0
        self._foreground = 0.0
        self._learning = self.settings.relearn_frames  #: frames to go until the floor counts as known

    def update(
        self,
        image: UInt8[np.ndarray, "rows columns *colour"],
        held: UInt8[np.ndarray, "rows columns"] | None = None,
    ) -> UInt8[np.ndarray, "rows columns"]:
        """Mask of what is not floor (255), and one step of learning.

        Where ``held`` is not 0 a pixel learns as slowly as foreground: parts of an
        obstacle that look like the floor would otherwise teach the whole obstacle to it.

        Parameters
        ----------
        image
            Grey or colour image of the size of the first.
        held
            Not 0 where a pixel learns as slowly as foreground: parts of an obstacle that look like the floor
            would otherwise make the whole obstacle a part of it.
        """
        from ._mixture_kernels import update_mixture

        s = self.settings
        levels = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
        rows, columns, channels = levels.shape
        shape = (rows, s.modes, 2 + channels, columns)
        if self._modes is None:
            self._modes = np.zeros(shape, np.float32)
        if self._modes.shape != shape:
            raise InputError(
                "FloorMixture.update",
                f"found an image of shape {image.shape}, expected {(self._modes.shape[0], self._modes.shape[3])} as before",
                remedy="use a new mixture for another camera",
            )
        self.frames += 1
        # The first frames are averaged evenly: the floor is known after the first one.
        rate = max(1.0 / s.memory_frames, 1.0 / self.frames)
        rate_foreground = rate if self._learning > 0 else 1.0 / s.memory_foreground_frames
        smallest = min(max(s.min_sigma, s.spatial_fraction * self._spread(levels, held)), s.max_sigma)
        variances = np.array([max(s.start_sigma, smallest), smallest, s.max_sigma]) ** 2
        parameters = np.array([s.gate_sigmas**2, s.prior, *variances], np.float32)
        mask = np.zeros((rows, columns), np.uint8)
        update_mixture(
            levels,
            self._modes,
            mask if held is None or self._learning > 0 else np.ascontiguousarray(held),
            np.float32(rate),
            np.float32(rate_foreground),
            np.float32(1.0 - s.foreground_fraction),
            parameters,
            mask,
        )
        self._foreground = float(np.count_nonzero(mask)) / mask.size
        self._learning = max(self._learning - 1, 0)
        if self.frames > 1 and self._foreground > s.changed_fraction:
            self._learning = s.relearn_frames
        return mask

    def _spread(self, levels: np.ndarray, held: np.ndarray | None) -> float:
        """Spread of the floor's levels over the image, from every eighth pixel.

        Robust and slow: an obstacle that gets into it would widen the modes, and more of it would.
        """
        sample = levels[::8, ::8].reshape(-1, levels.shape[2]).astype(np.float32)
        if held is not None and self._learning == 0:
            floor = held[::8, ::8].ravel() == 0
            if np.count_nonzero(floor) > 50:
                sample = sample[floor]
        spread = float(1.4826 * np.median(np.abs(sample - np.median(sample, axis=0)), axis=0).mean())
        fraction = 1.0 if self._learning > 0 else 1.0 / self.settings.memory_foreground_frames**0.5
        self._floor_spread += fraction * (spread - self._floor_spread)
        return self._floor_spread

    @property
    def settling(self) -> bool:
        """Whether the floor is being learnt: in the first frames, and after most of the strip has changed."""
        return self._learning > 0

    @property
    def foreground_fraction(self) -> float:
        """Fraction of the newest image that is foreground."""
        return self._foreground


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """What stands in the strip, and how near it is."""

    mask: UInt8[np.ndarray, "rows columns"]  #: 255 = not floor; bins of the strip at the upper border
    binning: int  #: edge of a bin of ``mask`` [px]
    valid: bool  #: the mask may be used
    reason: Reason
    proximity_m: float  #: from the front of the foam to the nearest foreground on the floor; inf = free
    proximity_sigma_m: float
    y_m: float  #: where along the sensor it is nearest; NaN when free
    at_border: bool  #: it reaches the lower border of the strip: it may be nearer than ``proximity_m``
    remembered: bool = False  #: not of this frame: seen before, and carried on by the platform's motion


class ObstacleDetector:
    """Finds approaching obstacles in the upper strip of the camera's image.

    Parameters
    ----------
    floor_view
        The floor plane as the camera sees it, its axes along those of the sensor frame F.
    front_m
        x of the foam's front contour at rest.
    settings
        Rates and thresholds of the mixture.
    """

    def __init__(
        self, floor_view: PlaneView, front_m: float = 0.02, settings: MixtureSettings | None = None
    ) -> None:
        self.settings = settings or MixtureSettings()
        self.floor_view, self.front_m = floor_view, float(front_m)
        self.mixture = FloorMixture(self.settings)
        self._held: UInt8[np.ndarray, "rows columns"] | None = None
        camera = floor_view.camera
        self._rows = min(self.settings.rows, camera.height) // self.settings.binning * self.settings.binning
        self._columns = camera.width // self.settings.binning * self.settings.binning
        if self._rows < self.settings.min_height_px:
            raise InputError(
                "ObstacleDetector", f"found an image of {camera.height} rows", field="floor_view"
            )

    @property
    def sight_m(self) -> float:
        """How far ahead of the foam the strip shows the floor, in the middle; inf = to the horizon."""
        high = np.array([[0.5 * self.floor_view.camera.width, self.settings.min_height_px + 0.0]])
        far = float(self.floor_view.cast(high)[0, 0]) - self.front_m
        return far if np.isfinite(far) and far > 0 else float("inf")

    @property
    def blind_m(self) -> float:
        """How far ahead of the foam the strip begins: what is nearer is not watched."""
        low = np.array([[0.5 * self.floor_view.camera.width, self._rows - 0.5]])
        return max(float(self.floor_view.cast(low)[0, 0]) - self.front_m, 0.0)

    def update(self, image: UInt8[np.ndarray, "rows columns *colour"]) -> Obstacle:
        """Nearest obstacle in one frame.

        Parameters
        ----------
        image
            Grey or colour image.
        """
        import cv2

        camera, n = self.floor_view.camera, self.settings.binning
        if image.shape[:2] != (camera.height, camera.width):
            raise InputError(
                "ObstacleDetector.update",
                f"found an image of {image.shape[1]} x {image.shape[0]}, "
                f"expected {camera.width} x {camera.height}",
            )
        strip = image[: self._rows, : self._columns]
        if n > 1:
            size = (self._columns // n, self._rows // n)
            strip = np.asarray(cv2.resize(strip, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        mask = self.mixture.update(strip, self._held)
        # The majority of the bins around: removes joints of the floor, and holes inside of an obstacle.
        mask = np.asarray(
            cv2.threshold(cv2.blur(mask, (_VOTE, _VOTE)), 127, 255, cv2.THRESH_BINARY)[1], np.uint8
        )
        self._held = mask
        if self.mixture.settling:
            # Also after a change of the whole strip, be it a new floor or a wall: free would be a guess.
            reason = Reason.NOT_ZEROED if self.mixture.frames < 3 else Reason.DRIFTED
            return Obstacle(mask, n, False, reason, np.nan, np.inf, np.nan, False)
        return self._nearest(mask)

    def _nearest(self, mask: UInt8[np.ndarray, "rows columns"]) -> Obstacle:
        """Lowest edge of the foreground in each column of bins, cast to the floor."""
        s, n = self.settings, self.settings.binning
        free = Obstacle(mask, n, True, Reason.OK, np.inf, np.inf, np.nan, False)
        lowest = mask.shape[0] - 1 - np.argmax(mask[::-1], axis=0)
        # A piece that is lower than the least height is a joint or a scratch of the floor.
        above = lowest - max(1, s.min_height_px // n)
        columns = np.arange(mask.shape[1])
        tall = (mask[lowest, columns] > 0) & (above >= 0) & (mask[np.maximum(above, 0), columns] > 0)
        columns = columns[tall]
        if len(columns) < 3:
            return free
        edge = lowest[columns]
        pixels = np.column_stack([(columns + 0.5) * n - 0.5, (edge + 1.0) * n - 0.5])
        points = self.floor_view.cast(pixels)
        distance = points[:, 0] - self.front_m
        # As many of the nearest columns as the least obstacle is wide, and the middle one of them.
        width = float(np.ptp(points[:, 1])) / max(int(np.ptp(columns)), 1)
        needed = max(3, int(np.ceil(s.min_width_m / max(width, 1e-6))))
        if len(columns) < needed or not np.isfinite(points).all():
            return free
        at = int(np.argsort(distance)[needed // 2])
        sigma = abs(float(self.floor_view.jacobian(pixels[at])[0, 1])) * s.edge_sigma_px
        # The vote of the neighbours may take its last bins away.
        border = bool(edge[at] >= mask.shape[0] - 2 - _VOTE // 2)
        return Obstacle(mask, n, True, Reason.OK, float(distance[at]), sigma, float(points[at, 1]), border)
