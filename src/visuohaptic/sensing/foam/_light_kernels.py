"""Compiled fits of the light on foam and on the surface beyond it, along the lines of one point."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: Correlation length limit of the residuals [samples].
LAGS = 10


@kernel(nogil=True)
def _solve(normal, right):
    """Solve a small symmetric system by Cholesky with a ridge; its factor and the solution replace both."""
    size = len(right)
    for i in range(size):
        normal[i, i] = normal[i, i] * (1.0 + 1e-6) + 1e-6
        for j in range(i + 1):
            value = normal[i, j]
            for k in range(j):
                value -= normal[i, k] * normal[j, k]
            normal[i, j] = math.sqrt(max(value, 1e-9)) if i == j else value / normal[j, j]
    for i in range(size):
        for k in range(i):
            right[i] -= normal[i, k] * right[k]
        right[i] /= normal[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= normal[k, i] * right[k]
        right[i] /= normal[i, i]


@kernel(nogil=True)
def fit_light(now, template, over, out, surface, first, last, mean, transfer, shaded, normal, solution):
    """Least-squares fit of the illumination of the template and of the surface beyond; returns the sum of squared residuals.

    With ``shaded``: the template in one light up to the edge, in another, linearly varying light from there to the front
    at rest, then the surface, which varies linearly; or, if ``shaded`` is 2, each in uniform light. Else the template up to
    the edge, then the surface, both varying linearly.
    """
    tilt = 0.0 if shaded == 2 else 0.05
    n00, n10, n11, n20, n21, n22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n30, n31, n32, n33, n40, n41, n42, n43, n44 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    r0, r1, r2, r3, r4, square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for lane in range(now.shape[0]):
        for j in range(first, last + 1):
            value = float(now[lane, j])
            foam = mean + transfer * (template[lane, j] - mean)
            p1, p0, tau = over[lane, j], out[lane, j], tilt * (j - first)
            if shaded:
                square += value * value
                # Far from both edges only one of the terms is not zero.
                if p1 == 0.0 and p0 == 0.0:
                    n00 += foam * foam
                    r0 += foam * value
                    continue
                if p0 == 0.0 and p1 == 1.0:
                    b, c = foam, foam * tau
                    n11, n21, n22 = n11 + b * b, n21 + b * c, n22 + c * c
                    r1, r2 = r1 + b * value, r2 + c * value
                    continue
                inside = foam * (1.0 - p0)
                a, b, d = inside * (1.0 - p1), inside * p1, surface[lane, j]
                c, e = b * tau, d * tau
            else:
                a, b = foam * (1.0 - p1), surface[lane, j]
                c, d, e = b * tau, a * tau, 0.0
                square += value * value
            n00 += a * a
            n10 += a * b
            n11 += b * b
            n20 += a * c
            n21 += b * c
            n22 += c * c
            n30 += a * d
            n31 += b * d
            n32 += c * d
            n33 += d * d
            n40 += a * e
            n41 += b * e
            n42 += c * e
            n43 += d * e
            n44 += e * e
            r0 += a * value
            r1 += b * value
            r2 += c * value
            r3 += d * value
            r4 += e * value
    normal[0, 0], normal[1, 0], normal[1, 1] = n00, n10, n11
    normal[2, 0], normal[2, 1], normal[2, 2] = n20, n21, n22
    normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = n30, n31, n32, n33
    normal[4, 0], normal[4, 1], normal[4, 2], normal[4, 3], normal[4, 4] = n40, n41, n42, n43, n44
    solution[0], solution[1], solution[2], solution[3], solution[4] = r0, r1, r2, r3, r4
    _solve(normal, solution)
    a, b, c, d, e = solution[0], solution[1], solution[2], solution[3], solution[4]
    # The ridge does not contribute to the residuals.
    square -= 2.0 * (a * r0 + b * r1 + c * r2 + d * r3 + e * r4)
    square += a * a * n00 + b * b * n11 + c * c * n22 + d * d * n33 + e * e * n44
    square += 2.0 * (a * (b * n10 + c * n20 + d * n30 + e * n40) + b * (c * n21 + d * n31 + e * n41))
    return max(square + 2.0 * (c * (d * n32 + e * n42) + d * e * n43), 0.0)


@kernel(nogil=True)
def light_residuals(
    now, template, over, out, surface, first, last, mean, transfer, solution, residual, texture
):
    """Sum of squared residuals of a shaded :func:`fit_light` beyond the edge, and their number.

    Fills the residuals and the fitted texture of the template, zero elsewhere.
    """
    squares, count = 0.0, 0
    for lane in range(now.shape[0]):
        for j in range(first, last + 1):
            residual[lane, j], texture[lane, j] = 0.0, 0.0
            p1, p0, tau = over[lane, j], out[lane, j], (j - first) / 20.0
            if p1 > 0.5:
                foam = mean + transfer * (template[lane, j] - mean)
                light = solution[0] * (1.0 - p1) + (solution[1] + solution[2] * tau) * p1
                beyond = surface[lane, j] * (solution[3] + solution[4] * tau)
                value = float(now[lane, j]) - light * foam * (1.0 - p0) - beyond
                squares, count = squares + value * value, count + 1
                residual[lane, j] = value
                texture[lane, j] = light * (foam - mean) * (1.0 - p0)
    return squares, count


#: Table of the complementary error function from -5 to 5, interpolated linearly: exact to 3e-6, 1/2000 of a grey level.
_OVER, _STEPS = 5.0, 200.0
_ERFC = np.array([math.erfc(i / _STEPS - _OVER) for i in range(int(2.0 * _OVER * _STEPS) + 2)])
_ERFC[0], _ERFC[-2:] = 2.0, 0.0


@kernel(nogil=True)
def _beyond(away):
    """Twice the fraction of a Gaussian edge that lies beyond a position, given in units of its width times sqrt(2)."""
    place = min(max((away + _OVER) * _STEPS, 0.0), 2.0 * _OVER * _STEPS)
    at = int(place)
    return _ERFC[at] + (place - at) * (_ERFC[at + 1] - _ERFC[at])


@kernel(nogil=True)
def pixel_weights(line, taps, first, last):
    """Fill the interpolation weights of each sample: position of a pixel and weight of the next one along the steeper axis
    of the line, and the variance due to interpolation along the other axis [samples^2], which softens edges."""
    lanes = taps.shape[1]
    axis = 0 if abs(line[2]) > abs(line[3]) else 1
    for lane in range(lanes):
        away = (lane - 0.5 * (lanes - 1)) * line[5]
        for j in range(first, last + 1):
            u = (line[0] + j * line[4] * line[2] - away * line[3]) % 1.0
            v = (line[1] + j * line[4] * line[3] + away * line[2]) % 1.0
            part, other = (v, u) if axis else (u, v)
            taps[0, lane, j] = j - part * line[2 + axis] / line[4]
            taps[1, lane, j] = part
            taps[2, lane, j] = other * (1.0 - other) * (line[3 - axis] / line[4]) ** 2
    return line[2 + axis] / line[4]


@kernel(nogil=True)
def edge_ramp(over, at, slope, width, taps, apart, first, last):
    """Fill the fraction of each sample that lies beyond a blurred edge, interpolated between pixels ``apart``."""
    lanes = over.shape[0]
    for lane in range(lanes):
        x1 = at + (lane - 0.5 * (lanes - 1)) * slope
        for j in range(first, last + 1):
            scale = 1.0 / math.sqrt(2.0 * (width * width + taps[2, lane, j]))
            away, part = (x1 - taps[0, lane, j]) * scale, taps[1, lane, j]
            over[lane, j] = 0.5 * ((1.0 - part) * _beyond(away) + part * _beyond(away - apart * scale))


@kernel(nogil=True)
def pixel_dependence(residual, texture, first, last):
    """Factor by which correlation raises the variance of the sum of residual times texture over that of white noise.

    Sum of the products of both autocorrelations over all lags (Bartlett), along the lines and across them.
    """
    lanes = residual.shape[0]
    result = 1.0
    own = 0.0
    for lane in range(lanes):
        for j in range(first, last + 1):
            own += residual[lane, j] ** 2
    power = 0.0
    for lane in range(lanes):
        for j in range(first, last + 1):
            power += texture[lane, j] ** 2
    if own * power <= 0.0:
        return result
    for across in range(2):
        total = 1.0
        for lag in range(1, lanes if across else LAGS):
            a, b = (lag, 0) if across else (0, lag)
            one, other = 0.0, 0.0
            for lane in range(lanes - a):
                for j in range(first, last + 1 - b):
                    one += residual[lane, j] * residual[lane + a, j + b]
                    other += texture[lane, j] * texture[lane + a, j + b]
            total += 2.0 * max(one * other / (own * power), 0.0)
        result *= total
    return result


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
                over, still = 0.5 * _beyond((at - x) * scale), 0.5 * _beyond(-x * scale)
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
