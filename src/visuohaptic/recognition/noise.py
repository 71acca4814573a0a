"""Training objects as a robot measures them: with noise, wrong poses and errors of the simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError
from .data_set import HEIGHTS, FeatureSet
from .posed import POSE_m
from .protocol import TouchProtocol

__all__ = ["noisy_copies"]


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
        Standard deviation of the height of all touches of a copy; where the maps of the objects told what
        wrong poses do, those are drawn from, scaled by this.
    discrepancy
        Relative standard deviation by which simulation is wrong, by place.
    keep
        The objects themselves come first.
    """
    if copies < 1:
        raise InputError("noisy_copies", f"found {copies}, expected at least 1", field="copies")
    protocol = TouchProtocol() if protocol is None else protocol
    stiffness = np.log(data.features[..., 0])
    slope = np.gradient(stiffness, axis=1)
    sigma = np.array([protocol.relative_sigma(k) for k in np.exp(stiffness).ravel()]).reshape(stiffness.shape)
    sigma = np.minimum(sigma, 1.0)
    parts = [data] if keep else []
    for copy in range(copies):
        shift = rng.normal(0, pose_m / protocol.place_m, (len(data), 1, 1))
        wrong = rng.normal(0, 1, (len(data), HEIGHTS, 4)) * sigma
        wrong += rng.normal(0, discrepancy, (len(data), HEIGHTS, 4))
        moved = shift * slope
        if data.posed is not None and pose_m > 0:
            which = rng.integers(0, data.posed.shape[1], len(data))
            moved = pose_m / POSE_m * data.posed[np.arange(len(data)), which]
        features = data.features.copy()
        features[..., 0] = np.exp(stiffness + moved + wrong)
        names = tuple(f"{name}~{copy}" for name in data.name)
        parts.append(replace(data, features=features, name=names))
    return FeatureSet(
        np.concatenate([part.features for part in parts]),
        np.concatenate([part.width_m for part in parts]),
        tuple(label for part in parts for label in part.label),
        tuple(name for part in parts for name in part.name),
        data.nonlinear,
        None if data.posed is None else np.concatenate([data.posed] * len(parts)),
    )
