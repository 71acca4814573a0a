"""Effect of pose errors of the gripper on the features of one object, from its stiffness map.

Between the 16 heights, walls have ridges and shoulders where stiffness changes by a factor within a few
millimetres, which is contained in the map but not in the features. Each copy samples one pose of the gripper
relative to the object, common to all touches of an exploration; both tips stay on one line, so a tilt moves them to
different heights. Symbols: c copies.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.geometry import so3_exp
from .places import HEIGHTS, SIDES

#: Number of sampled poses of each object; their standard deviations along [m] and about [rad] each axis.
COPIES, POSE_m, TILT_rad = 8, 0.002, 0.05


def pose_error_changes(
    vertices_m: Float[np.ndarray, "n 3"],
    stiffness_N_per_m: Float[np.ndarray, "n"],
    points_m: Float[np.ndarray, "16 4 3"],
    rng: np.random.Generator,
    *,
    copies: int = COPIES,
    pose_m: float = POSE_m,
    tilt_rad: float = TILT_rad,
) -> Float[np.ndarray, "c 16 4"]:
    """Change of log stiffness at each place due to pose errors.

    Parameters
    ----------
    vertices_m, stiffness_N_per_m
        Map of the surface; points without a stiffness are ignored.
    points_m
        Points of the features without a pose error.
    rng
        Source of the poses.
    copies
        Number of poses.
    pose_m, tilt_rad
        Standard deviations of each coordinate and of each angle.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError

    offset = rng.normal(0.0, pose_m, (copies, 3))
    turn = so3_exp(rng.normal(0.0, tilt_rad, (copies, 3)))
    out = np.zeros((copies, HEIGHTS, len(SIDES)))
    good = np.isfinite(stiffness_N_per_m) & (stiffness_N_per_m > 0)
    for column in range(len(SIDES)):
        axis, sign = divmod(column, 2)
        sign = 1 - 2 * sign
        across = 1 - axis
        reach = sign * points_m[:, column, axis]
        middle = points_m[:, column, across]
        near = np.abs(vertices_m[:, across] - middle.mean()) < 0.6 * max(float(reach.max()), 0.0)
        some = good & near & (sign * vertices_m[:, axis] > 0.3 * float(np.median(reach)))
        sheet = vertices_m[some][:, [across, 2]]
        try:
            log_stiffness = LinearNDInterpolator(sheet, np.log(stiffness_N_per_m[some]))
        except (QhullError, ValueError):
            continue  # too few points: no wall on this side
        low, high = float(sheet[:, 1].min()), float(sheet[:, 1].max())
        # Intersection of the line through the tips with this side.
        along = sign * turn[:, :, axis]
        moved = points_m[None, :, column] + offset[:, None]
        moved = moved + reach[None, :, None] * (along - sign * np.eye(3)[axis])[:, None]
        there = np.stack([moved[..., across], np.clip(moved[..., 2], low, high)], axis=-1)
        nominal = log_stiffness(np.stack([middle, np.clip(points_m[:, column, 2], low, high)], axis=-1))
        change = log_stiffness(there) - nominal
        out[:, :, column] = np.where(np.isfinite(change), change, 0.0)
    return out
