"""What the encoding of grey levels shifts a blurred edge by.

Most cameras encode the light L as the grey level L^(1/2.2), some as L itself. A lens blurs light, so that with the first
kind the bright side of an edge looks larger: where the grey level is half way between those on both sides, a and b, the
light is at a part p = (((1 + r) / 2)^2.2 - r^2.2) / (1 - r^2.2) of its step, r = b / a, and a blur s shifts the edge by
-s times the normal quantile of p. A strip then looks wider, and a front before a dark body is elsewhere than before a
bright floor.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ....tracking.contours.contour import PIXEL_PX, Contour

__all__ = ["encoded_shift_px"]

#: Exponent of sRGB and of television's cameras, about.
_EXPONENT = 2.2


def encoded_shift_px(contour: Contour) -> Float[np.ndarray, "k"]:
    """How far along its line each edge lies beyond that of a linear camera, if grey levels are encoded [px].

    Parameters
    ----------
    contour
        One contour in one frame.
    """
    ends = np.maximum(contour.level, 1.0), np.maximum(contour.level - contour.contrast, 1.0)
    dark = np.minimum(np.minimum(*ends) / np.maximum(*ends), 0.99)
    lost = dark**_EXPONENT
    part = ((0.5 * (1.0 + dark)) ** _EXPONENT - lost) / (1.0 - lost)
    # Two terms of the normal quantile: to 1 % down to a part of 0.25.
    quantile = math.sqrt(2.0 * math.pi) * (0.5 - part)
    quantile *= 1.0 + quantile**2 / 6.0
    shift: Float[np.ndarray, "k"] = (
        -np.sign(contour.contrast) * np.hypot(contour.blur_px, PIXEL_PX) * quantile
    )
    return shift
