"""Effects of lens and sensor on the exact image: blur, shading, light, noise, rounding, JPEG."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core import NON_NEGATIVE, Ranged, at_least, available_cores, within
from ...core.files import decode_image, encode_image
from ._render_kernels import develop


@dataclass(frozen=True, slots=True)
class CameraEffects(Ranged):
    """Imperfections of a camera; the default is a good camera in uniform light.

    The lens blurs first (the renderer does it, edge by edge), then light and gain
    scale, then noise is added, then levels are clipped to 0..255 and rounded, then JPEG.
    """

    #: standard deviation of the Gaussian point spread, on top of the pixel's square
    blur_px: float = field(default=0.8, metadata=NON_NEGATIVE)
    #: standard deviation of the noise at level 0 [grey levels]
    noise_sigma: float = field(default=0.0, metadata=NON_NEGATIVE)
    #: variance that each grey level adds [grey levels^2 per level]
    shot_noise: float = field(default=0.0, metadata=NON_NEGATIVE)
    gain: float = field(default=1.0, metadata=NON_NEGATIVE)  #: exposure; multiplies all levels
    #: relative loss of light in the image's corner
    vignetting: float = field(default=0.0, metadata=within(0, 1))
    gradient_x: float = 0.0  #: relative change of light from the left to the right border
    gradient_y: float = 0.0  #: relative change of light from the top to the bottom border
    light: Callable[[float], float] | None = None  #: relative light over time [s]; 0 is darkness
    #: duration of exposure, centred on the row's time; 0 = no motion blur
    exposure_s: float = field(default=0.0, metadata=NON_NEGATIVE)
    exposure_samples: int = field(default=4, metadata=at_least(1))  #: images averaged over the exposure
    #: 1..100; ``None`` = not compressed
    jpeg_quality: int | None = field(default=None, metadata=within(1, 100))

    def light_field(self, rows: int, columns: int) -> Float32[np.ndarray, "rows columns"]:
        """Relative light at each pixel by vignetting and gradient; empty when it is 1 everywhere.

        Parameters
        ----------
        rows, columns
            Size of the image [px].
        """
        if not (self.vignetting or self.gradient_x or self.gradient_y):
            return np.zeros((0, 0), np.float32)
        return _light_field(rows, columns, self.vignetting, self.gradient_x, self.gradient_y)

    def row_gain(self, row_times_s: Float[np.ndarray, "rows"]) -> Float[np.ndarray, "rows"]:
        """Gain times light of each row at the time of its exposure.

        Parameters
        ----------
        row_times_s
            Exposure time of each row (rows) [s].
        """
        if self.light is None:
            return np.full(len(row_times_s), self.gain)
        if row_times_s[0] == row_times_s[-1]:
            return np.full(len(row_times_s), self.gain * max(0.0, self.light(float(row_times_s[0]))))
        return np.array([self.gain * max(0.0, self.light(float(t))) for t in row_times_s])

    def sigma_of_level(self) -> Float32[np.ndarray, "levels"]:
        """Standard deviation of the noise at the grey levels 0..255; empty without noise."""
        if self.noise_sigma == 0 and self.shot_noise == 0:
            return np.zeros(0, np.float32)
        return np.sqrt(self.noise_sigma**2 + self.shot_noise * np.arange(256)).astype(np.float32)

    def developed(
        self,
        image: Float32[np.ndarray, "rows columns channels"],
        row_times_s: Float[np.ndarray, "rows"],
        rng: np.random.Generator,
    ) -> UInt8[np.ndarray, "rows columns channels"]:
        """Grey levels of a blurred exact image; the same ``rng`` state gives the same levels.

        Parameters
        ----------
        image
            Exact image (rows, columns, channels) float32.
        row_times_s
            Exposure time of each row (rows) [s].
        rng
            Source of the noise.
        """
        rows, columns, channels = image.shape
        seeds = np.asarray(rng.integers(0, 2**64, rows, dtype=np.uint64))
        field, gain = self.light_field(rows, columns), self.row_gain(row_times_s)
        sigma, quantiles = self.sigma_of_level(), _normal_quantiles()
        result = np.empty(image.shape, np.uint8)

        def band(low: int, high: int) -> None:
            words, at = np.zeros((columns * channels + 3) // 4, np.uint64), slice(low, high)
            tables = sigma, seeds[at], quantiles, words, words.view(np.uint16)
            develop(image[at], field[at], gain[at], *tables, result[at])

        in_bands(band, rows)
        return result if self.jpeg_quality is None else _through_jpeg(result, self.jpeg_quality)


#: A smaller band of rows takes less time (1 ms) than is worth starting a thread (0.1 ms).
_MIN_BAND_ROWS = 128


def in_bands(work: Callable[[int, int], None], rows: int) -> None:
    """Process bands of rows in parallel, one per core; the bands share no pixel.

    Parameters
    ----------
    work
        Works on the rows from its first argument to its second, without the last.
    rows
        Number of rows of the image.
    """
    count = max(1, min(available_cores(), rows // _MIN_BAND_ROWS))
    ends = [rows * i // count for i in range(count + 1)]
    # Threads of a frame end with it: a process that is forked between frames does not inherit any.
    with ThreadPoolExecutor(count) as pool:
        others = [pool.submit(work, *band) for band in pairwise(ends[1:])]
        work(ends[0], ends[1])
        for other in others:
            other.result()


@lru_cache(maxsize=4)
def _light_field(rows: int, columns: int, vignetting: float, x: float, y: float) -> np.ndarray:
    across = np.linspace(-1, 1, columns)[None, :]
    down = np.linspace(-1, 1, rows)[:, None]
    # Natural vignetting decreases with r^2 near the axis; the corner has |(columns, rows)| = 1.
    diagonal = columns**2 + rows**2
    radius_2 = (across**2 * columns**2 + down**2 * rows**2) / diagonal
    field = (1 - vignetting * radius_2) * (1 + 0.5 * x * across) * (1 + 0.5 * y * down)
    return np.maximum(field, 0).astype(np.float32)


@lru_cache(maxsize=1)
def _normal_quantiles() -> np.ndarray:
    from scipy.special import ndtri

    # Centre of each of the 2^16 cells of probability; rescaled, as the variance within the cells is lost.
    table = ndtri((np.arange(65536) + 0.5) / 65536)
    return (table / table.std()).astype(np.float32)


def _through_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    data = encode_image(image, "jpg", quality=quality, where="CameraEffects")
    decoded = decode_image(data, "CameraEffects", "colour" if image.shape[2] == 3 else "grey")
    return decoded.reshape(image.shape)
