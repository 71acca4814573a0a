"""Where an object may be pushed to without blocking another passage: Alt 2016, Sec. 4.3.1 and Eq. (4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .local_costmap import FootprintSamples, LocalCostmap, distance_from

__all__ = ["GoalMap", "goal_map"]


@dataclass(frozen=True, slots=True, eq=False)
class GoalMap:
    """Places of an object's reference point, for one orientation."""

    goal: Bool[np.ndarray, "rows columns"]  #: M_g: fits, blocks no other passage, leaves the path open
    free: Bool[np.ndarray, "rows columns"]  #: fits there, at least in passing
    yaw_rad: float  #: orientation of the footprint


def goal_map(
    costmap: LocalCostmap,
    footprint: FootprintSamples,
    object_m: tuple[float, float, float],
    radius_m: float,
    *,
    blocked_path_m: Float[np.ndarray, "k 2"] | None = None,
    reach_m: float = 1.0,
) -> GoalMap:
    """All push goals about an object.

    A place is a goal when the footprint fits (in place of the dissertation's
    enclosing circle, M_d(y) > r_obj, the outline itself is asked), when the
    ring on which the platform drives around it has at most one part nearer to
    obstacles than the platform's radius (a wall on one side is fine, on two
    sides it would be a plug), and when the desired path then is free. Parts
    begin and end where M_d crosses r_rob.

    Parameters
    ----------
    costmap
        Surroundings without the object.
    footprint
        Its samples, for ``radius_m``.
    object_m
        Where it stands: x, y [m], yaw [rad]; goals keep the yaw.
    radius_m
        Of the platform.
    blocked_path_m
        The path that the push has to open, map frame.
    reach_m
        r_mani: how far from the object goals are looked for.
    """
    from ._ground_kernels import push_goals

    goal, free = np.zeros(costmap.map.shape, dtype=bool), np.zeros(costmap.map.shape, dtype=bool)
    push_goals(
        costmap.distance_m,
        path_distance(costmap, blocked_path_m),
        costmap.grid,
        footprint.inner_m,
        footprint.ring_m,
        footprint.border_m,
        costmap.margin_m,
        footprint.inside_m,
        footprint.reach_m,
        radius_m,
        reach_m,
        object_m[2],
        object_m[0],
        object_m[1],
        goal,
        free,
    )
    return GoalMap(goal, free, object_m[2])


def path_distance(
    costmap: LocalCostmap, path_m: Float[np.ndarray, "k 2"] | None
) -> Float[np.ndarray, "rows columns"]:
    """Distance of every cell from a path; infinite without one, and outside the window."""
    on_path = np.zeros(costmap.map.shape, dtype=bool)
    if path_m is not None and len(path_m) > 1:
        path = np.asarray(path_m, dtype=np.float64)
        length = np.hypot(*np.diff(path, axis=0).T)
        for a, b, chord in zip(path[:-1], path[1:], length, strict=True):
            fraction = np.linspace(0.0, 1.0, max(2, int(chord / (0.5 * costmap.map.resolution_m)) + 2))
            cells = costmap.map.cell_from_world(a + fraction[:, None] * (b - a))
            cells = cells[costmap.map.inside(cells)]
            on_path[cells[:, 0], cells[:, 1]] = True
    return distance_from(costmap.map, on_path)
