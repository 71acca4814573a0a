"""3D plots of surfaces and points in a common style."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..core.files import draw_surface, frame_box

_LIGHT = np.array([0.45, -0.65, 0.6]) / np.linalg.norm([0.45, -0.65, 0.6])


def shaded(axes: Any, mesh: Any, colour: str | np.ndarray, *, alpha: float = 1.0) -> None:
    """Draw a mesh of one colour, or coloured by a value 0..1 of each vertex.

    Parameters
    ----------
    axes
        In space.
    mesh
        With ``vertices_m`` and ``faces``.
    colour
        Name, or values (vertices,).
    alpha
        Opacity.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb

    points, faces = np.asarray(mesh.vertices_m, dtype=float), np.asarray(mesh.faces)
    if not len(faces):
        return
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    light = 0.62 + 0.38 * np.clip(normal @ _LIGHT, -0.6, 1.0)
    if isinstance(colour, str):
        base = np.tile(to_rgb(colour), (len(faces), 1))
    else:
        values = np.clip(np.nan_to_num(np.asarray(colour, dtype=float)[faces].mean(axis=1)), 0, 1)
        base = colormaps["viridis"](values)[:, :3]
    rgba = np.column_stack([base * light[:, None], np.full(len(faces), alpha)])
    draw_surface(axes, 1e3 * corners, rgba)


def frame_3d(
    axes: Any,
    low_m: np.ndarray | Sequence[float],
    high_m: np.ndarray | Sequence[float],
    *,
    elev: float = 14,
    zoom: float = 1.0,
) -> None:
    """Set limits in millimetres, equal axes, no frame; a flat scene may be enlarged.

    Parameters
    ----------
    axes
        In space.
    low_m, high_m
        Opposite corners (3,) [m].
    elev
        Height of the view [deg].
    zoom
        Enlargement.
    """
    low, high = 1e3 * np.asarray(low_m, dtype=float), 1e3 * np.asarray(high_m, dtype=float)
    frame_box(axes, low, high, elevation_deg=elev, zoom=zoom)
    axes.set_axis_off()
