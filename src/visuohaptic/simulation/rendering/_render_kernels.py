"""Inner loops of the renderer: exact area coverage, textured planes, sensor noise."""

from __future__ import annotations

from math import floor

import numpy as np

from ...core.kernels import kernel

#: Fractions this close to 0 or 1 are rounding errors of the cumulative sums (float32).
EDGE = 2e-5


@kernel
def add_signed_coverage(polygon: np.ndarray, x0: int, y0: int, cover: np.ndarray) -> None:
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
    for row in range(height):
        total = 0.0
        for column in range(width):
            total += cover[row, column]
            cover[row, column] = 0.0 if total < EDGE else (1.0 if total > 1.0 - EDGE else total)


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
        Window (h, w) float32, changed.
    """
    height, width = cover.shape
    count = len(polygon)
    per_px = (len(table) - 1) / (2.0 * radius + 2.0)
    taps = 2 * radius + 2
    weights = np.zeros(taps)
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
                    part *= 0.5 * dy / pieces
                    line = cover[row, left : left + taps]
                    for k in range(taps):
                        line[k] += np.float32(part * weights[k])
    for row in range(height):
        total = 0.0
        for column in range(width):
            total += cover[row, column]
            cover[row, column] = 0.0 if total < EDGE else (1.0 if total > 1.0 - EDGE else total)


@kernel(nogil=True, error_model="numpy")
def _shift(
    a: np.ndarray,
    b: np.ndarray,
    count: int,
    a0: float,
    b0: float,
    per_m: float,
    warp: np.ndarray,
    grid: np.ndarray,
) -> None:
    """Shift ``count`` texture coordinates (a, b) [texels], relative to (a0, b0), by a table that is interpolated linearly."""
    rows, columns = warp.shape[0], warp.shape[1]
    for c in range(count):
        x = min(max(((a[c] + a0) / per_m - grid[0]) / grid[2], 0.0), rows - 1.001)
        y = min(max(((b[c] + b0) / per_m - grid[1]) / grid[2], 0.0), columns - 1.001)
        i, j = int(x), int(y)
        u, v = x - i, y - j
        for axis in range(2):
            low = warp[i, j, axis] + u * (warp[i + 1, j, axis] - warp[i, j, axis])
            high = warp[i, j + 1, axis] + u * (warp[i + 1, j + 1, axis] - warp[i, j + 1, axis])
            moved = np.float32(per_m * (low + v * (high - low)))
            if axis == 0:
                a[c] += moved
            else:
                b[c] += moved


@kernel(nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})
def add_plane(
    image: np.ndarray,
    clear: np.ndarray,
    weight: np.ndarray,
    x0: int,
    y0: int,
    rays: np.ndarray,
    matrices: np.ndarray,
    tile: np.ndarray,
    texels_per_m: float,
    amplitude: float,
    colour: np.ndarray,
    warp: np.ndarray,
    grid: np.ndarray,
) -> None:
    """Add a weighted textured plane to a window of the image, where no nearer layer hides it.

    Its levels are ``colour + amplitude * (tile - 128) / 42``.

    Parameters
    ----------
    image
        Image (H, W, C) float32, changed.
    clear
        Fraction (H, W) float32 of each pixel that no nearer layer covers.
    weight
        Weight (h, w) float32 of each pixel of the window.
    x0, y0
        First pixel of the window.
    rays
        Normalised viewing rays (H, W, 2); or (1, W, 2) with ``y = rays[0, 0, 1] + row * rays[0, 1, 1]``.
    matrices
        Transforms from a ray (x, y, 1) to plane coordinates (a, b, 1) up to scale, (H or 1, 3, 3).
    tile
        Texture (T, T) uint32, T a power of two: in its bytes, from the lowest, a texel, its right, its lower and
        its lower right neighbour, of mean 128 and standard deviation 42.
    texels_per_m
        Texture elements per metre of the plane.
    amplitude
        Standard deviation of the texture [grey levels].
    colour
        Mean level of each channel (C).
    warp
        Shift of the texture along a and b at the points of an even grid [m], (A, B, 2) float32; (0, 0, 2) for none.
    grid
        Its first point (a, b) and its spacing [m], (3,).
    """
    height, width = weight.shape
    channels, size = image.shape[2], tile.shape[0]
    flat = tile.ravel()
    mask, byte, bits = np.int32(size - 1), np.uint32(255), np.int32(0)
    while (1 << bits) < size:
        bits += np.int32(1)
    table_rays = rays.shape[0] > 1
    factor, mean, zero = np.float32(amplitude / 42.0), np.float32(128.0), np.float32(0.0)
    # Texture coordinates stay small enough for the conversion to integers: the tile repeats.
    far = np.float32(4194304.0)
    part, values = np.zeros(width, np.float32), np.zeros(width, np.float32)
    right, down, at = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.int32)
    for r in range(height):
        row = r + y0
        first, last = 0, width
        while first < width and weight[r, first] * clear[row, x0 + first] == zero:
            first += 1
        while last > first and weight[r, last - 1] * clear[row, x0 + last - 1] == zero:
            last -= 1
        # Start at 0: numba then omits its checks for negative indices, and the loops are vectorised.
        count, start = last - first, first + x0
        if count == 0:
            continue
        covered, free = weight[r, first:last], clear[row, start : start + count]
        for c in range(count):
            part[c] = covered[c] * free[c]
        if factor != zero:
            m = matrices[row if matrices.shape[0] > 1 else 0]
            ax, ay, ac = m[0, 0] * texels_per_m, m[0, 1] * texels_per_m, m[0, 2] * texels_per_m
            bx, by, bc = m[1, 0] * texels_per_m, m[1, 1] * texels_per_m, m[1, 2] * texels_per_m
            wx, wy, wc = m[2, 0], m[2, 1], m[2, 2]
            ray = rays[row if table_rays else 0, start : start + count]
            if not table_rays:
                y = rays[0, 0, 1] + row * rays[0, 1, 1]
                ac, bc, wc, ay, by, wy = ac + ay * y, bc + by * y, wc + wy * y, 0.0, 0.0, 0.0
            # Relative to the middle of the row, minus whole tiles, 24 bits are exact to a thousandth of a texel.
            x, y = ray[count // 2, 0], ray[count // 2, 1]
            scale = 1.0 / (size * (wx * x + wy * y + wc))
            i0, j0 = (
                size * floor((ax * x + ay * y + ac) * scale),
                size * floor((bx * x + by * y + bc) * scale),
            )
            iwx, iwy, iwc = np.float32(ax - i0 * wx), np.float32(ay - i0 * wy), np.float32(ac - i0 * wc)
            jwx, jwy, jwc = np.float32(bx - j0 * wx), np.float32(by - j0 * wy), np.float32(bc - j0 * wc)
            zx, zy, zc = np.float32(wx), np.float32(wy), np.float32(wc)
            for c in range(count):
                u, v = np.float32(ray[c, 0]), np.float32(ray[c, 1])
                z = np.float32(1.0) / (zx * u + zy * v + zc)
                right[c] = min(max((iwx * u + iwy * v + iwc) * z, -far), far)
                down[c] = min(max((jwx * u + jwy * v + jwc) * z, -far), far)
            if warp.shape[0] > 0:
                _shift(right, down, count, i0, j0, texels_per_m, warp, grid)
            for c in range(count):
                s, t = right[c], down[c]
                i, j = np.floor(s), np.floor(t)
                right[c], down[c] = s - i, t - j
                at[c] = ((np.int32(j) & mask) << bits) | (np.int32(i) & mask)
            for c in range(count):
                four = flat[np.uintp(np.uint32(at[c]))]
                upper = np.float32(np.int32(four & byte))
                lower = np.float32(np.int32((four >> np.uint32(16)) & byte))
                upper += right[c] * (np.float32(np.int32((four >> np.uint32(8)) & byte)) - upper)
                lower += right[c] * (np.float32(np.int32(four >> np.uint32(24))) - lower)
                values[c] = factor * (upper + down[c] * (lower - upper) - mean)
        line = image[row, start : start + count]
        if channels == 3:
            blue, green, red = colour[0], colour[1], colour[2]
            for c in range(count):
                line[c, 0] += part[c] * max(zero, blue + values[c])
                line[c, 1] += part[c] * max(zero, green + values[c])
                line[c, 2] += part[c] * max(zero, red + values[c])
        else:
            for c in range(count):
                line[c, 0] += part[c] * max(zero, colour[0] + values[c])


@kernel(nogil=True)
def develop(
    image: np.ndarray,
    field: np.ndarray,
    row_gain: np.ndarray,
    sigma_of_level: np.ndarray,
    seeds: np.ndarray,
    quantiles: np.ndarray,
    words: np.ndarray,
    draws: np.ndarray,
    result: np.ndarray,
) -> None:
    """Convert the exact image to grey levels: gain, noise, clipping, rounding.

    Each 64-bit number of the splitmix64 generator yields four normal random numbers.

    Parameters
    ----------
    image
        Exact image (H, W, C) float32.
    field
        Relative light (H, W) float32, or (0, 0) for none.
    row_gain
        Gain of each row (H,).
    sigma_of_level
        Noise at each grey level (256,), or (0,) for none.
    seeds
        One seed per row (H,) uint64.
    quantiles
        Quantiles of the standard normal distribution (65536,) float32.
    words, draws
        Random bits of a row, one memory as (W * C / 4, rounded up) uint64 and four times as many uint16; filled.
    result
        Grey levels (H, W, C) uint8, filled.
    """
    height, width, channels = image.shape
    count = width * channels
    shaded, noisy = field.shape[0] > 0, sigma_of_level.shape[0] > 0
    exact, levels = image.reshape(height, count), result.reshape(height, count)
    light = np.zeros(count, np.float32)
    dark, bright, half = np.float32(0.0), np.float32(255.0), np.float32(0.5)
    sigma = sigma_of_level[0] if noisy else dark
    even = noisy and sigma == sigma_of_level[255]
    for row in range(height):
        gain = np.float32(row_gain[row])
        if channels == 3:
            for c in range(width):
                light[3 * c] = light[3 * c + 1] = light[3 * c + 2] = gain * field[row, c] if shaded else gain
        else:
            for c in range(width):
                light[c] = gain * field[row, c] if shaded else gain
        if not noisy:
            for i in range(count):
                value = exact[row, i] * light[i]
                levels[row, i] = np.uint8(np.int32(min(max(value + half, dark), bright)))
            continue
        for i in range(len(words)):
            bits = seeds[row] + np.uint64(i + 1) * np.uint64(0x9E3779B97F4A7C15)
            bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            words[i] = bits ^ (bits >> np.uint64(31))
        for i in range(count):
            value = exact[row, i] * light[i]
            if not even:
                sigma = sigma_of_level[np.uintp(min(max(value, dark), bright))]
            value += sigma * quantiles[np.uintp(draws[i])]
            levels[row, i] = np.uint8(np.int32(min(max(value + half, dark), bright)))
