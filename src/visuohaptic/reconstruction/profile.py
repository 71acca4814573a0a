"""A second opinion on the hidden wall: a Gaussian process of its radius around the height axis.

In cylinder coordinates (rho, theta, z)

    log rho = p(z) + e0(theta) + w(z) (e1(theta) - e0(theta)) + g(theta, z)

with the profile ``p``, the cross-sections ``e0`` and ``e1`` of the bands below
and above the hole (:mod:`.symmetry`), the share ``w`` of the upper one, which
is 0 and 1 in the bands and unknown between them, and what the cross-sections
leave over, ``g``. ``p`` and ``g`` are processes with Matern's covariance of
order 3/2 over the height, because walls have kinks; ``w`` is a Brownian bridge
around a straight line.

The spline of space and this process err in different ways: the one overshoots
between rings, the other knows walls around an axis only. With the mean m and
the variance v of the process, an estimate r of a wall f is off by

    E (r - f)^2 = (r - m)^2 + v

where the first part ranks the places and the second is what no model knows.
``v`` is scaled by how far each contact is off what all the others foretell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .._threads import one_blas_thread
from .hole import SupportBand
from .symmetry import ShapePrior

__all__ = ["RadialModel", "fit_radial_model"]

#: Correlation lengths in sizes of the region, and deviations of p, among which the likeliest pair is taken.
_LENGTHS, _DEVIATIONS = (0.15, 0.3, 0.6), (0.01, 0.02, 0.05, 0.1, 0.2)
#: Deviation of the unknown mean of log rho, and of a bin of the visible band.
_MEAN, _BAND = 0.3, 0.002
#: Bins of each band: heights and angles.
_HEIGHTS, _ANGLES = 5, 8
#: Correlation of g: length in sizes of the region, and over the angle [rad].
_OVER_HEIGHT, _OVER_ANGLE_RAD = 0.3, 0.35
#: Scale of the variance before contacts tell (on 30 bottles the likeliest process was too rough by this), in contacts.
_SCALE, _SCALE_WEIGHT = 0.4, 4.0
#: Squared standardised misses above this count as this: one contact with something else must not rule.
_LARGEST_MISS = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class RadialModel:
    """The process given the bands and the contacts."""

    prior: ShapePrior
    size_m: float  #: of the region
    theta: Float[np.ndarray, "k"]  #: angles of the known places [rad]
    z_m: Float[np.ndarray, "k"]  #: and their heights [m]
    length: float  #: correlation length of p, in sizes of the region
    deviation: float  #: of p
    mean: float  #: of log rho without its cross-section
    lower: Float[np.ndarray, "k k"]  #: Cholesky factor of the covariance of the known places
    whitened: Float[np.ndarray, "k"]  #: what is known, times the inverse of that factor
    scale: float = 1.0  #: of the variance

    def expected(
        self, points_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Distance of the wall from the axis at the angles and heights of points [m], and its deviation [m]."""
        from scipy.linalg import solve_triangular

        theta, _ = _polar(points_m, self.prior)
        z_m = points_m[:, 2]
        cross = self._covariance(theta, z_m, self.theta, self.z_m)
        solved = solve_triangular(self.lower, cross.T, lower=True, check_finite=False)
        log_rho = self.mean + self.prior.section(theta, z_m) + self.whitened @ solved
        at = _share(self.prior, z_m)
        own = self.deviation**2 + _MEAN**2 + self.prior.residual**2
        own = own + at * (1 - at) * _difference(self.prior, theta) ** 2
        variance = self.scale * np.maximum(own - (solved**2).sum(axis=0), 0.0)
        rho_m = np.exp(np.clip(log_rho, -20.0, 20.0))
        return rho_m, rho_m * np.sqrt(variance)

    def deviation_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Root mean square radial distance of estimated points from the wall [m]; no less than to the wall itself."""
        if not len(points_m):
            return np.zeros(0)
        expected_m, sigma_m = self.expected(points_m)
        return np.hypot(_polar(points_m, self.prior)[1] - expected_m, sigma_m)

    def _covariance(
        self, theta: np.ndarray, z_m: np.ndarray, theta2: np.ndarray, z2_m: np.ndarray
    ) -> np.ndarray:
        return _covariance(self.prior, self.size_m, (theta, z_m), (theta2, z2_m), self.length, self.deviation)


@one_blas_thread()
def fit_radial_model(
    prior: ShapePrior,
    band: SupportBand,
    contacts: Sequence[tuple[Float[np.ndarray, "3"], float]],
    size_m: float,
) -> RadialModel:
    """The likeliest process, and its scale by leaving out one contact after the other.

    Parameters
    ----------
    prior
        Axis and cross-sections of the bands.
    band, contacts
        Visible supports; contacts with their standard deviation [m].
    size_m
        Of the region.
    """
    wall = np.abs(band.normals[:, 2]) < 0.85
    theta, z_m, logs = _bins(band.points_m[wall], prior)
    noise = np.full(len(z_m), _BAND**2)
    if contacts:
        touched = np.array([contact for contact, _ in contacts])
        angle, rho_m = _polar(touched, prior)
        theta, z_m = np.append(theta, angle), np.append(z_m, touched[:, 2])
        logs = np.append(logs, np.log(rho_m) - prior.section(angle, touched[:, 2]))
        noise = np.append(noise, (np.array([sigma for _, sigma in contacts]) / rho_m) ** 2)
    mean = float(logs.mean())
    best: tuple[float, float, float, np.ndarray, np.ndarray] | None = None
    # Only p has parameters here: the rest is computed once.
    rest = _covariance(prior, size_m, (theta, z_m), (theta, z_m), 1.0, 0.0) + np.diag(noise + 1e-10)
    for length in _LENGTHS:
        shape = _matern((z_m[:, None] - z_m) / size_m, length)
        for deviation in _DEVIATIONS:
            lower = np.linalg.cholesky(rest + deviation**2 * shape)
            whitened = _solved(lower, logs - mean)
            likelihood = -0.5 * float(whitened @ whitened) - float(np.log(np.diag(lower)).sum())
            if best is None or likelihood > best[0]:
                best = likelihood, length, deviation, lower, whitened
    assert best is not None
    _, length, deviation, lower, whitened = best
    count = len(contacts)
    # y_i - mean_without_i = (K^-1 y)_i / (K^-1)_ii, with variance 1 / (K^-1)_ii.
    inverse = _solved(lower, np.eye(len(lower)))
    misses = (inverse.T @ whitened) ** 2 / (inverse**2).sum(axis=0)
    told = np.minimum(misses[len(misses) - count :], _LARGEST_MISS).sum()
    scale = float((_SCALE_WEIGHT * _SCALE + told) / (_SCALE_WEIGHT + count))
    return RadialModel(prior, size_m, theta, z_m, length, deviation, mean, lower, whitened, scale)


def _solved(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    from scipy.linalg import solve_triangular

    found: np.ndarray = solve_triangular(lower, right, lower=True, check_finite=False)
    return found


def _matern(gap: np.ndarray, length: float) -> np.ndarray:
    """Matern's correlation of order 3/2."""
    reach = np.sqrt(3.0) / length * np.abs(gap)
    near: np.ndarray = (1 + reach) * np.exp(-reach)
    return near


def _covariance(
    prior: ShapePrior,
    size_m: float,
    here: tuple[np.ndarray, np.ndarray],
    there: tuple[np.ndarray, np.ndarray],
    length: float,
    deviation: float,
) -> np.ndarray:
    """Covariance of log rho between places (theta, z)."""
    (theta, z_m), (theta2, z2_m) = here, there
    gap = (z_m[:, None] - z2_m) / size_m
    found = np.full(gap.shape, _MEAN**2)
    if deviation > 0:
        found += deviation**2 * _matern(gap, length)
    at, at2 = _share(prior, z_m)[:, None], _share(prior, z2_m)
    bridge = np.minimum(at, at2) * (1 - np.maximum(at, at2))
    found += bridge * np.outer(_difference(prior, theta), _difference(prior, theta2))
    turn = np.exp((np.cos(theta[:, None] - theta2) - 1) / _OVER_ANGLE_RAD**2)
    found += prior.residual**2 * _matern(gap, _OVER_HEIGHT) * turn
    return found


def _polar(points_m: Float[np.ndarray, "n 3"], prior: ShapePrior) -> tuple[np.ndarray, np.ndarray]:
    """Angle [rad] and distance from the axis [m]."""
    offset = points_m[:, :2] - prior.axis_m
    return np.arctan2(offset[:, 1], offset[:, 0]), np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6)


def _share(prior: ShapePrior, z_m: np.ndarray) -> np.ndarray:
    """Expected share of the upper cross-section."""
    low, high = prior.heights_m[0], prior.heights_m[-1]
    found: np.ndarray = np.clip((z_m - low) / max(high - low, 1e-9), 0.0, 1.0)
    return found


def _difference(prior: ShapePrior, theta: np.ndarray) -> np.ndarray:
    """Upper cross-section less the lower one."""
    low, high = prior.heights_m[0], prior.heights_m[-1]
    found: np.ndarray = prior.section(theta, np.full(len(theta), high)) - prior.section(
        theta, np.full(len(theta), low)
    )
    return found


def _bins(points_m: Float[np.ndarray, "n 3"], prior: ShapePrior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, heights and log rho without its cross-section, mean of bins of the bands."""
    theta, rho_m = _polar(points_m, prior)
    logs = np.log(rho_m) - prior.section(theta, points_m[:, 2])
    sector = np.floor((theta + np.pi) / (2 * np.pi) * _ANGLES).astype(int) % _ANGLES
    nearest = np.abs(points_m[:, 2:] - prior.heights_m).argmin(axis=1)
    found = []
    for number in range(len(prior.heights_m)):
        rows = np.flatnonzero(nearest == number)
        for part in np.array_split(rows[np.argsort(points_m[rows, 2])], _HEIGHTS):
            for place in np.unique(sector[part]):
                chosen = part[sector[part] == place]
                turn = np.arctan2(np.sin(theta[chosen]).mean(), np.cos(theta[chosen]).mean())
                found.append((turn, points_m[chosen, 2].mean(), logs[chosen].mean()))
    turns, heights, means = np.array(found).T
    return turns, heights, means
