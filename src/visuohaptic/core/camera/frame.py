"""A single image with its timestamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from ..errors import InputError

#: Frame rate of the usual camera, where none is stated [Hz].
USUAL_RATE_Hz = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """An image as delivered by a camera.

    ``image`` is grey (rows, columns) or colour in OpenCV's order blue, green,
    red (rows, columns, 3), 8 bit.
    """

    image: UInt8[np.ndarray, "rows columns *colour"]
    t_s: float  #: time of exposure of the first row [s], on the source's clock
    index: int  #: sequence number in the source; a gap means lost frames

    def __post_init__(self) -> None:
        image = self.image
        if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
            raise InputError(
                "Frame",
                f"found {image.dtype} of shape {image.shape}, "
                "expected uint8 (rows, columns) or (rows, columns, 3)",
                field="image",
            )

    @property
    def grey(self) -> UInt8[np.ndarray, "rows columns"]:
        """The image as grey levels; no copy if it is already grey."""
        if self.image.ndim == 2:
            return self.image
        import cv2

        return cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY)
