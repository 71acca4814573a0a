"""Cells covered by an object: clear and fill them in place, in grid coordinates."""

from __future__ import annotations

from collections.abc import Iterable

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


def clear_cells(
    occupied: Bool[np.ndarray, "rows columns"], outlines: Iterable[Outline], doors: Iterable[Outline] = ()
) -> None:
    """Free objects' cells in place: those they cover, and adjacent spurious components.

    A cell that a closed door shares with the wall beside it stays occupied, as the door closes the opening. A cell that
    another object shares with a wall stays where the wall's face continues in its line beside the object, and is freed
    otherwise: the wall that remains is too large or too small by less than a cell.

    Parameters
    ----------
    occupied
        Whether a cell is an obstacle; changed in place.
    outlines, doors
        Corners of objects and of closed doors in grid coordinates [cells].
    """
    cleared = []
    for outline, door in [*((one, False) for one in outlines), *((one, True) for one in doors)]:
        window = window_around(occupied.shape, outline, 4.0)
        cleared.append((window, _clear(occupied[window], outline, window), outline, door))
    for window, own, outline, door in cleared:
        _restore(occupied[window], own, outline - (window[1].start, window[0].start), door=door)


def _clear(
    part: Bool[np.ndarray, "r c"], outline: Outline, window: tuple[slice, slice]
) -> Bool[np.ndarray, "r c"]:
    """Free an object's cells and spurious components in a window; returns the former."""
    import cv2

    before = part.copy()
    if not part.size:
        return before
    patch, row, column = distance_patch(outline, 4.0)
    away = patch[
        window[0].start - row : window[0].stop - row, window[1].start - column : window[1].stop - column
    ]
    part[away == 0.0] = False
    beside = np.argwhere(part & (away < 0.7072))  # the centre is outside, the square may overlap
    part[tuple(beside.T)] = ~_touched(outline, beside.T + np.array([[window[0].start], [window[1].start]]))
    own = before & ~part
    # What remains beside it and is not part of a wall: components that lie completely within the reach.
    near = part & (away <= SPURIOUS_REACH_CELLS)
    if near.any():
        labels = cv2.connectedComponents(near.astype(np.uint8), connectivity=8)[1]
        rest = np.pad(part & ~near, 1, constant_values=True).astype(np.uint8)
        walls = cv2.dilate(rest, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
        part[near & ~np.isin(labels, labels[near & walls])] = False
    return own


def _restore(
    part: Bool[np.ndarray, "r c"], own: Bool[np.ndarray, "r c"], outline: Outline, *, door: bool
) -> None:
    """Occupy again, in place, the freed cells beside a wall that an object covers in part and that the wall shares."""
    import shapely

    if not (part.any() and own.any()):
        return
    shared = np.zeros_like(own)
    for turns, mirrored in np.ndindex(4, 2):  # walls on each side, faces to the left and to the right
        wall, mine, found = (np.rot90(a, turns)[:, :: 1 - 2 * mirrored] for a in (part, own, shared))
        around = np.pad(wall, ((1, 1), (0, 0)))
        beside = np.maximum.accumulate(np.where(mine, 0, np.arange(mine.shape[1])), axis=1)
        face = door | np.take_along_axis(wall & ~around[2:], beside, axis=1)
        found |= mine & around[:-2] & face
    r, c = np.nonzero(shared)
    inside = shapely.covers(shapely.Polygon(outline).buffer(1e-6), shapely.box(c, r, c + 1, r + 1))
    part[r[~inside], c[~inside]] = True


def fill_cells(occupied: Bool[np.ndarray, "rows columns"], *outlines: Outline) -> None:
    """Mark the cells that objects cover as occupied, in place.

    Parameters
    ----------
    occupied, outlines
        See :func:`clear_cells`.
    """
    for outline in outlines:
        window = window_around(occupied.shape, outline, 0.0)
        if occupied[window].size:
            occupied[window] |= _touched(outline, np.mgrid[window])
