"""A map as an image on the floor of a page."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int8


def draw_map(
    scene: Any,
    cells: Int8[np.ndarray, "rows columns"],
    resolution_m: float,
    origin_world_m: tuple[float, float, float] | tuple[float, float],
) -> tuple[Any, tuple[float, float, float], float]:
    """Draw a map on the floor: -1 unknown, 0 free, 100 occupied; row 0 at the smallest y.

    ``origin_world_m`` is the position of its lower left corner, with optional yaw [rad].

    Parameters
    ----------
    scene
        Scene of a viser server.
    cells
        -1 unknown, 0 free, 100 occupied.
    resolution_m
        Edge of a cell [m].
    origin_world_m
        Lower left corner (x, y) [m], and optional yaw [rad].

    Returns
    -------
    handle, centre_m, reach_m
        Handle of the scene node; centre of the map; length of its longer side.
    """
    rows, columns = cells.shape
    grey = np.select([cells < 0, cells >= 50], [205, 70], default=250).astype(np.uint8)
    picture = np.repeat(grey[::-1, :, None], 3, axis=2)
    width_m, height_m = columns * resolution_m, rows * resolution_m
    x, y, yaw = (*origin_world_m, 0.0)[:3]
    c, s = np.cos(yaw), np.sin(yaw)
    half = 0.5 * np.array([width_m, height_m])
    centre_m = (float(x + c * half[0] - s * half[1]), float(y + s * half[0] + c * half[1]), 0.0)
    # The first row of an image is at its bottom in viser's axes: rotate it about x.
    handle = scene.add_image(
        "/map",
        picture,
        width_m,
        height_m,
        format="png",
        position=centre_m,
        wxyz=(0.0, float(np.cos(0.5 * yaw)), float(np.sin(0.5 * yaw)), 0.0),
    )
    return handle, centre_m, max(width_m, height_m)
