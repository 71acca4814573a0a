"""Simulated haptic exploration of three objects (Fig. 5.7).

Left: complete geometry; its middle is removed and estimated. Then the surface (yellow) with 0, 3 and 10
touches (red), the visible parts in grey. Right: uncertainty before the fourth touch, dark is certain,
yellow is the highest uncertainty of the object (as in the dissertation, simulation on parametric bottles).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.files import new_figure
from ...reconstruction.completion import Completion
from ...reconstruction.mesh import SurfaceMesh
from ...simulation.tabletop.bottles import Bottle, random_bottle
from .._solid import frame_3d, shaded
from ..output import Columns, Output
from ..worlds.virtual_completion import errors_m, explore, scene, true_points

SHOWN = (0, 3, 10)


def run(out: Output) -> None:
    """Explore three bottles with planned touches and draw the steps.

    Parameters
    ----------
    out
        Receives the table ``errors``, picture ``completion``, and the comparisons; its seed and size are used.
    """
    shown = SHOWN[:2] if out.quick else SHOWN
    names = "A" if out.quick else "ABC"
    columns = len(shown) + 2
    size = (2.7 * columns, 3.4 * len(names))
    figure, axes = new_figure(len(names), columns, size=size, layout="constrained", projection="3d")
    rows = Columns("object kind touches mse_mm2 largest_mm")
    better = []
    for row, name in enumerate(names):
        bottle = random_bottle(out.rng(row))
        found = _explored(out, bottle, row, shown)
        mean = [float(np.mean(errors**2)) for _, _, errors, _ in found]
        better.append(mean[-1] / mean[0])
        for count, (_, _, errors, _) in zip(shown, found, strict=True):
            rows.add(name, bottle.kind, count, 1e6 * float(np.mean(errors**2)), 1e3 * float(errors.max()))
        _draw(axes[row * columns : (row + 1) * columns], name, bottle, found, shown)
    out.table("errors", rows)
    out.picture("completion", figure, dpi=75)
    out.compare(f"error after {shown[-1]} touches by that of the untouched surface, largest of the objects",
                max(better), dissertation=0.1, note="after 10 touches, mean of the data set")  # fmt: skip


def _explored(out: Output, bottle: Bottle, row: int, shown: tuple[int, ...]) -> list[Any]:
    truth, found = true_points(bottle), list[Any]()

    def look(number: int, completion: Completion) -> None:
        if number in shown:
            surface = completion.surface()
            found.append((surface, [t.contact_m for t in completion.touches], errors_m(truth, surface),
                          completion.uncertainty()))  # fmt: skip

    explore(bottle, out.rng(row, 1), touches=shown[-1] + 1, on_plan=look)
    return found


def _draw(axes: Any, name: str, bottle: Bottle, found: list[Any], shown: tuple[int, ...]) -> None:
    whole = SurfaceMesh(*bottle.mesh(0.0, bottle.height_m))
    visible, _ = scene(bottle)
    low, high = whole.vertices_m.min(axis=0), whole.vertices_m.max(axis=0)
    shaded(axes[0], whole, "#9aa7b5")
    axes[0].set_title(f"{name}: {bottle.kind}", fontsize=9)
    for axis, (surface, contacts, errors, _), count in zip(axes[1:-1], found, shown, strict=True):
        shaded(axis, visible, "#b9c1ca")
        shaded(axis, surface, "#e9c53a")
        touched = [point for point in contacts if point is not None]
        if touched:
            axis.plot(*(1e3 * np.array(touched).T), "o", color="red", ms=3.5, zorder=10)
        rms = 1e3 * float(np.sqrt(np.mean(errors**2)))
        axis.set_title(f"{count} touches, rms {rms:.1f} mm", fontsize=9)
    before = found[min(1, len(found) - 1)][3]
    colour = before.sigma_m / max(float(before.sigma_m[before.missing].max(initial=1e-9)), 1e-9)
    shaded(axes[-1], before.mesh, colour)
    axes[-1].set_title(f"uncertainty, {shown[min(1, len(shown) - 1)]} touches", fontsize=9)
    for axis in axes:
        frame_3d(axis, low, high)
