"""Outline of an object on the floor from its laser points: box or cylinder, pose, size and their standard deviations.

Points of a face of width w are uniform along it, with Gaussian errors of the laser: the density at a distance v from the face
and u from its middle is ``N(v; 0, s) (Phi((u + w/2) / s) - Phi((u - w/2) / s)) / w``. Its maximum likelihood has neither the
excess of the outermost of many points nor the deficit of their quantiles. A box shows its near face and parts of two sides, in
unknown proportions; the visible arc of a cylinder follows from the positions of the laser. Points of neither are uniform.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.geometry import compose_2d, rotation_2d

#: Standard deviation of laser points from their outline [m]: 9.3 +- 0.8 mm over twenty objects of random houses, for a laser
#: of 10 mm. Errors of points of one scan are correlated: for the choice between shapes, a group counts as this many independent
#: points, because the root mean square of a group varies by 21 % = 1 / sqrt(2 * 11) over 142 objects.
POINT_M, INDEPENDENT = 0.0093, 10
#: Standard deviation of a range of the laser; and, across a beam, of positions of a scan relative to the others of the same
#: object: 1.4 mm, and 1.2 mrad of its heading at a metre [m].
RANGE_M, PLACE_M = 0.01, 0.002
#: Standard deviation of a fitted width beyond that of the points [m]: of 58 objects of random houses 5.2 mm.
SIDE_M = 0.0052
#: Prior of the depth of a box: lognormal about its width; this factor is one standard deviation.
DEPTH_FACTOR = 1.4
#: Number of points that are fitted, and rotations from which the fit may start [rad].
MAX_POINTS, TURNS_RAD = 150, np.radians(np.arange(-45.0, 45.0, 7.5))


@dataclass(frozen=True, slots=True, eq=False)
class FloorOutline:
    """A box or a cylinder on the floor, observed from one side."""

    round: bool
    pose: tuple[float, float, float]  #: middle of the near side: x, y [m], direction into the object [rad]
    size_m: tuple[float, float]  #: width of the near side, and depth [m]
    sigma_m: tuple[float, float]  #: standard deviations of both [m]
    log_likelihood: float = 0.0  #: of the laser points

    @property
    def centre_m(self) -> Float[np.ndarray, "2"]:
        """Centre of the outline [m]."""
        return np.array(compose_2d(self.pose, (0.5 * self.size_m[1], 0.0, 0.0))[:2])

    @property
    def corners_m(self) -> Float[np.ndarray, "p 2"]:
        """Corners: four of a box, sixteen of a cylinder [m]."""
        width, depth = self.size_m
        if self.round:
            angle = np.arange(16) * math.pi / 8
            return self.centre_m + 0.5 * width * np.column_stack([np.cos(angle), np.sin(angle)])
        own = np.array([[0.0, -0.5], [1.0, -0.5], [1.0, 0.5], [0.0, 0.5]]) * (depth, width)
        return own @ rotation_2d(self.pose[2]).T + self.pose[:2]


def log_depth_prior(width_m: float, depth_m: float) -> float:
    """Logarithm of the prior density of the depth of a box [1/m], given its width.

    Parameters
    ----------
    width_m, depth_m
        Size of the box [m].
    """
    sigma = math.log(DEPTH_FACTOR)
    deviate = math.log(depth_m / width_m) / sigma
    return -0.5 * deviate**2 - math.log(math.sqrt(2.0 * math.pi) * sigma * depth_m)


def fit_outlines(
    points_m: Float[np.ndarray, "k 2"], views_m: Float[np.ndarray, "v 2"], heading_rad: float
) -> tuple[FloorOutline, FloorOutline]:
    """The most probable box and cylinder, the more probable one first.

    Parameters
    ----------
    points_m
        Laser points of one object [m].
    views_m
        Positions of the laser [m].
    heading_rad
        Direction of passage [rad]: the near face of the box is the one that is turned by at most 45 degrees from it, and that
        of the cylinder is where this direction meets it.
    """
    turn = rotation_2d(heading_rad)
    local = (points_m @ turn)[:: max(1, len(points_m) // MAX_POINTS)]
    found = []
    for one in (_fit_box(local, views_m @ turn), _fit_cylinder(local, views_m @ turn)):
        x, y = turn @ one.pose[:2]
        found.append(replace(one, pose=(float(x), float(y), one.pose[2] + heading_rad)))
    box, cylinder = found
    return (box, cylinder) if box.log_likelihood > cylinder.log_likelihood else (cylinder, box)


def _fit_box(points_m: Float[np.ndarray, "k 2"], views_m: Float[np.ndarray, "v 2"]) -> FloorOutline:
    """Box whose near face is seen along x."""
    stray = _stray_density(points_m)
    beams = points_m.mean(axis=0) - views_m
    # Errors of ranges are along the beams, from each view as many as it is near.
    near = 1.0 / np.hypot(*beams.T)
    beams *= near[:, None]
    covariance = RANGE_M**2 * (beams.T * near) @ beams / near.sum() + PLACE_M**2 * np.eye(2)

    def log_likelihood(values: Float[np.ndarray, "5"]) -> float:
        x, y, yaw, width, depth = values
        if min(width, depth) < POINT_M or abs(yaw) > 0.25 * math.pi:
            return -math.inf
        turn = rotation_2d(yaw)
        v, u = ((points_m - (x, y)) @ turn).T
        noise_v, noise_u = np.sqrt(np.diag(turn.T @ covariance @ turn))
        sides = (_face(u + s * width, noise_u, v - 0.5 * depth, noise_v, depth) for s in (-0.5, 0.5))
        return _log_mixture([_face(v, noise_v, u, noise_u, width), *sides, stray])

    def log_posterior(values: Float[np.ndarray, "5"]) -> float:
        value = log_likelihood(values)
        return value + log_depth_prior(values[3], values[4]) if value > -math.inf else value

    starts = []
    for yaw in TURNS_RAD:
        turn = rotation_2d(float(yaw))
        low, high = np.quantile(points_m @ turn, (0.04, 0.96), axis=0)
        width = max(float(high[1] - low[1]), 0.04)
        near = turn @ np.array([low[0], 0.5 * (low[1] + high[1])])
        starts.append(np.array([*near, yaw, width, max(float(high[0] - low[0]), 0.5 * width)]))
    start = max(starts, key=log_posterior)
    best, scale = _maximum(log_posterior, start, (0.01, 0.01, 0.1, 0.02, 0.03)), INDEPENDENT / len(points_m)
    x, y, yaw, width, depth = (float(one) for one in best)
    sigma = (
        math.hypot(SIDE_M, _sigma(log_posterior, best, 3)),
        math.hypot(SIDE_M, _sigma(log_posterior, best, 4)),
    )
    return FloorOutline(False, (x, y, yaw), (width, depth), sigma, scale * log_likelihood(best))


def _fit_cylinder(points_m: Float[np.ndarray, "k 2"], views_m: Float[np.ndarray, "v 2"]) -> FloorOutline:
    """Cylinder seen along x."""
    stray = _stray_density(points_m)

    def log_likelihood(values: Float[np.ndarray, "3"]) -> float:
        x, y, radius = values
        if radius < POINT_M:
            return -math.inf
        own, towards = points_m - (x, y), views_m - (x, y)
        distance, away = np.hypot(*own.T), np.hypot(*towards.T)
        # Points per length of the arc, of a laser in each position: as the cosine of the incidence, by distance.
        cosine = np.maximum((own / distance[:, None]) @ (towards / away[:, None]).T, 0.0)
        arc = cosine @ (1.0 / away) / (2.0 * radius * np.sum(1.0 / away))
        return _log_mixture([_gauss(distance - radius, POINT_M) * arc, stray])

    low, high = np.quantile(points_m, (0.04, 0.96), axis=0)
    radius = 0.5 * float(high[1] - low[1])
    start = np.array([low[0] + radius, 0.5 * (low[1] + high[1]), radius])
    best, scale = _maximum(log_likelihood, start, (0.01, 0.01, 0.01)), INDEPENDENT / len(points_m)
    x, y, radius = (float(one) for one in best)
    width, sigma = 2.0 * radius, math.hypot(SIDE_M, 2.0 * _sigma(log_likelihood, best, 2))
    return FloorOutline(
        True, (x - radius, y, 0.0), (width, width), (sigma, sigma), scale * log_likelihood(best)
    )


def _gauss(off_m: Float[np.ndarray, "k"], sigma_m: float) -> Float[np.ndarray, "k"]:
    return np.exp(-0.5 * (off_m / sigma_m) ** 2) / (sigma_m * math.sqrt(2.0 * math.pi))


def _face(
    off_m: Float[np.ndarray, "k"],
    off_sigma_m: float,
    along_m: Float[np.ndarray, "k"],
    along_sigma_m: float,
    width_m: float,
) -> Float[np.ndarray, "k"]:
    """Density of the points of a face [1/m^2]."""
    from scipy.special import ndtr

    ends = [(along_m + s * width_m) / along_sigma_m for s in (0.5, -0.5)]
    return _gauss(off_m, off_sigma_m) * (ndtr(ends[0]) - ndtr(ends[1])) / width_m


def _stray_density(points_m: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k"]:
    """Density of points of neither face, uniform where there are points [1/m^2]."""
    return np.full(len(points_m), 1.0 / float(np.prod(np.ptp(points_m, axis=0) + 4.0 * POINT_M)))


def _log_mixture(densities: list[Float[np.ndarray, "k"]]) -> float:
    """Log likelihood of points of several sources in the most probable proportions (EM)."""
    parts = np.array(densities) + 1e-300
    weights = np.full(len(parts), 1.0 / len(parts))
    for _ in range(8):
        of = weights[:, None] * parts
        weights = (of / of.sum(axis=0)).mean(axis=1)
    return float(np.log(weights @ parts).sum())


def _maximum(
    log_posterior: Callable[[np.ndarray], float], start: Float[np.ndarray, "n"], steps: tuple[float, ...]
) -> Float[np.ndarray, "n"]:
    """Parameters of the largest value."""
    from scipy.optimize import minimize

    simplex = np.vstack([start, start + np.diag(steps)])
    options = {"initial_simplex": simplex, "maxiter": 500, "xatol": 2e-4, "fatol": 0.05}
    found = minimize(lambda values: -log_posterior(values), start, method="Nelder-Mead", options=options)
    return np.asarray(found.x)


def _sigma(log_posterior: Callable[[np.ndarray], float], best: Float[np.ndarray, "n"], which: int) -> float:
    """Standard deviation of a parameter by the curvature of its posterior over the laser's noise [m]."""
    step = np.zeros(len(best))
    step[which] = POINT_M
    drop = 2.0 * log_posterior(best) - log_posterior(best - step) - log_posterior(best + step)
    return POINT_M / math.sqrt(max(drop, 1e-3))
