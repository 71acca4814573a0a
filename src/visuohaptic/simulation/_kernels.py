"""Inner loops of the renderer: exact area coverage, textured planes, sensor noise."""

from __future__ import annotations

from math import floor

import numpy as np
from numba import njit

__all__ = ["add_plane", "add_signed_coverage", "develop"]


@njit(cache=True)
def add_signed_coverage(polygon: np.ndarray, x0: int, y0: int, cover: np.ndarray) -> None:
    """Add the exact area of a polygon inside each pixel, signed by its direction of turn.

    ``polygon`` (n, 2) in px, pixel centres at integers, entirely inside the window of
    ``cover`` (h, w) float32 (zero at the start) whose first pixel is (x0, y0). Each edge adds
    the area between itself and the right border of the window, differentiated
    along the row; a running sum at the end integrates it again.
    """
    height, width = cover.shape
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
            if first == last or right - left < 1e-9:
                share = part * (1.0 - (0.5 * (left + right) - first))
                cover[row, first] += share
                if first + 1 < width:
                    cover[row, first + 1] += part - share
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
    for row in range(height):
        total = 0.0
        for column in range(width):
            total += cover[row, column]
            cover[row, column] = total


@njit(cache=True, error_model="numpy")
def add_plane(
    image: np.ndarray,
    weight: np.ndarray,
    x0: int,
    y0: int,
    rays: np.ndarray,
    matrices: np.ndarray,
    tile: np.ndarray,
    texels_per_m: float,
    amplitude: float,
    colour: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add ``weight`` times the look of a textured plane to a window of the image.

    ``image`` (H, W, C) float32; ``weight`` (h, w) float32 or (0, 0) for weight 1
    everywhere; ``rays`` (H, W, 2) or (1, W, 2) normalised viewing rays, the latter
    with ``y = rays[0, 0, 1] + row * rays[0, 1, 1]``; ``matrices`` (H or 1, 3, 3) from
    a ray (x, y, 1) to plane coordinates (a, b, 1) up to scale; ``tile`` (T, T) uint8 with T
    a power of two, mean 128, standard deviation 42; value
    ``colour * (g0 + g1 a + g2 b) + amplitude * (tile - 128) / 42``.
    """
    everywhere = weight.shape[0] == 0
    if everywhere:
        height, width = image.shape[:2]
    else:
        height, width = weight.shape
    channels = image.shape[2]
    mask = tile.shape[0] - 1
    table_rays = rays.shape[0] > 1
    factor = np.float32(amplitude / 42.0)
    for r in range(height):
        row = r + y0
        m = matrices[row if matrices.shape[0] > 1 else 0]
        # The row's share of the matrix product, and texture coordinates instead of metres.
        for c in range(width):
            w = np.float32(1.0) if everywhere else weight[r, c]
            if w <= np.float32(1e-5):
                continue
            column = c + x0
            if table_rays:
                x, y = rays[row, column, 0], rays[row, column, 1]
            else:
                x, y = rays[0, column, 0], rays[0, 0, 1] + row * rays[0, 1, 1]
            scale = 1.0 / (m[2, 0] * x + m[2, 1] * y + m[2, 2])
            a = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * scale
            b = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * scale
            value = np.float32(0.0)
            if factor != 0.0 and abs(a) < 1e5 and abs(b) < 1e5:
                s, t = a * texels_per_m, b * texels_per_m
                i, j = floor(s), floor(t)
                fs, ft = np.float32(s - i), np.float32(t - j)
                i0, j0 = i & mask, j & mask
                i1, j1 = (i + 1) & mask, (j + 1) & mask
                upper = tile[j0, i0] + fs * (np.float32(tile[j0, i1]) - np.float32(tile[j0, i0]))
                lower = tile[j1, i0] + fs * (np.float32(tile[j1, i1]) - np.float32(tile[j1, i0]))
                value = factor * (upper + ft * (lower - upper) - np.float32(128.0))
            light = np.float32(max(0.0, gradient[0] + gradient[1] * a + gradient[2] * b))
            for k in range(channels):
                image[row, column, k] += w * max(np.float32(0.0), colour[k] * light + value)


@njit(cache=True)
def develop(
    image: np.ndarray,
    field: np.ndarray,
    row_gain: np.ndarray,
    sigma_of_level: np.ndarray,
    seeds: np.ndarray,
    quantiles: np.ndarray,
    result: np.ndarray,
) -> None:
    """Turn the exact image into grey levels: gain, noise, clipping, rounding.

    ``field`` (H, W) float32 or (0, 0) for none; ``row_gain`` (H,); ``sigma_of_level``
    (256,) noise at each grey level, or (0,) for no noise; ``seeds`` (H,) uint64, one per row;
    ``quantiles`` (65536,) float32 of the standard normal distribution. Each
    64-bit number of the splitmix64 generator gives four normal numbers.
    """
    height, width, channels = image.shape
    shaded = field.shape[0] > 0
    noisy = sigma_of_level.shape[0] > 0
    for row in range(height):
        state = seeds[row]
        bits = np.uint64(0)
        left = 0
        gain = np.float32(row_gain[row])
        for column in range(width):
            factor = gain * field[row, column] if shaded else gain
            for k in range(channels):
                value = image[row, column, k] * factor
                if noisy:
                    if left == 0:
                        state += np.uint64(0x9E3779B97F4A7C15)
                        bits = state
                        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                        bits = bits ^ (bits >> np.uint64(31))
                        left = 4
                    level = int(min(max(value, np.float32(0.0)), np.float32(255.0)))
                    value += sigma_of_level[level] * quantiles[np.int64(bits & np.uint64(0xFFFF))]
                    bits >>= np.uint64(16)
                    left -= 1
                result[row, column, k] = np.uint8(
                    min(max(value + np.float32(0.5), np.float32(0.0)), np.float32(255.0))
                )
