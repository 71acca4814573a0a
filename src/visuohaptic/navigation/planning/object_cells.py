"""Cells covered by an object: clear and fill them in place, in grid coordinates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ._joint_kernels import free_object


def window_around(
    shape: tuple[int, int], outline: Float[np.ndarray, "p 2"], margin: float
) -> tuple[slice, slice]:
    """Rows and columns of the map within a margin around an outline.

    Parameters
    ----------
    shape
        Rows and columns of the map.
    outline
        Corners in grid coordinates [cells].
    margin
        Distance from the bounding box [cells].
    """
    first = np.clip(np.floor(outline.min(axis=0) - margin).astype(int)[::-1], 0, shape).tolist()
    last = np.clip(np.ceil(outline.max(axis=0) + margin).astype(int)[::-1] + 1, 0, shape).tolist()
    return slice(first[0], last[0]), slice(first[1], last[1])


def _touched(outline: Float[np.ndarray, "p 2"], window: tuple[slice, slice]) -> Bool[np.ndarray, "r c"]:
    """Cells of a window whose square overlaps the interior of the outline."""
    import shapely

    r, c = np.mgrid[window]
    body = shapely.Polygon(outline).buffer(-1e-6)  # exclude squares that only touch the outline
    shapely.prepare(body)
    return np.asarray(shapely.intersects(body, shapely.box(c, r, c + 1, r + 1)))


def clear_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Float[np.ndarray, "p 2"]) -> None:
    """Free an object's cells in place: those it covers, and adjacent spurious components.

    Parameters
    ----------
    occupied
        Whether a cell is an obstacle; changed in place.
    outline
        Corners in grid coordinates [cells].
    """

    window = window_around(occupied.shape, outline, 4.0)
    part = np.ascontiguousarray(occupied[window])
    if part.size:
        free_object(part, outline, window[0].start, window[1].start)
        occupied[window] = part


def fill_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Float[np.ndarray, "p 2"]) -> None:
    """Mark the cells that an object covers as occupied, in place.

    Parameters
    ----------
    occupied, outline
        See :func:`clear_cells`.
    """
    window = window_around(occupied.shape, outline, 0.0)
    if occupied[window].size:
        occupied[window] |= _touched(outline, window)
