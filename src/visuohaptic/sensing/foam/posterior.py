"""What each edge of the contour is: foam, a shadow on it, something before it, or nothing.

The point k of the contour has one of the states z_k = F (the foam's own front), S (a shadow's edge on foam at
rest), O (an occluder) and N (no edge). With the image I along its line, the zero image Z, the place x of the edge
now and x0 at rest, the likelihoods of a frame are, each against the same for O,

    foam      p(I before x | F) = 0.6 p(I | g Z(t x0/x)) + 0.3 p(I | g Z(t)) + 0.1 p(I | any)
    shadow    p(I | S) : I = light(t) Z(t) up to x0, then a floor;   p(I | F) : g Z up to x, then another surface
    place     p(x | F) : at rest, or anywhere that max_contact_speed reaches from where it was;  p(x | O) : anywhere
    blur      p(b | F, pressed) : the lens's, and that of its own motion;  p(b | O) : any, a shadow's edge has no lens
    steepness p(x_k, x_k+1 | F, F) : free foam falls off over DECAY_PER_WIDTH w or more (a free end has no slope)
    crossing  p(x_k, x_k+1 | F, O) : an occluder crosses the foam's edge at any angle;  p(... | F, F) : one edge goes on
    edge      p(no edge | F) = 0

The variance about g Z and the part of Z's texture that an image shows (blur, JPEG) are those of the foam behind the
edges of this very frame; pixels beyond the edge count by the correlation of their own residuals. F is joined to F along the strip, states persist in time for ``PERSISTENCE_S``; forward and
backward over the points give p(z_k | all). So do the probabilities P_ij that all points from i to j are
something else than they are taken for, of which force and variance follow in ``deflection.py``.
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

#: Shortest decay length of free foam by the width of the strip: continuum simulations of five foams under plates,
#: wedges and cylinders stay above it with 3 % of the higher point and a four-hundredth (``OPTICS``) of the width.
DECAY_PER_WIDTH = 0.15
_CHORD = 0.03
#: Foam bulges beside a contact by this part of its depth, at the most.
BULGE = 0.067
#: Probability that a run of points is none of the foam, and a frame that is read wrong by its force: one in a thousand.
FALSE_ALARM = 1e-3
#: States of an edge persist for so long [s].
PERSISTENCE_S = 0.3
#: Log-probability to enter F, S, O and N from another state at the next point: one strip in a hundred has an
#: occluder or a shadow's edge, one point in a hundred is not seen, and any of them is some twenty points long.
_ENTER = np.log([0.05, 0.01, 0.01, 0.01])
#: A contact begins in one frame of a hundred, at the most.
_ONSET = 0.01
#: Standard deviation of the front under a shadow's edge [px]: where the pixels of foam end.
REST_PX = 0.5
#: Names of what may speak, in the order of :attr:`EdgeStates.against`.
_CHANNELS = ("texture", "shadow", "speed", "steepness", "no edge", "blur")


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStates:
    """States of K edges in one frame."""

    probability: Float[np.ndarray, "K 4"]  #: of foam, shadow, occluder, nothing
    #: Probability that all points from one to another are something else than they are taken for; one or two alone
    #: are bridged, and not counted.
    runs: Float[np.ndarray, "K K"]
    against: Float[np.ndarray, "K 6"]  #: log-odds against foam of each kind of evidence

    @property
    def foam(self) -> Bool[np.ndarray, "K"]:
        """Edges that most likely are the foam's front."""
        return self.probability.argmax(axis=1) == FOAM

    @property
    def undecided(self) -> Float[np.ndarray, "K"]:
        """Probability that a point lies in a run of something else than it is taken for."""
        return self.runs.diagonal()

    @property
    def shadow(self) -> Bool[np.ndarray, "K"]:
        """Edges that most likely are a shadow's on foam at rest."""
        return self.probability.argmax(axis=1) == SHADOW

    def evidence(self, points: Bool[np.ndarray, "K"]) -> str:
        """What spoke most against the foam at some points; empty where nothing did.

        Parameters
        ----------
        points
            Points that are asked for.
        """
        if not points.any():
            return ""
        total = self.against[points].sum(axis=0)
        return _CHANNELS[int(total.argmax())] if total.max() > 0.0 else ""


class EdgePosterior:
    """States of the edges from frame to frame.

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
        self._trusted_m = np.full(len(s_m), np.nan)  # deflection of foam that was seen, and when
        self._since_s = np.full(len(s_m), np.nan)
        self._pressed = np.zeros(len(s_m), dtype=bool)  # points of contacts that are established
        self._last: tuple[float, Float[np.ndarray, "K 4"]] | None = None

    def start(self, t_s: float) -> None:
        """The foam was free at this time.

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
        """States of one frame; what is foam is what the next frame is compared with.

        Parameters
        ----------
        strip, zero, rest_px
            As of :func:`~visuohaptic.sensing.foam.pixel_evidence.image_evidence`.
        delta_m, sigma_m
            Deflection of each edge and its standard deviation, that of the zero included [m].
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
            # Neighbours share what they were: a run of ten counts once.
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
        """How far edges are from where the foam was last seen [m]; zero where it was not.

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
        """Odds against contacts that begin: an edge that comes is as rare as a contact; changes ``runs``."""
        grown = np.convolve(self._pressed, np.ones(3), mode="same") > 0.0
        fresh = deflected & ~grown
        runs[np.ix_(fresh, fresh)] = np.minimum(runs[np.ix_(fresh, fresh)] / _ONSET, 1.0)
        self._pressed = (foam > 0.5) & deflected & (grown | (runs.diagonal() < FALSE_ALARM))
