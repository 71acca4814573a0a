"""Homographies near the identity: velocity fields, their images, and plausibility."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def velocity_fields(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 8"]:
    """The eight velocity fields of a small homography at centred points.

    Parameters
    ----------
    points
        Centred points (x, y).
    """
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
    """Derivative of the image points with respect to the eight parameters A of ``h exp(A)``, (n, 2, 8).

    Parameters
    ----------
    h
        Homography from centred coordinates to pixels.
    points
        Centred points (x, y).
    """
    mapped = points @ h[:, :2].T + h[:, 2]
    depth = mapped[:, 2:]
    image = mapped[:, :2] / depth
    # d pi(h x) / dx, where pi divides by the third coordinate.
    local = (h[None, :2, :2] - image[:, :, None] * h[None, 2:, :2]) / depth[:, :, None]
    return np.asarray(local @ velocity_fields(points))


def is_proper(homography: Float[np.ndarray, "3 3"], corners: Float[np.ndarray, "4 2"]) -> bool:
    """Whether the image of a quadrilateral is convex, keeps its orientation and stays in front of the horizon.

    Plain numbers: this runs several times per frame, and arrays of four would take ten times as long.

    Parameters
    ----------
    homography
        Template pixels to image pixels.
    corners
        The quadrilateral (x, y).
    """
    (a, b, c), (d, e, f), (g, h, i) = homography.tolist()
    quad = []
    for x, y in corners.tolist():
        depth = g * x + h * y + i
        if not depth > 1e-9:
            return False
        quad.append(((a * x + b * y + c) / depth, (d * x + e * y + f) / depth))
    for k in range(4):
        (x0, y0), (x1, y1), (x2, y2) = quad[k - 2], quad[k - 1], quad[k]
        if not (x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1) > 1.0:
            return False
    return True
