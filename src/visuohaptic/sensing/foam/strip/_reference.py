"""The reference contour as one rigid body: how the base has moved in the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ....tracking.contours.contour import quick_median

__all__ = ["ImageMotion", "fit_motion", "motion_basis"]

#: Prior standard deviations of the motion [px]: shift x, shift y, and what rotation and scale do at
#: the far end. Directions that the contour does not show (along a straight strip) stay at zero.
_PRIOR_PX = np.array([20.0, 20.0, 20.0, 20.0])


@dataclass(frozen=True, slots=True, eq=False)
class ImageMotion:
    """Similarity motion of the base in the image with respect to the zero reference."""

    parameters: Float[np.ndarray, "4"]  #: shift x, y [px], rotation and scale times the half length [px]
    covariance: Float[np.ndarray, "4 4"]
    inlier: Bool[np.ndarray, "K"]
    residual_px: float  #: robust scatter of the inliers about the fit

    @classmethod
    def none(cls, count: int) -> ImageMotion:
        """The base has not moved.

        Parameters
        ----------
        count
            K, points of the contour.
        """
        return cls(np.zeros(4), np.zeros((4, 4)), np.ones(count, dtype=bool), 0.0)


def motion_basis(
    points_px: Float[np.ndarray, "K 2"],
    direction_px: Float[np.ndarray, "K 2"],
    centre_px: Float[np.ndarray, "2"],
    length_px: float,
) -> Float[np.ndarray, "K 4"]:
    """How far each point moves along its line for a unit of each motion parameter.

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
    """Robust weighted fit of a similarity motion; ``None`` when fewer than six points agree.

    Tukey's weights from a start at the median shift: a base that is covered on up to a
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
        Points that were seen.
    """
    usable = usable & np.isfinite(shift_px) & (sigma_px > 0)
    if usable.sum() < 6:
        return None
    prior = np.diag(1.0 / _PRIOR_PX**2)
    weight = np.where(usable, 1.0 / np.where(usable, sigma_px, 1.0) ** 2, 0.0)
    shift = np.where(usable, shift_px, 0.0)
    residual = shift - quick_median(shift[usable])
    least = quick_median(sigma_px[usable])
    parameters = np.zeros(4)
    covariance = np.eye(4)
    scale = 0.0
    inlier = usable
    for _ in range(4):
        scale = max(1.4826 * quick_median(np.abs(residual[usable])), least)
        ratio = residual / (4.685 * scale)
        robust = np.where(np.abs(ratio) < 1.0, (1.0 - ratio**2) ** 2, 0.0) * weight
        normal = basis.T @ (robust[:, None] * basis) + prior
        covariance = np.linalg.inv(normal)
        parameters = covariance @ (basis.T @ (robust * shift))
        residual = shift - basis @ parameters
        inlier = usable & (np.abs(residual) < 4.685 * scale)
    if inlier.sum() < max(6, 0.3 * len(shift_px)):
        return None
    return ImageMotion(parameters, covariance, inlier, scale)
