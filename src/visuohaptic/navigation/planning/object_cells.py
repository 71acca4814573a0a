"""Cells covered by an object: clear and fill them in place, in grid coordinates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from ..pushing._outline_kernels import distance_patch
from .arrays import Outline

#: Distance from an object's outline within which spurious components are searched [cells].
SPURIOUS_REACH_CELLS = 1.25


def window_around(shape: tuple[int, int], outline: Outline, margin: float) -> tuple[slice, slice]:
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


def _touched(outline: Outline, cells: Int[np.ndarray, "2 *n"]) -> Bool[np.ndarray, "*n"]:
    """Whether the square of each cell (row, column) overlaps the interior of the outline."""
    import shapely

    r, c = cells
    body = shapely.Polygon(outline).buffer(-1e-6)  # exclude squares that only touch the outline
    shapely.prepare(body)
    return np.asarray(shapely.intersects(body, shapely.box(c, r, c + 1, r + 1)))


def clear_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Outline) -> None:
    """Free an object's cells in place: those it covers, and adjacent spurious components.

    Parameters
    ----------
    occupied
        Whether a cell is an obstacle; changed in place.
    outline
        Corners in grid coordinates [cells].
    """

    import cv2

    window = window_around(occupied.shape, outline, 4.0)
    part = occupied[window]
    if not part.size:
        return
    patch, row, column = distance_patch(outline, 4.0)
    away = patch[
        window[0].start - row : window[0].stop - row, window[1].start - column : window[1].stop - column
    ]
    part[away == 0.0] = False
    beside = np.argwhere(part & (away < 0.7072))  # the centre is outside, the square may overlap
    part[tuple(beside.T)] = ~_touched(outline, beside.T + np.array([[window[0].start], [window[1].start]]))
    # What remains beside it and is not part of a wall: components that lie completely within the reach.
    near = part & (away <= SPURIOUS_REACH_CELLS)
    if not near.any():
        return
    labels = cv2.connectedComponents(near.astype(np.uint8), connectivity=8)[1]
    rest = np.pad(part & ~near, 1, constant_values=True).astype(np.uint8)
    walls = cv2.dilate(rest, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    part[near & ~np.isin(labels, labels[near & walls])] = False


def fill_cells(occupied: Bool[np.ndarray, "rows columns"], outline: Outline) -> None:
    """Mark the cells that an object covers as occupied, in place.

    Parameters
    ----------
    occupied, outline
        See :func:`clear_cells`.
    """
    window = window_around(occupied.shape, outline, 0.0)
    if occupied[window].size:
        occupied[window] |= _touched(outline, np.mgrid[window])
