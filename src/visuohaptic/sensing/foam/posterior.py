"""What each edge of the contour is: foam, a shadow on it, something before it, or nothing.

The point k of the contour has one of the states z_k = F (the foam's own front), S (a shadow's edge on foam at
rest), O (an occluder) and N (no edge). With the image I along its line, the zero image Z, the place x of the edge
now and x0 at rest, the likelihoods of a frame are, each against the same for O,

    foam      p(I before x | F) = 0.6 p(I | g Z(t x0/x)) + 0.3 p(I | g Z(t)) + 0.1 p(I | any)
    shadow    p(I | S) : I = light(t) Z(t) up to x0, then a floor;   p(I | F) : g Z up to x, then another surface
    place     p(x | F) : at rest, or anywhere that max_contact_speed reaches from where it was;  p(x | O) : anywhere
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
from jaxtyping import Bool, Float, UInt8

from ...tracking.contours.contour import PIXEL_PX
from ._chain_kernels import FOAM, NOTHING, OCCLUDER, SHADOW, join
from ._posterior_kernels import (
    COUNT,
    COV_PRESSED,
    COV_REST,
    GAIN_PRESSED,
    GAIN_REST,
    OWN,
    VAR_PRESSED,
    VAR_REST,
    foam_bands,
    shadow_odds,
)
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference

__all__ = ["BULGE", "DECAY_PER_WIDTH", "FALSE_ALARM", "EdgePosterior", "EdgeStates", "edge_crossing"]

#: Shortest decay length of free foam by the width of the strip: continuum simulations of five foams under
#: plates, wedges and cylinders stay above it with 3 % of the higher point and a four-hundredth of the width.
DECAY_PER_WIDTH = 0.15
_CHORD, _OPTICS = 0.03, 0.0025
#: Foam bulges beside a contact by this part of its depth, at the most.
BULGE = 0.067
#: Probability that a run of points is none of the foam, and a frame that is read wrong by its force: one in a thousand.
FALSE_ALARM = 1e-3
#: States of an edge persist for so long [s].
PERSISTENCE_S = 0.3
#: Log-probability to enter F, S, O and N from another state at the next point: one strip in a hundred has an
#: occluder or a shadow's edge, one point in a hundred is not seen, and any of them is some twenty points long.
_ENTER = np.log([0.05, 0.01, 0.01, 0.01])
#: Texture that goes with the foam, stays, or is not that of the zero.
_MOVED, _FIXED, _OTHER = np.log([0.6, 0.3, 0.1])
#: Pixels of a band are not independent: lens, interpolation and JPEG leave half of them.
_INDEPENDENT = 0.5
#: Two surfaces have the same grey within this part of it, and neighbours share their surfaces: five are one.
_SAME_GREY, _ALIKE = 0.03, 0.2
#: An edge of a body is within a pixel of a given place: two edges on some forty pixels.
_BY_CHANCE = 0.05
#: Mean squared residual of the zero in another light, in variances of the foam, at the most.
_MISFIT = 3.0
#: Clean steps are few among the edges of other things, and seldom missing among those of foam, at kinks.
_UNCLEAN = math.log(0.07 / 0.33)
#: Standard deviation of the front under a shadow's edge [px]: where the pixels of foam end.
REST_PX = 0.5
#: Largest log-odds of one point by its pixels: a speck must not decide alone.
_MAX_ODDS = 12.0
#: Names of what may speak, in the order of :attr:`EdgeStates.against`.
_CHANNELS = ("texture", "shadow", "speed", "steepness", "no edge")


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStates:
    """States of K edges in one frame."""

    probability: Float[np.ndarray, "K 4"]  #: of foam, shadow, occluder, nothing
    #: Probability that all points from one to another are something else than they are taken for; one or two alone
    #: are bridged, and not counted.
    runs: Float[np.ndarray, "K K"]
    against: Float[np.ndarray, "K 5"]  #: log-odds against foam of each kind of evidence

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
        strip, zero
            What this image shows, and the strip at rest.
        rest_px
            Place of the resting front along each line [px].
        delta_m, sigma_m
            Deflection of each edge and its standard deviation, that of the zero included [m].
        """
        seen = (strip.usable | strip.low_confidence) & np.isfinite(delta_m) & np.isfinite(sigma_m)
        delta, sigma = np.where(seen, delta_m, 0.0), np.where(seen, sigma_m, self._width)
        deflected = delta > 3.0 * np.minimum(sigma, strip.pixel_m)
        against = np.zeros((len(seen), len(_CHANNELS)))
        unary = np.zeros((len(seen), 4))
        if strip.stripe:
            against[:, 1] = -_MAX_ODDS
        else:
            _image_evidence(strip, zero, rest_px, seen, deflected, unary, against)
        unary[:, SHADOW] = np.where(deflected, unary[:, SHADOW], -_MAX_ODDS)
        unary[:, FOAM] += np.where(strip.low_confidence, _UNCLEAN, 0.0)
        unary[:, FOAM] += self._place(strip.t_s, delta, np.hypot(sigma, strip.common_sigma_m), against)
        against[~seen, :] = 0.0
        against[~seen, 4] = _MAX_ODDS
        unary[~seen] = [-60.0, -60.0, 0.0, 0.0]
        unary[seen, NOTHING] = -_MAX_ODDS
        if self._last is not None:
            stay = math.exp(-max(strip.t_s - self._last[0], 0.0) / PERSISTENCE_S)
            # Neighbours share what they were: a run of ten counts once.
            unary += 0.1 * np.log(stay * self._last[1] + (1.0 - stay) * 0.25)
        probability, runs = np.empty_like(unary), np.empty((len(seen), len(seen)))
        rules = DECAY_PER_WIDTH * self._width, _CHORD, _OPTICS * self._width
        crossing = edge_crossing(delta, sigma, self._s, self._width)
        s_m, rest_m = self._s, REST_PX * strip.pixel_m
        join(unary, crossing, delta, sigma, rest_m, s_m, _ENTER, *rules, probability, runs, against[:, 3])
        self._last = strip.t_s, probability
        states = EdgeStates(probability, runs, against)
        calm = states.foam & seen
        self._trusted_m[calm], self._since_s[calm] = delta[calm], strip.t_s
        return states

    def _place(
        self,
        t_s: float,
        delta: Float[np.ndarray, "K"],
        sigma: Float[np.ndarray, "K"],
        against: Float[np.ndarray, "K 5"],
    ) -> Float[np.ndarray, "K"]:
        """Log-likelihood of the edges' places as foam, by that of an edge anywhere on the strip."""
        at_rest = self._width / (math.sqrt(2.0 * math.pi) * sigma) * np.exp(-0.5 * (delta / sigma) ** 2)
        # A contact may also come from the side: what a neighbour had is no surprise.
        padded = np.concatenate([[np.nan], self._trusted_m, [np.nan]])
        before = np.fmax(np.fmax(padded[:-2], padded[1:-1]), padded[2:])
        waited = t_s - self._since_s
        known = np.isfinite(before) & (waited > 0.0)
        reach = np.where(known, np.maximum(before, 0.0) + self._speed * waited, self._width)
        blunt = np.hypot(sigma, _OPTICS * self._width)
        fast = 0.5 * (np.maximum(delta - reach, 0.0) / blunt) ** 2
        thick = 0.5 * (np.maximum(-delta - BULGE * max(float(delta.max()), 0.0), 0.0) / (2.0 * blunt)) ** 2
        anywhere = self._width / np.clip(reach, blunt, self._width)
        step = 2.0 * (self._speed * np.where(known, waited, np.inf) + blunt)
        near = np.where(np.abs(delta - self._trusted_m) < 0.5 * step, self._width / step, 0.0)
        near = np.where(known, near, anywhere)
        pressed = np.log(np.maximum(0.3 * anywhere + 0.7 * near, 0.3)) - fast - thick
        against[:, 2] = np.clip(fast + thick, 0.0, 40.0)
        result: Float[np.ndarray, "K"] = np.clip(
            np.logaddexp(np.log(0.5 * at_rest + 1e-30), pressed), -40.0, 8.0
        )
        return result


def _image_evidence(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    deflected: Bool[np.ndarray, "K"],
    unary: Float[np.ndarray, "K 4"],
    against: Float[np.ndarray, "K 5"],
) -> None:
    """Log-likelihoods of the pixels on both sides of each edge; changes ``unary`` and ``against``."""
    step = strip.step_px * (strip.image.shape[2] - 1) / (zero.image.shape[2] - 1)
    front = np.where(seen, strip.front.position_px, rest_px) / step
    resting = rest_px / step
    blur = float(np.hypot(strip.blur_px, PIXEL_PX) / np.median(step)) if np.isfinite(strip.blur_px) else 1.0
    bands = np.empty((len(seen), 9))
    slope = strip.front.slope * strip.across_px / step
    foam_bands(strip.image, zero.image, front, resting, slope, blur, seen, bands)
    used = bands[:, COUNT] > 0.0
    if used.sum() < 6:
        return
    b = bands[used]
    pressed = np.abs(b[:, COV_PRESSED]) * b[:, VAR_REST] > np.abs(b[:, COV_REST]) * b[:, VAR_PRESSED]
    cov, var = (
        np.where(pressed, b[:, COV_PRESSED], b[:, COV_REST]),
        np.where(pressed, b[:, VAR_PRESSED], b[:, VAR_REST]),
    )
    transfer = float(np.clip(np.median(cov) / max(float(np.median(var)), 1e-6), 0.0, 1.0))

    def left(cov: Float[np.ndarray, "n"], var: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return np.maximum(b[:, OWN] - 2.0 * transfer * cov + transfer**2 * var, 0.05)

    moved, fixed = left(b[:, COV_PRESSED], b[:, VAR_PRESSED]), left(b[:, COV_REST], b[:, VAR_REST])
    variance = float(np.median(np.minimum(moved, fixed)))
    half = 0.5 * _INDEPENDENT * b[:, COUNT]
    odds = [
        np.clip(
            half * (1.0 + np.log(np.maximum(b[:, OWN], 0.05) / variance) - rest / variance),
            -_MAX_ODDS,
            _MAX_ODDS,
        )
        for rest in (moved, fixed)
    ]
    foam = np.logaddexp(np.logaddexp(_MOVED + odds[0], _FIXED + odds[1]), _OTHER)
    other = np.logaddexp(_FIXED + odds[1], np.log1p(-np.exp(_FIXED)))
    # Why a texture is another one is the same for a run of points: where foam also turns, where it is worn.
    foam = np.where(foam < other, other + _ALIKE * (foam - other), foam)
    unary[used, FOAM], unary[used, OCCLUDER] = foam, other
    unary[used, SHADOW] = np.logaddexp(np.log(0.9) + odds[1], _OTHER)
    against[used, 0] = other - foam
    places = _Places(front, resting, slope, blur)
    gain = np.full(len(seen), np.nan)
    gain[used] = np.where(moved < fixed, b[:, GAIN_PRESSED], b[:, GAIN_REST])
    odds_shadow = _shadow_evidence(strip, zero, places, deflected & seen, gain, transfer, variance)
    unary[:, SHADOW] += odds_shadow
    against[:, 1] = odds_shadow


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Edges in the rectified image; all in samples."""

    front: Float[np.ndarray, "K"]
    resting: Float[np.ndarray, "K"]
    slope: Float[np.ndarray, "K"]  #: from one parallel to the next
    blur: float  #: standard deviation


def _shadow_evidence(
    strip: ObservedStrip,
    zero: ZeroReference,
    at: _Places,
    tested: Bool[np.ndarray, "K"],
    gain: Float[np.ndarray, "K"],
    transfer: float,
    variance: float,
) -> Float[np.ndarray, "K"]:
    """Log-odds of a shadow's edge against a body's, by what lies between the edge and where it was at rest."""
    found = np.empty((len(tested), 7))
    shadow_odds(
        strip.image, zero.image, at.front, at.resting, at.slope, at.blur, transfer, variance, tested, found
    )
    texture, near, between, beyond, floor, misfit, alike = found.T
    # A point whose texture agrees by chance leaves residuals that look independent; its neighbours know better.
    known = np.isfinite(alike)
    texture[known] /= np.nanmedian(_around(alike)[known], axis=1)
    light, foam = float(np.nanmedian(gain)), resting_grey(zero.image, at.resting)
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.hypot(_SAME_GREY * light * foam, math.sqrt(variance))

        def density(away: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
            return np.exp(-0.5 * (away / sigma) ** 2) / (2.5 * sigma)

        shaded = (
            0.4 * density(beyond - light * floor) + 0.4 * density(beyond - between / foam * floor) + 0.2 / 255
        )
        # A body's own edge lies just where the front was at rest by chance alone.
        clean = misfit < _MISFIT
        body = 0.6 * density(beyond - between) + 0.4 / 255 * np.where(clean, _BY_CHANCE, 1.0)
        # What is not the zero in another light cannot show that its texture goes on.
        texture = np.where(clean, texture, np.minimum(texture, 0.0))
        levels = _ALIKE * np.log(shaded / body)
    # A shadow's edge that crosses the strip changes the light from one point to some other beside it.
    around = _around(np.log(np.maximum(gain, 1e-3)))
    with np.errstate(invalid="ignore"):
        change = np.fmax.reduce(around, axis=1) - np.fmin.reduce(around, axis=1)
    lit = _ALIKE * np.clip(0.5 * (np.nan_to_num(change) / _SAME_GREY) ** 2 - 3.0, -3.0, 3.0)
    odds_shadow = (
        np.where(np.isfinite(near), lit, 0.0)
        + np.nan_to_num(texture)
        + np.nan_to_num(levels)
        + np.nan_to_num(_INDEPENDENT * near)
    )
    result: Float[np.ndarray, "K"] = np.clip(odds_shadow, -_MAX_ODDS, _MAX_ODDS)
    return result


def _around(values: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K 9"]:
    """A point with four to either side; NaN beyond the ends."""
    padded = np.pad(values, 4, constant_values=np.nan)
    result: Float[np.ndarray, "K 9"] = np.lib.stride_tricks.sliding_window_view(padded, 9)
    return result


def edge_crossing(
    delta: Float[np.ndarray, "K"], sigma: Float[np.ndarray, "K"], s: Float[np.ndarray, "K"], width: float
) -> Float[np.ndarray, "K 2"]:
    """Log-likelihood of the step where an occluder's edge crosses the foam's, against that of one edge going on.

    Of each point beside the one before; with the foam before it, and with the foam at it.

    The step r is that from the straight line on through the foam. An occluder crosses at any angle alike, so that r
    has a Cauchy distribution with the distance of the points; that of one edge has no scale between its error
    and the width of the strip. A step that says less than nothing is a kink.

    Parameters
    ----------
    delta, sigma
        Deflection and its standard deviation [m].
    s
        Position along the strip [m].
    width
        Width of the strip [m].
    """
    padded, place = np.pad(delta, 1, mode="edge"), np.pad(s, 1, mode="reflect", reflect_type="odd")
    slope = np.diff(padded) / np.diff(place)  # before each point, and after the last one
    apart = np.diff(s)
    result = np.zeros((len(s), 2))
    error = np.minimum(2.0 * np.hypot(sigma[1:], sigma[:-1]), 0.3 * width)
    for column, side in enumerate((slope[:-2], slope[2:])):
        r = np.abs(np.diff(delta) - side * apart)
        same = 0.5 / ((r + error) * np.log(width / error))
        result[1:, column] = np.log(
            np.minimum(1.0 / (math.pi * apart * (1.0 + (r / apart) ** 2)) / same, 1.0)
        )
    return result


def resting_grey(
    image: UInt8[np.ndarray, "K parallels samples"], resting: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Grey level of the foam before its front at rest.

    Parameters
    ----------
    image
        Strip at rest.
    resting
        Place of the front [samples].
    """
    stop = int(0.9 * resting.min())
    result: Float[np.ndarray, "K"] = image[:, :, stop // 2 : stop].mean(axis=(1, 2))
    return result
