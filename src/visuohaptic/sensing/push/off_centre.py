"""How much less it takes to move an object that is pushed beside its centre: it turns, too.

Symbols: F force of a push with the arm e beside the centre of friction, F_0 that of a straight push, c lever of the
bottom. Near a straight push the limit surface is an ellipsoid (Lee and Cutkosky 1991), on which an object slides where

    (F / F_0)^2 + (F e / (F_0 c))^2 = 1,    F_0 = F sqrt(1 + (e / c)^2).

The face that is touched shows e and its width, not how deep the bottom is nor where it rests on the floor. As real
limit surfaces are slimmer than ellipsoids, c is what explains them at e of three tenths of the width, a seventh to a
fifth less than the load's mean distance from its centre.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core.objects import Estimate, Primitive, PrimitiveKind

__all__ = ["of_straight_push", "straight_by_felt"]

#: Lever by the width of the face, and its relative deviation: a square bottom has 0.33 where it rests evenly and 0.53 on
#: feet at its corners, all between is as likely; deeper or less deep than wide by a factor of 1.4 is one deviation.
LEVER, LEVER_SIGMA = 0.43, 0.27


def straight_by_felt(
    contact_m: Float[np.ndarray, "n"], centre_m: float | None, shape: Primitive | None
) -> tuple[float, float]:
    """Friction of a straight push by the one that was felt, and its standard deviation.

    Parameters
    ----------
    contact_m
        Where the object is touched, along the strip [m]; NaN: not seen.
    centre_m
        Its centre along the strip [m]; ``None``: not known.
    shape
        Of the face, with its ends where they were seen. A round object is pushed through its centre wherever it is touched.
    """
    seen = contact_m[np.isfinite(contact_m)]
    if centre_m is None or shape is None or shape.kind is not PrimitiveKind.SEGMENT or not len(seen):
        return 1.0, 0.0
    width = math.dist(shape.parameters[:2], shape.parameters[2:])
    square = float(np.mean((seen - centre_m) ** 2)) / max(LEVER * width, 1e-3) ** 2
    return math.sqrt(1.0 + square), LEVER_SIGMA * square / math.sqrt(1.0 + square)


def of_straight_push(felt: Estimate, factor: tuple[float, float]) -> Estimate:
    """Friction of a straight push.

    Parameters
    ----------
    felt
        Of the push that was felt [N].
    factor
        Of :func:`straight_by_felt`.
    """
    return Estimate(factor[0] * felt.value, math.hypot(factor[0] * felt.sigma, factor[1] * felt.value))
