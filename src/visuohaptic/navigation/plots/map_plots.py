"""Plots of a navigation map, as in figure 4.1 of Alt 2016."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.files import new_figure
from ..graph import NavigationGraph, Regions
from ..grid.cost_grid import GridLayers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_RED, _INK = "#d55e00", "#1c2430"


def plot_navigation(regions: Regions) -> Figure:
    """Distance with skeleton edges (a), and graph with regions (b), as figure 4.1 of Alt 2016.

    Parameters
    ----------
    regions
        Regions with their layers and graph.
    """
    from matplotlib.colors import hsv_to_rgb

    layers, graph = regions.layers, regions.graph
    width_m, height_m = layers.map.size_m
    tall = height_m > 0.8 * width_m
    rows, columns, size = (1, 2, (12.0, 6.2)) if tall else (2, 1, (9.0, 10.0))
    figure, (left, right) = new_figure(rows, columns, size=size, layout="constrained")
    _walls(left, layers)
    distance = np.where(layers.distance_m > 0, layers.distance_m, np.nan)
    shown = left.imshow(distance, origin="lower", cmap="Greens", vmin=0, vmax=float(np.nanpercentile(distance, 99.5)) if np.isfinite(distance).any() else 1.0)  # fmt: skip
    # A colour bar inside the margin keeps both maps at the same size and position.
    figure.colorbar(
        shown, cax=left.inset_axes((1.02, 0.15, 0.02, 0.7)), label="distance to the nearest obstacle [m]"
    )
    left.set_title("a  distance and skeleton", loc="left")
    _edges(left, graph, 0.8)
    _walls(right, layers)
    # Neighbouring numbers get different colours: the golden ratio distributes them over the circle.
    hue = 0.61803398875 * np.arange(max(graph.nodes, 1)) % 1.0
    pale = hsv_to_rgb(np.column_stack([hue, np.full((len(hue), 2), (0.3, 0.98))]))
    picture = np.dstack([pale[regions.node], regions.node >= 0])
    right.imshow(picture, origin="lower", interpolation="nearest")
    _edges(right, graph, 0.7)
    right.scatter(graph.node_cells[:, 1], graph.node_cells[:, 0], s=9, color=_INK, zorder=4, linewidths=0)
    right.set_title(
        f"b  graph: {graph.nodes} nodes, {len(graph.edges)} edges, {graph.loops} loops", loc="left"
    )
    for axes in (left, right):
        axes.set(xticks=[], yticks=[])
    _scale(left, layers)
    return figure


def _walls(axes: Axes, layers: GridLayers) -> None:
    shade = np.where(layers.map.cells >= 50, 0.25, np.where(layers.map.cells < 0, 0.82, 1.0))
    axes.imshow(shade, origin="lower", cmap="gray", vmin=0, vmax=1, interpolation="nearest")


def _edges(axes: Axes, graph: NavigationGraph, linewidth: float) -> None:
    from matplotlib.collections import LineCollection

    lines = [graph.edge_path(edge)[:, ::-1] for edge in range(len(graph.edges))]
    axes.add_collection(LineCollection(lines, colors=_RED, linewidths=linewidth, zorder=3))


def _scale(axes: Axes, layers: GridLayers) -> None:
    """A scale bar of 1, 2, 5 or 10 m."""
    rows, columns = layers.shape
    resolution_m = layers.map.resolution_m
    length_m = max((v for v in (1, 2, 5, 10, 20, 50) if v < 0.25 * columns * resolution_m), default=0.5)
    x, y = 0.03 * columns, 0.03 * rows
    axes.plot([x, x + length_m / resolution_m], [y, y], color=_INK, linewidth=3, zorder=6)
    axes.text(x, y + 0.015 * rows, f"{length_m:g} m", color=_INK, zorder=6, fontsize=9)
