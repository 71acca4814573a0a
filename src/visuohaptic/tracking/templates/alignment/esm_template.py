"""Data that the planar tracker precomputes from a template: pyramid, gradients, informative rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from ....core.errors import InputError
from .template_blocks import block_side, block_values, softened

#: Templates with a smaller side have too few pixels for eight unknowns.
MIN_SIDE_PX = 16

#: Blurs that can be applied to a template to match the camera's image: variances of a Gaussian
#: [px^2 of the level]. Steps of about 15 % of the combined variance of pixel and lens.
BLUR_VARIANCES = (0.0, 0.1, 0.2, 0.32, 0.45, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.6, 3.4, 4.5, 6.0)
#: Blur of a typical lens [px^2].
LENS = 0.45
#: Curves from light to grey levels that can be applied to a template: 0 is proportional, 1 that of sRGB.
CURVES = (0.0, 0.5, 1.0)
#: Exponent of the curve 1, and offset of the light relative to white paper: black ink reflects a twentieth, and the
#: curve of sRGB makes 0.67 of the mean of black and white, as the power of 1 / 2.2 does with this offset.
_EXPONENT, _BLACK = 1 / 2.2, 0.035
#: Correlation of a template with itself, shifted, from which another place can be taken for it: half of its blocks, each
#: explained to a half.
REPEATS = 0.25
#: Rows of the intermediate passes, a limit of the work: even with weak texture (2 grey levels per px, a noise of 5), a hundred
#: rows of a hundred pixels are exact to 0.025 px, less than what the last passes correct.
_ROWS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of a template's pyramid, R rows and C columns without its border, ready for the kernels."""

    image: Float32[np.ndarray, "R C"]
    gradient_x: Float32[np.ndarray, "R C"]  #: per unit of x
    gradient_y: Float32[np.ndarray, "R C"]
    x: Float32[np.ndarray, "C"]  #: centred coordinates
    y: Float[np.ndarray, "R"]
    rows: Int[np.ndarray, "R"]
    informative: Int[
        np.ndarray, "k"
    ]  #: of each group of rows, the one with the largest gradients: half of them, or about ``_ROWS`` if these are fewer
    unit: float  #: columns per unit of x
    to_template: Float[np.ndarray, "3 3"]  #: centred coordinates to pixels of the whole template
    from_template: Float[np.ndarray, "3 3"]  #: inverse of ``to_template``
    side: int  #: side of the blocks whose motion is compared at the end [px of the level]
    #: width of the border that is affected by blur from outside the template [px of the level]
    border: int
    independent: Float[np.ndarray, "down across"]  #: number of independent values in each block
    contrast: Float[np.ndarray, "down across"]  #: variance of each block [grey levels^2]
    products: Float[
        np.ndarray, "down across 28"
    ]  #: sums of each block without the image, see ``template_sums``
    #: apparent motion of each block due to a blur of 1 px^2 along x, across, and along y, and due to a curve that
    #: is larger by 1, in centred coordinates
    softened: Float[np.ndarray, "down across 2 4"]


def _gradient(image: Float[np.ndarray, "R C"], axis: int) -> Float[np.ndarray, "R C"]:
    """Derivative of the interpolating cubic spline at the pixels; one-sided at the border."""
    from scipy.ndimage import spline_filter1d

    derivative = np.gradient(image, axis=axis)
    coefficients = np.moveaxis(spline_filter1d(image, order=3, axis=axis, mode="mirror"), axis, 0)
    np.moveaxis(derivative, axis, 0)[1:-1] = 0.5 * (coefficients[2:] - coefficients[:-2])
    return derivative


def _level(
    image: Float[np.ndarray, "rows columns"],
    gradients: tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]],
    every: int,
    block: tuple[float, float],
    bloom: Float[np.ndarray, "rows columns"] | None = None,
    blur: float = 0.0,
) -> Level:
    """Precompute one level; the outermost pixels are excluded, because their neighbours in print are unknown.

    One pixel here is every ``every``-th pixel of the chain's first level, each the mean of ``block`` (x, y).
    ``bloom`` is the change of the level due to a curve that is larger by 1; None: not modelled. ``blur`` is that of the
    level [px^2].
    """
    rows, columns = image.shape
    unit = 0.5 * max(rows, columns)
    centre_x, centre_y = (columns - 1) / 2, (rows - 1) / 2
    bx, by = block
    to_template = np.array(
        [
            [unit * every * bx, 0, centre_x * every * bx + (bx - 1) / 2],
            [0, unit * every * by, centre_y * every * by + (by - 1) / 2],
            [0, 0, 1.0],
        ]
    )
    inner = (slice(1, -1), slice(1, -1))
    shown, gradient_x, gradient_y = (
        np.ascontiguousarray(part[inner], dtype=np.float32)
        for part in (image, gradients[0] * unit, gradients[1] * unit)
    )
    energy = (gradient_x**2 + gradient_y**2).sum(axis=1)
    group = max(2, round(len(shown) / _ROWS))
    chosen = [k + int(np.argmax(energy[k : k + group])) for k in range(0, len(shown), group)]
    side = block_side(*shown.shape)
    # Beyond three standard deviations of the blur it is less than 0.15 %.
    border = min(side // 3, int(3.0 * np.sqrt(max(blur, LENS))))
    independent, contrast = block_values(shown, side)
    products, apparent = softened(
        shown,
        (gradient_x, gradient_y),
        unit,
        (side, border),
        np.zeros_like(shown) if bloom is None else bloom[inner],
    )
    return Level(
        image=shown,
        gradient_x=gradient_x,
        gradient_y=gradient_y,
        x=((np.arange(1, columns - 1) - centre_x) / unit).astype(np.float32),
        y=(np.arange(1, rows - 1) - centre_y) / unit,
        rows=np.arange(len(shown)),
        informative=np.array(chosen, dtype=np.int64),
        unit=unit,
        to_template=to_template,
        from_template=np.linalg.inv(to_template),
        side=side,
        border=border,
        independent=independent,
        contrast=contrast,
        products=products,
        softened=apparent,
    )


def resemblance(starts: list[Float32[np.ndarray, "rows columns"]]) -> float:
    """Largest correlation of a template with itself where it is shifted by more than a block and half of it overlaps.

    Parameters
    ----------
    starts
        First levels of all chains, the finest first; the first of at most 200 px is used.
    """
    import cv2

    image = next((start for start in starts if max(start.shape) <= 200), starts[-1])
    side = block_side(*image.shape)
    # Shades that are larger than a block do not place it.
    flat = image - cv2.GaussianBlur(image, (0, 0), side)
    rows, columns = image.shape
    power = np.abs(np.fft.rfft2(flat, (2 * rows, 2 * columns))) ** 2
    alike = np.fft.irfft2(power, (2 * rows, 2 * columns))
    y, x = (np.fft.fftfreq(2 * n, 0.5 / n) for n in (rows, columns))
    common = np.outer(rows - np.abs(y), columns - np.abs(x))
    alike = np.where(common >= 0.5 * image.size, alike / np.maximum(common, 1.0), 0.0).astype(np.float32)
    # Peaks other than that without a shift; its slopes are none.
    alike = np.fft.fftshift(alike)
    alike[alike < cv2.dilate(alike, np.ones((5, 5)))] = 0.0
    alike[rows, columns] = 0.0
    return float(alike.max()) / max(float((flat**2).mean()), 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class EsmTemplate:
    """A template and the data precomputed from it for tracking.

    ``chains[k]`` is a pyramid that starts at 1 / sqrt(2)^k of the size, for templates
    seen from a distance: one of them is hardly finer than the image, so that neither computation nor
    information is wasted. Its first level consists of block averages, like a camera's pixels;
    further levels are smoothed, and the pixels of level k+1 are every second pixel of level k.
    """

    chains: tuple[tuple[Level, ...], ...]
    blocks: tuple[tuple[float, float], ...]  #: template pixels per pixel of each chain's first level, x and y
    starts: tuple[Float32[np.ndarray, "rows columns"], ...]  #: first levels, including their border
    corners: Float[np.ndarray, "4 2"]  #: centres of the corner pixels (column, row), clockwise
    sharp: bool = False  #: consists of steps, like a tag: blurrier in any camera
    repeats: bool = False  #: resembles itself a shift away, like a wall of bricks
    _blurred: dict[tuple[int, int, int], Level] = field(default_factory=dict, repr=False)

    @classmethod
    def from_image(
        cls, image: UInt8[np.ndarray, "R C"] | Float[np.ndarray, "R C"], *, sharp: bool = False
    ) -> EsmTemplate:
        """Precompute pyramid and gradients of a grey image.

        Parameters
        ----------
        image
            The template.
        sharp
            Whether it consists of steps, like a tag.

        Raises
        ------
        InputError
            The image is not grey, too small, or has no contrast.
        """
        import cv2

        image = np.asarray(image)
        if image.ndim != 2 or min(image.shape, default=0) < MIN_SIDE_PX:
            raise InputError(
                "EsmTemplate", f"found shape {image.shape}, expected a grey image of {MIN_SIDE_PX} px or more"
            )
        level = image.astype(np.float32)
        if not (np.isfinite(level).all() and level.std() > 1.0):
            raise InputError("EsmTemplate", "the image has no contrast", remedy="use a textured image")
        rows, columns = image.shape
        chains, blocks, starts = [], [], []
        for k in range(64):
            shrink = 2.0 ** (-0.5 * k)
            size = (round(columns * shrink), round(rows * shrink))
            if min(size) < MIN_SIDE_PX:
                break
            start = level if k == 0 else cv2.resize(level, size, interpolation=cv2.INTER_AREA)
            blocks.append((columns / size[0], rows / size[1]))
            chains.append(_chain(start, blocks[-1]))
            starts.append(start)
        x, y = columns - 1.0, rows - 1.0
        corners = np.array([[0, 0], [x, 0], [x, y], [0, y]], dtype=np.float64)
        repeats = not sharp and resemblance(starts) >= REPEATS
        return cls(tuple(chains), tuple(blocks), tuple(starts), corners, sharp, repeats)

    def variance(self, chain: int, blur: int) -> float:
        """Blur of a chain with an index of ``BLUR_VARIANCES`` relative to the whole template [template px^2].

        Averages over blocks of b pixels contribute a blur of (b^2 - 1) / 12.

        Parameters
        ----------
        chain
            Index of the chain of levels.
        blur
            Index of ``BLUR_VARIANCES``.
        """
        bx, by = self.blocks[chain]
        return BLUR_VARIANCES[blur] * bx * by + (bx * by - 1) / 12

    def blur_index(self, chain: int, variance: float) -> int:
        """The index of ``BLUR_VARIANCES`` closest to a blur [template px^2].

        Parameters
        ----------
        chain
            As in :meth:`variance`.
        variance
            Blur relative to the whole template [template px^2].
        """
        off = [abs(self.variance(chain, blur) - variance) for blur in range(len(BLUR_VARIANCES))]
        return int(np.argmin(off))

    @property
    def first_blur(self) -> int:
        """Index of the initial blur: for sharp prints that of a typical lens, half a pixel of variance."""
        return BLUR_VARIANCES.index(LENS) if self.sharp else 0

    def finest(self, chain: int, blur: int, curve: int = 0) -> Level:
        """First level of a chain as seen by a camera with a given blur and curve.

        Parameters
        ----------
        chain, blur
            As in :meth:`variance`.
        curve
            Index of ``CURVES``.
        """
        if blur <= 0 and curve <= 0:
            return self.chains[chain][0]
        key = (chain, min(blur, len(BLUR_VARIANCES) - 1), curve)
        if key not in self._blurred:
            self._blurred[key] = _sampled(
                self.starts[0],
                self.starts[chain].shape,
                self.blocks[chain],
                self.variance(*key[:2]),
                CURVES[curve],
            )
        return self._blurred[key]


def _sampled(
    image: Float32[np.ndarray, "R C"],
    shape: tuple[int, ...],
    block: tuple[float, float],
    variance: float,
    curve: float,
) -> Level:
    """A level whose pixels and gradients are samples of the whole template with a blur [px^2].

    Both are sampled at the full resolution: pixels as large as those of a camera do not resolve
    its edges, and gradients computed from them would bias the scale by 100 ppm.
    """
    from scipy.ndimage import map_coordinates

    soft = _photographed(image, variance, curve)
    # By a finite difference, within the range of the curves.
    other = curve - 0.5 if curve > 0.5 else curve + 0.5
    bloom = (_photographed(image, variance, other) - soft) / (other - curve)
    bx, by = block
    place = np.meshgrid(
        np.arange(shape[0]) * by + (by - 1) / 2, np.arange(shape[1]) * bx + (bx - 1) / 2, indexing="ij"
    )

    def taken(values: np.ndarray) -> np.ndarray:
        whole = bx == 1.0 and by == 1.0
        return values if whole else map_coordinates(values, place, order=3, mode="nearest")

    gradients = taken(_gradient(soft, 1) * bx), taken(_gradient(soft, 0) * by)
    blur = (variance - (bx * by - 1) / 12) / (bx * by)
    return _level(taken(soft), gradients, 1, block, taken(bloom), blur)


def _photographed(
    image: Float32[np.ndarray, "R C"], variance: float, curve: float
) -> Float[np.ndarray, "R C"]:
    """The print as a camera shows it: the lens blurs the light [px^2], then the curve makes grey levels of it.

    Between black and white, equal parts of the light of both are brighter than the mean of their grey levels: bright
    parts grow by up to half a pixel.
    """
    from scipy.ndimage import gaussian_filter

    exponent = 1.0 - curve * (1.0 - _EXPONENT)
    low, high = float(image.min()), float(image.max())
    grey = (image.astype(np.float64) - low) / (high - low)
    black = _BLACK**exponent
    light = (black + (1.0 - black) * grey) ** (1.0 / exponent)
    light = gaussian_filter(light, np.sqrt(variance), mode="reflect", truncate=5.0)
    return low + (high - low) * (light**exponent - black) / (1.0 - black)


def _chain(image: Float32[np.ndarray, "rows columns"], block: tuple[float, float]) -> tuple[Level, ...]:
    """Pyramid of an image, up to the smallest usable level."""
    import cv2

    levels: list[Level] = []
    while min(image.shape) >= MIN_SIDE_PX:
        gradients = _gradient(image.astype(np.float64), 1), _gradient(image.astype(np.float64), 0)
        levels.append(_level(image, gradients, 2 ** len(levels), block))
        image = cv2.pyrDown(image)
    return tuple(levels)
