"""Correction of a stiffness map by measured stiffness (Alt 2016, Sec. 6.3.2).

All computations use logarithms of stiffness: errors are relative, and an error of the modulus is an offset.
Symbols: k measurements, v points of the map, q heights, s possible bodies.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ...core import InputError, StiffnessMap

if TYPE_CHECKING:
    from ...deformation import ShellObject

#: Standard deviations of the logarithm of the ratio of true to simulated stiffness, of a class's shape: of the part that is common
#: to an object (wall, modulus, size), and of the part that varies over the wall; correlation length of the latter [m]. Rounded from
#: the most probable ones of 24 open oval containers (``benchmarks.grasp_walls --fit --oval --count 24``): 0.548, 0.246, 0.0053.
CLASS = (0.55, 0.25, 0.005)
#: The same of a measured outline with sampled errors and a wall that was fitted to squeezes: what is left of wall and modulus, and
#: what the outline does not resolve. From 24 open containers (``benchmarks.grasp_walls --fit --count 24``): 0.178, 0.230, 0.0100.
OUTLINE = (0.18, 0.23, 0.01)


def map_of_outline(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    heights_m: Float[np.ndarray, "q"],
    logs: Float[np.ndarray, "s q"],
) -> tuple[StiffnessMap, Float[np.ndarray, "s v"]]:
    """Map of a round body before it is squeezed, and the deviations of the logarithm of stiffness among possible bodies.

    Parameters
    ----------
    vertices_m, faces
        Surface of its model, z up.
    heights_m, logs
        Heights on the model [m], and the samples of the logarithm of stiffness there, see :func:`stiffness_samples`.
    """
    each = np.array([np.interp(vertices_m[:, 2], heights_m, one) for one in logs])
    mean = each.mean(axis=0)
    outside = (vertices_m[:, 2] <= heights_m[0]) | (vertices_m[:, 2] > heights_m[-1])
    stiffness = np.where(outside, np.nan, np.exp(mean))
    sigma = stiffness * np.hypot(each.std(axis=0, ddof=1), np.hypot(*OUTLINE[:2]))
    return StiffnessMap(vertices_m, faces, stiffness, sigma), each - mean


def map_of_oval(
    model: ShellObject, closed: float, fill: float = 0.0
) -> tuple[StiffnessMap, Float[np.ndarray, "4 v"]]:
    """Map of a measured body that is not round, before it is squeezed, and the deviations of the logarithm of its stiffness.

    A lid holds the rim and encloses the air. Besides the lid, the wall and its modulus are unknown, see :data:`CLASS`.

    Parameters
    ----------
    model
        Its shell, without a lid.
    closed
        Probability of a lid.
    fill
        Fraction of the volume that is filled.
    """
    from ...deformation import Contents, object_map

    vertices = model.mesh.vertices_m
    held = replace(model, fixed=model.fixed | (vertices[:, 2] > vertices[:, 2].max() - 1e-6))
    contents = Contents(closed=True, fill=fill)
    maps = (object_map(model, band=False), object_map(held, contents, band=False))
    stiffness = np.array([one.stiffness_N_per_m for one in maps])
    given = (np.isfinite(stiffness) & (stiffness > 0)).all(axis=0)
    logs = np.log(np.where(given, stiffness, 1.0))
    lid = np.sqrt(closed * (1.0 - closed)) * (logs[1] - logs[0])
    # Their mean square over one less than their number is the sum of both variances.
    wall = CLASS[0] * given
    deviations = np.sqrt(1.5) * np.array([lid, -lid, wall, -wall])
    mean = np.where(given, np.exp((1.0 - closed) * logs[0] + closed * logs[1]), np.nan)
    sigma = mean * np.sqrt(lid**2 + CLASS[0] ** 2 + OUTLINE[0] ** 2 + OUTLINE[1] ** 2)
    return StiffnessMap(vertices, model.surface_faces, mean, sigma), deviations


def correct_map(
    found: StiffnessMap,
    points_m: Float[np.ndarray, "k 3"],
    measured_N_per_m: Float[np.ndarray, "k"],
    relative_sigma: Float[np.ndarray, "k"],
    deviations: Float[np.ndarray, "s v"] | None = None,
) -> StiffnessMap:
    """Correct a map with sparse pinches, interpolated by a Gaussian process.

    The logarithm of the ratio of true to simulated stiffness has a part that is common to the object and one that varies over
    the wall (:data:`CLASS`), alike at both ends of a pinch; of a measured outline it has the covariance of the
    deviations too (:data:`OUTLINE`), and is the same around the axis. The new sigma is that of the process: small near a
    measurement; far from all of them, that of all parts.

    Parameters
    ----------
    found
        Simulated map.
    points_m
        One end of each pinch through the height axis, which is x = y = 0 [m].
    measured_N_per_m
        Stiffness at these points [N/m].
    relative_sigma
        Relative standard deviation of each measurement.
    deviations
        Of the logarithm of stiffness of possible bodies at the map's points, with a mean of 0; see :func:`map_of_outline`
        and :func:`map_of_oval`.
    """
    points = np.atleast_2d(np.asarray(points_m, dtype=float))
    measured, sigma = np.asarray(measured_N_per_m, dtype=float), np.asarray(relative_sigma, dtype=float)
    if points.shape != (len(measured), 3) or sigma.shape != measured.shape or not len(measured):
        raise InputError("correct_map", f"found shapes {points.shape}, {measured.shape}, {sigma.shape}")
    if not ((measured > 0).all() and (sigma > 0).all()):
        raise InputError("correct_map", "expected stiffness and sigma above 0")
    if deviations is not None and deviations.shape[1:] != found.stiffness_N_per_m.shape:
        raise InputError(
            "correct_map", f"found {deviations.shape[1:]} deviations, expected those of {len(found.stiffness_N_per_m)} "
            "points of the map", field="deviations",
        )  # fmt: skip
    from scipy.spatial import cKDTree

    stiffness = np.asarray(found.stiffness_N_per_m, dtype=float)
    use = np.isfinite(stiffness) & (stiffness > 0)
    place = np.asarray(found.vertices_m)[use]
    logarithm = np.log(stiffness[use])
    distance, near = cKDTree(place).query(points, k=min(3, len(place)))
    near = np.asarray(near).reshape(len(points), -1)
    weight = 1 / np.maximum(np.asarray(distance).reshape(near.shape), 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    away = np.log(measured) - (logarithm[near] * weight).sum(axis=1)
    common, local, reach_m = CLASS if deviations is None else OUTLINE
    several = np.zeros((1, len(place))) if deviations is None else deviations[:, use]
    there = (several[:, near] * weight).sum(axis=2)
    scale = max(len(several) - 1, 1)
    here, at = (_folded(one, deviations is not None) / reach_m for one in (place, points))

    def kernel(a: np.ndarray, b: np.ndarray, da: np.ndarray, db: np.ndarray) -> np.ndarray:
        square = ((a[:, None, :] - b[None]) ** 2).sum(axis=2)
        out: np.ndarray = common**2 + local**2 * np.exp(-0.5 * square) + da.T @ db / scale
        return out

    cross = kernel(here, at, several, there)
    solved = np.linalg.solve(kernel(at, at, there, there) + np.diag(sigma**2), np.c_[away, cross.T])
    mean = cross @ solved[:, 0]
    before = common**2 + local**2 + (several**2).sum(axis=0) / scale
    variance = before - np.einsum("vk,kv->v", cross, solved[:, 1:])
    new, new_sigma = stiffness.copy(), np.full_like(stiffness, np.nan)
    new[use] = np.exp(logarithm + mean)
    new_sigma[use] = new[use] * np.sqrt(np.maximum(variance, 0.0))
    return replace(found, stiffness_N_per_m=new, stiffness_sigma_N_per_m=new_sigma)


def _folded(points_m: Float[np.ndarray, "n 3"], even: bool) -> Float[np.ndarray, "n 3"]:
    """Coordinates in which both ends of a pinch are the same point, and, around an even body, all points of a height."""
    x, y, z = points_m.T
    radius, twice = (0.0 * x if even else np.hypot(x, y)), 2.0 * np.arctan2(y, x)
    return np.column_stack([radius * np.cos(twice), radius * np.sin(twice), z])
