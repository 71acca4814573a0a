"""Procedural surfaces: seamless tiles, each determined by its name and seed, and their shift on foam that is compressed.

Every tile is uint8 with mean 128 and standard deviation 42, so that an amplitude in
grey levels is the standard deviation of its contribution to a surface.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt32

from ...core import InputError, check_choice

TILE_MEAN = 128.0
TILE_SIGMA = 42.0
#: Edge length of a tile.
TILE_TEXELS = 1024

#: Names of the materials and the size of their tile [m].
MATERIALS: dict[str, float] = {
    "plain": 0.2,
    "concrete": 0.3,
    "wood": 0.4,
    "planks": 0.48,
    "cardboard": 0.2,
    "foam": 0.08,
    "metal": 0.15,
    "carpet": 0.2,
}

#: Width of a strip at which its texture has its nominal size, and spacing of the table [m].
FOAM_WIDTH_M, FOAM_STEP_M = 0.02, 1e-3
#: Columns whose directions differ by less are parallel.
_PARALLEL = 1e-6
#: Compression below which the texture is not moved: a hundredth of a micrometre.
_AT_REST = 5e-7


def fractal_noise(
    rng: np.random.Generator,
    size: int,
    slope: float,
    stretch: float = 1.0,
    shortest_texels: float = 2.5,
    longest_texels: float = 1e9,
) -> Float[np.ndarray, "size size"]:
    """Periodic noise with spectrum 1 / f^slope, zero mean and unit variance.

    Parameters
    ----------
    rng
        Random numbers.
    size
        Texels along each side.
    slope
        Exponent of the amplitude; 0 is white, 1 is cloudy.
    stretch
        The grain is this many times longer along the columns' axis (x).
    shortest_texels, longest_texels
        Wavelengths outside of these are damped; two texels is the limit of sampling.
    """
    fy = np.fft.fftfreq(size)[:, None]
    fx = np.fft.rfftfreq(size)[None, :] * stretch
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = 1.0
    gain = frequency**-slope * np.exp(-((frequency * shortest_texels / 1.5) ** 2))
    gain *= frequency > 1.0 / longest_texels
    gain[0, 0] = 0.0
    white = np.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    noise = np.fft.irfft2(white * gain, s=(size, size))
    return noise / noise.std()


def _concrete(rng: np.random.Generator, size: int) -> np.ndarray:
    clouds = fractal_noise(rng, size, 1.4)
    sand = fractal_noise(rng, size, 0.2, longest_texels=16)
    pores = fractal_noise(rng, size, 0.5, longest_texels=40)
    return clouds + 0.8 * sand - 2.5 * np.clip(pores - 2.1, 0, 1)


def _wood(rng: np.random.Generator, size: int) -> np.ndarray:
    _, y = np.mgrid[:size, :size] / size
    y = y.T
    warp = fractal_noise(rng, size, 2.0, stretch=5.0)
    rings = np.sin(2 * np.pi * (7 * y + 0.55 * warp))
    fibres = fractal_noise(rng, size, 0.6, stretch=24.0)
    return 0.7 * np.sign(rings) * np.abs(rings) ** 1.5 + 0.7 * fibres + 0.3 * warp


def _planks(rng: np.random.Generator, size: int) -> np.ndarray:
    rows = 4
    height = size // rows
    grain = _wood(rng, size)
    result = np.zeros((size, size))
    for i in range(rows):
        band = np.roll(grain, int(rng.integers(size)), axis=1)[i * height : (i + 1) * height]
        cut = int(rng.integers(size))
        tone = np.where((np.arange(size) - cut) % size < size // 2, *rng.normal(0, 0.7, 2))
        plank = 0.7 * band + tone
        # Joints: a dark gap of about a millimetre on two sides of each plank.
        gap = max(2, size // 360)
        plank[:gap] = -4.0
        for joint in (cut, cut + size // 2):
            plank[:, (joint + np.arange(gap)) % size] = -4.0
        result[i * height : (i + 1) * height] = plank
    return result


def _cardboard(rng: np.random.Generator, size: int) -> np.ndarray:
    x = np.arange(size)[None, :] / size
    flutes = np.sin(2 * np.pi * 32 * x + 0.4 * fractal_noise(rng, size, 1.5))
    fibres = fractal_noise(rng, size, 0.5, stretch=3.0)
    return 0.5 * flutes + 0.8 * fibres + 0.5 * fractal_noise(rng, size, 1.6)


def _foam(rng: np.random.Generator, size: int) -> np.ndarray:
    pores = fractal_noise(rng, size, 0.1, shortest_texels=10, longest_texels=60)
    return 0.5 * fractal_noise(rng, size, 1.0) - 2.0 * np.clip(pores - 1.0, 0, 1.5)


def _metal(rng: np.random.Generator, size: int) -> np.ndarray:
    return fractal_noise(rng, size, 0.5, stretch=30.0) + 0.5 * fractal_noise(rng, size, 1.8)


def _carpet(rng: np.random.Generator, size: int) -> np.ndarray:
    loops = fractal_noise(rng, size, 0.0, shortest_texels=7, longest_texels=24)
    return loops + 0.5 * fractal_noise(rng, size, 1.5)


def _plain(rng: np.random.Generator, size: int) -> np.ndarray:
    return fractal_noise(rng, size, 1.0)


_MAKERS = {
    "plain": _plain,
    "concrete": _concrete,
    "wood": _wood,
    "planks": _planks,
    "cardboard": _cardboard,
    "foam": _foam,
    "metal": _metal,
    "carpet": _carpet,
}


@lru_cache(maxsize=32)
def texture_tile(material: str, seed: int = 0, size: int = TILE_TEXELS) -> UInt8[np.ndarray, "size size"]:
    """Tile of a material; the same name, seed and size give the same image.

    Parameters
    ----------
    material
        One of :data:`MATERIALS`.
    seed
        Selects the sample of the material.
    size
        Edge length [texels], a power of two.

    Raises
    ------
    InputError
        Unknown material, or a size that is not a power of two.
    """
    check_choice("texture_tile", _MAKERS, material, field="material")
    if size < 16 or size & (size - 1):
        raise InputError("texture_tile", f"found {size}, expected a power of two >= 16", field="size")
    rng = np.random.default_rng([sum(material.encode()), seed])
    values = _MAKERS[material](rng, size)
    values = (values - values.mean()) / values.std()
    tile = np.clip(np.rint(TILE_MEAN + TILE_SIGMA * values), 0, 255).astype(np.uint8)
    tile.flags.writeable = False  # shared by all callers through the cache
    return tile


@lru_cache(maxsize=32)
def blurred_texels(material: str, seed: int, sigma_texels: float) -> UInt32[np.ndarray, "size size"]:
    """A blurred texture, each texel in one word with its neighbours to the right, below and below to the right.

    Parameters
    ----------
    material, seed
        As of :func:`texture_tile`.
    sigma_texels
        Standard deviation of the blur [texels].
    """
    import cv2

    tile = texture_tile(material, seed, TILE_TEXELS)
    pad = min(int(4 * sigma_texels) + 1, TILE_TEXELS)
    wrapped = np.pad(tile, pad, mode="wrap")
    texels = cv2.GaussianBlur(wrapped, (0, 0), sigma_texels)[pad:-pad, pad:-pad].astype(np.uint32)
    for axis, shift in ((1, 8), (0, 16)):
        texels |= np.roll(texels, -1, axis) << np.uint32(shift)
    return texels


def compression(
    back_m: Float[np.ndarray, "n 2"], front_m: Float[np.ndarray, "n 2"]
) -> tuple[Float32[np.ndarray, "A B 2"], Float[np.ndarray, "3"]]:
    """Shift from a place of the sensor plane to the place of the same material in a strip of nominal width.

    Each column is compressed evenly from its back to its front. Columns are parallel, or on lines that meet in one point.

    Parameters
    ----------
    back_m, front_m
        Ends (x, y) of each column, in order along the strip [m].

    Returns
    -------
    tuple
        Shift along a = y and b = x at the points of an even grid [m], and the first point (a, b) and the spacing of the grid [m];
        no points for a strip of nominal width at rest.
    """
    width = np.linalg.norm(front_m - back_m, axis=1)
    normal, stretch = (front_m - back_m) / width[:, None], FOAM_WIDTH_M / width - 1.0
    if np.abs(stretch).max() < _AT_REST:
        return np.zeros((0, 0, 2), np.float32), np.ones(3)
    corners = np.concatenate([back_m, front_m])
    low, high = corners.min(axis=0) - FOAM_STEP_M, corners.max(axis=0) + 2 * FOAM_STEP_M
    x, y = np.arange(low[0], high[0], FOAM_STEP_M), np.arange(low[1], high[1], FOAM_STEP_M)
    points = np.stack(np.broadcast_arrays(x[None], y[:, None]), axis=2)
    along = np.array([-normal[0, 1], normal[0, 0]])
    turned = float(normal[-1] @ along)
    if abs(turned) < _PARALLEL:
        place, column, height = (
            (points - back_m[0]) @ along,
            (back_m - back_m[0]) @ along,
            (points - back_m[0]) @ normal[0],
        )
    else:
        chord = back_m[-1] - back_m[0]
        radius = (chord[0] * normal[-1, 1] - chord[1] * normal[-1, 0]) / turned
        centre, ahead = back_m[0] + radius * normal[0], normal[len(normal) // 2]
        side = np.array([-ahead[1], ahead[0]])
        away, rays = -np.sign(radius) * (points - centre), -np.sign(radius) * (back_m - centre)
        place, column = (np.arctan2(p @ side, p @ ahead) for p in (away, rays))
        height = np.hypot(away[..., 0], away[..., 1]) * -np.sign(radius) + radius
    order = np.argsort(column)
    column, normal = column[order], normal[order]
    part = np.maximum(height, 0.0) * np.interp(place, column, stretch[order])
    shift = np.stack([part * np.interp(place, column, normal[:, axis]) for axis in (1, 0)], axis=2)
    return shift.astype(np.float32), np.array([low[1], low[0], FOAM_STEP_M])
