"""Motion of the base in the image: rigid registration of the reference contour."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ....core.kernels import kernel
from ....core.measurement import SIGMA_PER_MAD
from ....tracking._solve_kernels import median

#: Prior standard deviations of the motion [px]: shift x, shift y, and the displacement by rotation and scale at
#: the far end. Unobservable directions (along a straight strip) remain zero.
_PRIOR_PX = 20.0
#: Cut-off of Tukey's biweight in standard deviations: 95 % efficient for Gaussian noise.
_TUKEY, _ITERATIONS = 4.685, 4


@dataclass(frozen=True, slots=True, eq=False)
class ImageMotion:
    """Similarity transform of the base in the image with respect to the zero reference."""

    parameters: Float[np.ndarray, "4"]  #: shift x, y [px], rotation and scale times the half length [px]
    covariance: Float[np.ndarray, "4 4"]


def motion_basis(
    points_px: Float[np.ndarray, "K 2"],
    direction_px: Float[np.ndarray, "K 2"],
    centre_px: Float[np.ndarray, "2"],
    length_px: float,
) -> Float[np.ndarray, "K 4"]:
    """Displacement of each point along its line per unit of each motion parameter.

    Parameters
    ----------
    points_px
        Points of the contour (x, y) [px].
    direction_px
        Unit directions of their lines.
    centre_px
        Centre of rotation and scale [px].
    length_px
        Half length of the contour [px].
    """
    offset = (points_px - centre_px) / length_px
    return np.column_stack(
        [
            direction_px[:, 0],
            direction_px[:, 1],
            direction_px[:, 1] * offset[:, 0] - direction_px[:, 0] * offset[:, 1],
            direction_px[:, 0] * offset[:, 0] + direction_px[:, 1] * offset[:, 1],
        ]
    )


def fit_motion(
    basis: Float[np.ndarray, "K 4"],
    shift_px: Float[np.ndarray, "K"],
    sigma_px: Float[np.ndarray, "K"],
    usable: Bool[np.ndarray, "K"],
) -> ImageMotion | None:
    """Robust weighted fit of a similarity motion; ``None`` if there are fewer than six inliers.

    Tukey's weights, initialised at the median shift: a base that is covered on up to a
    third of its length is still found.

    Parameters
    ----------
    basis
        From :func:`motion_basis`.
    shift_px
        Motion of each point along its line [px].
    sigma_px
        Its standard deviation [px].
    usable
        Points that were observed.
    """
    usable = usable & np.isfinite(shift_px) & (sigma_px > 0)
    if usable.sum() < 6:
        return None
    parameters, covariance, residual = np.empty(4), np.empty((4, 4)), np.empty(len(shift_px))
    scale = _tukey_fit(basis, shift_px, sigma_px, usable, parameters, covariance, residual)
    inliers = (usable & (np.abs(residual) < _TUKEY * scale)).sum()
    return ImageMotion(parameters, covariance) if inliers >= max(6, 0.3 * len(shift_px)) else None


@kernel(nogil=True)
def _tukey_fit(basis, shift, sigma, usable, parameters, covariance, residual):
    """Fill parameters (4), covariance (4, 4) and residuals (K) of the fit; returns the scatter of the residuals."""
    count, away, work = 0, np.empty(len(shift)), np.empty(len(shift))
    for k in range(len(shift)):
        if usable[k]:
            away[count], residual[count] = shift[k], sigma[k]
            count += 1
    middle, least, scale = median(away, count, work), median(residual, count, work), 0.0
    for k in range(len(shift)):
        residual[k] = shift[k] - middle
    rows = np.empty((4, 9))  # normal equations, right-hand side, and the identity that becomes the inverse
    for _ in range(_ITERATIONS):
        count = 0
        for k in range(len(shift)):
            if usable[k]:
                away[count] = abs(residual[k])
                count += 1
        scale = max(SIGMA_PER_MAD * median(away, count, work), least)
        for i in range(4):
            for j in range(9):
                rows[i, j] = 1.0 if j == 5 + i else 0.0
            rows[i, i] = 1.0 / _PRIOR_PX**2
        for k in range(len(shift)):
            ratio = residual[k] / (_TUKEY * scale)
            if usable[k] and abs(ratio) < 1.0:
                weight = (1.0 - ratio * ratio) ** 2 / sigma[k] ** 2
                for i in range(4):
                    for j in range(4):
                        rows[i, j] += weight * basis[k, i] * basis[k, j]
                    rows[i, 4] += weight * basis[k, i] * shift[k]
        # Gauss-Jordan without pivoting: the prior keeps the matrix positive definite.
        for i in range(4):
            pivot = rows[i, i]
            for j in range(9):
                rows[i, j] /= pivot
            for other in range(4):
                if other != i:
                    factor = rows[other, i]
                    for j in range(9):
                        rows[other, j] -= factor * rows[i, j]
        for k in range(len(shift)):
            residual[k] = shift[k]
            for i in range(4):
                residual[k] -= basis[k, i] * rows[i, 4]
    for i in range(4):
        parameters[i] = rows[i, 4]
        for j in range(4):
            covariance[i, j] = rows[i, 5 + j]
    return scale
