"""A second opinion on the hidden wall: radius over height by a Gaussian process of one dimension.

The spline of space and the profile err in different ways: the one overshoots
between rings, the other knows nothing of the angle. Where both agree the
surface is likely right; their disagreement, with what the cross-section leaves
over at an angle, ranks the places after many touches, when all supports are
about as near and the variance of the spline says little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .hole import SupportBand
from .symmetry import ShapePrior

__all__ = ["disagreement_m"]

#: Correlation lengths in sizes of the region, and deviations of log R, among which the likeliest is taken.
_LENGTHS, _DEVIATIONS = (0.15, 0.3, 0.6), (0.01, 0.02, 0.05, 0.1, 0.2)
#: Deviation of the unknown mean of log R, and of a bin of the visible band.
_MEAN, _BAND = 0.3, 0.002
#: Bins of heights in each band.
_BINS = 5


def disagreement_m(
    points_m: Float[np.ndarray, "n 3"],
    prior: ShapePrior,
    band: SupportBand,
    contacts: Sequence[tuple[Float[np.ndarray, "3"], float]],
    size_m: float,
) -> Float[np.ndarray, "n"]:
    """How far points of the estimated surface are off what profile and cross-section expect there [m].

    Parameters
    ----------
    points_m
        Points of the estimated surface.
    prior
        Axis and cross-sections, and what they leave over at each angle.
    band, contacts
        Visible supports; contacts with their standard deviation [m].
    size_m
        Of the region.
    """
    if not len(points_m):
        return np.zeros(0)
    wall = np.abs(band.normals[:, 2]) < 0.85
    heights, logs, noise = _bins(band.points_m[wall], prior)
    touched = np.array([contact for contact, _ in contacts]).reshape(-1, 3)
    _, touched_logs, _ = _cylinder(touched, prior)
    sigma_m = np.array([sigma for _, sigma in contacts])
    radius_m = float(np.exp(logs.mean()))
    heights = np.concatenate([heights, touched[:, 2]]) / size_m
    logs = np.concatenate([logs, touched_logs])
    # Half of a contact's residual is its ring's, half is the angle's own.
    noise = np.concatenate([noise, (1.3 * sigma_m / radius_m) ** 2 + 0.5 * prior.residual**2])
    rho_m, _, expected = _cylinder(points_m, prior)
    expected += _process_mean(heights, logs, noise, points_m[:, 2] / size_m)
    off_m = rho_m - np.exp(np.clip(expected, -20.0, 20.0))
    theta = np.arctan2(points_m[:, 1] - prior.axis_m[1], points_m[:, 0] - prior.axis_m[0])
    return np.hypot(off_m, rho_m * prior.spread(theta))


def _cylinder(points_m: Float[np.ndarray, "n 3"], prior: ShapePrior) -> tuple[np.ndarray, ...]:
    """Distance from the axis [m], its log without the cross-section, and the cross-section."""
    offset = points_m[:, :2] - prior.axis_m
    rho = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6)
    section = prior.section(np.arctan2(offset[:, 1], offset[:, 0]), points_m[:, 2])
    return rho, np.log(rho) - section, section


def _bins(
    points_m: Float[np.ndarray, "n 3"], prior: ShapePrior
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Mean height, mean log R and variance of bins of the bands."""
    _, logs, _ = _cylinder(points_m, prior)
    nearest = np.abs(points_m[:, 2:] - prior.heights_m).argmin(axis=1)
    heights, means = [], []
    for number in range(len(prior.heights_m)):
        rows = np.flatnonzero(nearest == number)
        for part in np.array_split(rows[np.argsort(points_m[rows, 2])], _BINS):
            if len(part):
                heights.append(float(points_m[part, 2].mean()))
                means.append(float(logs[part].mean()))
    return np.array(heights), np.array(means), np.full(len(heights), _BAND**2)


def _process_mean(
    x: Float[np.ndarray, "k"], y: Float[np.ndarray, "k"], noise: Float[np.ndarray, "k"], at: np.ndarray
) -> np.ndarray:
    """Mean of a process with Matern's covariance of order 3/2, likeliest of a few parameters."""
    middle = float(y.mean())

    def covariance(a: np.ndarray, length: float, deviation: float) -> np.ndarray:
        gap = np.sqrt(3.0) * np.abs(a[:, None] - x) / length
        return deviation**2 * (1 + gap) * np.exp(-gap) + _MEAN**2

    best, found = -np.inf, (np.zeros_like(y), _LENGTHS[0], _DEVIATIONS[0])
    for length in _LENGTHS:
        for deviation in _DEVIATIONS:
            matrix = covariance(x, length, deviation) + np.diag(noise + 1e-10)
            weights = np.linalg.solve(matrix, y - middle)
            likelihood = -0.5 * float((y - middle) @ weights + np.linalg.slogdet(matrix)[1])
            if likelihood > best:
                best, found = likelihood, (weights, length, deviation)
    return middle + covariance(at, *found[1:]) @ found[0]
