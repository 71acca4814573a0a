"""Compiled chain of the edges' states along the strip; the model is in ``posterior.py``."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: States of the chain.
FOAM, SHADOW, OCCLUDER, NOTHING = range(4)


@kernel(nogil=True)
def _step(delta_a, delta_b, sigma, distance, decay, chord, margin):
    """Log-likelihood of a foam that falls from one point to the other."""
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
        # p(states | all) = exp(ahead + behind) / evidence; the posterior of the first point has the evidence.
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
    for a in range(n):
        for b in range(a, min(a + 2, n)):
            value = 0.0
            for start in range(b - 2, a + 1):
                value = max(value, runs[max(start, 0), min(start + 2, n - 1)])
            runs[a, b] = runs[b, a] = value


@kernel(nogil=True)
def join(unary, crossing, delta, sigma, rest_sigma, s, enter, decay, chord, margin, posterior, runs, fall):
    """Forward-backward over the points.

    Parameters
    ----------
    unary
        Log-likelihood of each state, (K, 4).
    crossing
        Log-likelihood of a point's place beside the one before where foam and occluder meet, against one body;
        with the foam first, and with the occluder first, (K, 2).
    delta, sigma
        Deflection and its standard deviation [m], (K,).
    rest_sigma
        Standard deviation of foam that a shadow's edge shows to be at rest [m], (K,).
    s
        Position along the strip [m], (K,).
    enter
        Log-probability of another state at the next point, for each of the four.
    decay
        Shortest decay length of free foam [m].
    chord, margin
        What its law forgives: a fraction of the higher point, and a length [m].
    posterior
        Filled, (K, 4).
    runs
        Filled, (K, K): probability that all points from one to the other are something else than most likely.
        One or two alone are bridged, so that only runs of three count, and fewer at the ends of the strip.
    fall
        Filled, (K,): what speaks against a step of foam down to a neighbour [nats].
    """
    n = len(s)
    pair = np.zeros((n, 4, 4))
    fall[:] = 0.0
    for k in range(1, n):
        for a in range(4):
            for b in range(4):
                value = enter[b] if a != b else 0.0
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
            total = 0.0 if k == 0 and b == FOAM else enter[b]
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
