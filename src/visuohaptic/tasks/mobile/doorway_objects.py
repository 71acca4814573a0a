"""Objects in a doorway by their laser points: direction of passage, and which points are of one object."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from ...core.geometry import rotation_2d
from .floor_outline import DEPTH_FACTOR

#: Two standard deviations of laser and map between scans of the same side [m].
SIDE_DISTANCE_M = 0.03


def doorways(
    groups: Sequence[Float[np.ndarray, "k 2"]], passage_m: float
) -> list[list[Float[np.ndarray, "k 2"]]]:
    """Rows of objects, between which there is no passage: those of one row have one direction of passage.

    Parameters
    ----------
    groups
        Laser points of each object [m].
    passage_m
        Width of the platform [m].
    """
    rows = list[list[Float[np.ndarray, "k 2"]]]()
    for one in groups:
        near = [any(cdist(one, other).min() < passage_m for other in row) for row in rows]
        joined = [group for row, is_near in zip(rows, near, strict=True) if is_near for group in row]
        rows = [row for row, is_near in zip(rows, near, strict=True) if not is_near] + [[*joined, one]]
    return rows


def heading_across(groups: Sequence[Float[np.ndarray, "k 2"]], path: Float[np.ndarray, "n 3"]) -> float:
    """Heading perpendicular to a row of objects, or along the path at a single one [rad].

    Parameters
    ----------
    groups
        Laser points of each object [m].
    path
        Poses along the path that they block: x, y [m], heading [rad].
    """
    middles = np.array([one.mean(axis=0) for one in groups])
    nearest = np.hypot(*(path[:, None, :2] - middles[None]).transpose(2, 0, 1)).min(axis=1).argmin()
    heading = float(path[nearest, 2])
    if len(middles) == 1:
        return heading
    _, _, axes = np.linalg.svd(middles - middles.mean(axis=0))
    normal = axes[1] * np.sign(axes[1] @ (math.cos(heading), math.sin(heading)))
    return math.atan2(normal[1], normal[0])


def join_sides(
    groups: Sequence[Float[np.ndarray, "k 2"]], heading_rad: float
) -> list[Float[np.ndarray, "k 2"]]:
    """Objects: points behind a near side belong to it, up to two deviations of the depth of an object of its width.

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
            high[0] = max(high[0], low[0] + DEPTH_FACTOR**2 * (high[1] - low[1]))
            if ((one @ turn > low) & (one @ turn < high)).all():
                whole[number] = np.concatenate([wider, one])
                break
        else:
            whole.append(one)
    return sorted(whole, key=lambda group: float(group[:, 1].mean()))
