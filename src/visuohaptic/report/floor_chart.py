"""A map with the platform's path, and the obstacles with their haptic tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int8

from ..core.objects import HapticTag
from .run_tables import tag_text
from .style import COLOURS, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MapObject", "floor_map"]


@dataclass(frozen=True, slots=True, eq=False)
class MapObject:
    """One obstacle on a map."""

    name: str
    outline_world_m: Float[np.ndarray, "n 2"]  #: outline on the floor, closed by itself
    tag: HapticTag | None = None
    end_outline_world_m: Float[np.ndarray, "n 2"] | None = None  #: where it stood after the push


@styled
def floor_map(
    cells: Int8[np.ndarray, "rows columns"],
    resolution_m: float,
    origin_world_m: tuple[float, float],
    *,
    path_world_m: Float[np.ndarray, "n 2"] | None = None,
    objects: Sequence[MapObject] = (),
    title: str = "",
) -> Figure:
    """A map with the platform's path and the obstacles with their tags.

    Parameters
    ----------
    cells
        -1 unknown, 0 free, 100 occupied; row 0 is at the bottom (smallest y).
    resolution_m
        Side of a cell.
    origin_world_m
        World coordinates of the lower left corner of cell (0, 0); the map is
        not turned.
    path_world_m
        Path of the platform.
    objects
        Obstacles; each is named, with its tag when it has one.
    title
        Of the axes.
    """
    rows, columns = cells.shape
    x_m, y_m = origin_world_m
    grey = np.select([cells < 0, cells >= 50], [0.88, 0.25], default=1.0)
    width_m, height_m = columns * resolution_m, rows * resolution_m
    figure, (axes,) = new_figure(1, 1, size=(8.6, float(np.clip(8.6 * height_m / width_m, 3.5, 9.0))))
    extent = (x_m, x_m + width_m, y_m, y_m + height_m)
    axes.imshow(grey, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
    axes.grid(visible=False)
    if path_world_m is not None and len(path_world_m):
        axes.plot(*np.asarray(path_world_m).T, color=COLOURS["blue"], lw=1.8, label="platform")
        axes.plot(*path_world_m[0], "o", color=COLOURS["blue"], ms=6, label="start")
    for obj in objects:
        outline = np.vstack([obj.outline_world_m, obj.outline_world_m[:1]])
        fixed = obj.tag is not None and obj.tag.fixed
        colour = COLOURS["ink"] if fixed else COLOURS["orange"]
        axes.fill(*outline.T, color=colour, alpha=0.35, lw=0)
        axes.plot(*outline.T, color=colour, lw=1.2)
        if obj.end_outline_world_m is not None:
            end = np.vstack([obj.end_outline_world_m, obj.end_outline_world_m[:1]])
            axes.plot(*end.T, color=colour, lw=1.2, ls="--")
        drawn = outline if obj.end_outline_world_m is None else np.vstack([outline, end])
        above = (0.5 * (drawn[:, 0].min() + drawn[:, 0].max()), drawn[:, 1].max())
        text = obj.name if obj.tag is None else f"{obj.name}\n{tag_text(obj.tag)}"
        axes.annotate(
            text,
            above,
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "#dde2e8", "alpha": 0.9, "boxstyle": "round,pad=0.3"},
        )
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title, xlim=extent[:2], ylim=extent[2:])
    if path_world_m is not None:
        axes.legend(loc="lower right", frameon=True, facecolor="white", edgecolor="#dde2e8")
    return figure
