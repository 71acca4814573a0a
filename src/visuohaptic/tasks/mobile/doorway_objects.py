"""Objects in a doorway by their laser points: which points are of one object, where its near side is, how it is pushed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d
from ...io.maps.occupancy_map import OccupancyMap

__all__ = ["heading_across", "join_sides", "near_side"]

#: Two standard deviations of laser and map between scans of the same side [m].
SIDE_DISTANCE_M = 0.03
#: Part of the map around the objects that shows the direction of their doorway's wall, turns that are compared: the row is
#: off by up to 8 degrees in random houses; bins of the projection, finer than cells [m].
WALL_M, WALL_TURNS_RAD, BIN_M = 1.0, np.radians(np.arange(-20, 21)), 0.02
#: Depth of an object by its width, two deviations above one: a factor of 1.4 is one deviation.
MAX_DEPTH = 2.0
#: Standard deviation of one laser point, and width of the strips whose points are averaged: at the middle of a round
#: bin the sides of a strip are half a millimetre farther away than its middle [m].
LASER_SIGMA_M, STRIP_M = 0.01, 0.02


def near_side(group: Float[np.ndarray, "k 2"], heading_rad: float) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre of the near side of an object [m], and its width [m].

    Parameters
    ----------
    group
        Laser points of the object [m].
    heading_rad
        Direction of approach [rad].
    """
    turn = rotation_2d(heading_rad)
    ahead, beside = (group @ turn).T
    strip = np.floor((beside - beside.min()) / STRIP_M).astype(int)
    count = np.bincount(strip)
    used = count > 0
    mean = np.bincount(strip, weights=ahead)[used] / count[used]
    # The smallest of a few hundred points is three deviations nearer than the side, the mean of a strip is not; the
    # strip is chosen by an upper bound of two standard errors, for those at the ends have few points.
    nearest = mean[np.argmin(mean + 2.0 * LASER_SIGMA_M / np.sqrt(count[used]))]
    width = float(np.ptp(beside))
    return turn @ np.array([nearest, beside.min() + 0.5 * width]), width


def heading_across(
    groups: Sequence[Float[np.ndarray, "k 2"]], path: Float[np.ndarray, "n 3"], grid: OccupancyMap
) -> float:
    """Heading perpendicular to the wall whose doorway is blocked [rad].

    The row of the objects, or the path at a single one, says which wall it is, but only to 3 degrees and more: near sides
    of a row are at different depths. Among turns of that heading, the one with the sharpest projection of the occupied
    cells of the map around the objects is chosen: the largest sum of squares of its histogram.

    Parameters
    ----------
    groups
        Laser points of each object [m].
    path
        Poses along the path that they block: x, y [m], heading [rad].
    grid
        Map without the objects.
    """
    middles = np.array([one.mean(axis=0) for one in groups])
    nearest = np.hypot(*(path[:, None, :2] - middles[None]).transpose(2, 0, 1)).min(axis=1).argmin()
    heading = float(path[nearest, 2])
    if len(middles) > 1:
        _, _, axes = np.linalg.svd(middles - middles.mean(axis=0))
        normal = axes[1] * np.sign(axes[1] @ (math.cos(heading), math.sin(heading)))
        heading = math.atan2(normal[1], normal[0])
    walls = grid.world_from_cell(np.argwhere(grid.cells >= 50).astype(float))
    walls = walls[np.hypot(*(walls - middles.mean(axis=0)).T) < WALL_M]
    if not len(walls):
        return heading
    turns = heading + WALL_TURNS_RAD
    across = np.floor(walls @ np.array([np.cos(turns), np.sin(turns)]) / BIN_M).astype(int)
    return float(turns[np.argmax([np.sum(np.unique(one, return_counts=True)[1] ** 2) for one in across.T])])


def join_sides(
    groups: Sequence[Float[np.ndarray, "k 2"]], heading_rad: float
) -> list[Float[np.ndarray, "k 2"]]:
    """Objects: points behind a near side belong to it, up to the depth that an object of its width may have.

    Parameters
    ----------
    groups
        Groups of laser points [m].
    heading_rad
        Direction of observation [rad].
    """
    turn, whole = rotation_2d(heading_rad), list[Float[np.ndarray, "k 2"]]()
    for one in sorted(groups, key=lambda group: -float(np.ptp(group @ turn[:, 1]))):
        for number, wider in enumerate(whole):
            low, high = (
                (wider @ turn).min(axis=0) - SIDE_DISTANCE_M,
                (wider @ turn).max(axis=0) + SIDE_DISTANCE_M,
            )
            high[0] = max(high[0], low[0] + MAX_DEPTH * (high[1] - low[1]))
            if ((one @ turn > low) & (one @ turn < high)).all():
                whole[number] = np.concatenate([wider, one])
                break
        else:
            whole.append(one)
    return sorted(whole, key=lambda group: float(group[:, 1].mean()))
