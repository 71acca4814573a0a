"""How far the estimated surface may be off: the spline's own variance, scaled by what touches found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..mesh import SurfaceMesh
from ..surfaces.rbf import RbfSurface

__all__ = ["SurfaceUncertainty", "between", "spline_sigma_m"]

#: Slope of the signed distance that is believed at least.
_MIN_SLOPE = 0.2
#: Points at which the variance is computed.
_SAMPLES = 150


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceUncertainty:
    """How far the estimated surface may be off."""

    mesh: SurfaceMesh  #: the planning mesh
    score: Float[np.ndarray, "v"]  #: biharmonic distance from the nearest support (Eq. 5.7)
    sigma_m: Float[np.ndarray, "v"]  #: standard deviation of the surface
    missing: Bool[np.ndarray, "v"]  #: whether a vertex is in the part that was not seen


def spline_sigma_m(fit: RbfSurface, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Kriging standard deviation of points of the zero surface along its normal [m].

    It is smooth: every few points are enough, the others take their neighbours'.

    Parameters
    ----------
    fit
        Spline.
    points_m
        Points (n, 3) of its zero surface [m].
    """
    some = points_m[:: max(1, len(points_m) // _SAMPLES)]
    # r(X) is a distance only where its slope is one: where it is flat, the surface moves farther.
    slope = np.maximum(np.linalg.norm(fit.gradient(some), axis=1), _MIN_SLOPE)
    return between(some, fit.kriging_sigma_m(some) / slope, points_m)


def between(
    known_m: Float[np.ndarray, "k 3"], values: Float[np.ndarray, "k"], points_m: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Values at points, from the three nearest known ones by inverse distance weights.

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
    gaps, near = (part.reshape(len(points_m), -1) for part in cKDTree(known_m).query(points_m, k=nearest))
    fraction = 1 / np.maximum(gaps, 1e-9)
    return (values[near] * fraction).sum(axis=1) / fraction.sum(axis=1)
