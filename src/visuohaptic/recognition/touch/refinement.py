"""From a generic model to this object: wall and modulus, models combined, maps corrected (Alt 2016, Sec. 6.3.2).

All of it works on logarithms of stiffness: errors are relative, and the modulus is a shift.
Symbols: k measurements, v points of a map, m models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.objects import StiffnessMap
from ...deformation.maps.features import linear_features
from ...deformation.shapes.container import ContainerDescription
from ...deformation.shapes.mesher import mesh_container
from ..data.places import HEIGHTS

__all__ = ["WallFit", "combine_models", "correct_map", "fit_wall"]


@dataclass(frozen=True, slots=True, eq=False)
class WallFit:
    """Wall and modulus of one object."""

    wall_m: float
    youngs_modulus_Pa: float
    log_covariance: Float[np.ndarray, "2 2"]  #: of (log wall, log modulus)
    chi2_per_measurement: float  #: far above 1: the shape is wrong, too

    @property
    def wall_sigma_m(self) -> float:
        """Standard deviation."""
        return float(self.wall_m * np.sqrt(self.log_covariance[0, 0]))

    @property
    def youngs_modulus_sigma_Pa(self) -> float:
        """Standard deviation."""
        return float(self.youngs_modulus_Pa * np.sqrt(self.log_covariance[1, 1]))


def fit_wall(
    container: ContainerDescription,
    measured_N_per_m: Float[np.ndarray, "16 4"],
    relative_sigma: Float[np.ndarray, "16 4"],
    *,
    wall_spread: float = 0.3,
    modulus_spread: float = 0.1,
    around: int = 48,
    max_iterations: int = 6,
) -> WallFit:
    """Fit wall and modulus to a few measured places.

    Parameters
    ----------
    container
        The generic model, without ranges; its wall and modulus are the prior's middle.
    measured_N_per_m
        NaN where nothing was measured.
    relative_sigma
        Of the measurements, the error of the model included.
    wall_spread, modulus_spread
        Relative standard deviations of the prior. Stiffness goes with E t^2 almost everywhere, so
        measurements alone hardly distinguish the two, which the covariance shows.
    around
        Vertices round the wall, a multiple of 4.
    max_iterations
        Of Gauss-Newton.

    Raises
    ------
    InputError
        No stiffness, wrong shapes, or a container with ranges.
    """
    measured, sigma = np.asarray(measured_N_per_m, dtype=float), np.asarray(relative_sigma, dtype=float)
    if measured.shape != (HEIGHTS, 4) or sigma.shape != (HEIGHTS, 4):
        raise InputError("fit_wall", f"found shapes {measured.shape} and {sigma.shape}, expected (16, 4)")
    use = np.isfinite(measured)
    if not use.any() or not ((measured[use] > 0).all() and (sigma[use] > 0).all()):
        raise InputError("fit_wall", "expected at least one stiffness above 0, with a sigma above 0")
    if container.free_parameters:
        raise InputError("fit_wall", "the container has ranges", remedy="take a variant or its middle")
    modulus = mesh_container(container, around=around).material.youngs_modulus_Pa
    weight = 1 / sigma[use] ** 2
    prior = np.diag([1 / wall_spread**2, 1 / modulus_spread**2])
    target = np.log(measured[use])
    moved = np.zeros(2)
    for _ in range(max_iterations):
        model = _log_stiffness(container, moved[0], around)[use]
        exponent = (_log_stiffness(container, moved[0] + 0.02, around)[use] - model) / 0.02
        jacobian = np.stack([exponent, np.ones_like(exponent)], axis=1)
        away = target - model - moved[1]
        precision = jacobian.T @ (weight[:, None] * jacobian) + prior
        step = np.linalg.solve(precision, jacobian.T @ (weight * away) - prior @ moved)
        moved = moved + step
        if np.abs(step).max() < 1e-5:
            break
    left = target - _log_stiffness(container, moved[0], around)[use] - moved[1]
    return WallFit(
        float(container.wall[0] * np.exp(moved[0])),
        float(modulus * np.exp(moved[1])),
        np.linalg.inv(precision),
        float(np.mean(weight * left**2)),
    )


def combine_models(
    log_stiffness: Float[np.ndarray, "m k"],
    measured_log: Float[np.ndarray, "k"],
    sigma: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "m"]:
    """Weights of models whose weighted mean fits the measurements best (non-negative least squares, sum 1).

    Parameters
    ----------
    log_stiffness
        Logarithms of the stiffness that m models predict at k places.
    measured_log
        Logarithms of what was measured there.
    sigma
        Their standard deviations.
    """
    from scipy.optimize import nnls

    models = np.atleast_2d(np.asarray(log_stiffness, dtype=float))
    target, sigma = np.asarray(measured_log, dtype=float), np.asarray(sigma, dtype=float)
    if models.shape[1:] != target.shape or target.shape != sigma.shape or not (sigma > 0).all():
        raise InputError(
            "combine_models", f"found shapes {models.shape}, {target.shape}, {sigma.shape}, expected "
            "(m, k), (k,), (k,) with sigma > 0"
        )  # fmt: skip
    if not models.size or not np.isfinite([*models.flat, *target, *sigma]).all():
        raise InputError("combine_models", "found no numbers, NaN or infinity, expected finite numbers")
    # The sum is held by one more, heavy equation.
    heavy = 1e4 / float(sigma.min())
    matrix = np.vstack([(models / sigma).T, np.full(len(models), heavy)])
    weights, _ = nnls(matrix, np.append(target / sigma, heavy))
    out: np.ndarray = weights / weights.sum()
    return out


def correct_map(
    found: StiffnessMap,
    points_m: Float[np.ndarray, "k 3"],
    measured_N_per_m: Float[np.ndarray, "k"],
    relative_sigma: Float[np.ndarray, "k"],
    *,
    reach_m: float = 0.04,
    common: float = 0.2,
    local: float = 0.1,
) -> StiffnessMap:
    """Correct a map by sparse measurements, between them by a Gaussian process.

    The logarithm of true by simulated stiffness has a part that is common to the object (wall,
    modulus; standard deviation ``common``) and one that varies over ``reach_m`` (``local``). The
    new sigma is that of the process: small where it was touched, ``common`` and ``local`` together
    where nothing is known.

    Parameters
    ----------
    found
        Simulated map.
    points_m
        Where it was touched [m].
    measured_N_per_m
        Stiffness there [N/m].
    relative_sigma
        Relative standard deviation of each measurement.
    reach_m
        Correlation length of the local part [m].
    common, local
        Standard deviations of the two parts, of the logarithm.
    """
    points = np.atleast_2d(np.asarray(points_m, dtype=float))
    measured, sigma = np.asarray(measured_N_per_m, dtype=float), np.asarray(relative_sigma, dtype=float)
    if points.shape != (len(measured), 3) or sigma.shape != measured.shape or not len(measured):
        raise InputError("correct_map", f"found shapes {points.shape}, {measured.shape}, {sigma.shape}")
    if not ((measured > 0).all() and (sigma > 0).all() and reach_m > 0):
        raise InputError("correct_map", "expected stiffness, sigma and reach above 0")
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
        out: np.ndarray = common**2 + local**2 * np.exp(-0.5 * square / reach_m**2)
        return out

    cross = kernel(place, points)
    solved = np.linalg.solve(kernel(points, points) + np.diag(sigma**2), np.c_[away, cross.T])
    mean = cross @ solved[:, 0]
    variance = common**2 + local**2 - np.einsum("vk,kv->v", cross, solved[:, 1:])
    new, new_sigma = stiffness.copy(), np.full_like(stiffness, np.nan)
    new[use] = np.exp(logarithm + mean)
    new_sigma[use] = new[use] * np.sqrt(np.maximum(variance, 0.0))
    return replace(found, stiffness_N_per_m=new, stiffness_sigma_N_per_m=new_sigma)


def _log_stiffness(
    container: ContainerDescription, log_wall: float, around: int
) -> Float[np.ndarray, "16 4"]:
    factor = float(np.exp(log_wall))
    changed = container.model_copy(update={"wall": tuple(value * factor for value in container.wall)})
    values = linear_features(mesh_container(changed, around=around)).values[..., 0]
    out: np.ndarray = np.log(values)
    return out
