"""Pixels of a foam strip: illumination of surfaces, a lens, a sensor with noise.

Everything is computed in linear light and in metres of the foam's top plane: x away from the robot, y along
the strip. A pixel whose corners see the same surface under the same light is sampled once, every other pixel
at 64 Hammersley points, so that the position of an edge is accurate to about a hundredth of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

__all__ = [
    "BAND",
    "BASE",
    "BODY",
    "DISC",
    "EDGE",
    "FLOOR",
    "FOAM",
    "SKIN",
    "WEDGE",
    "Sensor",
    "hammersley",
    "point_spread",
    "render_light",
]

#: Surfaces, by which ``albedo``, ``textures`` and ``offsets`` are indexed.
BASE, FOAM, FLOOR, BODY, SKIN = range(5)
#: Shapes of a shadow, first column of its row.
EDGE, BAND, DISC, WEDGE = range(4)


def hammersley(count: int = 64) -> np.ndarray:
    """Points of the unit square that are stratified along both axes, (count, 2), mean (0, 0)."""
    bits = count.bit_length() - 1
    reverse = np.array([int(f"{i:0{bits}b}"[::-1], 2) for i in range(count)])
    return (np.column_stack([np.arange(count), reverse]) + 0.5) / count - 0.5


@numba.njit(cache=True, error_model="numpy", inline="always")
def _interpolated(table, first, step, place):
    """Linear interpolation in an even table, constant beyond its ends."""
    g = (place - first) / step
    if g <= 0.0:
        return table[0]
    i = int(g)
    if i >= len(table) - 1:
        return table[-1]
    return table[i] + (g - i) * (table[i + 1] - table[i])


@numba.njit(cache=True, error_model="numpy", inline="always")
def _surface(x, y, grid, front, body, top, ends, capsules):
    """Index of the surface visible at a point."""
    for k in range(capsules.shape[0]):
        ax, ay = capsules[k, 0], capsules[k, 1]
        dx, dy = capsules[k, 2] - ax, capsules[k, 3] - ay
        t = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-12)
        t = min(max(t, 0.0), 1.0)
        if (x - ax - t * dx) ** 2 + (y - ay - t * dy) ** 2 < capsules[k, 4] ** 2:
            return SKIN
    if x < 0.0:
        return BASE
    if x <= grid[4] and x <= _interpolated(front, grid[0], grid[1], y):
        low = _interpolated(ends[0], 0.0, grid[2], x)
        high = _interpolated(ends[1], 0.0, grid[2], x)
        if low <= y <= high:
            return FOAM
    if x < top and x >= _interpolated(body, grid[0], grid[1], y):
        return BODY
    return FLOOR


@numba.njit(cache=True, error_model="numpy", inline="always")
def _shade(x, y, on_floor, shadows):
    """Fraction of the direct light that reaches a point."""
    light = 1.0
    for k in range(shadows.shape[0]):
        px, py = x - shadows[k, 1], y - shadows[k, 2]
        if on_floor:
            px, py = px - shadows[k, 7], py - shadows[k, 8]
        ahead = px * shadows[k, 3] + py * shadows[k, 4]
        shape = shadows[k, 0]
        inside = ahead
        if shape == BAND:
            inside = shadows[k, 5] - abs(ahead)
        elif shape == DISC:
            inside = shadows[k, 5] - np.sqrt(px * px + py * py)
        elif shape == WEDGE:
            inside = min(ahead, px * shadows[k, 4] - py * shadows[k, 3])
        f = min(max(inside / max(shadows[k, 6], 1e-9) + 0.5, 0.0), 1.0)
        if shadows[k, 10] > 0.0:
            f = f * f * (3.0 - 2.0 * f)
        light *= 1.0 - shadows[k, 9] * f
    return light


@numba.njit(cache=True, error_model="numpy", inline="always")
def _texture(textures, surface, x, y, texel):
    """Relative brightness of a surface's texture, periodic, bilinear."""
    rows, columns = textures.shape[1], textures.shape[2]
    gx, gy = x / texel, y / texel
    i, j = int(np.floor(gx)), int(np.floor(gy))
    fx, fy = gx - i, gy - j
    i0, j0 = i & (rows - 1), j & (columns - 1)  # powers of two
    i1, j1 = (i + 1) & (rows - 1), (j + 1) & (columns - 1)
    low = textures[surface, i0, j0] * (1.0 - fy) + textures[surface, i0, j1] * fy
    high = textures[surface, i1, j0] * (1.0 - fy) + textures[surface, i1, j1] * fy
    return low * (1.0 - fx) + high * fx


@numba.njit(cache=True, error_model="numpy", inline="always")
def _brightness(x, y, surface, grid, front, textures, texel, offsets):
    """Texture of a surface at a place; that of the foam is compressed with it."""
    tx, ty = x, y
    if surface == FOAM:
        tx = x * grid[3] / max(_interpolated(front, grid[0], grid[1], y), 1e-6)
    return _texture(textures, surface, tx - offsets[surface, 0], ty - offsets[surface, 1], texel)


@numba.njit(cache=True, error_model="numpy")
def render_light(
    out,
    inverse,
    grid,
    front,
    body,
    top,
    ends,
    capsules,
    shadows,
    tint,
    albedo,
    textures,
    texel,
    offsets,
    points,
):
    """Paint linear light into ``out`` (rows, columns, channels).

    ``inverse`` (2, 3) maps pixels (u, v, 1) to x, y; ``grid`` is (first y, step of y, step of x, width at rest,
    highest front);
    ``front`` and ``body`` are tables over y [m], ``ends`` two tables over x [m], ``top`` is where the body ends;
    ``capsules`` (m, 5) are segments with a radius; ``shadows`` (n, 11) are shape, x, y, normal x, normal y,
    half width, penumbra, floor shift x, floor shift y, darkness, smooth; light is raised to ``tint`` per channel.
    """
    rows, columns, channels = out.shape
    seen = np.empty((2, columns + 1), np.int8)
    lit = np.empty((2, columns + 1), np.float64)
    bright = np.empty(5, np.float64)
    for v in range(rows + 1):
        now = v % 2
        for u in range(columns + 1):
            pu, pv = u - 0.5, v - 0.5
            x = inverse[0, 0] * pu + inverse[0, 1] * pv + inverse[0, 2]
            y = inverse[1, 0] * pu + inverse[1, 1] * pv + inverse[1, 2]
            seen[now, u] = _surface(x, y, grid, front, body, top, ends, capsules)
            lit[now, u] = _shade(x, y, seen[now, u] == FLOOR, shadows)
        if v == 0:
            continue
        for u in range(columns):
            c = seen[0, u]
            same = c == seen[1, u] and c == seen[0, u + 1] and c == seen[1, u + 1]
            low = min(min(lit[0, u], lit[1, u]), min(lit[0, u + 1], lit[1, u + 1]))
            high = max(max(lit[0, u], lit[1, u]), max(lit[0, u + 1], lit[1, u + 1]))
            same = same and high - low < 0.1
            count = 1 if same else len(points)
            for ch in range(channels):
                out[v - 1, u, ch] = 0.0
            bright[:] = -1.0
            for k in range(count):
                pu, pv = float(u), float(v - 1)
                if not same:
                    pu, pv = pu + points[k, 0], pv + points[k, 1]
                x = inverse[0, 0] * pu + inverse[0, 1] * pv + inverse[0, 2]
                y = inverse[1, 0] * pu + inverse[1, 1] * pv + inverse[1, 2]
                light = 0.25 * (lit[0, u] + lit[1, u] + lit[0, u + 1] + lit[1, u + 1])
                if not same:
                    c = _surface(x, y, grid, front, body, top, ends, capsules)
                    light = _shade(x, y, c == FLOOR, shadows)
                if bright[c] < 0.0:  # textures are smooth: once for each surface of a pixel
                    bright[c] = _brightness(x, y, c, grid, front, textures, texel, offsets) / count
                for ch in range(channels):
                    part = light if channels == 1 or light == 1.0 else light ** tint[ch]
                    out[v - 1, u, ch] += np.float32(albedo[c, ch] * part * bright[c])


def point_spread(
    lens_px: float,
    *,
    defocus_px: float = 0.0,
    disc: bool = False,
    motion_px: float = 0.0,
    angle_rad: float = 0.0,
) -> np.ndarray:
    """Point spread of lens, defocus (disc of radius or Gaussian of sigma ``defocus_px``) and motion (box)."""
    fine = 5
    sigma = np.hypot(lens_px, 0.0 if disc else defocus_px)
    half = int(np.ceil(3.5 * sigma + (defocus_px if disc else 0.0) + 0.5 * motion_px)) + 1
    size = (2 * half + 1) * fine
    axis = (np.arange(size) - (size - 1) / 2) / fine
    u, v = np.meshgrid(axis, axis)
    spread = np.exp(-0.5 * (u**2 + v**2) / max(sigma, 0.15) ** 2)
    if disc and defocus_px > 0:
        spread = _convolved(spread, ((u**2 + v**2) <= defocus_px**2).astype(float))
    if motion_px > 0:
        along, across = (
            u * np.cos(angle_rad) + v * np.sin(angle_rad),
            v * np.cos(angle_rad) - u * np.sin(angle_rad),
        )
        line = np.clip((0.5 * motion_px - np.abs(along)) * fine + 0.5, 0, 1) * np.clip(
            1 - np.abs(across) * fine, 0, 1
        )
        spread = _convolved(spread, line)
    kernel = spread.reshape(2 * half + 1, fine, 2 * half + 1, fine).sum(axis=(1, 3))
    return (kernel / kernel.sum()).astype(np.float32)


def _convolved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return cv2.filter2D(a, -1, b / b.sum(), borderType=cv2.BORDER_CONSTANT)


@dataclass(slots=True)
class Sensor:
    """Conversion of light behind the lens into grey levels of a webcam."""

    gamma: float  #: grey = 255 * light ** (1 / gamma)
    read_noise: float  #: standard deviation at black [grey levels]
    shot_noise: float  #: variance per grey level [grey levels]
    sharpen: float = 0.0  #: amount of the unsharp mask
    jpeg: int = 0  #: quality, 0 for none

    def image(self, light: np.ndarray, spread: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Grey levels (rows, columns) or BGR (rows, columns, 3), uint8, of linear light (1 is white)."""
        seen = cv2.filter2D(light, -1, spread, borderType=cv2.BORDER_REPLICATE)
        grey = np.clip(seen, 1e-6, 1.0)
        if self.gamma != 1.0:
            grey = cv2.pow(grey, 1.0 / self.gamma)
        grey = 255.0 * grey
        if self.sharpen > 0:
            grey = grey + self.sharpen * (grey - cv2.GaussianBlur(grey, (0, 0), 1.2))
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        grey = grey + noise * np.sqrt(self.read_noise**2 + self.shot_noise * np.maximum(grey, 0.0))
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        if image.ndim == 3 and image.shape[2] == 1:
            image = image[:, :, 0]
        if self.jpeg:
            _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg])
            image = cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)
        return image
