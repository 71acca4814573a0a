"""Poses of all views at once: sparse Gauss-Newton over the pairs of views that see the same surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .registration import Phase, RegisteredViews, moved

#: Over-relaxation, as of single registrations.
_RELAXED = 1.4


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Solution of a pose graph."""

    poses: Float[np.ndarray, "n 4 4"]  #: ``T_world_camera``
    #: of rotation [rad] and camera centre [m], relative to the fixed view
    covariance: Float[np.ndarray, "n 6 6"]


def solve_graph(
    views: RegisteredViews,
    poses: Float[np.ndarray, "n 4 4"],
    pairs: Int[np.ndarray, "p 2"],
    fixed: int,
    phases: Sequence[Phase],
) -> PoseGraph:
    """Poses that agree best with all pairs.

    Parameters
    ----------
    views
        The views.
    poses
        Start.
    pairs
        Pairs of views, both directions.
    fixed
        View that does not move.
    phases
        Steps of Gauss-Newton; the last one's planes and steps are those of the covariance.
    """
    poses = poses.copy()
    members = np.unique(pairs)
    for reach_m, planes, steps in phases:
        square, pull = views.equations(pairs, poses, reach_m, 2, (planes, steps))
        matrix, right, place = _assembled(square, pull, pairs, members, fixed)
        step = _RELAXED * _factor(matrix)(right).reshape(-1, 6)
        for view, row in place.items():
            poses[view] = moved(poses[view], step[row])
    square, pull = views.equations(pairs, poses, phases[-1][0], 1, phases[-1][1:])
    matrix, _, place = _assembled(square, pull, pairs, members, fixed)
    inverse = _factor(matrix)(np.eye(matrix.shape[0]))
    covariance = np.full((len(poses), 6, 6), np.nan)
    covariance[fixed] = 0.0
    for view, row in place.items():
        block = inverse[6 * row : 6 * row + 6, 6 * row : 6 * row + 6]
        # A motion of the world's origin, at the centre of the camera.
        lever = np.eye(6)
        x, y, z = poses[view, :3, 3]
        lever[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        covariance[view] = views.shared * lever @ block @ lever.T
    return PoseGraph(poses, covariance)


def _assembled(
    squares: Float[np.ndarray, "p 6 6"],
    pulls: Float[np.ndarray, "p 6"],
    pairs: Int[np.ndarray, "p 2"],
    members: Int[np.ndarray, "m"],
    fixed: int,
) -> tuple[Any, Float[np.ndarray, "r"], dict[int, int]]:
    """Sparse normal equations of all views but the fixed one, and the row of each view."""
    from scipy.sparse import coo_matrix

    place = {int(view): row for row, view in enumerate(view for view in members if view != fixed)}
    rows, columns, values = [], [], []
    right = np.zeros((len(place), 6))
    local = np.indices((6, 6)).reshape(2, -1)
    for (i, k), square, pull in zip(pairs.tolist(), squares, pulls, strict=True):
        for a, b, sign in ((i, i, 1.0), (k, k, 1.0), (i, k, -1.0), (k, i, -1.0)):
            if a in place and b in place:
                rows.append(6 * place[a] + local[0])
                columns.append(6 * place[b] + local[1])
                values.append(sign * square.ravel())
        if i in place:
            right[place[i]] -= pull
        if k in place:
            right[place[k]] += pull
    size = 6 * len(place)
    # A view that nothing holds does not move.
    slight = 1e-9 * float(np.trace(squares.mean(axis=0)))
    rows.append(np.arange(size))
    columns.append(np.arange(size))
    values.append(np.full(size, slight))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return coo_matrix(entries, shape=(size, size)).tocsc(), right.ravel(), place


def _factor(matrix: Any) -> Any:
    from scipy.sparse.linalg import splu

    return splu(matrix).solve
