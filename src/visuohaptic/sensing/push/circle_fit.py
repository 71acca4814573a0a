"""Non-iterative circle fit. Symbols: K points (x, y), centre (a, b), radius R."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError


def fit_circle_algebraic(points_m: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "3"]:
    """Taubin's circle fit: minimises sum (z - 2ax - 2by + c)², z = x² + y², normalised by the mean squared gradient.

    Almost unbiased for short arcs, where the plain algebraic fit (Kåsa)
    underestimates the radius. Solved by a singular value decomposition of the
    centred data, which is accurate also for nearly straight arcs.

    Parameters
    ----------
    points_m
        At least three points (K, 2) [m], not all collinear.

    Returns
    -------
    Centre and radius (a, b, R) [m].

    Raises
    ------
    InputError
        Fewer than three points, or exactly collinear or coincident ones.

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
