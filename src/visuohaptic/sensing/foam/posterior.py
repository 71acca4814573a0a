"""States of the edges of the contour: foam, a shadow on it, an occluder in front of it, or no edge.

Point k of the contour has one of the states z_k = F (front of the foam), S (edge of a shadow on foam at
rest), O (occluder) and N (no edge). With the image I along its line, the zero image Z, the position x of the edge
now and x0 at rest, the likelihoods of a frame, each relative to that of O, are

    foam      p(I before x | F) = 0.9 p(I | g Z(t x0/x)) + 0.1 p(I | any);  p(... | O) = 0.5 p(I | g Z(t)) + 0.5 p(I | any)
    shadow    p(I | S) : I = light(t) Z(t), or light(t) Z(t) up to x0, then another floor; p(I | F) : g Z up to x, then a surface
    floor     p(I beyond x0 | S) : the floor of Z in any light, or a body that may press: then the front is not seen; nor is it
              where the foam in the shadow ends before x0, by a pixel or more
    position  p(x | F) : at rest, or within reach of the last position at max_contact_speed;  p(x | O) : anywhere
    blur      p(b | F, pressed) : that of the lens and of its own motion;  p(b | O) : any, the edge of a shadow may be soft
    steepness p(x_k, x_k+1 | F, F) : free foam decays over DECAY_PER_WIDTH w or more (a free end has no slope)
    crossing  p(x_k, x_k+1 | F, O) : an occluder crosses the edge of the foam at any angle;  p(... | F, F) : a single edge
    surface   p(grey beyond x | F, pressed before) : that of the body that pressed there, or another one;  p(... | O) : any
    body      p(floor beyond x along a whole run | F, pressed) : by chance; a body presses somewhere along it
    edge      p(no edge | F) = 0

The shadow's edge is where it fits best: two merged edges, or that of the shadow apart from a front that is still seen. Where
the contour follows the edge of a shadow instead of the front, the front is a second edge beyond it (``shadowed.py``): foam
from one edge to the other, in another light, is evidence for both, or for a second shadow whose edge is the second one.
The variance about g Z and the visible fraction of the texture of Z (blur, JPEG) are measured on the foam behind the
edges of the same frame; pixels beyond the edge are weighted by the correlation of their own residuals. Steepness and
crossing couple the states along the strip, and states persist in time for ``PERSISTENCE_S``. An occluder that covers one
point within reach of the contact covers its neighbours within reach as well: position, surface and persistence of a run of
points count once, not once per point. Where the edge of a shadow is known, another one is as probable as not: things have two
sides, and rooms several lamps. The forward-backward algorithm over the points gives p(z_k | all), and the probability of each
run of points that all of its states are wrong, from which force and variance follow in ``validity.py``.

It is filtered from frame to frame (``filter_runs``). An edge that was wrongly taken for foam moves on as foam would, and
frames share its appearance. Therefore its odds decrease by the rate at which states change, and where its appearance becomes
more like that of foam than in any frame since it came, but not because it looks the same in every frame. Beside an occluder or
shadow that has gone, such an edge is what that has left, with one of the ends that are possible in its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...tracking.contours.contour import PIXEL_PX
from ._chain_kernels import BLUR, FOAM, NOTHING, OPTICS, SHADOW, edge_crossing, filter_runs, join, place_odds
from ._posterior_kernels import EDGE, shadow_odds
from ._texture_kernels import MAX_ODDS, SAME_GREY, foam_bands, level_odds, texture_odds
from .edges import MeasuredEdges, local_statistics, mean_between
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference

#: Shortest decay length of free foam, relative to the width of the strip: continuum simulations of five foams under plates,
#: wedges and cylinders stay above it with a tolerance of 3 % of the higher point and 1/400 (``OPTICS``) of the width.
DECAY_PER_WIDTH = 0.15
_CHORD = 0.03
#: Largest bulge of the foam beside a contact, as a fraction of the depth of the contact.
BULGE = 0.067
#: Accepted probability that points have wrong states and their force makes the reading of the frame wrong.
FALSE_ALARM = 1e-3
#: Time constant of the persistence of edge states [s].
PERSISTENCE_S = 0.3
#: Log-probability of entering F, S, O and N from another state at the next point: one strip in a hundred has an
#: occluder or the edge of a shadow, one point in a hundred has no edge, and each of them is some twenty points long.
#: Where the edge of a shadow is known, another one is as likely as not.
_ENTER = np.log([[0.05, 0.01, 0.01, 0.01], [0.05, 0.5, 0.01, 0.01]])
#: Prior probability of the onset of a contact per frame, at most.
_ONSET = 0.01
#: Probability that the surface beyond the front of a contact is not that of the body that pressed there before, and none of a body.
_OTHER_SURFACE = 0.05
#: Standard deviation of the front under the edge of a shadow [px], due to the pixel resolution.
REST_PX = 0.5
#: Names of the kinds of evidence against foam.
_CHANNELS = ("texture", "shadow", "speed", "steepness", "no edge", "blur")


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStates:
    """States of K edges in one frame."""

    probability: Float[np.ndarray, "K 4"]  #: of foam, shadow, occluder, nothing
    #: Probability that the states of a run of points with this one are wrong; single points and pairs are interpolated.
    doubt: Float[np.ndarray, "K"]
    evidence: str  #: strongest evidence against foam over the points that are not, or may not be; empty if there is none

    @property
    def foam(self) -> Bool[np.ndarray, "K"]:
        """Edges that are most likely the front of the foam."""
        return self.probability.argmax(axis=1) == FOAM

    @property
    def undecided(self) -> Bool[np.ndarray, "K"]:
        """Points that may belong to a run of points with wrong states."""
        return self.doubt > FALSE_ALARM

    @property
    def shadow(self) -> Bool[np.ndarray, "K"]:
        """Edges that are most likely those of a shadow on foam at rest."""
        return self.probability.argmax(axis=1) == SHADOW


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
        #: Last observed deflection of the foam, NaN where there is none, and its time
        self.last_m, self._since_s = np.full((2, len(s_m)), np.nan)
        self._pressed = np.zeros(len(s_m), dtype=bool)  # points of contacts
        self._wrong, self._best = np.zeros((2, len(s_m), len(s_m)))  # see filter_runs
        self._foam = np.ones(len(s_m), dtype=bool)
        #: Last grey level beyond the front, relative to that of the foam
        self._beyond = np.full(len(s_m), np.nan)
        self._last: tuple[float, Float[np.ndarray, "K 4"]] | None = None

    def start(self, t_s: float) -> None:
        """Initialise with foam at rest at this time.

        Parameters
        ----------
        t_s
            Time [s].
        """
        self.last_m[:], self._since_s[:] = 0.0, t_s

    def infer(self, strip: ObservedStrip, zero: ZeroReference, edges: MeasuredEdges) -> EdgeStates:
        """Infer the states of one frame; the positions of foam become the reference for the next frame.

        Parameters
        ----------
        strip, zero
            Observation of the strip in this image, and the strip at rest.
        edges
            Deflection of the edges in this image, and its errors.
        """
        sigma_m = np.hypot(np.hypot(edges.sigma_m, edges.systematic_m), edges.encoding_m)
        seen = (strip.usable | strip.low_confidence) & np.isfinite(edges.delta_m) & np.isfinite(sigma_m)
        delta, sigma = np.where(seen, edges.delta_m, 0.0), np.where(seen, sigma_m, self._width)
        deflected = delta > 3.0 * np.minimum(sigma, strip.pixel_m)
        surface = _beyond(strip)
        unary, against, same, bare = self._look(strip, zero, seen, deflected, delta, surface)
        own, near = unary[:, FOAM] - unary[:, SHADOW:NOTHING].max(axis=1), np.empty(len(seen))
        apart_s = strip.t_s - self._last[0] if self._last is not None else math.inf
        place_odds(
            strip.t_s, apart_s, delta, np.hypot(sigma, strip.common_sigma_m), self.last_m, self._since_s,
            strip.front.blur_px, strip.lens_px, strip.pixel_m, self._width, self._speed,
            BULGE * max(float(delta.max()), 0.0), against, unary, near,
        )  # fmt: skip
        against[~seen] = MAX_ODDS * np.eye(len(_CHANNELS))[_CHANNELS.index("no edge")]
        unary[~seen] = [-60.0, -60.0, 0.0, 0.0]
        unary[seen, NOTHING] = -MAX_ODDS
        # The front corner of a free end moves inwards beside a body: the last line may meet the end face, or no edge.
        corner = np.zeros(len(seen), dtype=bool)
        corner[[0, -1]] = deflected[[1, -2]] & ~strip.usable[[0, -1]]
        unary[corner, FOAM] = np.maximum(unary[corner, FOAM], math.log(0.5))
        # An occluder or shadow that is there already remains where it was, as foam does; a new one is there by chance.
        common = np.where(seen, near + same, 0.0) + body_odds(edges.floor, deflected)
        stay, last = self._before(strip)
        change = 0.25 * (1.0 - stay)
        log_prior = np.log(stay * last * np.exp(np.maximum(common, 0.0))[:, None] + change)
        log_prior[:, FOAM] = common + np.log(stay * last[:, FOAM] + change)
        shared = log_prior.max(axis=1, keepdims=True) - log_prior
        probability, runs = np.empty_like(unary), np.empty_like(self._wrong)
        crossing = edge_crossing(delta, sigma, self._s, self._width)
        places = crossing, delta, sigma, REST_PX * strip.pixel_m, self._s
        enter = _ENTER[int((strip.edge_px > 0.0).any())]
        rules = enter, DECAY_PER_WIDTH * self._width, _CHORD, OPTICS * self._width
        join(unary, shared, *places, *rules, probability, runs, against[:, 3])
        self._last = strip.t_s, probability
        reach = min(self._speed * apart_s, self._width) + np.hypot(sigma, OPTICS * self._width)
        own -= against[:, BLUR]
        foam = probability.argmax(axis=1) == FOAM
        # New contacts are as rare as other new edges: they carry the prior odds of their onset.
        grown = np.convolve(self._pressed, np.ones(3), mode="same") > 0.0
        onset = np.where(foam & deflected & ~grown, _ONSET, 1.0)
        moved = np.nan_to_num(delta - self.last_m)
        same = foam & self._foam & (np.abs(moved) < reach)
        self._wrong, self._best = self._wrong.copy(), self._best.copy()  # for a shallow copy
        before = same, foam & ~self._foam, own, stay, self._wrong, self._best
        doubt = filter_runs(runs, onset, moved, self._s, strip.pixel_m, *before)
        # A contact that is hidden is expected to be there afterwards.
        self._pressed = np.where(foam, deflected, self._pressed)
        # How an edge came to its place is known only where there was foam before.
        self._foam = foam & np.isfinite(self.last_m)
        # Foam in a shadow is at rest where the floor lies beyond it. Beside another surface, which may press, it is not seen.
        beside = probability[:, SHADOW] * (1.0 - bare)
        probability = probability + np.outer(beside, np.eye(4)[NOTHING] - np.eye(4)[SHADOW])
        total = against[(probability.argmax(axis=1) != FOAM) | (doubt > FALSE_ALARM)].sum(axis=0)
        states = EdgeStates(probability, doubt, _CHANNELS[total.argmax()] if total.max() > 0.0 else "")
        calm = states.foam & seen
        self._beyond = np.where(calm, surface, self._beyond)
        self.last_m = np.where(calm, delta, self.last_m)
        self._since_s = np.where(calm, strip.t_s, self._since_s)
        return states

    def _before(self, strip: ObservedStrip) -> tuple[float, Float[np.ndarray, "K 4"]]:
        """Probability that a state has persisted since the last frame, and the probabilities of the states in it."""
        if self._last is None:
            return 0.0, 0.25 * np.ones((len(self._s), 4))
        stay, last = math.exp(-max(strip.t_s - self._last[0], 0.0) / PERSISTENCE_S), self._last[1]
        # What a second edge was in the last frame is not known where that was not the foam's, and where it merges with the front at
        # rest: that of another shadow may have come there since.
        near = strip.rest_px - strip.front.position_px < 2.0 * EDGE * math.hypot(strip.lens_px, PIXEL_PX)
        unknown = (strip.edge_px > 0.0) & (near | (last.argmax(axis=1) != FOAM))
        return stay, np.where(unknown[:, None], 0.25, last)

    def _look(
        self,
        strip: ObservedStrip,
        zero: ZeroReference,
        seen: Bool[np.ndarray, "K"],
        deflected: Bool[np.ndarray, "K"],
        delta: Float[np.ndarray, "K"],
        surface: Float[np.ndarray, "K"],
    ) -> tuple[
        Float[np.ndarray, "K 4"], Float[np.ndarray, "K 6"], Float[np.ndarray, "K"], Float[np.ndarray, "K"]
    ]:
        """Log-likelihoods of the grey levels on both sides of each edge.

        Returns those of foam, shadow, occluder and nothing; the log-odds against foam by kind of evidence, of which the first
        two, texture and shadow, are filled; the log-likelihood ratio of the levels beyond the edges: the body that pressed
        there before against any surface; and the probability that the floor at rest lies beyond an edge of a shadow. Neighbours
        share the ratio: the points of known contacts whose surface is the same have its median over the strip.
        """
        unary, against, bare = (
            np.zeros((len(seen), 4)),
            np.zeros((len(seen), len(_CHANNELS))),
            np.ones(len(seen)),
        )
        if strip.stripe:
            against[:, 1] = -MAX_ODDS
        else:
            moved_m = np.abs(delta - self.last_m)
            moved_px = np.where(np.isfinite(moved_m), moved_m, 0.0) / strip.pixel_m
            bare = _compare(strip, zero, seen, deflected, moved_px, unary, against)
        unary[:, SHADOW] = np.where(deflected, unary[:, SHADOW], -MAX_ODDS)
        known = seen & deflected & self._pressed
        away = (surface - self._beyond) / SAME_GREY
        density = np.exp(-0.5 * away**2) / (2.5 * SAME_GREY)
        each = np.log((1.0 - _OTHER_SURFACE) * density + _OTHER_SURFACE)
        local = local_statistics(np.where(known & np.isfinite(each), each, np.nan))[0]
        same = max(float(np.median(local[known])), 0.0) if known.any() else 0.0
        return unary, against, np.where(known, np.where(local > 0.0, same, local), 0.0), bare


def body_odds(floor: Float[np.ndarray, "K"], deflected: Bool[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Log-likelihood of what lies beyond the edges, if they are the front of the foam, relative to that of any other edge.

    Foam is deflected by a body, which lies beyond the front somewhere along a run of deflected points, or beside it.

    Parameters
    ----------
    floor
        Probability that the floor as at rest lies beyond each edge, 0 where it is not seen.
    deflected
        Points that are deflected, if they are foam.
    """
    result = np.zeros(len(floor))
    ends = np.flatnonzero(np.diff(np.concatenate([[0], deflected.astype(np.int8), [0]])))
    for first, stop in zip(ends[::2], ends[1::2], strict=True):
        bare = float(floor[max(first - 1, 0) : stop + 1].min())
        result[first:stop] = math.log(1.0 - (1.0 - _OTHER_SURFACE) * bare)
    return result


def _beyond(strip: ObservedStrip) -> Float[np.ndarray, "K"]:
    """Grey level beyond each edge, relative to that of the foam behind it, which is lit alike; NaN where there is no edge."""
    level = strip.front.level
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(strip.stripe, np.nan, level / (level - strip.front.contrast))


def _compare(
    strip: ObservedStrip,
    zero: ZeroReference,
    seen: Bool[np.ndarray, "K"],
    deflected: Bool[np.ndarray, "K"],
    moved_px: Float[np.ndarray, "K"],
    unary: Float[np.ndarray, "K 4"],
    against: Float[np.ndarray, "K 6"],
) -> Float[np.ndarray, "K"]:
    """Log-likelihoods of the pixels on both sides of each edge: texture behind it, shadow or body in front of it.

    Returns the probability that the floor at rest lies beyond an edge, if it is that of a shadow.
    """
    step = strip.step_px * (strip.image.shape[2] - 1) / (zero.image.shape[2] - 1)
    resting = strip.rest_px / step
    front = np.where(seen, strip.front.position_px, strip.rest_px) / step
    blur = math.hypot(strip.blur_px, PIXEL_PX) / float(np.median(step)) if np.isfinite(strip.blur_px) else 1.0
    bands, gain = np.empty((len(seen), 9)), np.empty(len(seen))
    slope = strip.front.slope * strip.across_px / step
    edge = strip.edge_px / step
    behind = seen & (edge > 0.0) & (edge < front)
    begin = np.where(behind, edge + EDGE * blur, 0.0)
    foam_bands(strip.image, zero.image, front, resting, slope, blur, seen, begin, bands)
    transfer, variance = texture_odds(bands, unary, against, gain)
    if variance == 0.0:
        return np.ones(len(seen))
    found = np.empty((len(seen), 8))
    lines = np.column_stack(
        [strip.reference_points_px, strip.front.lines.direction_px, strip.step_px, strip.across_px]
    )
    # A shutter that is open from frame to frame, at the most, sees the edge move by a box.
    places = front, resting, slope, blur, moved_px / step / math.sqrt(12.0)
    shadow_odds(strip.image, zero.image, lines, *places, transfer, variance, deflected, found)
    # One shadow is evidence for another one: its edge is no free parameter of each line.
    found[behind, 1] = np.maximum(found[behind, 1], 0.0)
    stop = int(0.9 * resting.min())
    foam = mean_between(zero.image, np.full((len(seen), 2), [float(stop // 2), float(stop)]))[:, 0]
    dependence = local_statistics(np.ascontiguousarray(found[:, 5]))[0]
    bare: Float[np.ndarray, "K"] = level_odds(found, dependence, gain, foam, variance, against)
    unary[:, SHADOW] += against[:, 1]
    if behind.any():
        # Beyond the edge of a shadow, foam continues up to its front, or to the edge of another shadow.
        pressed, odds = _compressed(zero.image, front / resting, behind), np.zeros_like(against)
        places = edge, front, np.zeros(len(seen)), blur, np.zeros(len(seen))
        shadow_odds(strip.image, pressed, lines, *places, transfer, variance, behind, found)
        dependence = local_statistics(np.ascontiguousarray(found[:, 5]))[0]
        level_odds(found, dependence, gain, foam, variance, odds)
        unary[behind, FOAM : SHADOW + 1] += odds[behind, 1:2]
    return bare


def _compressed(
    image: UInt8[np.ndarray, "K parallels samples"],
    part: Float[np.ndarray, "K"],
    chosen: Bool[np.ndarray, "K"],
) -> UInt8[np.ndarray, "K parallels samples"]:
    """The strip at rest with its texture moved to a part of its distance from the base, as foam that is pressed moves it."""
    result, place = image.copy(), np.arange(image.shape[2])
    for k in np.flatnonzero(chosen):
        for lane in range(image.shape[1]):
            result[k, lane] = np.rint(np.interp(place / part[k], place, image[k, lane]))
    return result
