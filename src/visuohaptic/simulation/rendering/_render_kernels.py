"""Inner loops of the renderer: textured planes, sensor noise."""

from __future__ import annotations

from math import floor

import numpy as np

from ...core.kernels import kernel


@kernel(nogil=True)
def hide(clear: np.ndarray, fraction: np.ndarray, spans: np.ndarray, x0: int, y0: int) -> None:
    """Take what a layer covers from what nearer layers left.

    Parameters
    ----------
    clear
        Fraction (H, W) float32 of each pixel that no nearer layer covers, changed.
    fraction, spans
        Coverage of the layer (h, w) float32, and the columns of each row that are not zero (h, 2).
    x0, y0
        Its first pixel.
    """
    one = np.float32(1.0)
    for r in range(len(fraction)):
        low, high = spans[r, 0], max(spans[r, 0], spans[r, 1])
        covered, free = fraction[r, low:high], clear[y0 + r, x0 + low : x0 + high]
        for c in range(len(covered)):
            free[c] *= one - covered[c]


@kernel(nogil=True, error_model="numpy")
def _shift(
    a: np.ndarray,
    b: np.ndarray,
    a0: float,
    b0: float,
    per_m: float,
    warp: np.ndarray,
    grid: np.ndarray,
) -> None:
    """Shift texture coordinates (a, b) [texels], relative to (a0, b0), by a table that is interpolated linearly."""
    rows, columns = warp.shape[0], warp.shape[1]
    cells, scale = 1.0 / (per_m * grid[2]), np.float32(per_m)
    step, right, down = np.float32(cells), np.float32(rows - 1.001), np.float32(columns - 1.001)
    x0, y0 = np.float32(a0 * cells - grid[0] / grid[2]), np.float32(b0 * cells - grid[1] / grid[2])
    zero = np.float32(0.0)
    for c in range(len(a)):
        x, y = min(max(a[c] * step + x0, zero), right), min(max(b[c] * step + y0, zero), down)
        i, j = np.uintp(np.int32(x)), np.uintp(np.int32(y))
        u, v = x - np.float32(np.int32(x)), y - np.float32(np.int32(y))
        near, far = warp[i, j, 0], warp[i, j + np.uintp(1), 0]
        near += u * (warp[i + np.uintp(1), j, 0] - near)
        far += u * (warp[i + np.uintp(1), j + np.uintp(1), 0] - far)
        a[c] += scale * (near + v * (far - near))
        near, far = warp[i, j, 1], warp[i, j + np.uintp(1), 1]
        near += u * (warp[i + np.uintp(1), j, 1] - near)
        far += u * (warp[i + np.uintp(1), j + np.uintp(1), 1] - far)
        b[c] += scale * (near + v * (far - near))


@kernel(nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})
def add_plane(
    image: np.ndarray,
    clear: np.ndarray,
    weight: np.ndarray,
    spans: np.ndarray,
    x0: int,
    y0: int,
    rays_x: np.ndarray,
    rays_y: np.ndarray,
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
    spans
        Columns of each row of the window whose weight is not zero (h, 2) int32.
    x0, y0
        First pixel of the window.
    rays_x, rays_y
        Normalised viewing rays, each (H, W) float32; or (1, W) and (H, 1), when x depends on the column alone, y on the row.
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
    size = tile.shape[0]
    flat = tile.ravel()
    mask, bits = np.int32(size - 1), np.int32(0)
    byte, one, two, three = np.int32(255), np.int32(8), np.int32(16), np.int32(24)
    while (1 << bits) < size:
        bits += np.int32(1)
    upright = rays_y.shape[1] == 1
    factor, mean, zero = np.float32(amplitude / 42.0), np.float32(128.0), np.float32(0.0)
    # Texture coordinates stay small enough for the conversion to integers: the tile repeats.
    far = np.float32(4194304.0)
    parts, texture = np.zeros(width, np.float32), np.zeros(width, np.float32)
    across, along, texel = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.int32)
    for r in range(height):
        row = r + y0
        low, high = spans[r, 0], max(spans[r, 0], spans[r, 1])
        covered, free, start, end = (
            weight[r, low:high],
            clear[row, x0 + low : x0 + high],
            x0 + low,
            high - low,
        )
        # Slices start at 0: numba then omits its checks for negative indices, and the loops are vectorised.
        for c in range(end):
            parts[c] = covered[c] * free[c]
        last = 0
        while True:
            first = last
            while first < end and parts[first] == zero:
                first += 1
            if first == end:
                break
            last = first + 1
            while last < end and parts[last] != zero:
                last += 1
            part, values = parts[first:last], texture[first:last]
            if factor != zero:
                m = matrices[row if matrices.shape[0] > 1 else 0]
                ax, ay, ac = m[0, 0] * texels_per_m, m[0, 1] * texels_per_m, m[0, 2] * texels_per_m
                bx, by, bc = m[1, 0] * texels_per_m, m[1, 1] * texels_per_m, m[1, 2] * texels_per_m
                wx, wy, wc = m[2, 0], m[2, 1], m[2, 2]
                us = rays_x[0 if upright else row, start + first : start + last]
                vs = us if upright else rays_y[row, start + first : start + last]
                if upright:
                    y = rays_y[row, 0]
                    ac, bc, wc, ay, by, wy = ac + ay * y, bc + by * y, wc + wy * y, 0.0, 0.0, 0.0
                right, down, at = across[first:last], along[first:last], texel[first:last]
                # Relative to the middle of the run, minus whole tiles, 24 bits are exact to a thousandth of a texel.
                x, y = us[len(part) // 2], vs[len(part) // 2]
                scale = 1.0 / (size * (wx * x + wy * y + wc))
                i0, j0 = (
                    size * floor((ax * x + ay * y + ac) * scale),
                    size * floor((bx * x + by * y + bc) * scale),
                )
                iwx, iwy, iwc = np.float32(ax - i0 * wx), np.float32(ay - i0 * wy), np.float32(ac - i0 * wc)
                jwx, jwy, jwc = np.float32(bx - j0 * wx), np.float32(by - j0 * wy), np.float32(bc - j0 * wc)
                zx, zy, zc = np.float32(wx), np.float32(wy), np.float32(wc)
                for c in range(len(part)):
                    u, v = us[c], vs[c]
                    z = np.float32(1.0) / (zx * u + zy * v + zc)
                    right[c] = min(max((iwx * u + iwy * v + iwc) * z, -far), far)
                    down[c] = min(max((jwx * u + jwy * v + jwc) * z, -far), far)
                if warp.shape[0] > 0:
                    _shift(right, down, i0, j0, texels_per_m, warp, grid)
                for c in range(len(part)):
                    s, t = right[c], down[c]
                    i, j = np.floor(s), np.floor(t)
                    right[c], down[c] = s - i, t - j
                    at[c] = ((np.int32(j) & mask) << bits) | (np.int32(i) & mask)
                # In two loops, since the look-up in the first one cannot be vectorised.
                for c in range(len(part)):
                    at[c] = flat[np.uintp(np.uint32(at[c]))]
                for c in range(len(part)):
                    upper, lower = np.float32(at[c] & byte), np.float32((at[c] >> two) & byte)
                    upper += right[c] * (np.float32((at[c] >> one) & byte) - upper)
                    lower += right[c] * (np.float32((at[c] >> three) & byte) - lower)
                    values[c] = factor * (upper + down[c] * (lower - upper) - mean)
            line = image[row, start + first : start + last]
            if image.shape[2] == 3:
                blue, green, red = colour[0], colour[1], colour[2]
                for c in range(len(part)):
                    line[c, 0] += part[c] * max(zero, blue + values[c])
                    line[c, 1] += part[c] * max(zero, green + values[c])
                    line[c, 2] += part[c] * max(zero, red + values[c])
            else:
                for c in range(len(part)):
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
    light, noise = np.zeros(count, np.float32), np.zeros(count, np.float32)
    dark, bright, half = np.float32(0.0), np.float32(255.0), np.float32(0.5)
    even = noisy and sigma_of_level[0] == sigma_of_level[255]
    for row in range(height):
        gain, bare, level = np.float32(row_gain[row]), exact[row], levels[row]
        if channels == 3:
            for c in range(width):
                light[3 * c] = light[3 * c + 1] = light[3 * c + 2] = gain * field[row, c] if shaded else gain
        else:
            for c in range(width):
                light[c] = gain * field[row, c] if shaded else gain
        if noisy:
            for i in range(len(words)):
                bits = seeds[row] + np.uint64(i + 1) * np.uint64(0x9E3779B97F4A7C15)
                bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                words[i] = bits ^ (bits >> np.uint64(31))
            # Apart from the loop of the levels, which is vectorised.
            sigma = sigma_of_level[0]
            for i in range(count):
                if not even:
                    sigma = sigma_of_level[np.uintp(min(max(bare[i] * light[i], dark), bright))]
                noise[i] = sigma * quantiles[np.uintp(draws[i])]
        for i in range(count):
            level[i] = np.uint8(np.int32(min(max(bare[i] * light[i] + noise[i] + half, dark), bright)))
