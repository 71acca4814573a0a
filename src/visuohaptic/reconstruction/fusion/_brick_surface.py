"""Zero level set of bricks of voxels: marching cubes over all bricks in one array, then welded."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from ...core.errors import InputError
from . import _fusion_kernels as kernels

#: Distances of a cell at a surface that is seen at grazing incidence differ by up to the reach behind it, and those of their nearest
#: pixels by more: half a voxel of 6 mm is .7 pixels of 1 mm at the tangent 4.
_ROUNDED = 1.125


def cube_of_tiles(count: int) -> tuple[np.ndarray, np.ndarray, Int[np.ndarray, "3 n"]]:
    """Arrays (layers, rows, columns, x, y, z) for bricks with a common face: values, which of them are known; tile of each brick.

    The tiles form a cube rather than a row, because marching cubes returns float32 coordinates, which lose precision when they are
    large. Both arrays are views of contiguous grids (layers, x, rows, y, columns, z).

    Parameters
    ----------
    count
        Number of bricks.
    """
    side = max(1, int(np.ceil(np.cbrt(count))))
    side += side**3 < count
    layers, edge = max(1, -(-count // side**2)), kernels.BRICK + 1
    shape, order = (layers, edge, side, edge, side, edge), (0, 2, 4, 1, 3, 5)
    tile = np.array(np.unravel_index(np.arange(count), (layers, side, side)))
    return np.ones(shape, np.float32).transpose(order), np.zeros(shape, np.bool_).transpose(order), tile


def brick_surface(
    values: Float32[np.ndarray, "l r c x y z"],
    known: Bool[np.ndarray, "l r c x y z"],
    places: Int[np.ndarray, "n 3"],
    reach: float,
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Marching cubes over an array of bricks; returns vertices in voxels, welded between bricks, and triangles.

    Parameters
    ----------
    values, known
        Truncated signed distances of the tiles, 1 where they are not known; see :func:`cube_of_tiles`.
    places
        First voxel of each brick (n, 3).
    reach
        Depth behind a surface to which voxels are observed [bands].

    Raises
    ------
    InputError
        No surface is observed.
    """
    from skimage.measure import marching_cubes

    layers, side, _, edge = values.shape[:4]
    whole = layers * edge, side * edge, side * edge
    tiled, known = (part.transpose(0, 3, 1, 4, 2, 5).reshape(whole) for part in (values, known))
    # A cell is used if all its corners are known and lie in one brick. One with a corner behind the band, and another farther in
    # front than a surface at grazing incidence reaches within a cell, is where hidden space ends, not at a surface that was seen.
    cell = _over_cells(known, np.logical_and)
    if tiled.min() < -1.0:
        low, high = _over_cells(tiled, np.minimum), _over_cells(tiled, np.maximum)
        cell &= (low >= -1.0) | (high - low <= _ROUNDED * reach)
    cell[edge - 1 :: edge] = False
    cell[:, edge - 1 :: edge] = False
    cell[:, :, edge - 1 :: edge] = False
    mask = np.zeros(known.shape, dtype=np.bool_)
    mask[1:, 1:, 1:] = cell  # skimage reads the mask at the upper corner of a cell
    try:
        # Distances decrease inwards: triangles are counter-clockwise from the visible side.
        vertices, faces, _, _ = marching_cubes(tiled, 0.0, mask=mask, gradient_direction="descent")
    except (RuntimeError, ValueError) as error:
        remedy = "integrate views of the volume first"
        raise InputError("TsdfVolume", f"no surface was seen ({error})", remedy=remedy) from error
    return _welded(vertices.astype(np.float64), faces.astype(np.int64), places, edge, side)


def _over_cells(values: np.ndarray, ufunc: np.ufunc) -> np.ndarray:
    """A ufunc over the 8 corners of each cell."""
    for axis in range(3):
        along = np.moveaxis(values, axis, 0)
        values = np.moveaxis(ufunc(along[:-1], along[1:]), 0, axis)
    return values


def _welded(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    places: Int[np.ndarray, "n 3"],
    edge: int,
    side: int,
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices moved to the positions of their bricks; duplicates on an edge of the grid are merged."""
    # Cells between tiles are masked, so a vertex is never outside its own brick.
    tile = (vertices / edge).astype(np.int64)
    vertices -= tile * edge
    border = np.flatnonzero(((vertices == 0) | (vertices == edge - 1)).any(axis=1))
    vertices += places[(tile[:, 0] * side + tile[:, 1]) * side + tile[:, 2]]
    # A vertex lies on one edge of the grid, identified by its lower end and its direction.
    low = np.floor(vertices[border]).astype(np.int64)
    along = vertices[border] - low > 0
    axis = np.where(along.any(axis=1), along.argmax(axis=1), 3)
    low -= low.min(axis=0, initial=0)
    packed = ((low[:, 0] << 20 | low[:, 1]) << 20 | low[:, 2]) << 2 | axis
    _, first, where = np.unique(packed, return_index=True, return_inverse=True)
    to = np.arange(len(vertices))
    to[border] = border[first[where]]
    kept = np.flatnonzero(to == np.arange(len(vertices)))
    number = np.zeros(len(vertices), dtype=np.int64)
    number[kept] = np.arange(len(kept))
    faces = number[to][faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[kept], faces[whole]
