"""Positions to which an object can be pushed without blocking another passage: Alt 2016, Sec. 4.3.1 and Eq. (4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from .local_costmap import FootprintSamples, LocalCostmap, distance_from


@dataclass(frozen=True, slots=True, eq=False)
class GoalMap:
    """Positions of an object's reference point, for one orientation."""

    goal: Bool[np.ndarray, "rows columns"]  #: M_g: fits, blocks no other passage, leaves the path open
    free: Bool[np.ndarray, "rows columns"]  #: fits there, at least temporarily
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
    """All push goals around an object.

    A position is a goal if the footprint fits (the outline itself is tested instead of the dissertation's
    enclosing circle, M_d(y) > r_obj), if the
    ring on which the platform drives around it has at most one part closer to
    obstacles than the platform's radius (a wall on one side is acceptable, on two
    sides the object would block a passage), and if the desired path is then free. Parts
    start and end where M_d crosses r_rob.

    Parameters
    ----------
    costmap
        Surroundings without the object.
    footprint
        Its samples, for ``radius_m``.
    object_m
        Current pose: x, y [m], yaw [rad]; goals keep the yaw.
    radius_m
        Of the platform.
    blocked_path_m
        The path that the push has to open, map frame.
    reach_m
        r_mani: maximum distance of goals from the object.
    """
    goal, free = np.zeros(costmap.map.shape, dtype=bool), np.zeros(costmap.map.shape, dtype=bool)
    cells = np.argwhere(~free)
    places = costmap.map.world_from_cell(cells)
    near = np.hypot(*(places - object_m[:2]).T) <= reach_m
    cells, poses = cells[near], np.column_stack([places[near], np.full(near.sum(), object_m[2])])
    free[tuple(cells.T)] = in_collision(costmap, footprint, poses) == 0
    path = _path_distance(costmap, blocked_path_m)
    goal[tuple(cells.T)] = are_goals(costmap, footprint, poses, radius_m, path)
    return GoalMap(goal, free, object_m[2])


def in_collision(
    costmap: LocalCostmap, footprint: FootprintSamples, poses: Float[np.ndarray, "n 3"]
) -> Int[np.ndarray, "n"]:
    """Number of samples of a footprint that are too close to obstacles, at each pose; 0 if it fits.

    Parameters
    ----------
    costmap, footprint
        As of :func:`goal_map`.
    poses
        Of the object: x, y [m], yaw [rad].
    """
    near = costmap.distance_at(_placed(footprint.inner_m, poses)) < costmap.margin_m
    return near.sum(axis=1) + (costmap.distance_at(poses[:, :2]) < footprint.inside_m)


def blocked_parts(
    costmap: LocalCostmap, footprint: FootprintSamples, poses: Float[np.ndarray, "n 3"], radius_m: float
) -> Int[np.ndarray, "n"]:
    """Number of segments of the closed ring where obstacles are closer than the radius: l of Eq. (4.3).

    Parameters
    ----------
    costmap, footprint, poses
        As of :func:`in_collision`.
    radius_m
        Of the platform [m].
    """
    near = costmap.distance_at(_placed(footprint.ring_m, poses)) < radius_m
    return (near & ~np.roll(near, 1, axis=1)).sum(axis=1) + near.all(axis=1)


def are_goals(
    costmap: LocalCostmap,
    footprint: FootprintSamples,
    poses: Float[np.ndarray, "n 3"],
    radius_m: float,
    from_path: Float32[np.ndarray, "rows columns"],
) -> Bool[np.ndarray, "n"]:
    """Whether the footprint fits, blocks no other passage and leaves the path open, at each pose.

    Parameters
    ----------
    costmap, footprint, poses, radius_m
        As of :func:`blocked_parts`.
    from_path
        From :func:`_path_distance`.
    """
    beside = LocalCostmap(costmap.map, from_path).distance_at(_placed(footprint.border_m, poses))
    free = (in_collision(costmap, footprint, poses) == 0) & (beside >= radius_m).all(axis=1)
    return free & (blocked_parts(costmap, footprint, poses, radius_m) <= 1)


def _placed(
    points_m: Float[np.ndarray, "k 2"], poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n k 2"]:
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return points_m @ np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2) + poses[:, None, :2]


def _path_distance(
    costmap: LocalCostmap, path_m: Float[np.ndarray, "k 2"] | None
) -> Float32[np.ndarray, "rows columns"]:
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
