"""Could foam stand so steep? An occluder's edge makes a step; foam beside a contact is drawn along.

Symbols: s position, delta deflection, l decay length. Whatever pushes foam pushes it towards the
base: the pressure of a strip on an elastic foundation with tension T and stiffness k,

    p = k delta - T delta'' >= 0,    l^2 = T / k,

is never negative. So between any two of its points foam lies at or beyond the catenary of free
foam through both,

    delta(b) >= [delta(a) sinh((c - b) / l) + delta(c) sinh((b - a) / l)] / sinh((c - a) / l),

with the least l that foam can have. A hand or a cable in front of the foam knows nothing of this: free
foam begins where its edge ends. (A body may have any shape: no test of the other direction.)
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from .plausibility import local_roughness, roughness

__all__ = ["DECAY_PER_WIDTH", "stepped_points"]

#: Shortest decay length by the width of the strip. Continuum simulations of five foams under plates,
#: wedges and cylinders stay below the chord by at most 0.06 mm + 1 % of the depth with it; further away
#: from the edge the true decay is twice as long.
DECAY_PER_WIDTH = 0.15
#: What is forgiven: a fraction of the higher neighbour for the chord, a fraction of the width for the
#: optics, so many sigmas ...
_CHORD, _OPTICS, _SIGMAS = 0.03, 0.0025, 4.0
#: ... and a fraction of the deepest point within so many widths: foam bulges beside a deep contact.
_BULGE, _BULGE_REACH = 0.01, 1.5
#: Scatter of neighbours in declared sigmas, beyond which it counts instead of these; a median of 21 with a
#: contact among them seldom exceeds it.
_ROUGH = 2.0


def stepped_points(
    s_m: Float[np.ndarray, "K"],
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    width_m: float,
    end_cells_m: tuple[float, float],
) -> Bool[np.ndarray, "K"]:
    """Points that stand above foam which would have been drawn along if they were foam.

    From each foot of a step to where the contour is down at its level again.

    Parameters
    ----------
    s_m, delta_m, sigma_m
        Points along the strip, their deflection and its standard deviation [m].
    seen
        Points to look at.
    width_m
        Width of the strip at rest.
    end_cells_m
        Length of foam before the first and after the last point [m].
    """
    from ._flank_kernels import below_chord

    stepped = np.zeros(len(s_m), dtype=bool)
    index = np.flatnonzero(seen)
    if len(index) < 6:
        return stepped
    # Foam that bulges beside a contact, most of all at a free end, is free foam: no foot of a step.
    delta, sigma = np.maximum(delta_m[index], 0.0), sigma_m[index]
    margin = _OPTICS * width_m
    if delta.max() - delta.min() < margin:
        return stepped
    at = np.ascontiguousarray(s_m[index], dtype=np.float64)
    ends = float(s_m[0] - end_cells_m[0]), float(s_m[-1] + end_cells_m[1])
    rules = DECAY_PER_WIDTH * width_m, _CHORD, _BULGE, _BULGE_REACH * width_m, _SIGMAS
    excess, side = below_chord(at, delta, sigma, *ends, *rules)
    if (excess > margin).any():
        # Texture of the object at the edge shifts points beyond their sigma: their neighbours decide.
        rough = np.maximum(local_roughness(delta, sigma), roughness(delta, sigma, sigma > 0.0))
        sigma = sigma * np.where(rough > _ROUGH, rough, 1.0)
        excess, side = below_chord(at, delta, sigma, *ends, *rules)
    for foot in np.flatnonzero(excess > margin):
        level = delta[foot] + margin + _SIGMAS * sigma[foot]
        ahead = np.arange(foot, -1, -1) if side[foot] < 0 else np.arange(foot, len(index))
        above = delta[ahead] > level
        first = int(above.argmax())
        down = ~above[first:]
        last = first + int(down.argmax()) if down.any() else len(ahead)
        stepped[index[ahead[first:last]]] = True
    return stepped
