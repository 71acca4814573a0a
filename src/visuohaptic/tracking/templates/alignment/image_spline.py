"""Cubic B-spline coefficients of an image, computed where they are needed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32

#: Samples to B-spline coefficients: sqrt(3) z^|k|, z = sqrt(3) - 2, cut where it is below 1e-3.
_PREFILTER = np.sqrt(3.0) * (np.sqrt(3.0) - 2.0) ** np.abs(np.arange(-6, 7))
_PREFILTER /= _PREFILTER.sum()


class ImageSpline:
    """The coefficients of one image in the requested area.

    Parameters
    ----------
    image
        The image, (rows, columns) float32.
    """

    def __init__(self, image: Float32[np.ndarray, "rows columns"]) -> None:
        self._image = image
        self._known = 0, 0, -1, -1  #: area of the coefficients: y0, x0, y1, x1
        self._coefficients = np.zeros((0, 0), np.float32)

    def around(self, corners: Float[np.ndarray, "n 2"]) -> Float32[np.ndarray, "rows columns"]:
        """Coefficients in the bounding rectangle of points (x, y) [px] with a margin of 8 px, 0 elsewhere.

        Parameters
        ----------
        corners
            The points.
        """
        import cv2

        height, width = self._image.shape
        (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        low = max(0, int(top) - 8), max(0, int(left) - 8)
        high = min(height, max(0, int(bottom) + 9)), min(width, max(0, int(right) + 9))
        y0, x0, y1, x1 = self._known
        if low[0] < y0 or low[1] < x0 or high[0] > y1 or high[1] > x1:
            # Twice the margin: the passes that follow move by less, and use the same coefficients.
            y0, x0, y1, x1 = max(0, low[0] - 8), max(0, low[1] - 8), high[0] + 8, high[1] + 8
            self._known = y0, x0, min(y1, height), min(x1, width)
            part = self._image[y0:y1, x0:x1]
            self._coefficients = np.zeros_like(self._image)
            if part.size:
                self._coefficients[y0:y1, x0:x1] = cv2.sepFilter2D(
                    part, -1, _PREFILTER, _PREFILTER, borderType=cv2.BORDER_REFLECT_101
                )
        return self._coefficients
