"""Simulated deformation shapes of two models (Fig. 6.2).

A cup without (a) and with a reinforced rim (b) under the same pinch near the top, colour: displacement of the
wall; (c) local stiffness of (b), dark soft, bright stiff (simulated, as in the dissertation).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.files import draw_surface, new_figure
from ...deformation import PinchPlane, load_object, object_map, side_vertex
from ...deformation.maps.map_file import colours
from ...grasping.confirm import confirm_grasp
from ...reconstruction.mesh import SurfaceMesh
from .._solid import frame_3d, shaded
from ..output import Columns, Output

FORCE_N, HEIGHT = 3.0, 0.9


def run(out: Output) -> None:
    """Pinch both cups, compute the stiffness map of one.

    Parameters
    ----------
    out
        Receives the tables ``pinch`` and ``map``, picture ``deformation``, and the comparisons; its seed and size are used.
    """
    from matplotlib.colors import LogNorm, Normalize

    figure, axes = new_figure(1, 3, size=(11.0, 4.4), layout="constrained", projection="3d")
    rows = Columns("model deformation_mm stiffness_N_per_m")
    moved = {}
    for axis, name, letter in zip(axes[:2], ("cup", "cup-rim"), "ab", strict=True):
        container = load_object(name, around=24 if out.quick else 40)
        vertex = side_vertex(container, "x+", HEIGHT * container.height_m)
        confirmation = confirm_grasp(container, vertex, FORCE_N, max_deformation_m=0.02)
        points = container.mesh.vertices_m
        moved[name] = float(np.linalg.norm(confirmation.shape_m[vertex] - points[vertex]))
        stiffness = 1.0 / float(PinchPlane(container).linear(vertex).mean())
        rows.add(name, 1e3 * moved[name], stiffness)
        amount = np.linalg.norm(confirmation.shape_m - points, axis=1)
        surface = SurfaceMesh(confirmation.shape_m, container.surface_faces)
        shaded(axis, surface, amount / max(float(amount.max()), 1e-9))
        low, high = points.min(axis=0), points.max(axis=0)
        frame_3d(axis, low, high, elev=20, zoom=1.05)
        axis.set_title(f"{letter}  {name}: {1e3 * moved[name]:.1f} mm at {FORCE_N:g} N", fontsize=10)
        _scale(figure, axis, "viridis", Normalize(0.0, 1e3 * float(amount.max())), "moved by [mm]")
    found = object_map(container, band=False)
    shade = colours(found.stiffness_N_per_m)[found.faces].mean(axis=1) / 255
    corners = 1e3 * found.vertices_m[found.faces]
    draw_surface(axes[2], corners, shade)
    frame_3d(axes[2], low, high, elev=20, zoom=1.05)
    axes[2].set_title("c  local stiffness of b", fontsize=10)
    used = np.isfinite(found.stiffness_N_per_m)
    # The scale of `colours`: logarithmic, from the 2nd to the 98th percentile.
    ends = np.exp(np.percentile(np.log(found.stiffness_N_per_m[used]), (2, 98)))
    _scale(figure, axes[2], "viridis", LogNorm(*ends), "stiffness [N/m]")
    out.picture("deformation", figure, dpi=90)
    out.table("pinch", rows)
    out.table("map", {"x_m": found.vertices_m[used, 0], "y_m": found.vertices_m[used, 1],
                      "z_m": found.vertices_m[used, 2], "stiffness_N_per_m": found.stiffness_N_per_m[used]})  # fmt: skip
    stiff = [float(value) for value in rows["stiffness_N_per_m"]]
    out.compare("stiffness near the top, with rim by without", stiff[1] / stiff[0],
                note="the dissertation shows pictures: the rim holds the shape")  # fmt: skip
    out.compare("deformation at 3 N, without rim", 1e3 * moved["cup"], "mm")
    out.compare("deformation at 3 N, with rim", 1e3 * moved["cup-rim"], "mm")


def _scale(figure: Any, axis: Any, colours: str, norm: Any, label: str) -> None:
    from matplotlib.cm import ScalarMappable

    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axis, shrink=0.6, pad=0.02, label=label)
    bar.ax.tick_params(which="both", labelsize=8)
