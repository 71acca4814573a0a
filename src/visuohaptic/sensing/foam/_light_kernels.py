"""Compiled comparison of fronts near their place at rest with the zero image, in the light that is seen beside them."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: Table of the complementary error function from -5 to 5, interpolated linearly: exact to 3e-6, 1/2000 of a grey level.
_OVER, _STEPS = 5.0, 200.0
_ERFC = np.array([math.erfc(i / _STEPS - _OVER) for i in range(int(2.0 * _OVER * _STEPS) + 2)])
_ERFC[0], _ERFC[-2:] = 2.0, 0.0


@kernel(nogil=True)
def beyond_edge(away):
    """Twice the fraction of a Gaussian edge that lies beyond a position, given in units of its width times sqrt(2)."""
    place = min(max((away + _OVER) * _STEPS, 0.0), 2.0 * _OVER * _STEPS)
    at = int(place)
    return _ERFC[at] + (place - at) * (_ERFC[at + 1] - _ERFC[at])


@kernel(nogil=True)
def _line(now, rest, begin, end, spacing, origin, out):
    """Fill the light ``now / rest`` between two positions: a straight line over the distance from ``origin``, and its variance.

    ``now`` and ``rest`` are (lines, samples). ``out`` (5): value and slope of the line, mean of ``rest``, variance about the line, number
    of samples. Returns whether there are enough of them.
    """
    n, sx, sxx, sy, sxy, syy, level = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(max(int(math.ceil(begin / spacing)), 0), min(int(end / spacing) + 1, now.shape[1])):
        x = j * spacing - origin
        for lane in range(now.shape[0]):
            if rest[lane, j] > 0.0 and now[lane, j] > 0.0:
                y = now[lane, j] / rest[lane, j]
                n, sx, sxx, level = n + 1.0, sx + x, sxx + x * x, level + rest[lane, j]
                sy, sxy, syy = sy + y, sxy + x * y, syy + y * y
    if n < 4.0 * now.shape[0]:
        return False
    out[1] = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    out[0], out[2], out[4] = (sy - out[1] * sx) / n, level / n, n
    out[3] = max(syy - out[0] * sy - out[1] * sxy, 0.0) / (n - 2.0)
    return True


@kernel(nogil=True)
def front_in_light(image, zero, spacing, rest, front, blur, margin, plateau, found):
    """Fill the displacement and the excess of the squared blur of fronts near their place at rest, in the light beside them.

    The light relative to the zero image is extrapolated to the front along straight lines, fitted to a ``plateau`` on each side of the
    blurred edge. The zero image in this light is compared with the image within the blur: the remainder is a displacement of
    the edge or another blur (Gauss-Newton steps from the front at rest).

    Parameters
    ----------
    image, zero
        Grey levels along the lines, (K, parallels, samples).
    spacing
        Of the samples [px], (K,).
    rest, front
        Front at rest and as found along each line [px], (K,).
    blur, margin
        Blur of an edge in even light, and half the length of the blurred edge [px], (K,).
    plateau
        Length of the plateaus [px].
    found
        (7, K): displacement towards the base [px], excess of the squared blur over the zero image [px^2], standard deviation of
        the displacement due to light that is not straight, and its difference between light that is seen beside the front at
        rest and beside the displaced one [px]; of the samples beyond, their variance about the zero image in this light, that about
        a straight line, and their number. Left as it is where the front is not within ``margin``
        of ``rest``, or its surroundings are not seen.
    """
    samples = image.shape[2]
    now, then, even = np.empty((1, samples)), np.empty((1, samples)), np.ones(image.shape[1:])
    foam, floor, other = np.empty(5), np.empty(5), np.empty(5)
    for k in range(image.shape[0]):
        if not abs(front[k] - rest[k]) < margin[k]:
            continue
        for j in range(samples):
            now[0, j], then[0, j] = 0.0, 0.0
            for lane in range(image.shape[1]):
                now[0, j] += image[k, lane, j] / image.shape[1]
                then[0, j] += zero[k, lane, j] / image.shape[1]
        at, moved, squares, wider, bends, step = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        density, scale = math.sqrt(2.0 * math.pi) * blur[k], 1.0 / (math.sqrt(2.0) * blur[k])
        beside = 0.0
        for turn in range(6):
            # The light is seen beside the front at rest at first, and then beside the displaced one.
            if turn == 3:
                beside = at
            away = 0.0 if turn < 3 else at
            first, last = rest[k] + min(away, 0.0) - margin[k], rest[k] + max(away, 0.0) + margin[k]
            moved, squares, wider, bends = 0.0, 0.0, 0.0, 0.0
            if not _line(now, then, first - plateau, first, spacing[k], rest[k], foam):
                break
            if not _line(now, then, last, last + plateau, spacing[k], rest[k], floor):
                break
            for j in range(int(math.ceil(first / spacing[k])), int(last / spacing[k]) + 1):
                x = j * spacing[k] - rest[k]
                inside, beyond = foam[0] + foam[1] * x, floor[0] + floor[1] * x
                over, still = 0.5 * beyond_edge((at - x) * scale), 0.5 * beyond_edge(-x * scale)
                part = floor[2] * still / (foam[2] * (1.0 - still) + floor[2] * still)
                step = floor[2] * beyond - foam[2] * inside
                left = (
                    now[0, j] - then[0, j] * (inside * (1.0 - part) + beyond * part) - step * (over - still)
                )
                slope = step * math.exp(-(((x - at) * scale) ** 2))
                bend = slope * (x - at)
                moved, squares = moved + left * slope, squares + slope * slope
                wider, bends = wider + left * bend, bends + bend * bend
            if squares * bends <= 0.0:
                break
            at -= min(max(moved / squares * density, -blur[k]), blur[k])
        if squares * bends > 0.0:
            # The derivative of an edge by its place is the density of its blur, that by its variance half the slope of that.
            found[0, k], found[1, k] = -at, -2.0 * blur[k] ** 2 * density * wider / bends
            # What is no line has one cause for all samples of a plateau, from which the front is 'margin' away.
            uneven = foam[3] * foam[2] ** 2 + floor[3] * floor[2] ** 2
            uneven *= 1.0 + 12.0 * (0.5 + margin[k] / plateau) ** 2
            found[3, k] = abs(at - beside)
            found[2, k] = 0.5 * density * math.sqrt(uneven) / max(abs(step), 1.0)
            # Whether the surface beyond is still the floor: all lines in this light, or without its texture.
            if _line(image[k], zero[k], last, last + plateau, spacing[k], rest[k], floor):
                _line(image[k], even, last, last + plateau, spacing[k], rest[k], other)
                found[4, k], found[5, k], found[6, k] = floor[3] * floor[2] ** 2, other[3], other[4]
