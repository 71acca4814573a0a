"""Prediction of hidden rings from the visible parts of upright objects with similar cross-sections.

In cylinder coordinates (rho, theta, z) about the height axis a container is
often ``log rho = log R(z) + e(theta, z)``, where the cross-section ``e`` hardly
changes with height. It is fitted to the bands below and above the hole
separately and interpolated between them. ``e = 0`` is rotational symmetry,
``e(-theta) = e(theta)`` about some direction a mirror plane; the probability of
both is computed from the residuals. One touch then gives ``R`` at its height,
and so the whole ring, with the uncertainty of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: Maximum vertical component of the unit normal of a wall; at floors and shoulders the height does not determine the radius.
MAX_WALL_NZ = 0.85
#: Maximum order n of the harmonics of a cross-section; of a box 1 : 2.3, they leave sqrt(.49 / n^3) of the log radius, .008 with this one.
ORDER = 20
#: Ratios of the variance of the cross-section to that of the noise among which the marginal likelihood chooses.
_RATIOS = np.append(0.0, np.geomspace(1e-3, 1e7, 41))
#: Number of knots of log R(z) in a band.
_KNOTS = 6
#: Relative residual at which the probability of a symmetry is one half.
_HALF = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class ShapePrior:
    """A fitted cross-section."""

    axis_m: Float[np.ndarray, "2"]  #: x and y of the height axis [m]
    heights_m: Float[np.ndarray, "b"]  #: middle of each band [m], ascending
    harmonics: Float[np.ndarray, "b h"]  #: of e(theta) in each band: cos 1, sin 1, cos 2, ...
    residual: float  #: standard deviation of the residuals of log rho
    p_rotation: float  #: probability of rotational symmetry
    p_mirror: float  #: probability of a mirror plane through the axis
    p_sweep: float  #: probability that the cross-section keeps its shape between the bands
    uneven: float = 0.0  #: asymmetric part of e about the mirror plane, standard deviation of log rho
    mirror_rad: float = 0.0  #: direction of the mirror plane [rad]

    def section(self, theta: Float[np.ndarray, "n"], z_m: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Logarithm of the cross-section, e(theta) at heights: log rho minus log R.

        Parameters
        ----------
        theta
            Angles (n) around the axis [rad].
        z_m
            Heights (n) [m].
        """
        each = _basis(theta) @ self.harmonics.T
        low, high = self.heights_m[[0, -1]]
        t = np.clip((z_m - low) / max(high - low, 1e-9), 0.0, 1.0)
        between: Float[np.ndarray, "n"] = (1 - t) * each[:, 0] + t * each[:, -1]
        return between

    def mirrored(self, point_m: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], float]:
        """A contact reflected in the mirror plane, and the standard deviation of the result [m].

        It does not assume that the cross-section is constant over the height.

        Parameters
        ----------
        point_m
            Contact (3) [m].
        """
        offset = np.asarray(point_m)[:2] - self.axis_m
        along = np.array([np.cos(self.mirror_rad), np.sin(self.mirror_rad)])
        x, y = 2 * (offset @ along) * along - offset + self.axis_m
        point = np.array([x, y, float(point_m[2])])
        return point, float(np.hypot(*offset)) * float(np.hypot(self.uneven, self.residual))


def _basis(theta: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n h"]:
    orders = np.arange(1, ORDER + 1)
    turns = np.outer(theta, orders)
    return np.stack([np.cos(turns), np.sin(turns)], axis=-1).reshape(len(theta), 2 * ORDER)


def fit_prior(
    points_m: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    middle_z_m: float,
) -> ShapePrior | None:
    """Cross-section of the bands below and above ``middle_z_m``; ``None`` if neither covers the full circle.

    Source: own; the dissertation's extrapolation has no such prior.

    Parameters
    ----------
    points_m
        Points (n, 3) of the bands [m].
    normals
        Their unit normals (n, 3), outwards.
    middle_z_m
        Height that divides lower and upper band [m].
    """
    axis = height_axis(points_m, normals)
    theta, rho = polar(points_m, axis)
    wall = (np.abs(normals[:, 2]) < MAX_WALL_NZ) & (rho > 1e-6)
    parts = []
    for below in (True, False):
        rows = np.flatnonzero(wall & ((points_m[:, 2] < middle_z_m) == below))
        sectors = np.unique(np.floor((theta[rows] + np.pi) / (2 * np.pi) * 12).astype(int))
        if len(rows) >= 40 and len(sectors) >= 11:
            parts.append(rows)
    if not parts:
        return None
    fits = [_fit_band(np.log(rho[rows]), theta[rows], points_m[rows, 2]) for rows in parts]
    heights = np.array([float(np.median(points_m[rows, 2])) for rows in parts])
    # Errors of a surface are lengths, not fractions of the radius: those of a narrow neck are no measure of a wide wall.
    radius_m = np.sqrt([np.mean(rho[rows] ** 2) for rows in parts])
    off_m, number = radius_m * [fit[1] for fit in fits], [len(rows) for rows in parts]
    wide_m = float(np.sqrt(np.average(radius_m**2, weights=number)))
    residual = float(np.sqrt(np.average(off_m**2, weights=number))) / wide_m
    # The first one is the distance of the band's centre from the axis, a length as well.
    scale = np.where(np.arange(2 * ORDER) < 2, radius_m[:, None] / wide_m, 1.0)
    harmonics = scale * np.array([fit[0] for fit in fits])
    ripple = float(np.sqrt(np.mean(np.sum(harmonics**2, axis=1)) / 2))
    difference = float(np.sqrt(np.sum((harmonics[0] - harmonics[-1]) ** 2) / 2))
    mirror_rad, uneven = _mirror(harmonics)
    return ShapePrior(
        axis,
        heights,
        harmonics,
        max(residual, 0.004),
        _probability(np.hypot(ripple, residual)),
        _probability(np.hypot(uneven, residual)),
        _probability(np.hypot(difference, residual)),
        uneven,
        mirror_rad,
    )


def polar(
    points_m: Float[np.ndarray, "*n 3"], axis_m: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Angle [rad] around an upright axis and distance from it, at least 1e-6 [m].

    Parameters
    ----------
    points_m
        Points (..., 3) [m].
    axis_m
        x and y of the axis [m].
    """
    offset = points_m[..., :2] - axis_m
    return np.arctan2(offset[..., 1], offset[..., 0]), np.maximum(
        np.hypot(offset[..., 0], offset[..., 1]), 1e-6
    )


def height_axis(
    points_m: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "2"]:
    """x and y of the upright axis through the horizontal components of the normals [m].

    The point with least squared distance from the lines of the normals, regularised
    towards the centroid.

    Parameters
    ----------
    points_m
        Points of the surface [m], (N, 3).
    normals
        Their unit normals, (N, 3).
    """
    flat = normals[:, :2]
    length = np.linalg.norm(flat, axis=1)
    used = length > 0.5
    centroid = 0.5 * (points_m[:, :2].min(axis=0) + points_m[:, :2].max(axis=0))
    if used.sum() < 8:
        return centroid
    across = np.column_stack([-flat[used, 1], flat[used, 0]]) / length[used, None]
    matrix = across.T @ across + 0.05 * used.sum() * np.eye(2)
    right = across.T @ (across * points_m[used, :2]).sum(axis=1) + 0.05 * used.sum() * centroid
    return np.linalg.solve(matrix, right)


def _fit_band(
    log_rho: Float[np.ndarray, "n"], theta: Float[np.ndarray, "n"], z: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "h"], float]:
    """Harmonics in theta beside hat functions in z, and standard deviation of the noise.

    Coefficients of the order n have the prior deviation s / n^2: a radius with corners has kinks. The restricted marginal likelihood (Patterson and
    Thompson 1971), without what hat functions explain, determines s and the noise.
    """
    knots = np.linspace(z.min(), z.max() + 1e-9, _KNOTS)
    hats = np.maximum(0.0, 1.0 - np.abs(z[:, None] - knots) / (knots[1] - knots[0]))
    columns = np.column_stack([log_rho, _basis(theta)])
    heights, _, rank, _ = np.linalg.lstsq(hats, columns, rcond=None)
    columns -= hats @ heights
    falling = np.repeat(np.arange(1, ORDER + 1), 2) ** -2.0
    left, across = columns[:, 0], columns[:, 1:] * falling
    modes, sizes, right = np.linalg.svd(across, full_matrices=False)
    parts, free = modes.T @ left, len(z) - rank
    power = 1.0 + _RATIOS[:, None] * sizes**2  # variances of the modes, in those of the noise
    squares = max(float(left @ left - parts @ parts), 0.0) + (parts**2 / power).sum(axis=1)
    best = int(np.argmax(-free * np.log(np.maximum(squares, 1e-300)) - np.log(power).sum(axis=1)))
    harmonics = falling * (right.T @ (_RATIOS[best] * sizes / power[best] * parts))
    return harmonics, float(np.sqrt(squares[best] / free))


def _mirror(harmonics: Float[np.ndarray, "b h"]) -> tuple[float, float]:
    """Direction of the best mirror plane [rad], and the asymmetric part about it."""
    phases = np.pi * np.arange(90) / 90
    orders = np.arange(1, ORDER + 1)
    left = np.zeros(len(phases))
    for band in harmonics:
        turned = (band[0::2] + 1j * band[1::2])[None, :] * np.exp(-1j * np.outer(phases, orders))
        left += (turned.imag**2).sum(axis=1) / 2
    best = int(np.argmin(left))
    return float(phases[best]), float(np.sqrt(left[best] / len(harmonics)))


def _probability(deviation: float) -> float:
    return float(1.0 / (1.0 + (deviation / _HALF) ** 2))
