"""States of the edges of the contour: foam, a shadow on it, an occluder in front of it, or no edge.

Point k of the contour has one of the states z_k = F (front of the foam), S (edge of a shadow on foam at
rest), O (occluder) and N (no edge). With the image I along its line, the zero image Z, the position x of the edge
now and x0 at rest, the likelihoods of a frame, each relative to that of O, are

    foam      p(I before x | F) = 0.6 p(I | g Z(t x0/x)) + 0.3 p(I | g Z(t)) + 0.1 p(I | any)
    shadow    p(I | S) : I = light(t) Z(t) up to x0, then a floor;   p(I | F) : g Z up to x, then another surface
    position  p(x | F) : at rest, or within reach of the last position at max_contact_speed;  p(x | O) : anywhere
    blur      p(b | F, pressed) : that of the lens and of its own motion;  p(b | O) : any, the edge of a shadow may be soft
    steepness p(x_k, x_k+1 | F, F) : free foam decays over DECAY_PER_WIDTH w or more (a free end has no slope)
    crossing  p(x_k, x_k+1 | F, O) : an occluder crosses the edge of the foam at any angle;  p(... | F, F) : a single edge
    edge      p(no edge | F) = 0

The variance about g Z and the visible fraction of the texture of Z (blur, JPEG) are measured on the foam behind the
edges of the same frame; pixels beyond the edge are weighted by the correlation of their own residuals. Steepness and
crossing couple the states along the strip, and states persist in time for ``PERSISTENCE_S``; the forward-backward
algorithm over the points gives p(z_k | all). It also gives the probabilities P_ij that the states of all points from i to
j are wrong, from which force and variance follow in ``deflection.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ._chain_kernels import FOAM, NOTHING, OPTICS, SHADOW, edge_crossing, join, place_odds
from ._texture_kernels import MAX_ODDS
from .pixel_evidence import image_evidence
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference

__all__ = ["BULGE", "DECAY_PER_WIDTH", "FALSE_ALARM", "EdgePosterior", "EdgeStates"]

#: Shortest decay length of free foam, relative to the width of the strip: continuum simulations of five foams under plates,
#: wedges and cylinders stay above it with a tolerance of 3 % of the higher point and 1/400 (``OPTICS``) of the width.
DECAY_PER_WIDTH = 0.15
_CHORD = 0.03
#: Largest bulge of the foam beside a contact, as a fraction of the depth of the contact.
BULGE = 0.067
#: Accepted probability that a run of points has wrong states and its force makes the reading of the frame wrong.
FALSE_ALARM = 1e-3
#: Time constant of the persistence of edge states [s].
PERSISTENCE_S = 0.3
#: Log-probability of entering F, S, O and N from another state at the next point: one strip in a hundred has an
#: occluder or the edge of a shadow, one point in a hundred has no edge, and each of them is some twenty points long.
_ENTER = np.log([0.05, 0.01, 0.01, 0.01])
#: Prior probability of the onset of a contact per frame, at most.
_ONSET = 0.01
#: Standard deviation of the front under the edge of a shadow [px], due to the pixel resolution.
REST_PX = 0.5
#: Names of the kinds of evidence, in the order of :attr:`EdgeStates.against`.
_CHANNELS = ("texture", "shadow", "speed", "steepness", "no edge", "blur")


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStates:
    """States of K edges in one frame."""

    probability: Float[np.ndarray, "K 4"]  #: of foam, shadow, occluder, nothing
    #: Probability that the states of all points from one to another are wrong; single points and pairs
    #: are interpolated and do not count.
    runs: Float[np.ndarray, "K K"]
    against: Float[np.ndarray, "K 6"]  #: log-odds against foam from each kind of evidence

    @property
    def foam(self) -> Bool[np.ndarray, "K"]:
        """Edges that are most likely the front of the foam."""
        return self.probability.argmax(axis=1) == FOAM

    @property
    def undecided(self) -> Float[np.ndarray, "K"]:
        """Probability that a point belongs to a run of points with wrong states."""
        return self.runs.diagonal()

    @property
    def shadow(self) -> Bool[np.ndarray, "K"]:
        """Edges that are most likely those of a shadow on foam at rest."""
        return self.probability.argmax(axis=1) == SHADOW

    def evidence(self, points: Bool[np.ndarray, "K"]) -> str:
        """Strongest evidence against foam over some points; empty if there is none.

        Parameters
        ----------
        points
            Points to include.
        """
        if not points.any():
            return ""
        total = self.against[points].sum(axis=0)
        return _CHANNELS[int(total.argmax())] if total.max() > 0.0 else ""


class EdgePosterior:
    """Recursive estimation of the edge states from frame to frame.

    Parameters
    ----------
    s_m
        Position of K points along the strip [m].
    width_m
        Width of the strip at rest [m].
    speed_m_s
        Largest speed of a contact [m/s].
    """

    def __init__(self, s_m: Float[np.ndarray, "K"], width_m: float, speed_m_s: float) -> None:
        self._s, self._width, self._speed = np.ascontiguousarray(s_m, dtype=np.float64), width_m, speed_m_s
        self._trusted_m = np.full(len(s_m), np.nan)  # last observed deflection of the foam, and its time
        self._since_s = np.full(len(s_m), np.nan)
        self._pressed = np.zeros(len(s_m), dtype=bool)  # points of contacts that are established
        self._last: tuple[float, Float[np.ndarray, "K 4"]] | None = None

    def start(self, t_s: float) -> None:
        """Initialise with foam at rest at this time.

        Parameters
        ----------
        t_s
            Time [s].
        """
        self._trusted_m[:], self._since_s[:] = 0.0, t_s

    def infer(
        self,
        strip: ObservedStrip,
        zero: ZeroReference,
        rest_px: Float[np.ndarray, "K"],
        delta_m: Float[np.ndarray, "K"],
        sigma_m: Float[np.ndarray, "K"],
    ) -> EdgeStates:
        """Infer the states of one frame; the positions of foam become the reference for the next frame.

        Parameters
        ----------
        strip, zero, rest_px
            See :func:`~visuohaptic.sensing.foam.pixel_evidence.image_evidence`.
        delta_m, sigma_m
            Deflection of each edge and its standard deviation, including that of the zero reference [m].
        """
        seen = (strip.usable | strip.low_confidence) & np.isfinite(delta_m) & np.isfinite(sigma_m)
        delta, sigma = np.where(seen, delta_m, 0.0), np.where(seen, sigma_m, self._width)
        deflected = delta > 3.0 * np.minimum(sigma, strip.pixel_m)
        against = np.zeros((len(seen), len(_CHANNELS)))
        unary = np.zeros((len(seen), 4))
        if strip.stripe:
            against[:, 1] = -MAX_ODDS
        else:
            image_evidence(strip, zero, rest_px, seen, deflected, unary, against)
        unary[:, SHADOW] = np.where(deflected, unary[:, SHADOW], -MAX_ODDS)
        apart_s = strip.t_s - self._last[0] if self._last is not None else math.inf
        place_odds(
            strip.t_s, apart_s, delta, np.hypot(sigma, strip.common_sigma_m), self._trusted_m, self._since_s,
            strip.front.blur_px, strip.lens_px, strip.pixel_m, self._width, self._speed,
            BULGE * max(float(delta.max()), 0.0), against, unary,
        )  # fmt: skip
        against[~seen, :] = 0.0
        against[~seen, 4] = MAX_ODDS
        unary[~seen] = [-60.0, -60.0, 0.0, 0.0]
        unary[seen, NOTHING] = -MAX_ODDS
        if self._last is not None:
            stay = math.exp(-max(strip.t_s - self._last[0], 0.0) / PERSISTENCE_S)
            # The previous states of neighbours are not independent: a run of ten counts once.
            unary += 0.1 * np.log(stay * self._last[1] + (1.0 - stay) * 0.25)
        probability, runs = np.empty_like(unary), np.empty((len(seen), len(seen)))
        rules = DECAY_PER_WIDTH * self._width, _CHORD, OPTICS * self._width
        crossing = edge_crossing(delta, sigma, self._s, self._width)
        s_m, rest_m = self._s, REST_PX * strip.pixel_m
        join(unary, crossing, delta, sigma, rest_m, s_m, _ENTER, *rules, probability, runs, against[:, 3])
        self._last = strip.t_s, probability
        self._confirm(probability[:, FOAM], deflected, runs)
        states = EdgeStates(probability, runs, against)
        calm = states.foam & seen
        self._trusted_m[calm], self._since_s[calm] = delta[calm], strip.t_s
        return states

    def moved_m(self, delta_m: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
        """Distance of the edges from the last observed position of the foam [m]; zero where there is none.

        Parameters
        ----------
        delta_m
            Deflection of each edge [m].
        """
        moved = np.abs(delta_m - self._trusted_m)
        return np.where(np.isfinite(moved), moved, 0.0)

    def _confirm(
        self, foam: Float[np.ndarray, "K"], deflected: Bool[np.ndarray, "K"], runs: Float[np.ndarray, "K K"]
    ) -> None:
        """Apply the prior odds of new contacts, which are as rare as other new edges; changes ``runs``."""
        grown = np.convolve(self._pressed, np.ones(3), mode="same") > 0.0
        fresh = deflected & ~grown
        runs[np.ix_(fresh, fresh)] = np.minimum(runs[np.ix_(fresh, fresh)] / _ONSET, 1.0)
        self._pressed = (foam > 0.5) & deflected & (grown | (runs.diagonal() < FALSE_ALARM))
