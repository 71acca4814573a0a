"""Standard deviation of the estimated surface: kriging variance of the spline, scaled by the residuals of touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..mesh import SurfaceMesh
from ..surfaces.rbf import RbfSurface
from .symmetry import ShapePrior

#: Minimum slope of the signed distance.
_MIN_SLOPE = 0.2
#: Number of points at which the variance is computed.
_SAMPLES = 150


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceUncertainty:
    """Standard deviation of the estimated surface at the vertices of the planning mesh."""

    mesh: SurfaceMesh  #: the planning mesh
    score: Float[np.ndarray, "v"]  #: biharmonic distance from the nearest support (Eq. 5.7)
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


class TouchResiduals:
    """Standardised residuals of touches, of the spline and of the predicted rings.

    Parameters
    ----------
    prior
        Symmetries of the object; ``None`` without rings.
    size_m
        Size of the region where the surface is missing [m].
    """

    def __init__(self, prior: ShapePrior | None, size_m: float) -> None:
        self._prior, self._size_m = prior, size_m
        self._of_spline: list[float] = []
        self._of_rings: list[float] = []

    def add(
        self,
        fit: RbfSurface,
        contact_m: Float[np.ndarray, "3"],
        sigma_m: float,
        earlier: Sequence[tuple[Float[np.ndarray, "3"], float]],
    ) -> None:
        """Record the residual of a touch before it is added to the fit.

        Parameters
        ----------
        fit
            Spline without the touch.
        contact_m
            Contact (3) [m].
        sigma_m
            Its standard deviation [m].
        earlier
            Earlier contacts (3) [m] and their standard deviations [m].
        """
        expected = float(fit.kriging_sigma_m(contact_m[None])[0])
        off_m = abs(float(fit(contact_m[None])[0]))
        self._of_spline.append(off_m / float(np.hypot(expected, sigma_m)))
        if self._prior is None:
            return
        for other, _ in earlier[-8:]:
            # A ring predicts other contacts only at its own height.
            if abs(other[2] - contact_m[2]) > 0.05 * self._size_m:
                continue
            points, sigma = self._prior.ring(other, 71)
            near = int(np.argmin(np.linalg.norm(points[:, :2] - contact_m[:2], axis=1)))
            gap = float(np.linalg.norm(points[near, :2] - contact_m[:2]))
            self._of_rings.append(gap / float(np.hypot(sigma[near], 1.5 * sigma_m)))

    @property
    def prior_inflation(self) -> float:
        """Factor on the standard deviation of rings, from the residuals of touches; at least 1."""
        if not self._of_rings:
            return 1.0
        return float(max(1.0, np.sqrt(np.mean(np.square(self._of_rings)))))

    @property
    def calibration(self) -> float:
        """Root mean square of the standardised residuals of the spline, with two pseudo-residuals of 3.

        The process is fitted to the visible bands, and hidden parts are rougher than
        visible ones: without touches its standard deviation is too small.
        """
        squares = [9.0, 9.0, *(min(value, 10.0) ** 2 for value in self._of_spline)]
        return float(np.sqrt(np.mean(squares)))
