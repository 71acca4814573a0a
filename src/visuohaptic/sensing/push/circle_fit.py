"""Circle through noisy points: an algebraic start without iteration, then the geometric optimum.

Symbols: K points (x, y), centre (a, b), radius R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError

__all__ = ["CircleFit", "fit_circle", "fit_circle_algebraic"]


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit:
    """Result of :func:`fit_circle`."""

    parameters: Float[np.ndarray, "3"]  #: (a, b, R) [m]
    covariance: Float[np.ndarray, "3 3"]  #: [m²]
    chi2: float  #: weighted sum of squared orthogonal distances
    converged: bool


def fit_circle_algebraic(points_m: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "3"]:
    """Taubin's fit: minimises sum (z - 2ax - 2by + c)² under the mean squared gradient.

    Almost unbiased for short arcs, where the plain algebraic fit (Kåsa)
    shrinks the radius. Solved by a singular value decomposition of the
    centred data, which stays exact for nearly straight arcs.

    Parameters
    ----------
    points_m
        At least three points, not all on one line.

    Returns
    -------
    Centre and radius (a, b, R) [m].

    Raises
    ------
    InputError
        Fewer than three points, or exactly collinear ones.

    Notes
    -----
    Alt 2016, Sec. 3.3.3 ("algebraic approach described in [81]").
    """
    points = np.asarray(points_m, dtype=float)
    if len(points) < 3:
        raise InputError("points_m", f"found {len(points)} points, expected at least 3 for a circle")
    centroid = points.mean(axis=0)
    xy = points - centroid
    z = np.einsum("ki,ki->k", xy, xy)
    mean = z.mean()
    if mean <= 0:
        raise InputError("points_m", "found coinciding points, expected points on an arc")
    z0 = (z - mean) / (2.0 * np.sqrt(mean))
    _, _, rows = np.linalg.svd(np.column_stack([z0, xy]), full_matrices=False)
    v = rows[-1]
    if abs(v[0]) < 1e-12 * np.linalg.norm(v):
        raise InputError("points_m", "found collinear points, expected points on an arc")
    first = v[0] / (2.0 * np.sqrt(mean))
    offset = -mean * first
    centre = -v[1:] / (2.0 * first)
    radius = np.sqrt(v[1] ** 2 + v[2] ** 2 - 4.0 * first * offset) / (2.0 * abs(first))
    return np.array([*(centre + centroid), radius])


def fit_circle(
    points_m: Float[np.ndarray, "K 2"],
    sigma_m: Float[np.ndarray, "K"] | float = 1.0,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    iterations: int = 50,
) -> CircleFit:
    """Circle of least weighted orthogonal distance, with its covariance.

    Minimises sum ((|X_k - X_0| - R) / sigma_k)² by Levenberg-Marquardt from
    the algebraic fit. The covariance is that of independent noise sigma_k
    along the normal (J^T J)^-1; it is not scaled by the residual.

    Parameters
    ----------
    points_m
        Points on an arc [m], K >= 3.
    sigma_m
        Standard deviation of each point along the normal [m].
    start
        (a, b, R) to start from; the algebraic fit when absent.
    iterations
        Upper limit.
    """
    points = np.asarray(points_m, dtype=float)
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=float), (len(points),))
    if not np.all(sigma > 0):
        raise InputError("sigma_m", f"found {sigma.min()}, expected standard deviations > 0")
    theta = fit_circle_algebraic(points) if start is None else np.array(start, dtype=float)

    def model(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = points - theta[:2]
        distance = np.hypot(away[:, 0], away[:, 1])
        residual = (distance - theta[2]) / sigma
        jacobian = np.column_stack([-away / distance[:, None], -np.ones(len(points))]) / sigma[:, None]
        return residual, jacobian

    residual, jacobian = model(theta)
    cost, damping, converged = float(residual @ residual), 1e-3, False
    for _ in range(iterations):
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -jacobian.T @ residual)
        trial = model(theta + step)
        trial_cost = float(trial[0] @ trial[0])
        if trial_cost <= cost:
            converged = bool(np.linalg.norm(step) < 1e-10 * abs(theta[2])) or cost - trial_cost < 1e-12 * cost
            theta, (residual, jacobian), cost = theta + step, trial, trial_cost
            damping = max(damping / 10, 1e-12)
            if converged:
                break
        else:
            damping *= 10
            if damping > 1e12:
                converged = True  # no step lowers the cost: at the optimum to rounding
                break
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return CircleFit(theta, 0.5 * (covariance + covariance.T), cost, converged)
