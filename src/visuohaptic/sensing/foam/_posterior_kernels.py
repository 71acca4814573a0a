"""Compiled evidence of the pixels beyond the edges: edge of a shadow on foam, or a body; the model is in ``posterior.py``."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ._light_kernels import beyond_edge

#: Number of samples behind the edge that are compared with the zero image, and beyond the front at rest.
BAND, AHEAD = 12, 4
#: Samples closer to an edge than this many blurs are excluded.
EDGE = 2.0
#: Fraction of the pixels of a band that are independent, after lens, interpolation and JPEG.
INDEPENDENT = 0.5
#: The edge of a shadow is as sharp as the lens, or softer by this factor or its square.
SOFTNESS, SOFT = 3.0, 3
#: Fraction of the floor from which a sample shows its texture.
UNCOVERED = 0.3
#: Places of a sharp shadow before the front that are tried, at intervals of 1.5 blurs.
NEAR = 5
#: The place of such an edge is refined in this many steps, from half its width to an eighth.
REFINED = 3
#: Places of the front in a shadow that are tried are farther from that at rest by this factor, each.
STRIDE = 1.3
#: Correlation length limit of the residuals [samples].
_LAGS = 10


@kernel(nogil=True)
def solve(normal, right):
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
    solve(normal, solution)
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
            over[lane, j] = 0.5 * (
                (1.0 - part) * beyond_edge(away) + part * beyond_edge(away - apart * scale)
            )


@kernel(nogil=True)
def pixel_dependence(residual, texture, first, last):
    """Factor by which correlation raises the variance of the sum of residual times texture over that of white noise.

    Sum of the products of both autocorrelations over all lags (Bartlett), along the lines and across them.
    """
    lanes = residual.shape[0]
    result, own, power = 1.0, 0.0, 0.0
    for lane in range(lanes):
        for j in range(first, last + 1):
            own += residual[lane, j] ** 2
            power += texture[lane, j] ** 2
    if own * power <= 0.0:
        return result
    for across in range(2):
        total = 1.0
        for lag in range(1, lanes if across else _LAGS):
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
def _behind(beyond, over, rest_shape, known, x0, front, slope, blur, result, first, last):
    """Fill the surface behind a front: beyond a blurred step, or, if ``known``, beyond a step with the shape of that at rest."""
    lanes = over.shape[0]
    for lane in range(lanes):
        here = front + (lane - 0.5 * (lanes - 1)) * slope
        for j in range(first, last + 1):
            at = j + x0 - here
            if known and 0.0 <= at < last and j < here + EDGE * blur:
                m = int(at)
                result[lane, j] = rest_shape[lane, m] + (at - m) * (
                    rest_shape[lane, m + 1] - rest_shape[lane, m]
                )
            else:
                result[lane, j] = beyond[lane, j] * over[lane, j]


@kernel(nogil=True)
def _moved_odds(now, template, over, taps, line, places, given, noise, work, normal, solution, left):
    """Log-likelihood ratio of foam in a shadow whose front has moved, anywhere up to the edge of the shadow, against foam at rest.

    The front is at rest within half a pixel.
    """
    (x0, front, blur), (first, last, mean, transfer) = places, given
    pixel, apart = 1.0 / line[4], pixel_weights(line, taps, first, last)
    rest, moved, place, away = 1e300, 1e300, x0, -0.5
    while away * pixel < x0 - front:
        at = x0 - away * pixel
        edge_ramp(work, at, 0.0, blur, taps, apart, first, last)
        fit = fit_light(now, template, over, work, work, first, last, mean, transfer, 1, normal, solution)
        rest = min(rest, fit) if away < 1.0 else rest
        if away >= 1.0 and fit < moved:
            moved, place = fit, at
        away = max(away + 0.5, STRIDE * away)
    # It would be within a pixel of its place by chance.
    chance = math.log(max((x0 - front) / pixel, 1.0))
    if moved > rest:
        return -chance
    edge_ramp(work, place, 0.0, blur, taps, apart, first, last)
    fit_light(now, template, over, work, work, first, last, mean, transfer, 1, normal, solution)
    count = now.shape[0] * (last + 1 - first)
    better = 0.5 * count * math.log(max(rest, noise * count) / max(moved, noise * count))
    texture = np.zeros_like(left)
    light_residuals(now, template, over, work, work, first, last, mean, transfer, solution, left, texture)
    return better / pixel_dependence(left, left, first, last) - chance


@kernel(nogil=True)
def shadow_odds(now, rest, lines, front, resting, slope, blur, smear, transfer, variance, tested, result):
    """Test whether the zero image continues beyond each edge, in another light.

    Parameters
    ----------
    now, rest, front, resting, slope, blur
        See :func:`~visuohaptic.sensing.foam._texture_kernels.foam_bands`.
    lines
        Origin (x, y) [px] and unit direction of each line, spacing of its samples and of its parallels [px], (K, 6).
    smear
        Largest standard deviation by which its own motion blurs the front of the foam [samples], (K,).
    transfer
        Fraction of the texture of the zero image that is visible in this image.
    variance
        Variance of the foam's grey levels about their prediction [grey levels^2].
    tested
        Points to test, (K,).
    result
        Filled, (K, 8): log-likelihood ratio of the texture of the zero image beyond the edge against none, for
        independent pixels; log-likelihood ratio of a second edge at the front at rest against a single edge, where
        both are too close to be resolved; grey level between edge and front at rest, beyond it, and beyond it at rest;
        number of pixels equivalent to one independent pixel; log-likelihood ratio of an edge that is softer than lens and motion make
        it, for independent pixels; log-likelihood ratio of a front that has moved in the shadow against one at rest.
    """
    parallels, samples = now.shape[1], now.shape[2]
    over = np.zeros((parallels, samples))
    out, taps = np.zeros((parallels, samples)), np.zeros((3, parallels, samples))
    template, floors = np.zeros((parallels, samples)), np.zeros((2, parallels, samples))
    bodies = np.full((2, parallels, samples), 100.0)
    solution, normal = np.zeros(5), np.zeros((5, 5))
    left, texture = np.zeros((parallels, samples)), np.zeros((parallels, samples))
    body = np.zeros((parallels, samples))
    for k in range(len(front)):
        for i in range(8):
            result[k, i] = np.nan
        x0 = resting[k]
        first = max(int(min(front[k], x0) - EDGE * SOFTNESS * blur - 2.0), 0)
        last = min(int(x0 + EDGE * blur) + AHEAD, samples - 1)
        edge = int(x0 - 2.5 * blur)  # the template is foam up to here
        if not tested[k] or edge < 4:
            continue
        mean, beyond = 0.0, 0.0
        begin = max(min(first, edge - BAND), 0)
        for lane in range(parallels):
            for j in range(begin, edge + 1):
                mean += rest[k, lane, j]
            beyond += rest[k, lane, last] + rest[k, lane, last - 1] + rest[k, lane, last - 2]
        mean /= parallels * (edge + 1 - begin)
        beyond /= 3.0 * parallels
        apart = pixel_weights(lines[k], taps, first, last)
        edge_ramp(out, x0, 0.0, blur, taps, apart, first, last)
        # The surface beyond is uniform, or the floor of the zero image, which extends to where the foam has uncovered it.
        scale = 100.0 / max(beyond, 1.0)
        for lane in range(parallels):
            for j in range(last, first - 1, -1):
                foam = rest[k, lane, j] if j <= edge else mean
                template[lane, j], p0 = foam, out[lane, j]
                floors[0, lane, j] = 100.0 * p0
                floors[1, lane, j] = scale * (rest[k, lane, j] - foam * (1.0 - p0)) if p0 > 0.0 else 0.0
                bodies[1, lane, j] = floors[1, lane, j] / p0 if p0 > UNCOVERED else bodies[1, lane, j + 1]
        edge_ramp(over, front[k], slope[k], blur, taps, apart, first, last)
        count, sharp = parallels * (last + 1 - first), math.hypot(blur, smear[k])
        result[k, 4] = beyond
        given = first, last, mean, transfer
        if x0 - front[k] > 2.0 * EDGE * blur:
            width, best, floor = blur, 1e300, floors[0]
            for i in range(2):
                fit = fit_light(now[k], template, over, out, floors[i], *given, 1, normal, solution)
                if fit < best:
                    best, floor = fit, floors[i]
            least = best
            for i in range(1, SOFT):
                edge_ramp(over, front[k], slope[k], SOFTNESS**i * blur, taps, apart, first, last)
                fit = fit_light(now[k], template, over, out, floor, *given, 1, normal, solution)
                if fit < least:
                    least, width = fit, SOFTNESS**i * blur
            result[k, 6] = 0.0
            if width > sharp:
                edge_ramp(over, front[k], slope[k], sharp, taps, apart, first, last)
                best = fit_light(now[k], template, over, out, floor, *given, 1, normal, solution)
                noise = variance * count
                result[k, 6] = 0.5 * count * math.log(max(best, noise) / max(least, noise))
            shaded = template, over, out, floor, first, last, mean
            edge_ramp(over, front[k], slope[k], width, taps, apart, first, last)
            fit_light(now[k], *shaded, 0.0, 1, normal, solution)
            without, count = light_residuals(now[k], *shaded, 0.0, solution, left, texture)
            fit_light(now[k], *shaded, transfer, 1, normal, solution)
            with_texture, count = light_residuals(now[k], *shaded, transfer, solution, left, texture)
            noise = variance * max(count, 1)
            result[k, 0] = 0.5 * count * math.log(max(without, noise) / max(with_texture, noise))
            result[k, 5] = pixel_dependence(left, texture, first, last)
            middle = 0.5 * (front[k] + x0)
            result[k, 2] = mean * (solution[1] + solution[2] * (middle - first) / 20.0)
            result[k, 3] = 100.0 * (solution[3] + solution[4] * (x0 - first) / 20.0)
            result[k, 7] = _moved_odds(
                now[k], template, over, taps, lines[k], (x0, front[k], blur), given, variance, body, normal,
                solution, left,
            )  # fmt: skip
        else:
            # Foam that has moved: beyond it a body or the floor, with the shape of a blurred step or that of the front at rest;
            # and the better of them with the blur of its own motion.
            single, nearest = 1e300, 0
            for i in range(4):
                if i == 3:
                    edge_ramp(over, front[k], slope[k], sharp, taps, apart, first, last)
                behind = bodies[min(nearest if i == 3 else i, 1)]
                _behind(behind, over, floors[1], i == 2, x0, front[k], slope[k], blur, body, first, last)
                fit = fit_light(now[k], template, over, out, body, *given, 0, normal, solution)
                if fit < single:
                    single, nearest = fit, i
            # A sharp edge is resolved only where it lies before the front, a soft one anywhere. Nearer than two widths of the
            # step, they cannot be told from foam that has moved over a floor that is known.
            best, place, width, latest = 1e300, x0, blur, x0
            for i in range(2):
                soft = SOFTNESS**i * blur
                for m in range(3 if i else NEAR):
                    at = x0 - 1.5 * soft * (m - 1 if i else m + 1)
                    edge_ramp(over, at, slope[k], soft, taps, apart, first, last)
                    for known in range(2 if i == 0 and m > 0 else 1):
                        surface = floors[known]
                        fit = fit_light(now[k], template, over, out, surface, *given, 2, normal, solution)
                        if fit < best:
                            best, place, width, floor = fit, at, soft, surface
                            latest = x0 - 1.5 * blur * (1 + known) if i == 0 else x0 + 2.0 * soft
            span = 0.5 * width
            for _halving in range(REFINED):
                for m in range(2):
                    at = min(place + (span if m else -span), latest)
                    edge_ramp(over, at, slope[k], width, taps, apart, first, last)
                    fit = fit_light(now[k], template, over, out, floor, *given, 2, normal, solution)
                    if fit < best:
                        best, place = fit, at
                span *= 0.5
            # Foam in a shadow leaves the foam's variance, the surface of a body any larger one: it fits two edges better than
            # one by its own texture. Where neither fits, there is no evidence.
            own = single / (count * variance)
            own = 1.0 + math.log(own) if own > 1.0 else own
            better = 0.5 * count * max(own - best / (count * variance), 0.0)
            if better > 0.0:
                # The blotches of a surface are a few independent pixels.
                edge_ramp(over, place, slope[k], width, taps, apart, first, last)
                fit_light(now[k], template, over, out, floor, *given, 2, normal, solution)
                light_residuals(now[k], template, over, out, floor, *given, solution, left, texture)
                better /= pixel_dependence(left, left, first, last)
            result[k, 1] = better - math.log(count)
