"""Runs the kernels of both push planners once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Plan a direct and a sideward push of a box in a small room, and follow one with Algorithm 2."""
    from ..recording.occupancy_map import OccupancyMap
    from .direct_push import plan_direct_push
    from .goal_map import goal_map
    from .impulse_push import simulate_impulses
    from .local_ground import Footprint, local_ground
    from .push_model import PushModel
    from .quasi_static import line_path
    from .sideward_push import plan_sideward_push

    cells = np.zeros((60, 60), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    map = OccupancyMap(cells, 0.05)
    box = np.array([[1.4, 1.4], [1.6, 1.4], [1.6, 1.6], [1.4, 1.6]])
    plan_direct_push(map, box, samples=1)
    plan_sideward_push(map, box, (0.5, 1.5), (2.5, 1.5), samples=0)
    model = PushModel.patch(box - 1.5)
    ground = local_ground(map, box, 0.5)
    goal_map(ground, Footprint.of(box - 1.5, 0.17, 0.05), (1.5, 1.5, 0.0), 0.17)
    simulate_impulses(model, (0.4, 0.0, 0.0), line_path(np.zeros(2), np.array([0.2, 0.0])), 0.17)
