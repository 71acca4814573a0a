"""Runs every kernel of the graph once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Build, ask and edit a small map."""
    from ..recording.occupancy_map import OccupancyMap
    from .grid import SpeedLimits
    from .incremental import NavigationMap
    from .query import plan_path, shortest_path
    from .route_pieces import route_pieces

    cells = np.zeros((60, 60), np.int8)
    cells[20:30, 20:30] = 100
    live = NavigationMap(OccupancyMap(cells, 0.1), SpeedLimits(0.2), spacing_m=1.0)
    route_pieces(live.graph, live.layers)
    shortest_path(live.graph, 0, live.graph.nodes - 1)
    plan_path(live.regions, np.array([1.0, 1.0]), np.array([5.0, 5.0]))
    live.set_obstacle("box", np.array([[4.0, 1.0], [4.5, 1.0], [4.5, 1.5]]))
