"""Validated outlines on the floor: simple polygons."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import polygon_area

#: Maximum number of vertices of one footprint; more indicate a scan, not an outline.
MAX_VERTICES = 2000
#: Maximum distance of corners from the map's origin [m]; larger values are not plausible.
MAX_COORDINATE_M = 1e9


def outline_of(points: object, where: str, field: str = "footprint_m") -> Float[np.ndarray, "p 2"]:
    """A validated footprint: distinct corners of a simple polygon, counter-clockwise.

    Parameters
    ----------
    points
        x, y of the corners [m].
    where
        Name of the object, for messages.
    field
        Name of the outline inside ``where``, for messages.

    Raises
    ------
    InputError
        The corners do not form a simple polygon with an area.
    """
    import shapely

    try:
        outline = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, "found values that are not numbers", field=field) from error
    if outline.ndim != 2 or outline.shape[1] != 2 or not (np.abs(outline) <= MAX_COORDINATE_M).all():
        raise InputError(
            where,
            f"found shape {outline.shape}, expected finite [x, y] corners within {MAX_COORDINATE_M:g} m",
            field=field,
        )
    distinct = np.ones(len(outline), dtype=bool)
    if len(outline):
        distinct = (outline != np.roll(outline, 1, axis=0)).any(axis=1)  # a closed outline repeats its start
    outline = outline[distinct]
    if not 3 <= len(outline) <= MAX_VERTICES:
        raise InputError(
            where, f"found {len(outline)} distinct corners, expected 3 to {MAX_VERTICES}", field=field
        )
    area = polygon_area(outline)
    extent = float(np.ptp(outline, axis=0).max())
    if abs(area) <= 1e-9 * extent**2 or extent == 0:
        raise InputError(where, "found an outline without area, expected a polygon", field=field)
    if not shapely.Polygon(outline).is_valid:
        said = "found an outline that crosses itself, expected a simple polygon"
        raise InputError(where, said, field=field, remedy="list the corners in order around the object")
    return outline if area > 0 else outline[::-1].copy()
