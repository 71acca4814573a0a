"""Correction of a stiffness map by measured stiffness (Alt 2016, Sec. 6.3.2).

All computations use logarithms of stiffness: errors are relative, and an error of the modulus is an offset.
Symbols: k measurements, v points of the map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core import InputError, StiffnessMap

#: Standard deviations of the logarithm of the ratio of true to simulated stiffness: of the part that is common to an object
#: (wall, modulus), and of the part that varies over the wall; correlation length of the latter [m].
COMMON, LOCAL, REACH_m = 0.2, 0.1, 0.04


def correct_map(
    found: StiffnessMap,
    points_m: Float[np.ndarray, "k 3"],
    measured_N_per_m: Float[np.ndarray, "k"],
    relative_sigma: Float[np.ndarray, "k"],
) -> StiffnessMap:
    """Correct a map with sparse measurements, interpolated by a Gaussian process.

    The logarithm of the ratio of true to simulated stiffness has a part that is common to the object and one that varies over
    :data:`REACH_m`. The new sigma is that of the process: small near a measurement; far from all of them, that of both parts.

    Parameters
    ----------
    found
        Simulated map.
    points_m
        Touched points [m].
    measured_N_per_m
        Stiffness at these points [N/m].
    relative_sigma
        Relative standard deviation of each measurement.
    """
    points = np.atleast_2d(np.asarray(points_m, dtype=float))
    measured, sigma = np.asarray(measured_N_per_m, dtype=float), np.asarray(relative_sigma, dtype=float)
    if points.shape != (len(measured), 3) or sigma.shape != measured.shape or not len(measured):
        raise InputError("correct_map", f"found shapes {points.shape}, {measured.shape}, {sigma.shape}")
    if not ((measured > 0).all() and (sigma > 0).all()):
        raise InputError("correct_map", "expected stiffness and sigma above 0")
    from scipy.spatial import cKDTree

    stiffness = np.asarray(found.stiffness_N_per_m, dtype=float)
    use = np.isfinite(stiffness) & (stiffness > 0)
    place = np.asarray(found.vertices_m)[use]
    logarithm = np.log(stiffness[use])
    distance, near = cKDTree(place).query(points, k=min(3, len(place)))
    weight = 1 / np.maximum(np.asarray(distance).reshape(len(points), -1), 1e-9)
    there = (logarithm[near].reshape(weight.shape) * weight).sum(axis=1) / weight.sum(axis=1)
    away = np.log(measured) - there

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        square = ((a[:, None, :] - b[None]) ** 2).sum(axis=2)
        out: np.ndarray = COMMON**2 + LOCAL**2 * np.exp(-0.5 * square / REACH_m**2)
        return out

    cross = kernel(place, points)
    solved = np.linalg.solve(kernel(points, points) + np.diag(sigma**2), np.c_[away, cross.T])
    mean = cross @ solved[:, 0]
    variance = COMMON**2 + LOCAL**2 - np.einsum("vk,kv->v", cross, solved[:, 1:])
    new, new_sigma = stiffness.copy(), np.full_like(stiffness, np.nan)
    new[use] = np.exp(logarithm + mean)
    new_sigma[use] = new[use] * np.sqrt(np.maximum(variance, 0.0))
    return replace(found, stiffness_N_per_m=new, stiffness_sigma_N_per_m=new_sigma)
