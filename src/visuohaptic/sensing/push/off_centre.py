"""Conversion of the friction of an off-centre push, in which the object also rotates, to that of a straight push.

Symbols: F force of a push with the arm e from the centre of friction, F_0 that of a straight push, c lever of the
bottom. Near a straight push the limit surface is an ellipsoid (Lee and Cutkosky 1991), on which an object slides if

    (F / F_0)^2 + (F e / (F_0 c))^2 = 1,    F_0 = F sqrt(1 + (e / c)^2).

The touched face gives e and its width, but not the depth of the bottom or the contacts with the floor. Because
real limit surfaces are slimmer than ellipsoids, c is fitted to them at e = 0.3 of the width, where it is a seventh to a
fifth less than the mean distance of the load from its centre.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core.objects import Estimate, Primitive, PrimitiveKind

#: Lever by the width of the face, and its relative standard deviation: a square bottom has 0.33 if it rests evenly and 0.53 on
#: feet at its corners, uniform in between; a factor of 1.4 between depth and width is one standard deviation.
LEVER, LEVER_SIGMA = 0.43, 0.27


def straight_push_factor(
    contact_m: Float[np.ndarray, "n"], centre_m: float | None, shape: Primitive | None
) -> tuple[float, float]:
    """Ratio of the friction of a straight push to the measured force, and its standard deviation.

    Parameters
    ----------
    contact_m
        Positions of the contact along the strip [m]; NaN: not measured.
    centre_m
        Position of the object's centre along the strip [m]; ``None``: unknown.
    shape
        Primitive of the face, with its ends if observed. A round object is always pushed through its centre (ratio 1).
    """
    seen = contact_m[np.isfinite(contact_m)]
    if centre_m is None or shape is None or shape.kind is not PrimitiveKind.SEGMENT or not len(seen):
        return 1.0, 0.0
    width = math.dist(shape.parameters[:2], shape.parameters[2:])
    square = float(np.mean((seen - centre_m) ** 2)) / max(LEVER * width, 1e-3) ** 2
    return math.sqrt(1.0 + square), LEVER_SIGMA * square / math.sqrt(1.0 + square)


def to_straight_push(felt: Estimate, factor: tuple[float, float]) -> Estimate:
    """Convert a measured friction to that of a straight push.

    Parameters
    ----------
    felt
        Friction of the measured push [N].
    factor
        Result of :func:`straight_push_factor`.
    """
    return Estimate(factor[0] * felt.value, math.hypot(factor[0] * felt.sigma, factor[1] * felt.value))
