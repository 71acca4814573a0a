"""Meshes of the objects on the page: prisms, columns of the foam, and their colours."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core import InputError, finite_array
from ..core.geometry import polygon_area

#: Colours of the foam at rest and under full pressure (red, green, blue).
REST_RGB = np.array([226.0, 188.0, 92.0])
FULL_RGB = np.array([176.0, 12.0, 30.0])


def prism(
    outline_m: Float[np.ndarray, "n 2"], height_m: float
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """An upright prism over an outline that is star-shaped around its centre; no bottom.

    Parameters
    ----------
    outline_m
        Outline on the floor [m].
    height_m
        Height of the prism [m].

    Returns
    -------
    vertices_m
        Lower ring, upper ring, and the centre of the top.
    faces
        Indices, counter-clockwise seen from outside.
    """
    outline = finite_array("prism", outline_m, None, 2, field="outline_m", least=3)
    if polygon_area(outline) < 0:
        outline = outline[::-1]
    count = len(outline)
    lower = np.column_stack([outline, np.zeros(count)])
    upper = np.column_stack([outline, np.full(count, height_m)])
    centre = np.append(outline.mean(axis=0), height_m)
    here = np.arange(count)
    after = np.roll(here, -1)
    sides = np.concatenate(
        [np.column_stack([here, after, count + after]), np.column_stack([here, count + after, count + here])]
    )
    top = np.column_stack([count + here, count + after, np.full(count, 2 * count)])
    return np.vstack([lower, upper, centre]), np.concatenate([sides, top])


def columns(
    back_m: Float[np.ndarray, "K 2"], front_m: Float[np.ndarray, "K 2"], height_m: float
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 4"], Float[np.ndarray, "K 3"]]:
    """Foam between both contours as columns, one per point, with their tops at z = 0.

    Parameters
    ----------
    back_m
        Reference contour, one point per column, frame F [m].
    front_m
        Front contour, frame F [m].
    height_m
        Height of the foam [m].

    Returns
    -------
    positions_m
        Centre of each column's base.
    quaternions
        Rotation of each column about z (w, x, y, z): its x axis points from back to front.
    sizes_m
        Length from back to front, width along the strip, height.
    """
    if back_m.shape != front_m.shape or back_m.ndim != 2 or back_m.shape[1:] != (2,) or len(back_m) < 2:
        raise InputError(
            "columns", f"found shapes {back_m.shape} and {front_m.shape}, expected (K, 2) for both"
        )
    count = len(back_m)
    across = front_m - back_m
    half_angle = 0.5 * np.arctan2(across[:, 1], across[:, 0])
    nothing = np.zeros(count)
    middle_m = 0.5 * (back_m + front_m)
    spacing_m = np.linalg.norm(np.gradient(middle_m, axis=0), axis=1)
    positions_m = np.column_stack([middle_m, np.full(count, -height_m)])
    quaternions = np.column_stack([np.cos(half_angle), nothing, nothing, np.sin(half_angle)])
    sizes_m = np.column_stack([np.linalg.norm(across, axis=1), spacing_m, np.full(count, height_m)])
    return positions_m, quaternions, sizes_m


def pressure_colours(pressure_Pa: Float[np.ndarray, "K"], full_Pa: float) -> UInt8[np.ndarray, "K 3"]:
    """Colour of each point: pale at rest, red at ``full_Pa`` and above; grey if unknown.

    Parameters
    ----------
    pressure_Pa
        Pressure at each point, NaN if unknown [Pa].
    full_Pa
        Pressure that is drawn in full red [Pa].
    """
    fraction = np.clip(np.nan_to_num(pressure_Pa) / full_Pa, 0.0, 1.0)[:, None]
    colours = REST_RGB + fraction * (FULL_RGB - REST_RGB)
    colours[~np.isfinite(pressure_Pa)] = 150.0
    return np.round(colours).astype(np.uint8)
