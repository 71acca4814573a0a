"""The group of homographies near the identity: velocity fields, their images, and sanity."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .homography import apply_homography

__all__ = ["is_proper", "motion_jacobian", "velocity_fields"]


def velocity_fields(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 8"]:
    """The eight velocity fields of a small homography at centred points."""
    x, y = points[:, 0], points[:, 1]
    result = np.zeros((len(points), 2, 8))
    for axis in range(2):
        result[:, axis, 3 * axis] = 1
        result[:, axis, 3 * axis + 1] = x
        result[:, axis, 3 * axis + 2] = y
        result[:, axis, 6] = -x * points[:, axis]
        result[:, axis, 7] = -y * points[:, axis]
    return result


def motion_jacobian(h: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """d(image point) / d(eight parameters) for ``h exp(A)`` at centred points, (n, 2, 8)."""
    mapped = points @ h[:, :2].T + h[:, 2]
    depth = mapped[:, 2:]
    image = mapped[:, :2] / depth
    # d pi(h x) / dx, with pi the division by the third coordinate.
    local = (h[None, :2, :2] - image[:, :, None] * h[None, 2:, :2]) / depth[:, :, None]
    return np.asarray(local @ velocity_fields(points))


def is_proper(homography: np.ndarray, corners: np.ndarray) -> bool:
    """The quadrilateral is convex, keeps its orientation and stays in front of the horizon."""
    mapped = apply_homography(homography, corners)
    if not np.isfinite(mapped).all():
        return False
    sides = np.roll(mapped, -1, axis=0) - mapped
    after = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    return bool((turns > 1.0).all())
