"""Prints on the simulated rod: an AprilTag, a collage, or any image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, UInt8

from ..rendering._finger_tag import CELLS, tag_cells
from ..rendering.textures import fractal_noise

#: Subpixels per cell.
_CELL_PX = 48


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """Ink on paper, at a higher resolution than the camera's."""

    levels: Float32[np.ndarray, "R C"]  #: grey levels
    width_m: float  #: of the whole image, C columns

    @property
    def pixel_m(self) -> float:
        """Size of one pixel of ``levels`` [m]."""
        return self.width_m / self.levels.shape[1]


def print_of_tag(tag_id: int, size_m: float) -> Print:
    """An AprilTag 36h11 with half a cell of white paper around its black border.

    Parameters
    ----------
    tag_id
        Number in the family.
    size_m
        Side of the black border [m].
    """
    half = _CELL_PX // 2
    fine = np.kron(tag_cells(tag_id), np.ones((_CELL_PX, _CELL_PX), np.uint8))[half:-half, half:-half]
    levels = np.where(fine, 215.0, 25.0).astype(np.float32)
    return Print(levels, size_m * (CELLS + 1) / CELLS)


def print_of_image(image: UInt8[np.ndarray, "R C"], width_m: float) -> Print:
    """A printed image: interpolated between its pixels, and with reduced contrast.

    Parameters
    ----------
    image
        Grey image (rows, columns).
    width_m
        Printed width [m].
    """
    import cv2

    levels = 20.0 + 205.0 / 255.0 * image.astype(np.float32)
    return Print(cv2.resize(levels, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC), width_m)


@lru_cache(maxsize=16)
def collage(seed: int) -> UInt8[np.ndarray, "side side"]:
    """An image of 320 x 320 pixels with many shapes and grey levels, different for every seed; it tracks like a photo.

    Parameters
    ----------
    seed
        Seed of the shapes.
    """
    import cv2

    rng = np.random.default_rng([7202, seed])
    size = 512  # fractal noise requires a power of two
    canvas = 128 + 35 * fractal_noise(rng, size, 1.3)
    for _ in range(220):
        centre = rng.uniform(0, size, 2)
        level, fraction = rng.uniform(10, 245), rng.uniform(0.5, 0.95)
        mask = np.zeros((size, size), np.float32)
        if rng.random() < 0.5:
            axes = rng.uniform(5, 40, 2)
            cv2.ellipse(
                mask, (tuple(centre), tuple(2 * axes), float(rng.uniform(0, 180))), 1.0, -1, cv2.LINE_AA
            )
        else:
            angle = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
            ring = centre + rng.uniform(8, 50) * np.column_stack([np.cos(angle), np.sin(angle)])
            cv2.fillPoly(mask, [np.round(ring).astype(np.int32)], 1.0, cv2.LINE_AA)
        canvas += fraction * mask * (level - canvas)
    canvas += 10 * fractal_noise(rng, size, 0.3, shortest_texels=4)
    small = cv2.resize(cv2.GaussianBlur(canvas, (0, 0), 0.8), (320, 320), interpolation=cv2.INTER_AREA)
    image = np.clip(np.rint(small), 0, 255).astype(np.uint8)
    image.flags.writeable = False  # shared by all callers through the cache
    return image
