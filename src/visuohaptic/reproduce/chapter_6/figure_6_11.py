"""Quadratic feature of closed and open bottles (Fig. 6.11).

Difference of the quadratic feature II, closed with air minus open, on y+ from 3 to 13 sixteenths of the
height; values up to 0 in red (simulation only; the dissertation also measured real bottles, with values
up to 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.objects import NOMINAL_N
from ...report.style import draw_axes
from .._curves import curves_of
from ..output import Columns, Output

NAMES = ("isana", "palmo", "cien", "smoothie")
#: Nominal deformation of II [m].
NOMINAL_m = 0.003


def run(out: Output) -> None:
    """Curves of both states at every second height.

    Parameters
    ----------
    out
        Receives the table ``quadratic``, picture ``difference``, and the comparisons; its seed and size are used.
    """
    names = NAMES[:1] if out.quick else NAMES
    heights = (5, 9) if out.quick else (3, 5, 7, 9, 11, 13)
    places = [f"y+{height}" for height in heights]
    found = np.full((len(heights), len(names)), np.nan)
    rows = Columns("object height II_open II_closed difference")
    for column, name in enumerate(names):
        curves = curves_of(name, places, 24)
        for row, place in enumerate(places):
            two = [_quadratic(curves[state, place].deformation_m, curves[state, place].force_N)
                   for state in ("open", "closed")]  # fmt: skip
            found[row, column] = two[1] - two[0]
            rows.add(name, heights[row], *two, two[1] - two[0])
    out.table("quadratic", rows)

    def draw(axes: Any) -> None:
        from matplotlib import colormaps

        colours = colormaps["viridis"].copy()
        colours.set_under("red")
        shown = axes.imshow(
            found,
            origin="lower",
            cmap=colours,
            vmin=1e-9,
            vmax=max(float(np.nanmax(found)), 1e-3),
            aspect="auto",
        )
        axes.figure.colorbar(shown, ax=axes, label="II closed - II open", extend="min")
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(heights)), heights)
        axes.set(ylabel="height on y+, of 16")
        axes.grid(visible=False)
        for (row, column), value in np.ndenumerate(found):
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=9,
                      color="white" if value < 0.6 * np.nanmax(found) else "black")  # fmt: skip

    out.picture("difference", draw_axes(1, 1, draw, size=(6.5, 4.6)))
    good = np.isfinite(found)
    out.compare("places where the difference is positive", 100 * float((found[good] > 0).mean()), "%",
                note='printed: "expected to be positive on most feature locations"')  # fmt: skip
    out.compare(
        "largest difference",
        float(np.nanmax(found)),
        note='printed of simulation: "much smaller" than measured',
    )


def _quadratic(deformation_m: np.ndarray, force_N: np.ndarray) -> float:
    """II of Sec. 6.1.6: coefficient of the square, with deformation in units of 3 mm and force in units of 50 N."""
    x, y = deformation_m / NOMINAL_m, force_N / NOMINAL_N
    near = x <= 1.6
    if near.sum() < 2:
        return float("nan")
    design = np.column_stack([x[near], x[near] ** 2])
    return float(np.linalg.lstsq(design, y[near], rcond=None)[0][1])
