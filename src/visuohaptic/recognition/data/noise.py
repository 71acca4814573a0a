"""Training objects as a robot measures them: with noise, wrong poses and errors of the simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from .data_set import FeatureSet, join_feature_sets
from .pose_error import POSE_m
from .protocol import TouchProtocol

__all__ = ["as_measured", "noisy_copies"]


def noisy_copies(
    data: FeatureSet,
    copies: int,
    rng: np.random.Generator,
    *,
    protocol: TouchProtocol | None = None,
    pose_m: float = 0.002,
    discrepancy: float = 0.06,
    keep: bool = True,
) -> FeatureSet:
    """Objects with the noise of an exploration: a tree that learns from them leaves wider gaps.

    Parameters
    ----------
    data
        Objects without noise.
    copies
        Of each object.
    rng
        Source of the noise.
    protocol
        How a touch is done: the noise of a stiffness follows from it.
    pose_m
        Standard deviation of the height of all touches of a copy; where the effects of
        wrong poses are known from maps, these are sampled, scaled by this.
    discrepancy
        Relative standard deviation by which simulation is wrong, by place.
    keep
        The objects themselves come first.
    """
    if copies < 1:
        raise InputError("noisy_copies", f"found {copies}, expected at least 1", field="copies")
    stiffness = np.log(data.features[..., 0])
    parts = [data] if keep else []
    for copy in range(copies):
        measured = as_measured(
            stiffness,
            rng,
            pose_errors=data.pose_errors,
            protocol=protocol,
            pose_m=pose_m,
            discrepancy=discrepancy,
        )
        features = data.features.copy()
        features[..., 0] = np.exp(measured)
        names = tuple(f"{name}~{copy}" for name in data.name)
        parts.append(replace(data, features=features, name=names))
    return join_feature_sets(parts)


def as_measured(
    log_stiffness: Float[np.ndarray, "m 16 4"],
    rng: np.random.Generator,
    *,
    pose_errors: Float[np.ndarray, "m c 16 4"] | None = None,
    protocol: TouchProtocol | None = None,
    pose_m: float = 0.002,
    discrepancy: float = 0.06,
) -> Float[np.ndarray, "m 16 4"]:
    """What one exploration of each object measures.

    Parameters
    ----------
    log_stiffness
        Logarithm of the stiffness [N/m] at the places of m objects.
    rng
        Source of the noise.
    pose_errors
        Change of the logarithm under each of c wrong poses, see :func:`.pose_error_changes`; from the slope between
        the heights by default.
    protocol
        How a touch is done.
    pose_m
        Standard deviation of the height of all touches of an object [m].
    discrepancy
        Relative standard deviation by which the simulation is wrong, by place.
    """
    protocol = TouchProtocol() if protocol is None else protocol
    shape = log_stiffness.shape
    shift = rng.normal(0, pose_m / protocol.place_m, (shape[0], 1, 1))
    wrong = rng.normal(0, 1, shape) * np.minimum(protocol.relative_sigmas(np.exp(log_stiffness)), 1.0)
    wrong += rng.normal(0, discrepancy, shape)
    if pose_errors is None or not pose_m > 0:
        moved: np.ndarray = shift * np.gradient(log_stiffness, axis=1)
    else:
        which = rng.integers(0, pose_errors.shape[1], shape[0])
        moved = pose_m / POSE_m * pose_errors[np.arange(shape[0]), which]
    return log_stiffness + moved + wrong
