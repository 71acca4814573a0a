"""Compiled evidence of the pixels behind the edges, and of grey levels beyond them; the model is in ``posterior.py``."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ...tracking._solve_kernels import median
from ._chain_kernels import ALIKE, FOAM, OCCLUDER, SHADOW, log_sum
from ._posterior_kernels import BAND, EDGE, INDEPENDENT

#: Columns of the bands: number of samples, current mean grey level, gain relative to the zero image at its old position and
#: compressed with the foam; current variance, and covariance and variance of both predictions.
COUNT, MEAN, GAIN_REST, GAIN_PRESSED, OWN, COV_REST, VAR_REST, COV_PRESSED, VAR_PRESSED = range(9)
#: Log prior of texture that is that of the zero image, or differs from it. Foam moves it, as far as it is compressed.
_SAME, _OTHER = math.log(0.9), math.log(0.1)
#: Probability that the edge of a shadow lies within a band.
_LIGHT_EDGE = 0.05
#: Probability that an edge of a body lies within a pixel of a given position: two edges on some forty pixels.
_BY_CHANCE = 0.05
#: Largest log-odds of one point from its pixels, so that a single speck cannot decide.
MAX_ODDS = 12.0
#: Relative difference within which two surfaces have the same grey level.
SAME_GREY = 0.03


@kernel(nogil=True)
def foam_bands(now, rest, front, resting, slope, blur, seen, begin, bands):
    """Compare the foam just behind each edge with the zero image, both without their linear trend.

    Parameters
    ----------
    now, rest
        Strip in this image and at rest, (K, parallels, samples).
    front, resting
        Position of the edge now and at rest [samples], (K,).
    slope
        Shift of the edge from one parallel to the next [samples], (K,).
    blur
        Blur of the edges, as a standard deviation [samples].
    seen
        Points with an edge, (K,).
    begin
        Foam before these positions is in another light [samples], (K,).
    bands
        Filled, (K, 9), columns as above; zero where no comparison is possible.
    """
    for k in range(len(front)):
        for i in range(9):
            bands[k, i] = 0.0
        if not seen[k]:
            continue
        ratio = resting[k] / front[k]
        s = np.zeros(13)
        for lane in range(now.shape[1]):
            edge = front[k] + (lane - 0.5 * (now.shape[1] - 1)) * slope[k]
            last = min(int(min(edge, resting[k] + BAND) - EDGE * blur), rest.shape[2] - 2)
            first = max(last - BAND, int(max(0.12 * resting[k], begin[k])))
            if last - first < 3:
                continue
            for j in range(first, last + 1):
                t = j - 0.5 * (first + last)
                i = float(now[k, lane, j])
                z = float(rest[k, lane, j])
                at = min(max(j * ratio, 0.0), rest.shape[2] - 1.001)
                m = int(at)
                p = rest[k, lane, m] + (at - m) * (float(rest[k, lane, m + 1]) - rest[k, lane, m])
                s[0] += 1.0
                s[1] += t * t
                s[2] += i
                s[3] += z
                s[4] += p
                s[5] += i * i
                s[6] += z * z
                s[7] += p * p
                s[8] += i * z
                s[9] += i * p
                s[10] += t * i
                s[11] += t * z
                s[12] += t * p
        n = s[0]
        if n == 0.0:
            continue
        b = bands[k]
        b[COUNT], b[MEAN] = n, s[2] / n
        b[GAIN_REST], b[GAIN_PRESSED] = s[2] / max(s[3], 1.0), s[2] / max(s[4], 1.0)
        b[OWN] = (s[5] - s[2] * s[2] / n - s[10] * s[10] / s[1]) / n
        b[COV_REST] = b[GAIN_REST] * (s[8] - s[2] * s[3] / n - s[10] * s[11] / s[1]) / n
        b[VAR_REST] = b[GAIN_REST] ** 2 * (s[6] - s[3] * s[3] / n - s[11] * s[11] / s[1]) / n
        b[COV_PRESSED] = b[GAIN_PRESSED] * (s[9] - s[2] * s[4] / n - s[10] * s[12] / s[1]) / n
        b[VAR_PRESSED] = b[GAIN_PRESSED] ** 2 * (s[7] - s[4] * s[4] / n - s[12] * s[12] / s[1]) / n


@kernel(nogil=True)
def texture_odds(bands, unary, against, gain):
    """Log-likelihoods of the texture of the bands, the fraction of it that is visible in this image, and the foam's variance.

    Returns that fraction and the variance [grey levels^2]; both are 0 where fewer than six bands can be compared.

    Parameters
    ----------
    bands
        From :func:`foam_bands`.
    unary
        Log-likelihood of foam, shadow, occluder and nothing; filled where there is a band, (K, 4).
    against
        Log-odds against foam by kind of evidence; the first, texture, is filled where there is a band, (K, 6).
    gain
        Filled with the illumination relative to that at rest; NaN where unknown, (K,).
    """
    n, count = len(bands), 0
    cov, var, work = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        b = bands[k]
        if b[COUNT] > 0.0:
            pressed = abs(b[COV_PRESSED]) * b[VAR_REST] > abs(b[COV_REST]) * b[VAR_PRESSED]
            cov[count] = b[COV_PRESSED] if pressed else b[COV_REST]
            var[count] = b[VAR_PRESSED] if pressed else b[VAR_REST]
            count += 1
    if count < 6:
        return 0.0, 0.0
    transfer = min(max(median(cov, count, work) / max(median(var, count, work), 1e-6), 0.0), 1.0)
    moved, fixed, count, coarsest = np.empty(n), np.empty(n), 0, 0.0
    for k in range(n):
        b = bands[k]
        moved[k] = max(b[OWN] - 2.0 * transfer * b[COV_PRESSED] + transfer**2 * b[VAR_PRESSED], 0.05)
        fixed[k] = max(b[OWN] - 2.0 * transfer * b[COV_REST] + transfer**2 * b[VAR_REST], 0.05)
        if b[COUNT] > 0.0:
            cov[count] = min(moved[k], fixed[k])
            count += 1
            coarsest = max(coarsest, b[VAR_REST])
    variance = median(cov, count, work)
    for k in range(n):
        gain[k] = math.nan
        if bands[k, COUNT] > 0.0:
            half = 0.5 * INDEPENDENT * bands[k, COUNT]
            own = 1.0 + math.log(max(bands[k, OWN], 0.05) / variance)
            moved[k] = min(max(half * (own - moved[k] / variance), -MAX_ODDS), MAX_ODDS)
            fixed[k] = min(max(half * (own - fixed[k] / variance), -MAX_ODDS), MAX_ODDS)
    for k in range(n):
        if bands[k, COUNT] > 0.0:
            half = 0.5 * INDEPENDENT * bands[k, COUNT]
            goes, stays = moved[k], fixed[k]
            # Foam that shows another part of its surface is no coarser than the coarsest part of the strip at rest.
            ratio = max(bands[k, OWN] / (variance + transfer**2 * coarsest), 1.0)
            coarse = half * (1.0 + math.log(ratio) - ratio)
            coarse = log_sum(math.log(1.0 - _LIGHT_EDGE) + coarse, math.log(_LIGHT_EDGE))
            foam = log_sum(_SAME + goes, _OTHER + coarse)
            # Beside an occluder foam is at rest, or not.
            other = log_sum(stays, 0.0) + math.log(0.5)
            shaded = log_sum(_SAME + stays, _OTHER)
            # A run of points has a common cause for a different texture, such as rotated or worn foam, or a slanted shadow.
            foam -= (1.0 - ALIKE) * min(foam - other, 0.0)
            shaded -= (1.0 - ALIKE) * min(shaded - other, 0.0)
            unary[k, FOAM], unary[k, SHADOW], unary[k, OCCLUDER] = foam, shaded, other
            against[k, 0] = other - foam
            gain[k] = bands[k, GAIN_PRESSED] if goes > stays else bands[k, GAIN_REST]
    return transfer, variance


@kernel(nogil=True)
def level_odds(found, dependence, gain, foam, variance, against):
    """Log-odds of the edge of a shadow against that of a body, from the pixels between the edge and its position at rest.

    Returns the probability that the floor at rest lies beyond an edge, if it is that of a shadow, (K,).

    Parameters
    ----------
    found
        From :func:`~visuohaptic.sensing.foam._posterior_kernels.shadow_odds`.
    dependence
        Median of its sixth column over each point and its neighbours, because a point whose texture agrees by chance
        leaves residuals that seem independent, (K,).
    gain
        Illumination behind each edge relative to that at rest, NaN where unknown, (K,).
    foam
        Mean grey level of the foam at rest, (K,).
    variance
        Variance of the foam's grey levels about their prediction [grey levels^2].
    against
        The second column, shadow, is filled, (K, 6).
    """
    n, count = len(found), 0
    known, work, bare = np.empty(n), np.empty(n), np.ones(n)
    for k in range(n):
        if math.isfinite(gain[k]):
            known[count] = gain[k]
            count += 1
    # The light of the strip, and that of the deepest shadow in which foam is seen: on the floor it lies elsewhere.
    light, shade = median(known, count, work), math.inf
    for k in range(n):
        if found[k, 0] > 0.0:
            shade = min(shade, max(found[k, 2], 0.0) / foam[k])
    for k in range(n):
        texture, near, between, beyond, floor = (
            found[k, 0],
            found[k, 1],
            found[k, 2],
            found[k, 3],
            found[k, 4],
        )
        odds = 0.0
        if math.isfinite(near):
            odds += INDEPENDENT * near
        if math.isfinite(texture):
            # A front of foam is as sharp as lens and motion make it; neighbours share the softness of a shadow.
            odds += (texture + ALIKE * found[k, 6]) / dependence[k]
            sigma = math.hypot(SAME_GREY * light * foam[k], math.sqrt(variance))
            same = 0.3 * _density(beyond - light * floor, sigma)
            same += 0.3 * _density(beyond - between / foam[k] * floor, sigma)
            same += 0.2 * _density(beyond - shade * floor, sigma)
            shaded = same + 0.2 / 255
            bare[k] = same / shaded / (1.0 + math.exp(min(found[k, 7], 40.0)))
            # An edge of a body would have to coincide with the front at rest by chance.
            body = 0.6 * _density(beyond - between, sigma) + 0.4 / 255 * _BY_CHANCE
            levels = ALIKE * math.log(shaded / body)
            odds += levels if math.isfinite(levels) else 0.0
        against[k, 1] = min(max(odds, -MAX_ODDS), MAX_ODDS)
    return bare


@kernel(nogil=True)
def _density(away, sigma):
    """Density of a normal distribution."""
    return math.exp(-0.5 * (away / sigma) ** 2) / (2.5 * sigma)
