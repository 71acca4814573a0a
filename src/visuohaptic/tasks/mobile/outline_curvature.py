"""Curvature of an object's outline where a push is planned."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...navigation.pushing.push_model import PushModel

#: A planned contact farther from the outline is not on it: coordinates of a plan are rounded to micrometres [m].
ON_OUTLINE_M = 1e-4


def contact_curvature(
    outline_m: Float[np.ndarray, "p 2"], contact_m: tuple[float, float], radius_m: float
) -> float:
    """Curvature of an outline at a planned contact [1/m]: of a disc; 0 of a face; that of the rim where it bridges a concavity.

    Parameters
    ----------
    outline_m, contact_m
        Corners of the outline, and the contact of the plan, which lies off the outline in a concavity (x, y) [m].
    radius_m
        Radius of the platform [m].
    """
    from shapely import LinearRing, Point

    if LinearRing(outline_m).distance(Point(contact_m)) > ON_OUTLINE_M:
        return -1.0 / radius_m
    round_m = PushModel.of_footprint(outline_m).round_m
    return 1.0 / round_m if round_m else 0.0
