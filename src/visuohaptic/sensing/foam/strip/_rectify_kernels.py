"""Compiled sampling of the strip along its lines; plain arrays in and out."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from ....core.kernels import kernel


@kernel(nogil=True)
def rectify(image, base_px, direction_px, step_px, across_px, first, result):
    """Bilinear grey levels on a few parallel lines for each point; border pixels are replicated outside the image.

    Parameters
    ----------
    image
        Grey image.
    base_px, direction_px
        Origins (x, y) [px] and unit directions of K lines, (K, 2).
    step_px
        Spacing of the samples along each line [px], (K,).
    across_px
        Spacing of the parallel lines [px], (K,).
    first
        First sample of each line that is filled, (K,).
    result
        Filled, (K, parallels, samples).
    """
    rows, columns = image.shape
    for k in range(result.shape[0]):
        dx, dy = direction_px[k, 0], direction_px[k, 1]
        for lane in range(result.shape[1]):
            away = (lane - 0.5 * (result.shape[1] - 1)) * across_px[k]
            for j in range(first[k], result.shape[2]):
                t = j * step_px[k]
                x = min(max(base_px[k, 0] + t * dx - away * dy, 0.0), columns - 1.001)
                y = min(max(base_px[k, 1] + t * dy + away * dx, 0.0), rows - 1.001)
                i, m = int(y), int(x)
                v, u = y - i, x - m
                low = image[i, m] * (1.0 - u) + image[i, m + 1] * u
                high = image[i + 1, m] * (1.0 - u) + image[i + 1, m + 1] * u
                result[k, lane, j] = np.float32(low * (1.0 - v) + high * v)
