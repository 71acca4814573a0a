"""A map with the platform's path, and the obstacles with their haptic tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int8

from ..core.files import literal, new_figure
from ..core.objects import HapticTag
from .run_tables import tag_text
from .style import COLOURS, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class MapObject:
    """One obstacle on a map."""

    name: str
    outline_world_m: Float[np.ndarray, "n 2"]  #: outline on the floor, implicitly closed
    tag: HapticTag | None = None
    end_outline_world_m: Float[np.ndarray, "n 2"] | None = None  #: outline after the push


@styled
def floor_map(
    cells: Int8[np.ndarray, "rows columns"],
    resolution_m: float,
    origin_world_m: tuple[float, float],
    *,
    path_world_m: Float[np.ndarray, "n 2"] | None = None,
    objects: Sequence[MapObject] = (),
    robot_radius_m: float | None = None,
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
        not rotated.
    path_world_m
        Path of the platform.
    objects
        Obstacles; each is labelled with its name, and its tag if it has one, next to the drawing.
    robot_radius_m
        Radius of the platform, which is drawn at the end of its path.
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
        if robot_radius_m is not None:
            angle = np.linspace(0, 2 * np.pi, 40)
            disc = path_world_m[-1] + robot_radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
            axes.fill(*disc.T, fc=COLOURS["sky"], ec=COLOURS["blue"], alpha=0.8, label="end")
    drawn: list[np.ndarray] = []
    for obj in objects:
        outline = np.vstack([obj.outline_world_m, obj.outline_world_m[:1]])
        fixed = obj.tag is not None and obj.tag.fixed
        colour = COLOURS["ink"] if fixed else COLOURS["orange"]
        axes.fill(*outline.T, color=colour, alpha=0.35, lw=0)
        axes.plot(*outline.T, color=colour, lw=1.2)
        if obj.end_outline_world_m is not None:
            end = np.vstack([obj.end_outline_world_m, obj.end_outline_world_m[:1]])
            axes.plot(*end.T, color=colour, lw=1.2, ls="--")
        drawn.append(outline if obj.end_outline_world_m is None else np.vstack([outline, end]))
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=extent[:2], ylim=extent[2:])
    if path_world_m is not None:
        axes.legend(loc="lower right", frameon=True, facecolor="white", edgecolor="#dde2e8")
    _label(axes, objects, drawn, extent, path_world_m)
    return figure


def _label(
    axes: Axes,
    objects: Sequence[MapObject],
    drawn: Sequence[Float[np.ndarray, "n 2"]],
    extent: tuple[float, float, float, float],
    path_world_m: Float[np.ndarray, "n 2"] | None,
) -> None:
    """Label every object such that labels cover no object, no other label, and as little of the path as possible."""
    from matplotlib.text import Text

    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()  # the layout determines the size of the map
    per_px = 1.0 / float(axes.transData.get_matrix()[0, 0])  # map metres per pixel
    taken = [(*part.min(axis=0), *part.max(axis=0)) for part in drawn]
    path_m = np.zeros((0, 2)) if path_world_m is None else np.asarray(path_world_m)
    for obj, part in zip(objects, drawn, strict=True):
        middle = 0.5 * (part.min(axis=0) + part.max(axis=0))
        note = axes.annotate(
            literal(obj.name if obj.tag is None else f"{obj.name}\n{tag_text(obj.tag)}"),
            middle,
            xytext=middle,
            ha="center",
            va="center",
            fontsize=8,
            arrowprops={"arrowstyle": "-", "color": COLOURS["grey"], "lw": 0.8},
            bbox={"facecolor": "white", "edgecolor": "#dde2e8", "alpha": 0.9, "boxstyle": "round,pad=0.3"},
        )
        # The frame of a label exceeds its text by a third of the letters' height.
        size_px = np.array(Text.get_window_extent(note).size) + figure.dpi / 72 * 8 * 0.9
        half_m = 0.5 * per_px * size_px
        at = _free_place(part, half_m, taken, path_m, extent)
        taken.append((*(at - half_m), *(at + half_m)))
        note.set_position((float(at[0]), float(at[1])))


def _free_place(
    part: Float[np.ndarray, "n 2"],
    half_m: Float[np.ndarray, "2"],
    taken: Sequence[tuple[float, ...]],
    path_m: Float[np.ndarray, "k 2"],
    extent: tuple[float, float, float, float],
) -> Float[np.ndarray, "2"]:
    """Centre of a label around an object: inside the map and free first, then close, then off the path."""
    middle, reach = 0.5 * (part.min(axis=0) + part.max(axis=0)), 0.5 * np.ptp(part, axis=0) + half_m
    best, best_cost = middle, np.inf
    for ring in range(6):
        for angle in np.radians(np.arange(0, 360, 30)):
            at = middle + (reach + half_m[1] * (0.5 + ring)) * np.array([np.cos(angle), np.sin(angle)])
            low, high = at - half_m, at + half_m
            inside = (
                extent[0] <= low[0] and high[0] <= extent[1] and extent[2] <= low[1] and high[1] <= extent[3]
            )
            hits = sum(low[0] < b[2] and b[0] < high[0] and low[1] < b[3] and b[1] < high[1] for b in taken)
            covered = min(20, int(np.count_nonzero(((low < path_m) & (path_m < high)).all(axis=1))))
            cost = 10.0 * (not inside) + 10.0 * hits + 0.2 * covered + 0.3 * ring
            if cost < best_cost:
                best, best_cost = at, cost
    return best
