"""Poses of all views at once: sparse Gauss-Newton over the pairs of views that see the same surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import hat
from ..transparency.pose_refinement import normal_equations
from .registration import RELAXED, Phase, RegisteredViews, moved


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
    from scipy.sparse import eye
    from scipy.sparse.linalg import splu

    poses, free = poses.copy(), np.setdiff1d(pairs, fixed)
    own = (6 * free[:, None] + np.arange(6)).ravel()

    def linear(
        stride: int, reach_m: float, planes: float, steps: float
    ) -> tuple[Any, Float[np.ndarray, "r"]]:
        squares, pulls = views.equations(pairs, poses, reach_m, stride, (planes, steps))
        matrix, right = normal_equations(squares, pulls, pairs, len(poses))
        # A view that nothing holds does not move.
        slight = 1e-9 * float(np.trace(squares.mean(axis=0)))
        return splu(matrix[own][:, own] + slight * eye(len(own), format="csc")).solve, right[free].ravel()

    for phase in phases:
        solve, right = linear(2, *phase)
        for view, step in zip(free, RELAXED * solve(right).reshape(-1, 6), strict=True):
            poses[view] = moved(poses[view], step)
    inverse = linear(1, *phases[-1])[0](np.eye(len(own)))
    covariance = np.full((len(poses), 6, 6), np.nan)
    covariance[fixed] = 0.0
    for row, view in enumerate(free):
        block = inverse[6 * row : 6 * row + 6, 6 * row : 6 * row + 6]
        # A motion of the world's origin, at the centre of the camera.
        lever = np.eye(6)
        lever[3:, :3] = -hat(poses[view, :3, 3])
        covariance[view] = views.shared * lever @ block @ lever.T
    return PoseGraph(poses, covariance)
