"""Compiled hidden Markov chain of the edge states along the strip; the model is in ``posterior.py``."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ...tracking.contours.contour import PIXEL_PX

#: States of the chain.
FOAM, SHADOW, OCCLUDER, NOTHING = range(4)
#: Columns of the evidence against foam: speed and blur.
SPEED, BLUR = 2, 5
#: Position error of any edge, relative to the width of the strip.
OPTICS = 0.0025
#: Scale of the log ratio of the blur of a foam edge to that of the lens (Laplace: 0.08 at 16 and 84 %, 0.3 at 99 %, over
#: 2,000 edges in and out of focus, moving and at rest), and range of the log ratio of any edge.
SAME_BLUR, _ANY_BLUR = 0.08, math.log(30.0)
#: Neighbours share their surfaces: the evidence of five points counts as that of one.
ALIKE = 0.2


@kernel(nogil=True)
def log_sum(a, b):
    """Logarithm of the sum of two exponentials.

    Parameters
    ----------
    a, b
        Exponents.
    """
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))


@kernel(nogil=True, error_model="numpy")
def place_odds(
    t, apart, delta, sigma, trusted, since, blur, lens, pixel, width, speed, bulge, against, unary, shared
):
    """Log-likelihood ratio of position and blur of each edge: foam against an edge anywhere on the strip with any blur.

    Parameters
    ----------
    t, apart
        Time, and that since the frame before, or since the zero [s].
    delta, sigma
        Deflection and its standard deviation [m], (K,).
    trusted, since
        Last observed deflection of the foam [m], and its time [s], NaN where foam was never observed, (K,).
    blur, lens, pixel
        Blur of each edge [px], (K,), that of the lens [px], and length of a pixel [m], (K,).
    width, speed, bulge
        Width of the strip [m], largest speed of a contact [m/s], and how far foam bulges beside contacts [m].
    against
        Columns ``SPEED`` and ``BLUR`` are filled, (K, 6).
    unary
        The log-likelihood of what each point has of its own is added to the column of foam, (K, 4).
    shared
        Filled with the part that neighbours have in common: if one point of an occluder lies within reach of a contact, so
        do the points beside it, (K,).
    """
    n, lens = len(delta), math.hypot(lens, PIXEL_PX)
    for k in range(n):
        rest = width / (math.sqrt(2.0 * math.pi) * sigma[k]) * math.exp(-0.5 * (delta[k] / sigma[k]) ** 2)
        rest = math.log(0.5 * rest + 1e-30)
        # A contact may also move in from the side: the last deflection of a neighbour is likely, too.
        before = -math.inf
        for j in range(max(k - 1, 0), min(k + 2, n)):
            if trusted[j] > before:
                before = trusted[j]
        waited = t - since[k]
        known = before > -math.inf and waited > 0.0
        reach = max(before, 0.0) + speed * waited if known else width
        blunt = math.hypot(sigma[k], OPTICS * width)
        surprise = 0.5 * (max(delta[k] - reach, 0.0) / blunt) ** 2
        surprise += 0.5 * (max(-delta[k] - bulge, 0.0) / (2.0 * blunt)) ** 2
        anywhere = near = width / min(max(reach, blunt), width)
        moved = abs(delta[k] - trusted[k])
        if known:
            # Uniform over the range of the largest speed from one frame to the next, limited by the width of the strip. For foam
            # that was out of sight longer, the probability of reappearing in this very frame decreases with that time (rule of
            # succession): the range continues to grow.
            step = 2.0 * (speed * waited + blunt)
            reached = min(2.0 * (speed * min(apart, waited) + blunt), width)
            near = width / (reached + 2.0 * speed * max(waited - apart, 0.0)) if moved < 0.5 * step else 0.0
        # A shutter that is open from frame to frame, at the most, sees the edge move by a box.
        smear = moved / pixel[k] / math.sqrt(12.0) if moved < math.inf else 0.0
        excess = math.log(math.hypot(blur[k], PIXEL_PX) / math.hypot(lens, smear))
        sharp = -(excess if excess > 0.0 else 0.0) / SAME_BLUR - math.log(2.0 * SAME_BLUR)
        against[k, BLUR] = ALIKE * (log_sum(math.log(0.5) + sharp, -math.log(2.0 * _ANY_BLUR)) - sharp)
        against[k, SPEED] = min(surprise, 40.0)
        pressed = -surprise - against[k, BLUR]
        own = min(max(log_sum(rest, pressed), -40.0), 8.0)
        unary[k, FOAM] += own
        pressed += math.log(max(0.3 * anywhere + 0.7 * near, 0.3))
        shared[k] = min(max(log_sum(rest, pressed), -40.0), 8.0) - own


@kernel(nogil=True, error_model="numpy")
def edge_crossing(delta, sigma, s, width):
    """Log-likelihood ratio of the step between two points: an occluder's edge crossing that of the foam, against one edge.

    Shape (K, 2): each point compared with the previous one, with foam at the previous point and with foam at this point.

    The step r is the distance from the straight line that extrapolates the foam. All crossing angles of an occluder are
    equally likely, so that r is Cauchy-distributed with the point spacing as its scale; for a single edge r is
    scale-free between its error and the width of the strip. The ratio is at most 1: a larger one is due to a kink.

    Parameters
    ----------
    delta, sigma
        Deflection and its standard deviation [m], (K,).
    s
        Position along the strip [m], (K,).
    width
        Width of the strip [m].
    """
    n = len(s)
    result = np.zeros((n, 2))
    for k in range(1, n):
        apart = s[k] - s[k - 1]
        error = min(2.0 * math.hypot(sigma[k], sigma[k - 1]), 0.3 * width)
        for side in range(2):
            i = k - 1 if side == 0 else k + 1  # the line passes through this point and the previous one
            slope = (delta[i] - delta[i - 1]) / (s[i] - s[i - 1]) if 0 < i < n else 0.0
            r = abs(delta[k] - delta[k - 1] - slope * apart)
            same = 0.5 / ((r + error) * math.log(width / error))
            cauchy = 1.0 / (math.pi * apart * (1.0 + (r / apart) ** 2))
            result[k, side] = math.log(min(cauchy / same, 1.0))
    return result


@kernel(nogil=True)
def _step(delta_a, delta_b, sigma, distance, decay, chord, margin):
    """Log-likelihood of the difference in deflection of two points of free foam."""
    high, low = max(delta_a, delta_b), max(min(delta_a, delta_b), 0.0)
    excess = max(high, 0.0) * math.exp(-distance / decay) * (1.0 - chord) - low - margin
    return -0.5 * (max(excess, 0.0) / sigma) ** 2


@kernel(nogil=True)
def _join_runs(unary, pair, ahead, behind, posterior, runs):
    """Fill ``runs`` of :func:`join`."""
    n = len(unary)
    runs[:] = 0.0
    taken = np.zeros(n, np.int64)
    for k in range(n):
        for a in range(4):
            if posterior[k, a] > posterior[k, taken[k]]:
                taken[k] = a
    weight = np.zeros(4)
    moved = np.zeros(4)
    for first in range(n):
        # p(states | all) = exp(ahead + behind) / evidence; the evidence follows from the posterior of the first point.
        z = taken[first]
        evidence = ahead[first, z] + behind[first, z] - math.log(posterior[first, z])
        for a in range(4):
            weight[a] = ahead[first, a]
        for last in range(first, n):
            if last > first:
                for b in range(4):
                    top = -1e300
                    for a in range(4):
                        top = max(top, weight[a] + pair[last, a, b])
                    total = 0.0
                    for a in range(4):
                        total += math.exp(weight[a] + pair[last, a, b] - top)
                    moved[b] = top + math.log(total) + unary[last, b]
                for b in range(4):
                    weight[b] = moved[b]
            weight[taken[last]] = -1e300
            value = 0.0
            for a in range(4):
                value += math.exp(weight[a] + behind[last, a] - evidence)
            runs[first, last] = runs[last, first] = value
            if value < 1e-12:
                break


@kernel(nogil=True)
def filter_runs(runs, onset, moved, s, pixel, same, cleared, own, stay, wrong, best):
    """Filter the probability of wrong runs from frame to frame; returns that of each point to be in one, (K,).

    What was not foam in the frame before and looked like it is still there with the probability ``stay``: its appearance is no
    new evidence, only a change of its appearance is. Single points and pairs are interpolated: only runs of at least three
    count, and shorter ones at the ends of the strip.

    Parameters
    ----------
    runs
        From :func:`join`; replaced by the probability given all frames, from the first to the last point, (K, K).
    onset
        Prior odds of a new contact against a new occluder or shadow, 1 where there is no new contact, (K,).
    moved, s
        Distance of each edge from the last position of the foam, and position along the strip [m], (K,). A body moves the front
        as a whole; other edges have any angle, and are parallel to it by chance.
    pixel
        Length of a pixel [m], (K,).
    same
        Points that were foam in the frame before and are foam within reach now, (K,).
    cleared
        Points that are foam and were not in the frame before, (K,).
    own
        Log-odds of foam from the appearance of each point, (K,).
    stay
        Probability that a state has persisted since the frame before.
    wrong
        Probability that a run is wrong and its neighbours are not; replaced by that of this frame, (K, K).
    best
        Largest log-odds of foam from the appearance of each run since it may have become wrong; updated, (K, K).
    """
    n = len(onset)
    # An occluder that has cleared n points beside a run ends at one of n + 1 places.
    left, right = np.ones(n), np.ones(n)
    for k in range(1, n):
        left[k] = left[k - 1] + 1.0 if cleared[k - 1] else 1.0
        right[n - 1 - k] = right[n - k] + 1.0 if cleared[n - k] else 1.0
    for first in range(n):
        high, low, odds, kept = moved[first], moved[first], 0.0, stay / left[first]
        for last in range(first, n):
            high, low = max(high, moved[last]), min(low, moved[last])
            odds += own[last]
            if not same[last]:
                kept = 0.0
            value = runs[first, last]
            if first > 0:
                value -= runs[first - 1, last]
            if last < n - 1:
                value -= runs[first, last + 1] - (runs[first - 1, last + 1] if first > 0 else 0.0)
            if last < first + 2 and first > 0 and last < n - 1:
                value = 0.0
            prior = max(onset[first], onset[last])
            if prior < 1.0:
                length = max(s[last] - s[first], 1e-9)
                value *= 2.0 / math.pi * math.atan((high - low + pixel[first]) / length) / prior
            before = (
                kept
                / right[last]
                * wrong[first, last]
                * math.exp(-min(max(odds - best[first, last], 0.0), 40.0))
            )
            if value > before or odds > best[first, last]:
                best[first, last] = odds
            wrong[first, last] = min(max(value, 0.0) + before, 1.0)
    for first in range(n):
        for last in range(n - 1, first - 1, -1):
            value = wrong[first, last]
            if first > 0:
                value += runs[first - 1, last]
            if last < n - 1:
                value += runs[first, last + 1] - (runs[first - 1, last + 1] if first > 0 else 0.0)
            runs[first, last] = value
    doubt = np.zeros(n)
    for k in range(n):
        for start in range(k - 2, k + 1):
            doubt[k] = min(max(doubt[k], runs[max(start, 0), min(start + 2, n - 1)]), 1.0)
    return doubt


@kernel(nogil=True)
def join(
    unary, shared, crossing, delta, sigma, rest_sigma, s, enter, decay, chord, margin, posterior, runs, fall
):
    """Forward-backward over the points.

    Parameters
    ----------
    unary
        Log-likelihood of each state, independent between points, (K, 4).
    shared
        Negative log-likelihood of each state that neighbours share, zero for the most likely one: along a run of points with
        one state it counts once, as its first value and its increases, (K, 4).
    crossing
        Log-likelihood ratio of a point's position relative to the previous one where foam and occluder meet, against
        a single body; with the foam first, and with the occluder first, (K, 2).
    delta, sigma
        Deflection and its standard deviation [m], (K,).
    rest_sigma
        Standard deviation of foam at rest under the edge of a shadow [m], (K,).
    s
        Position along the strip [m], (K,).
    enter
        Log-probability of entering each of the four states from another one at the next point.
    decay
        Shortest decay length of free foam [m].
    chord, margin
        Tolerance of the decay law: a fraction of the higher deflection, and a length [m].
    posterior
        Filled, (K, 4).
    runs
        Filled, (K, K): probability that none of the points from one to the other has its most likely state.
    fall
        Filled, (K,): negative log-likelihood of the drop in deflection to a neighbour, if both are foam [nats].
    """
    n = len(s)
    pair = np.zeros((n, 4, 4))
    fall[:] = 0.0
    for k in range(1, n):
        for a in range(4):
            for b in range(4):
                value = enter[b] - shared[k, b] if a != b else -max(shared[k, b] - shared[k - 1, b], 0.0)
                if a <= SHADOW and b <= SHADOW:
                    left = delta[k - 1] if a == FOAM else 0.0
                    here = delta[k] if b == FOAM else 0.0
                    scale = (sigma[k - 1] if a == FOAM else rest_sigma[k - 1]) ** 2
                    scale = math.sqrt(scale + (sigma[k] if b == FOAM else rest_sigma[k]) ** 2) + 1e-9
                    value += _step(left, here, scale, s[k] - s[k - 1], decay, chord, margin)
                elif a == FOAM and b == OCCLUDER:
                    value += crossing[k, 0]
                elif a == OCCLUDER and b == FOAM:
                    value += crossing[k, 1]
                pair[k, a, b] = max(value, -60.0)
        upper = k if delta[k] > delta[k - 1] else k - 1
        fall[upper] = max(fall[upper], -pair[k, FOAM, FOAM])
    ahead = np.zeros((n, 4))
    for k in range(n):
        for b in range(4):
            total = -shared[0, b] if b == FOAM else enter[b] - shared[0, b]
            if k > 0:
                top = -1e300
                for a in range(4):
                    top = max(top, ahead[k - 1, a] + pair[k, a, b])
                total = 0.0
                for a in range(4):
                    total += math.exp(ahead[k - 1, a] + pair[k, a, b] - top)
                total = top + math.log(total)
            ahead[k, b] = unary[k, b] + total
    behind = np.zeros((n, 4))
    for k in range(n - 1, -1, -1):
        top = -1e300
        if k < n - 1:
            for a in range(4):
                high = -1e300
                for b in range(4):
                    high = max(high, pair[k + 1, a, b] + unary[k + 1, b] + behind[k + 1, b])
                total = 0.0
                for b in range(4):
                    total += math.exp(pair[k + 1, a, b] + unary[k + 1, b] + behind[k + 1, b] - high)
                behind[k, a] = high + math.log(total)
        for a in range(4):
            top = max(top, ahead[k, a] + behind[k, a])
        total = 0.0
        for a in range(4):
            posterior[k, a] = math.exp(ahead[k, a] + behind[k, a] - top)
            total += posterior[k, a]
        for a in range(4):
            posterior[k, a] /= total
    _join_runs(unary, pair, ahead, behind, posterior, runs)
