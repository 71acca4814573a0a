"""Simulated measurements of training objects: noise, pose errors and errors of the simulation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .pose_error import POSE_m
from .protocol import TouchProtocol


def as_measured(
    log_stiffness: Float[np.ndarray, "m 16 4"],
    rng: np.random.Generator,
    *,
    pose_errors: Float[np.ndarray, "m c 16 4"] | None = None,
    protocol: TouchProtocol | None = None,
    pose_m: float | Float[np.ndarray, "m"] = 0.002,
    discrepancy: float = 0.06,
) -> Float[np.ndarray, "m 16 4"]:
    """Logarithm of stiffness as measured by one exploration of each object.

    Parameters
    ----------
    log_stiffness
        Logarithm of the stiffness [N/m] at the places of m objects.
    rng
        Source of the noise.
    pose_errors
        Change of the logarithm due to each of c pose errors, see :func:`.pose_error_changes`; by default from the slope
        between the heights.
    protocol
        Protocol of a touch.
    pose_m
        Standard deviation of the error of the height, common to all touches of an object [m]; a scalar or one per object.
    discrepancy
        Relative standard deviation of the error of the simulation, by place.
    """
    protocol = TouchProtocol() if protocol is None else protocol
    shape = log_stiffness.shape
    spread_m = np.broadcast_to(np.asarray(pose_m, dtype=float), shape[:1])[:, None, None]
    shift = rng.normal(0, spread_m / protocol.place_m, (shape[0], 1, 1))
    wrong = rng.normal(0, 1, shape) * np.minimum(protocol.relative_sigmas(np.exp(log_stiffness)), 1.0)
    wrong += rng.normal(0, discrepancy, shape)
    if pose_errors is None:
        moved: np.ndarray = shift * np.gradient(log_stiffness, axis=1)
    else:
        which = rng.integers(0, pose_errors.shape[1], shape[0])
        moved = spread_m / POSE_m * pose_errors[np.arange(shape[0]), which]
    return log_stiffness + moved + wrong
