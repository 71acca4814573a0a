"""Fraction of each pixel that polygons cover: exact, or through the blur of a lens; of facets within their outline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import floor

import numpy as np
from jaxtyping import Float, Int32

from ...core.geometry import polygon_area
from ...core.kernels import kernel

#: Fractions this close to 0 or 1 are rounding errors of the cumulative sums (float32).
EDGE = 2e-5


@kernel
def _integrate(cover: np.ndarray, spans: np.ndarray) -> None:
    """Cumulative sum of each row's span, in place; a branch where nothing changes is faster than a chain of additions."""
    for row in range(cover.shape[0]):
        total, level = 0.0, np.float32(0.0)
        line = cover[row, spans[row, 0] : max(spans[row, 0], spans[row, 1])]
        for column in range(len(line)):
            change = line[column]
            if change != 0.0:
                total += change
                level = np.float32(0.0 if total < EDGE else (1.0 if total > 1.0 - EDGE else total))
            line[column] = level


@kernel
def add_signed_coverage(polygon: np.ndarray, x0: int, y0: int, cover: np.ndarray, spans: np.ndarray) -> None:
    """Exact area of a polygon inside each pixel; the polygon is oriented counter-clockwise on the screen.

    Each edge adds the area between itself and the right border of the window, differentiated
    along the row; a cumulative sum at the end integrates it again.

    Parameters
    ----------
    polygon
        Corners (n, 2) [px], pixel centres at integers, entirely inside the window.
    x0, y0
        First pixel of the window.
    cover
        Window (h, w) float32, zero at the start, changed.
    spans
        First column of each row that is not zero, and the one after the last (h, 2) int32; filled.
    """
    height, width = cover.shape
    spans[:, 0], spans[:, 1] = width, 0
    count = len(polygon)
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        xa, ya = polygon[i, 0] - x0 + 0.5, polygon[i, 1] - y0 + 0.5
        xb, yb = polygon[j, 0] - x0 + 0.5, polygon[j, 1] - y0 + 0.5
        if ya == yb:
            continue
        sign = 1.0
        if ya > yb:
            xa, ya, xb, yb = xb, yb, xa, ya
            sign = -1.0
        slope = (xb - xa) / (yb - ya)
        for row in range(max(0, floor(ya)), min(height - 1, floor(yb)) + 1):
            top, bottom = max(ya, float(row)), min(yb, row + 1.0)
            if bottom <= top:
                continue
            left, right = xa + (top - ya) * slope, xa + (bottom - ya) * slope
            if left > right:
                left, right = right, left
            part = sign * (bottom - top)
            first, last = floor(left), floor(right)
            spans[row, 0] = min(spans[row, 0], first)
            spans[row, 1] = max(spans[row, 1], min(last + 2, width))
            if first == last or right - left < 1e-9:
                fraction = part * (1.0 - (0.5 * (left + right) - first))
                cover[row, first] += fraction
                if first + 1 < width:
                    cover[row, first + 1] += part - fraction
                continue
            # Area to the right of the edge in each crossed pixel, as cumulative sums.
            per_px = part / (right - left)
            done = 0.0
            before = 0.0
            for column in range(first, last + 1):
                inner = max(left, float(column))
                outer = min(right, column + 1.0)
                rise = per_px * (outer - inner)
                area = done + rise * (column + 1.0 - 0.5 * (inner + outer))
                cover[row, column] += area - before
                before = area
                done += rise
            if last + 1 < width:
                cover[row, last + 1] += part - before
    _integrate(cover, spans)


@kernel
def add_filtered_coverage(
    polygon: np.ndarray,
    x0: int,
    y0: int,
    sigma: float,
    table: np.ndarray,
    integral: np.ndarray,
    radius: int,
    cover: np.ndarray,
    spans: np.ndarray,
) -> None:
    """Like :func:`add_signed_coverage`, through the pixel's square and a Gaussian.

    The derivative along the row of a filtered region is the filter, integrated along its edge over
    dy. Edges are cut into pieces of 0.6 sigma with two Gauss points each; ``table`` has
    the filter b(x) and ``integral`` its integral, both (n,) at x from ``-radius - 1`` to
    ``radius + 1`` px in even steps, with b = 0 beyond ``radius``.

    Parameters
    ----------
    polygon
        Corners (n, 2) [px].
    x0, y0
        First pixel of the window.
    sigma
        Standard deviation of the Gaussian [px].
    table, integral
        Filter b(x) and its integral (n,).
    radius
        Distance beyond which the filter is zero [px].
    cover
        Window (h, w) float32, zero at the start, changed.
    spans
        Columns of each row of the window that may be not zero (h, 2) int32.
    """
    height = cover.shape[0]
    count = len(polygon)
    per_px = (len(table) - 1) / (2.0 * radius + 2.0)
    taps = 2 * radius + 2
    weights = np.zeros(taps, np.float32)
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        xa, ya = polygon[i, 0] - x0, polygon[i, 1] - y0
        dx, dy = polygon[j, 0] - x0 - xa, polygon[j, 1] - y0 - ya
        if dy == 0.0:
            continue
        length = np.sqrt(dx * dx + dy * dy)
        pieces = max(1, int(np.ceil(length / (0.6 * np.sqrt(sigma * sigma + 0.05)))))
        for piece in range(pieces):
            for side in range(2):
                fraction = (piece + 0.5 + (0.28867513459481287 if side else -0.28867513459481287)) / pieces
                x, y = xa + fraction * dx, ya + fraction * dy
                top, left = floor(y) - radius, floor(x) - radius
                if top + taps <= 0 or top >= height:
                    continue
                before = 0.0
                for k in range(taps):
                    at = min(max((left + k - x + radius + 1.0) * per_px, 0.0), len(table) - 1.001)
                    cell = int(at)
                    value = integral[cell] + (at - cell) * (integral[cell + 1] - integral[cell])
                    if k == taps - 1:
                        value = 1.0
                    weights[k] = value - before
                    before = value
                for m in range(taps):
                    row = top + m
                    if row < 0 or row >= height:
                        continue
                    at = min(max((row - y + radius + 1.0) * per_px, 0.0), len(table) - 1.001)
                    cell = int(at)
                    part = table[cell] + (at - cell) * (table[cell + 1] - table[cell])
                    share = np.float32(part * 0.5 * dy / pieces)
                    line = cover[row, left : left + taps]
                    for k in range(taps):
                        line[k] += share * weights[k]
    _integrate(cover, spans)


@kernel
def _add_facet(total: np.ndarray, facet: np.ndarray, spans: np.ndarray, x0: int, y0: int) -> None:
    """Add the coverage of a facet to that of all, and end its spans at the window of all.

    Parameters
    ----------
    total
        Coverage of all facets (H, W) float32, changed.
    facet, spans
        Coverage of one (h, w) float32, and the columns of each row that are not zero (h, 2), changed.
    x0, y0
        Its first pixel in ``total``.
    """
    for r in range(max(0, -y0), min(len(facet), len(total) - y0)):
        spans[r, 0] = max(spans[r, 0], -x0)
        spans[r, 1] = max(spans[r, 0], min(spans[r, 1], total.shape[1] - x0))
        low, high = spans[r, 0], spans[r, 1]
        part, line = facet[r, low:high], total[y0 + r, x0 + low : x0 + high]
        for c in range(len(part)):
            line[c] += part[c]


@kernel
def _share_outline(whole: np.ndarray, total: np.ndarray, rest: np.ndarray) -> None:
    """Factor that limits facets to their outline, and what of the outline they leave.

    Parameters
    ----------
    whole
        Coverage of the outline (h, w) float32.
    total
        Sum of the facets' coverages (h, w) float32; replaced by the factor.
    rest
        What they leave of the outline (h, w) float32, filled.
    """
    one, least = np.float32(1.0), np.float32(1e-6)
    for r in range(whole.shape[0]):
        outline, all_, left = whole[r], total[r], rest[r]
        for c in range(whole.shape[1]):
            factor = min(outline[c] / max(all_[c], least), one)
            left[c] = outline[c] - all_[c] * factor
            all_[c] = factor


@kernel
def _scale_facet(factor: np.ndarray, facet: np.ndarray, spans: np.ndarray, x0: int, y0: int) -> None:
    """Multiply the coverage of a facet by the factor of its pixels.

    Parameters
    ----------
    factor
        Factor (H, W) float32.
    facet, spans, x0, y0
        As in :func:`_add_facet`; the facet is changed.
    """
    for r in range(len(facet)):
        if not 0 <= y0 + r < len(factor):
            spans[r, 1] = spans[r, 0]
            continue
        low, high = spans[r, 0], max(spans[r, 0], spans[r, 1])
        part, line = facet[r, low:high], factor[y0 + r, x0 + low : x0 + high]
        for c in range(len(part)):
            part[c] *= line[c]


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Fraction of each pixel that a polygon covers, in a window whose first pixel is (x0, y0)."""

    x0: int
    y0: int
    fraction: Float[np.ndarray, "h w"]
    spans: Int32[np.ndarray, "h 2"]  #: first column of each row that is not zero, and the one after the last

    @classmethod
    def full(cls, x0: int, y0: int, fraction: Float[np.ndarray, "h w"]) -> Coverage:
        """A coverage that may be anything in its whole window.

        Parameters
        ----------
        x0, y0
            First pixel of the window.
        fraction
            Fraction of each pixel (h, w).
        """
        return cls(x0, y0, fraction, np.tile(np.array([0, fraction.shape[1]], np.int32), (len(fraction), 1)))

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the window."""
        return (
            slice(self.y0, self.y0 + self.fraction.shape[0]),
            slice(self.x0, self.x0 + self.fraction.shape[1]),
        )


def coverage(
    polygon_px: Float[np.ndarray, "n 2"], rows: int, columns: int, blur_px: float = 0.0
) -> Coverage | None:
    """Fraction of each pixel that a polygon of either direction covers, behind a Gaussian blur.

    The polygon's indicator convolved with the pixel's square and a Gaussian of
    standard deviation ``blur_px``, at each pixel; ``None`` when it is outside.

    Parameters
    ----------
    polygon_px
        Corners (n, 2) [px].
    rows, columns
        Size of the image [px].
    blur_px
        Standard deviation of the blur [px].
    """
    if len(polygon_px) < 3 or not np.isfinite(polygon_px).all():
        return None
    sharp = blur_px < SHARP_PX
    radius = 1 if sharp else _filter_table(blur_px)[0]
    # One more pixel on each side keeps rounding errors along an edge inside the window.
    low = np.floor(polygon_px.min(axis=0) + 0.5).astype(int) - radius - 1
    high = np.floor(polygon_px.max(axis=0) + 0.5).astype(int) + radius + 2
    # The window includes all columns to the left, since the cumulative sum starts there.
    y0, y1 = max(low[1], 0), min(high[1], rows)
    if y1 <= y0 or low[0] >= columns or high[0] <= 0:
        return None
    fraction = np.zeros((y1 - y0, high[0] - low[0]), np.float32)
    spans = np.tile(np.array([0, fraction.shape[1]], np.int32), (len(fraction), 1))
    polygon = np.ascontiguousarray(polygon_px, dtype=np.float64)
    # Downward edges (y grows) count positive: they are the left border of a polygon of negative orientation.
    if polygon_area(polygon) > 0:
        polygon = polygon[::-1].copy()
    if sharp:
        add_signed_coverage(polygon, low[0], y0, fraction, spans)
    else:
        radius, table, integral = _filter_table(blur_px)
        add_filtered_coverage(polygon, low[0], y0, blur_px, table, integral, radius, fraction, spans)
    x0, x1 = max(low[0], 0), min(high[0], columns)
    fraction = np.ascontiguousarray(fraction[:, x0 - low[0] : x1 - low[0]])
    return Coverage(int(x0), int(y0), fraction, np.clip(spans - np.int32(x0 - low[0]), 0, np.int32(x1 - x0)))


#: Below this, blur is ignored: the variance of a pixel is a hundred times larger.
SHARP_PX = 0.03

#: Steps per pixel of the tabulated filter; the error of linear interpolation is 1 / (8 steps^2) of its curvature.
_TABLE_STEPS = 256


@lru_cache(maxsize=16)
def _filter_table(blur_px: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Radius [px], and the filter of square and Gaussian with its integral, at equal steps."""
    from scipy.special import ndtr

    radius = int(np.ceil(4.2 * blur_px + 0.5))
    x = np.linspace(-radius - 1, radius + 1, _TABLE_STEPS * (2 * radius + 2) + 1)

    def primitive(z: np.ndarray) -> np.ndarray:  # of the normal distribution function
        z = z / blur_px
        return blur_px * (z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    table = ndtr((x + 0.5) / blur_px) - ndtr((x - 0.5) / blur_px)
    return radius, table, primitive(x + 0.5) - primitive(x - 0.5)


def share_facets(whole: Coverage, facets: list[Coverage]) -> Coverage:
    """Limit facets to the outline of their solid, in place; returns what of it they leave.

    Parameters
    ----------
    whole
        Coverage of the outline.
    facets
        Coverages of facets inside the outline.
    """
    factor, left = np.zeros_like(whole.fraction), np.empty_like(whole.fraction)
    for c in facets:
        _add_facet(factor, c.fraction, c.spans, c.x0 - whole.x0, c.y0 - whole.y0)
    _share_outline(whole.fraction, factor, left)
    for c in facets:
        _scale_facet(factor, c.fraction, c.spans, c.x0 - whole.x0, c.y0 - whole.y0)
    return replace(whole, fraction=left)
