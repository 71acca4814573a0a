"""Outlines on the floor, checked: simple polygons."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import polygon_area

__all__ = ["outline_of"]

#: Vertices of one footprint; more than this is a scan, not an outline.
MAX_VERTICES = 2000
#: Corners farther from the map's origin than this are no lengths on a floor [m].
MAX_COORDINATE_M = 1e9


def outline_of(points: object, where: str) -> Float[np.ndarray, "p 2"]:
    """A footprint that was checked: distinct corners of a simple polygon, counter-clockwise.

    Parameters
    ----------
    points
        x, y of the corners [m].
    where
        What it is of, for messages.

    Raises
    ------
    InputError
        No simple polygon with an area.
    """
    try:
        outline = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, "found something else than numbers", field="footprint_m") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or not (np.abs(outline) <= MAX_COORDINATE_M).all():
        raise InputError(
            where,
            f"found shape {outline.shape}, expected finite [x, y] corners within {MAX_COORDINATE_M:g} m",
            field="footprint_m",
        )
    distinct = np.ones(len(outline), dtype=bool)
    if len(outline):
        distinct = (outline != np.roll(outline, 1, axis=0)).any(axis=1)  # a closed outline repeats its start
    outline = outline[distinct]
    if not 3 <= len(outline) <= MAX_VERTICES:
        raise InputError(
            where, f"found {len(outline)} distinct corners, expected 3 to {MAX_VERTICES}", field="footprint_m"
        )
    area = polygon_area(outline)
    extent = float(np.ptp(outline, axis=0).max())
    if abs(area) <= 1e-9 * extent**2 or extent == 0:
        raise InputError(where, "found an outline without area, expected a polygon", field="footprint_m")
    if _crosses_itself(outline - outline[0]):
        raise InputError(
            where,
            "found an outline that crosses itself, expected a simple polygon",
            field="footprint_m",
            remedy="list the corners in order around the object",
        )
    return outline if area > 0 else outline[::-1].copy()


def _crosses_itself(p: Float[np.ndarray, "p 2"]) -> bool:
    """Whether two edges that are not neighbours cross properly."""
    n = len(p)
    if n < 4:
        return False
    a, b = p, np.roll(p, -1, axis=0)

    def side(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        return np.sign(
            (v[..., 0] - u[..., 0]) * (w[..., 1] - u[..., 1])
            - (v[..., 1] - u[..., 1]) * (w[..., 0] - u[..., 0])
        )

    one = side(a[:, None], b[:, None], a[None]) * side(a[:, None], b[:, None], b[None])
    two = one.T
    crossing = (one < 0) & (two < 0)
    return bool(crossing.any())
