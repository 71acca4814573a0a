"""What the planar tracker precomputes from a template: pyramid, gradients, informative rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from ..errors import InputError

__all__ = ["MIN_SIDE_PX", "EsmTemplate", "Level"]

#: Templates smaller than this on a side have too few pixels for eight unknowns.
MIN_SIDE_PX = 16


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of a template's pyramid, R rows and C columns without its border, ready for the kernels."""

    image: Float32[np.ndarray, "R C"]
    gradient_x: Float32[np.ndarray, "R C"]  #: per unit of x
    gradient_y: Float32[np.ndarray, "R C"]
    x: Float32[np.ndarray, "C"]  #: centred coordinates
    y: Float[np.ndarray, "R"]
    rows: Int[np.ndarray, "R"]
    informative: Int[np.ndarray, "k"]  #: the half of the rows with most gradient, spread over the height
    unit: float  #: columns per unit of x
    to_template: Float[np.ndarray, "3 3"]  #: centred coordinates to pixels of the whole template
    from_template: Float[np.ndarray, "3 3"]  #: its inverse


def _gradient(image: Float[np.ndarray, "R C"], axis: int) -> Float[np.ndarray, "R C"]:
    """Derivative of the interpolating cubic spline at the pixels; one-sided at the border."""
    from scipy.ndimage import spline_filter1d

    derivative = np.gradient(image, axis=axis)
    coefficients = np.moveaxis(spline_filter1d(image, order=3, axis=axis, mode="mirror"), axis, 0)
    np.moveaxis(derivative, axis, 0)[1:-1] = 0.5 * (coefficients[2:] - coefficients[:-2])
    return derivative


def _level(image: Float32[np.ndarray, "rows columns"], every: int, block: int) -> Level:
    """Precompute one level; the outermost pixels are left out, their neighbours in print are unknown.

    ``every`` pixels of the chain's first level, each the mean of ``block`` x ``block``, make one here.
    """
    rows, columns = image.shape
    unit = 0.5 * max(rows, columns)
    centre_x, centre_y = (columns - 1) / 2, (rows - 1) / 2
    half = (block - 1) / 2
    to_template = np.array(
        [
            [unit * every * block, 0, centre_x * every * block + half],
            [0, unit * every * block, centre_y * every * block + half],
            [0, 0, 1.0],
        ]
    )
    inner = (slice(1, -1), slice(1, -1))
    gradient_x = (_gradient(image.astype(np.float64), 1)[inner] * unit).astype(np.float32)
    gradient_y = (_gradient(image.astype(np.float64), 0)[inner] * unit).astype(np.float32)
    energy = (gradient_x**2 + gradient_y**2).sum(axis=1)
    chosen = [
        start + int(k)
        for start in range(0, rows - 2, 4)
        for k in np.sort(np.argsort(-energy[start : start + 4], kind="stable")[:2])
    ]
    return Level(
        image=np.ascontiguousarray(image[inner]),
        gradient_x=np.ascontiguousarray(gradient_x),
        gradient_y=np.ascontiguousarray(gradient_y),
        x=((np.arange(1, columns - 1) - centre_x) / unit).astype(np.float32),
        y=(np.arange(1, rows - 1) - centre_y) / unit,
        rows=np.arange(rows - 2),
        informative=np.array(chosen, dtype=np.int64),
        unit=unit,
        to_template=to_template,
        from_template=np.linalg.inv(to_template),
    )


@dataclass(frozen=True, slots=True, eq=False)
class EsmTemplate:
    """A template with what the tracker precomputes from it.

    ``chains[b]`` is a pyramid that begins at 1 / 2^b of the size, for templates that are
    seen from afar. Its beginning is made of means of blocks, as a camera's pixels are;
    further levels are smoothed, and the pixels of level k+1 lie on every second of level k.
    """

    chains: tuple[tuple[Level, ...], ...]
    corners: Float[np.ndarray, "4 2"]  #: centres of the corner pixels (column, row), clockwise

    @classmethod
    def from_image(cls, image: UInt8[np.ndarray, "R C"] | Float[np.ndarray, "R C"]) -> EsmTemplate:
        """Precompute pyramid and gradients of a grey image.

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
        chains = []
        block = 1
        while min(rows, columns) // block >= MIN_SIDE_PX:
            size = (columns // block, rows // block)
            start = level[: size[1] * block, : size[0] * block]
            start = cv2.resize(start, size, interpolation=cv2.INTER_AREA)
            chains.append(_chain(start, block))
            block *= 2
        x, y = columns - 1.0, rows - 1.0
        return cls(tuple(chains), np.array([[0, 0], [x, 0], [x, y], [0, y]], dtype=np.float64))


def _chain(image: Float32[np.ndarray, "rows columns"], block: int) -> tuple[Level, ...]:
    """Pyramid of an image, as long as its levels are large enough."""
    import cv2

    levels: list[Level] = []
    while min(image.shape) >= MIN_SIDE_PX:
        levels.append(_level(image, 2 ** len(levels), block))
        image = cv2.pyrDown(image)
    return tuple(levels)
