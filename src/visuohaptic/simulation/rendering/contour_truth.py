"""Ground truth of the foam's contours in a rendered frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, slots=True, eq=False)
class ContourTruth:
    """Exact image curves of a frame, with lens distortion and rolling shutter.

    Curves are polylines in pixels, dense enough that straight segments between
    their points are accurate to 1e-3 px. Points outside the view are NaN.
    """

    back_px: Float[np.ndarray, "m 2"]  #: contour between body and foam
    front_px: Float[np.ndarray, "n 2"]  #: contour between foam and surroundings
    stripe_px: Float[np.ndarray, "q 2"]  #: inner edge of the stripe; (0, 2) without stripe
    #: for each point of ``FoamScene.front_m``: not hidden by an object
    front_visible: Bool[np.ndarray, "points"]


def crossings(
    curve_px: Float[np.ndarray, "n 2"],
    origin_px: Float[np.ndarray, "*lines 2"],
    direction_px: Float[np.ndarray, "*lines 2"],
) -> Float[np.ndarray, "lines"]:
    """Parameter t of the crossing of each line ``origin + t direction`` with a curve.

    Of several crossings the one nearest to the origin is returned, t may be
    negative; NaN where a line does not meet the curve. With directions of length 1,
    t is in pixels.

    Parameters
    ----------
    curve_px
        Points of the curve (n, 2) [px].
    origin_px, direction_px
        Origins and directions of the lines (n, 2) [px].
    """
    origin = np.atleast_2d(np.asarray(origin_px, dtype=np.float64))
    direction = np.broadcast_to(np.atleast_2d(np.asarray(direction_px, dtype=np.float64)), origin.shape)
    if len(curve_px) < 2:
        return np.full(len(origin), np.nan)
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    offset = (origin * normal).sum(axis=1)
    side = curve_px @ normal.T - offset  # (n, lines), signed distance of each point from each line
    first, second = side[:-1], side[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = (first <= 0) != (second <= 0)
        fraction = first / (first - second)
        along = curve_px @ direction.T
        origin_along = (origin * direction).sum(axis=1)
        t = (along[:-1] + fraction * (along[1:] - along[:-1]) - origin_along) / (direction**2).sum(axis=1)
    t = np.where(meets & np.isfinite(t), t, np.inf)
    best = t[np.abs(t).argmin(axis=0), np.arange(len(origin))]
    return np.where(np.isfinite(best), best, np.nan)
