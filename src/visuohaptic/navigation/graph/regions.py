"""The node of each cell, and the path to it (Alt 2016, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from ..grid.cost_grid import GridLayers
from ._sweep_kernels import UNREACHED, sweep
from .navigation_graph import NavigationGraph


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """The nearest node of every cell by cost, and the cost of the path from it."""

    potential: Int32[np.ndarray, "rows columns"]  #: cost from the node [units]; 2^31 - 1 without a node
    seed: Int32[np.ndarray, "rows columns"]  #: cell (row * columns + column) of the node, -1 without a node
    unit_s: float  #: seconds of one unit
    layers: GridLayers  #: layers from which the potential was computed
    graph: NavigationGraph  #: graph whose nodes the regions belong to

    @property
    def node(self) -> Int32[np.ndarray, "rows columns"]:
        """Node of every cell, -1 if none is reachable.

        Computed on every access: store the result.
        """
        number = np.full(self.seed.size + 1, -1, np.int32)  # the last one for seed -1
        number[self.seed[tuple(self.graph.node_cells.T)]] = np.arange(self.graph.nodes)
        return number[self.seed]

    @property
    def potential_s(self) -> Float32[np.ndarray, "rows columns"]:
        """Cost of the path between a cell and its node [s], infinite without a node.

        Computed on every access: store the result.
        """
        seconds = self.potential * np.float32(self.unit_s)
        seconds[self.seed < 0] = np.inf
        return seconds


def assign_regions(layers: GridLayers, graph: NavigationGraph) -> Regions:
    """Assign every reachable cell to the node with the smallest travel cost (Alt 2016, Algorithm 1).

    The dissertation's loop over a set is a label-correcting method; this one has the same fixed point, uses
    costs rounded to integer units (1/4096 of the fastest step), and breaks ties by the node
    with the smaller cell, so that the result does not depend on the order of the computation.

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    graph
        Navigation graph of the same map.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> from visuohaptic.navigation.grid import SpeedLimits, grid_layers
    >>> walls = np.zeros((20, 40), dtype=bool)  # one room
    >>> walls[[0, -1]] = walls[:, [0, -1]] = True
    >>> layers = grid_layers(OccupancyMap(walls, 0.1), SpeedLimits(0.15, 0.3, 0.05))
    >>> from visuohaptic.navigation.graph import build_graph
    >>> regions = assign_regions(layers, build_graph(layers))
    >>> bool((regions.seed[layers.reachable] >= 0).all())  # every reachable cell has its node
    True
    """
    potential = np.full(layers.shape, UNREACHED, np.int32)
    seed = np.full(layers.shape, -1, np.int32)
    rows, columns = graph.node_cells.T
    potential[rows, columns] = 0
    seed[rows, columns] = rows * layers.shape[1] + columns
    # Reachable cells row by row: where they begin and end, in rows with a blocked cell at either end.
    changes = np.flatnonzero(np.diff(np.pad(layers.step > 0, ((0, 0), (1, 1))).ravel()))
    row, limits = np.divmod(changes, layers.shape[1] + 2)
    start = np.searchsorted(row[::2], np.arange(len(potential) + 1))
    sweep(layers.step, start, limits.reshape(-1, 2), potential, seed)
    return Regions(potential, seed, layers.unit_s, layers, graph)
