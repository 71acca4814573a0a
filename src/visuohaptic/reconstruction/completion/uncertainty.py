"""Standard deviation of the estimated surface: kriging variance of the spline, scaled by the residuals of touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..mesh import SurfaceMesh
from ..surfaces.rbf import RbfSurface

#: Minimum slope of the signed distance.
_MIN_SLOPE = 0.2
#: Number of points at which the variance is computed.
_SAMPLES = 150


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceUncertainty:
    """Standard deviation of the estimated surface at the vertices of the planning mesh."""

    mesh: SurfaceMesh  #: the planning mesh
    sigma_m: Float[np.ndarray, "v"]  #: standard deviation of the surface [m]
    missing: Bool[np.ndarray, "v"]  #: whether a vertex is in the missing part


def spline_sigma_m(fit: RbfSurface, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Kriging standard deviation of points of the zero surface along its normal [m].

    The variance is smooth: it is computed at a subset of the points and interpolated.

    Parameters
    ----------
    fit
        Spline.
    points_m
        Points (n, 3) of its zero surface [m].
    """
    some = points_m[:: max(1, len(points_m) // _SAMPLES)]
    # r(X) is a distance only where its slope is one; where it is flatter, an error of r moves the surface farther.
    slope = np.maximum(np.linalg.norm(fit.gradient(some), axis=1), _MIN_SLOPE)
    return between(some, fit.kriging_sigma_m(some) / slope, points_m)


def between(
    known_m: Float[np.ndarray, "k 3"], values: Float[np.ndarray, "k"], points_m: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Values at points, interpolated from the three nearest known points with inverse distance weights.

    Parameters
    ----------
    known_m
        Points (k, 3) with values [m].
    values
        Their values (k).
    points_m
        Points (n, 3) [m].
    """
    from scipy.spatial import cKDTree

    nearest = min(3, len(known_m))
    gaps, near = (part.reshape(-1, nearest) for part in cKDTree(known_m).query(points_m, k=nearest))
    fraction = 1 / np.maximum(gaps, 1e-9)
    return (values[near] * fraction).sum(axis=1) / fraction.sum(axis=1)


def calibration(squares: Sequence[float]) -> float:
    """Factor on the deviation of a spline: root mean square of the standardised residuals of touches, with two pseudo-residuals of 3.

    The process is fitted to the visible bands, and hidden parts are rougher than
    visible ones: without touches its standard deviation is too small.

    Parameters
    ----------
    squares
        Squared standardised residual of every touch before it was added.
    """
    return float(np.sqrt(np.mean([9.0, 9.0, *np.minimum(squares, 100.0)])))


def matern(gap: np.ndarray, length: float, order: int = 3) -> np.ndarray:
    """Matern's correlation.

    Parameters
    ----------
    gap
        Distances, of any shape.
    length
        Correlation length, in the unit of the distances.
    order
        Twice the order: 3 or 5.
    """
    reach = np.sqrt(float(order)) / length * np.abs(gap)
    near: np.ndarray = (1 + reach if order == 3 else 1 + reach + reach**2 / 3) * np.exp(-reach)
    return near
