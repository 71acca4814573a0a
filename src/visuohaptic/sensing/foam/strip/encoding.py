"""Shift of a blurred edge due to the encoding (gamma) of grey levels, and the probability that a camera encodes them.

Most cameras encode the light L as the grey level L^(1/2.2), some as L itself. A lens blurs light, so that with the first
kind the bright side of an edge looks larger: where the grey level is half way between those on both sides, a and b, the
light is at a fraction p = (((1 + r) / 2)^2.2 - r^2.2) / (1 - r^2.2) of its step, r = b / a, and a blur s shifts the edge by
-s times the normal quantile of p. A strip then looks wider, and a front seen against a dark body is shifted relative to one
seen against a bright floor.

The encoding also skews the blur of an edge, which is symmetric in linear light. With g(v) the encoded edge and
Phi(v) that of a linear camera, the grey levels beside the straight base are Phi + q (g - Phi) plus symmetric terms due to
lens, sharpening and pixels; q is 0 or 1.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.special import ndtr, ndtri

from ....tracking.contours.contour import PIXEL_PX, Contour

#: Prior probability that an unknown camera encodes its grey levels.
UNKNOWN_ENCODING = 0.5
#: Probability of encoding for each known transfer function.
ENCODINGS = {"linear": 0.0, "srgb": 1.0}
#: Approximate exponent of sRGB and of video cameras.
_EXPONENT = 2.2
#: Range of pixels on both sides of an edge that are used for its skewness, in blurs: the whole edge.
_REACH = 3.5
#: Neighbours to either side for smoothing the edge position by a parabola, because noise and pixels shift single points.
_SMOOTH_POINTS = 5
#: An edge that is narrow relative to the pixels deviates from a Gaussian by the shape of lens and pixel: modelled as another
#: shape of a tenth of the edge's component at the Nyquist frequency, relative to the height of g - Phi beside symmetric
#: terms (0.014 of the contrast for r from 0.15 to 0.4). The mean log-score of the probabilities over 63 open worlds is best with
#: a tenth to a seventh, -0.15; -0.38 without.
_SHAPE = 0.1 / 0.014


def _encoded_quantile(dark: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    """Normal quantile of the light fraction at half grey, for edges between the grey levels 1 and ``dark``."""
    lost = dark**_EXPONENT
    result: Float[np.ndarray, "k"] = ndtri(((0.5 * (1.0 + dark)) ** _EXPONENT - lost) / (1.0 - lost))
    return result


def _dark(contour: Contour) -> Float[np.ndarray, "k"]:
    """Ratio of dark to bright grey level of each edge."""
    ends = np.maximum(contour.level, 1.0), np.maximum(contour.level - contour.contrast, 1.0)
    result: Float[np.ndarray, "k"] = np.minimum(np.minimum(*ends) / np.maximum(*ends), 0.99)
    return result


def encoded_shift_px(contour: Contour) -> Float[np.ndarray, "k"]:
    """Shift of each edge along its line relative to that of a linear camera, if grey levels are encoded [px].

    Parameters
    ----------
    contour
        One contour in one frame.
    """
    dark = _dark(contour)
    quantile, lost = _encoded_quantile(dark), dark**_EXPONENT
    # Ratio of the slope at half grey of a blurred grey edge to that of blurred light.
    wider = _EXPONENT * (1.0 - dark) / (1.0 - lost) * (0.5 * (1.0 + dark)) ** (_EXPONENT - 1.0)
    blur = np.hypot(contour.blur_px, PIXEL_PX) / (wider * np.exp(0.5 * quantile**2))
    shift: Float[np.ndarray, "k"] = np.sign(contour.contrast) * blur * quantile
    return shift


#: q of a contour in one frame, its standard error, the blur, and the mean pixel phase along the edge.
EdgeSkew = tuple[float, float, float, float]


def edge_skew(grey: UInt8[np.ndarray, "rows columns"], contour: Contour) -> EdgeSkew:
    """Measured fraction q of the skewness due to encoding on the edges of a contour; NaN if there are too few.

    Parameters
    ----------
    grey
        Grey image.
    contour
        A contour in it.
    """
    blur, dark = np.hypot(contour.blur_px, PIXEL_PX), _dark(contour)
    known = np.flatnonzero(contour.valid & np.isfinite(blur))
    if len(known) <= 2 * _SMOOTH_POINTS:
        return math.nan, math.nan, math.nan, math.nan
    blur_px = float(np.median(blur[known]))
    offset, level, inside = _beside(grey, contour, known, _REACH * blur_px)
    v = -np.sign(contour.contrast[known])[:, None] * offset / blur[known, None]
    bright = np.maximum(contour.level, contour.level - contour.contrast)[known, None]
    step, r = np.abs(contour.contrast[known])[:, None], dark[known, None]
    # Linear model in q: constant, step, shift, and two symmetric shapes.
    light = r**_EXPONENT + (1.0 - r**_EXPONENT) * ndtr(v + _encoded_quantile(dark)[known, None])
    skew = (light ** (1.0 / _EXPONENT) - r) / (1.0 - r) - ndtr(v)
    bell = np.exp(-0.5 * v**2)
    inside &= np.abs(v) < _REACH
    terms = np.stack([np.ones_like(v), ndtr(v), bell, v * bell, v**3 * bell, skew], axis=-1)
    terms *= inside[..., None]
    y = np.where(inside, (level - bright + step) / step, 0.0)
    inverse = np.linalg.pinv(np.einsum("kia,kib->ab", terms, terms), hermitian=True)
    found = inverse @ np.einsum("kia,ki->a", terms, y)
    # Texture is common to all pixels of a point: its residuals are combined into one.
    each = np.einsum("kia,ki->ka", terms, y - terms @ found) @ inverse[:, -1]
    phase = abs(np.exp(2j * np.pi * offset[inside]).mean()) if inside.any() else 1.0
    return float(found[-1]), float(np.linalg.norm(each)), blur_px, float(phase)


def _beside(
    grey: UInt8[np.ndarray, "rows columns"], contour: Contour, known: np.ndarray, reach_px: float
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"], Bool[np.ndarray, "k n"]]:
    """Distances of pixels from the smoothed edge of each known point [px], their grey levels, and a mask of valid ones."""
    index = np.arange(len(contour.position_px))
    place = np.interp(index, known, contour.position_px[known])
    x = np.arange(-_SMOOTH_POINTS, _SMOOTH_POINTS + 1.0)
    weight = np.linalg.pinv(np.stack([x**0, x, x**2], axis=1))[0]
    padded = np.pad(place, _SMOOTH_POINTS, mode="reflect", reflect_type="odd")
    place = np.convolve(padded, weight, mode="valid")
    lines, direction = contour.lines, contour.lines.direction_px[known]
    centre = lines.points_px(place)[known]
    side = np.arange(-math.ceil(reach_px + 1.0), math.ceil(reach_px + 1.0) + 1.0)
    around = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    pixel = np.rint(centre)[:, None] + around
    away = pixel - centre[:, None]
    across = away[..., 1] * direction[:, None, 0] - away[..., 0] * direction[:, None, 1]
    along = np.einsum("kij,kj->ki", away, direction) - contour.slope[known, None] * across
    column, row = (pixel[..., axis].astype(np.int64) for axis in (0, 1))
    inside = np.abs(across) <= np.broadcast_to(lines.half_width_px, index.shape)[known, None]
    inside &= (column >= 0) & (row >= 0) & (column < grey.shape[1]) & (row < grey.shape[0])
    level = grey[np.clip(row, 0, grey.shape[0] - 1), np.clip(column, 0, grey.shape[1] - 1)]
    return along, level.astype(np.float64), inside


def encoding_probability(skews: list[EdgeSkew]) -> float:
    """Probability that a camera encodes its grey levels, from the base of the strip in some frames.

    Parameters
    ----------
    skews
        From :func:`edge_skew`, one for each frame.
    """
    seen = np.array(skews).reshape(-1, 4)
    seen = seen[np.isfinite(seen).all(axis=1)]
    if len(seen) == 0:
        return UNKNOWN_ENCODING
    q, error, blur, phase = seen.mean(axis=0)
    shape = _SHAPE * math.exp(-0.5 * (math.pi * blur) ** 2)
    # A uniform distribution of pixel phases keeps a symmetric edge symmetric, any other one does not.
    linear, encoded = math.hypot(error, shape * phase), math.hypot(error, shape)
    odds = _student(q - 1.0, encoded) / _student(q, linear)
    return float(UNKNOWN_ENCODING * odds / (UNKNOWN_ENCODING * odds + 1.0 - UNKNOWN_ENCODING))


def _student(x: float, scale: float) -> float:
    """Density of Student's t with three degrees of freedom, robust to edges that are skewed for other reasons."""
    scale = max(scale, 1e-9)  # for images without any noise
    return 2.0 / (math.pi * math.sqrt(3.0) * scale * (1.0 + (x / scale) ** 2 / 3.0) ** 2)
