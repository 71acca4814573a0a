"""Exploration of the "cien" bottle (Fig. 6.10).

(a) Stiffness features at 16 heights on four sides; (b) readings of the gripper at a point of the flat front
(y+) and one of the curved side (x+), open and closed with air inside; straight: linear model up to 3 mm,
dotted: quadratic one (simulated bottle, gripper and noise).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...deformation import linear_features, load_object
from ...report.style import COLOURS, draw_axes
from .._curves import curves_of, read_curve
from ..output import Columns, Output

PLACES = ("y+5", "x+4")


def run(out: Output) -> None:
    """Features of the nominal bottle; four curves with noise.

    Parameters
    ----------
    out
        Receives the tables ``features`` and ``curves``, picture ``exploration``, and the comparisons; its seed and size are used.
    """
    container = load_object("cien", around=32)
    values = linear_features(container).values[..., 0]
    curves = curves_of("cien", PLACES, 24 if out.quick else 32)
    read = {key: read_curve(curve, out.rng(number)) for number, (key, curve) in enumerate(curves.items())}
    out.table("features", {"height": np.arange(1, 17), **{side: values[:, k] for k, side in
                           enumerate(("x_plus_N_per_m", "x_minus_N_per_m", "y_plus_N_per_m", "y_minus_N_per_m"))}})  # fmt: skip
    rows = Columns("place state deformation_m force_N")
    for (state, place), (d, f, _) in read.items():
        for reading in zip(d, f, strict=True):
            rows.add(place, state, *reading)
    out.table("curves", rows)

    def draw(left: Any, right: Any) -> None:
        shown = left.imshow(
            np.log10(values), origin="lower", aspect="auto", cmap="viridis", extent=(-0.5, 3.5, 0.5, 16.5)
        )
        left.figure.colorbar(shown, ax=left, label="log10 of the stiffness [N/m]")
        left.set(title="a  stiffness features", ylabel="height", xlabel="side")
        left.set_xticks(range(4), ("x+", "x-", "y+", "y-"))
        left.grid(visible=False)
        colours = {
            ("open", "y+5"): "orange",
            ("closed", "y+5"): "pink",
            ("open", "x+4"): "blue",
            ("closed", "x+4"): "yellow",
        }
        for key, (d, f, fit) in read.items():
            colour = COLOURS[colours[key]]
            right.plot(1e3 * d, f, ".", ms=3, color=colour, label=f"{key[1]}, {key[0]}")
            at = np.linspace(0, float(d.max()), 50)
            if np.isfinite(fit.i_N_per_m):
                near = at[at <= 0.003]
                right.plot(1e3 * near, fit.i_N_per_m * near, "-", color=colour, lw=2, alpha=0.5)
            both = np.linalg.lstsq(np.column_stack([d, d**2]), f, rcond=None)[0]
            right.plot(1e3 * at, np.column_stack([at, at**2]) @ both, ":", color=colour, lw=1.2)
        right.set(
            title="b  readings", xlabel="deformation [mm]", ylabel="force [N]", ylim=(0, None), xlim=(0, None)
        )
        right.legend()

    out.picture("exploration", draw_axes(1, 2, draw, size=(11.0, 4.6)))
    ratio = values[3, 0] / values[4, 2]
    out.compare("stiffness of x+4 by y+5, open", ratio, note='printed: "pronounced differences of stiffness"')
    for place in PLACES:
        opened, closed = curves["open", place], curves["closed", place]
        k = min(len(opened.force_N), len(closed.force_N)) - 1
        out.compare(
            f"{place}: force closed by open, smallest deformation", closed.force_N[0] / opened.force_N[0]
        )
        out.compare(f"{place}: force closed by open, {1e3 * opened.deformation_m[k]:.1f} mm",
                    closed.force_N[k] / opened.force_N[k],
                    note='printed: "much stiffer for large deformations"' if place == "y+5" else "")  # fmt: skip
