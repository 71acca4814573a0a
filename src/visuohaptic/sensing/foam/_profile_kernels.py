"""Compiled sums over a contour; plain arrays in and out. Everything else is in ``profile.py``."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ...tracking.contours.contour import SHARED_POINTS
from .material.stress_curve import curve_values

#: Columns of the region table, named in ``profile.py``.
COLUMNS = 16
#: Flanks of simulated foams bend as if their tension were this many times that of the force law.
FLANK = 2.5
#: A point bears load when the pressure left by the tension exceeds this fraction of m(eps).
TOUCH = 0.5


#: Foam beside a free end relieves its shear by moving with it: of what sheared foam loses, 1 - exp(-(x / d)^2) is left at
#: a distance x from the end, with d this part of the width. Forces of plates 2 to 45 mm from the ends of four simulated
#: foams are right to 0.6 % with it, to 1.0 % without, and not worse than by a fiftieth of it from 0.7 to 0.9.
END_PER_WIDTH = 0.8

#: A region ends one point beyond the last one that is deflected by more than this, in the mean of three neighbours.
EDGE_SIGMAS = 1.0
OF_THREE = EDGE_SIGMAS / math.sqrt(3.0)


@kernel
def _total(sigma, uncertainty, zero_sigma, i):
    """Standard deviation of one deflection, noise and systematic."""
    return np.sqrt(sigma[i] ** 2 + uncertainty[i] ** 2 + zero_sigma**2)


@kernel
def shared_variance(alone, noise, first, last):
    """What neighbours add to the variance of a force [N^2].

    The tracker fits the levels on both sides of the edge over neighbouring points together; their error is common to
    these points.

    Parameters
    ----------
    alone, noise
        Derivative of the force by each deflection [N/m], and the part of its noise that is common to these points [m], (n,).
    first, last
        Points of the force.
    """
    total = 0.0
    for j in range(first, last + 1):
        for i in range(j + 1, min(j + SHARED_POINTS, last) + 1):
            total += 2.0 * alone[j] * noise[j] * alone[i] * noise[i]
    return total


@kernel
def _run_variance(alone, error, first, last):
    """What neighbours add to the variance [N^2] where runs of them have the same error."""
    total, run = 0.0, 0.0
    for j in range(first, last + 1):
        own = alone[j] * error[j]
        total += 2.0 * run * own
        run = run + own if own != 0.0 else 0.0
    return total


@kernel
def _share(
    s, delta, stress, factor, weight, pressure, first, last, lo, hi, width, height, kappa, mode, force
):
    """Distribute the force of a region over its points by the Pasternak law; find where it touches."""
    highest = 0.0
    for j in range(first, last + 1):
        highest = max(highest, delta[j])
    for j in range(lo, hi):
        ds = s[j + 1] - s[j]
        g = (max(delta[j + 1], 0.0) - max(delta[j], 0.0)) / ds
        eps = max(0.5 * (max(delta[j], 0.0) + max(delta[j + 1], 0.0)) / width, 2e-3)
        mean = 0.5 * (factor[j] * stress[j] + factor[j + 1] * stress[j + 1])
        pull = FLANK * kappa * width * mean * (1 - eps) / (eps * (2 - eps)) / 3 * g / np.sqrt(1 + g * g)
        if j >= first:
            pressure[j] -= pull / weight[j]
        if j + 1 <= last:
            pressure[j + 1] += pull / weight[j + 1]
    touch_first, touch_last = -1, -1
    total = 0.0
    for j in range(first, last + 1):
        # Two neighbours must agree: in the shallow tail noise bends the contour at single points.
        here = pressure[j] > TOUCH * factor[j] * stress[j]
        after = j < last and pressure[j + 1] > TOUCH * factor[j + 1] * stress[j + 1]
        before = j > first and pressure[j - 1] > TOUCH * factor[j - 1] * stress[j - 1]
        if here and (after or before) and delta[j] > 0.1 * highest:
            if touch_first < 0:
                touch_first = j
            touch_last = j
    if touch_first < 0:
        touch_first, touch_last = first, last
    if mode == 0:
        force = 0.0
        for j in range(first, last + 1):
            inside = touch_first <= j <= touch_last
            pressure[j] = factor[j] * stress[j] if inside else 0.0
            force += height * weight[j] * pressure[j]
        return touch_first, touch_last, force
    for j in range(first, last + 1):
        if pressure[j] < 0 or j < touch_first or j > touch_last:
            pressure[j] = 0.0
        total += height * weight[j] * pressure[j]
    if total > 0:
        for j in range(first, last + 1):
            pressure[j] *= force / total
    return touch_first, touch_last, force


@kernel
def integrate_regions(s, delta, errors, index, history, ends, zero_sigma, width, height, kappa, mode,
                      seed_pair, seed_single, max_gap, averaged, knots, pieces, basis_pieces, soft, soft_end):  # fmt: skip
    """Find contact regions and integrate stress, noise and derivatives over each.

    All points given are valid. Returns the number of regions, pressure, pressure sigma, the region
    table, and the sums of basis functions per region.

    Parameters
    ----------
    s, delta
        Position along the strip and deflection of the seen points [m], (n,).
    errors
        Of each deflection [m], (5, n): noise, systematic error, error that all points share, the part of the noise that
        neighbours share, and the part of the systematic error that runs of points share.
    index
        Number of each point on the strip, (n,); a jump in it is a gap.
    history
        Stress by the loading stress (hysteresis), its standard deviation, and 1 where a point is unloading, (3, n).
    ends
        Length of foam beyond the first and the last point that was seen, and positions of the strip's free ends
        [m], (2, 2).
    zero_sigma
        Error that is common to all points [m].
    width, height
        Size of the strip along the compression and across the contour [m].
    kappa
        Ratio of the lateral tension.
    mode
        Index of the boundary law in ``BOUNDARIES``.
    seed_pair, seed_single
        Sigmas of two neighbours, and of one point, from which a region grows.
    max_gap
        Points that a gap within a region may lack.
    averaged
        Whether each deflection is the mean over the spacing of the points, or that at the point.
    knots, pieces, basis_pieces
        Loading curve, as of :class:`~visuohaptic.sensing.foam.material.stress_curve.StressCurve`.
    soft, soft_end
        Softening at even strains from 0 [Pa], and the last of these strains.
    """
    n = len(s)
    sigma, uncertainty, shared, factor = errors[0], errors[1], errors[2], history[0]
    terms = basis_pieces.shape[1]
    strain, values = np.empty(n), np.empty((2, n))
    for i in range(n):
        strain[i] = delta[i] / width
    curve_values(strain, knots, pieces, values)
    stress, slope = values[0], values[1]
    pressure = np.zeros(n)
    pressure_sigma = np.zeros(n)
    weight = np.zeros(n)
    piece_of = np.zeros(n, np.int64)
    end = knots[-1]
    last_piece = len(knots) - 2
    for i in range(n):
        while piece_of[i] < last_piece and strain[i] >= knots[piece_of[i] + 1]:
            piece_of[i] += 1
        # A point that noise has beyond the resting front takes from the force what it gives elsewhere.
        stress[i] += slope[i] * min(strain[i], 0.0)
        pressure_sigma[i] = (
            factor[i]
            * slope[i]
            / width
            * np.sqrt(sigma[i] ** 2 + uncertainty[i] ** 2 + shared[i] ** 2 + zero_sigma**2)
        )
    # Every point may be a region of its own, when all have long gaps between them.
    table = np.zeros((n, COLUMNS))
    sums = np.zeros((n, terms))
    count = 0
    step = soft_end / (len(soft) - 1)
    gradient, alone = np.zeros(n), np.zeros(n)
    # Noise must not cut off the shallow end of a contact: three neighbours say where it is.
    mean = np.zeros(n)
    for i in range(n):
        total = 0.0
        number = 0
        for j in range(max(i - 1, 0), min(i + 2, n)):
            if abs(index[j] - index[i]) <= max_gap + 1:
                total += delta[j]
                number += 1
        mean[i] = total / number
    i = 0
    while i < n:
        # A region grows from a seed: one point far above the noise, or two neighbours above it.
        if mean[i] <= 0.0:
            i += 1
            continue
        first = i
        seeded = False
        previous = False
        while i < n and mean[i] > 0.0:
            if i > first and index[i] - index[i - 1] > max_gap + 1:
                break
            scale = _total(sigma, uncertainty, math.hypot(zero_sigma, shared[i]), i)
            high = delta[i] > seed_pair * scale
            if delta[i] > seed_single * scale or (high and previous):
                seeded = True
            previous = high
            i += 1
        last = i - 1
        if not seeded:
            continue
        # Free foam that is off by its own error is no part of the contact.
        while first < last and mean[first + 1] <= OF_THREE * _total(sigma, uncertainty, 0.0, first + 1):
            first += 1
        while last > first and mean[last - 1] <= OF_THREE * _total(sigma, uncertainty, 0.0, last - 1):
            last -= 1
        cut = 0.0
        # The trapezoid goes on to the neighbour outside, where the stress is zero.
        if first > 0:
            if index[first] - index[first - 1] > max_gap + 1:
                cut = 1.0
        elif index[first] > max_gap:
            cut = 1.0
        if last < n - 1 and index[last + 1] - index[last] > max_gap + 1:
            cut = 1.0
        lo = first - 1 if first > 0 and index[first] - index[first - 1] <= max_gap + 1 else first
        hi = last + 1 if last < n - 1 and index[last + 1] - index[last] <= max_gap + 1 else last
        for j in range(lo, hi + 1):
            gradient[j] = 0.0
            if first <= j <= last:
                weight[j] = 0.0
                pressure[j] = factor[j] * stress[j]
        if first == 0:
            weight[0] += ends[0, 0]
        if last == n - 1:
            weight[n - 1] += ends[0, 1]
        relief = 0.0
        freed = 0.0
        sampling = 0.0
        top = 0.0
        for j in range(lo, hi):
            ds = s[j + 1] - s[j]
            left = max(delta[j], 0.0)
            right = max(delta[j + 1], 0.0)
            if j >= first:
                weight[j] += 0.5 * ds
            if j + 1 <= last:
                weight[j + 1] += 0.5 * ds
            m_left = factor[j] * stress[j]
            m_right = factor[j + 1] * stress[j + 1]
            g = (right - left) / ds
            if abs(g) > 0.7 or index[j + 1] - index[j] > 1:
                # A jump somewhere between two points, uniformly distributed. The mean over the spacing has the right
                # area, and is wrong by the bow of the stress over the jump, which falls on two segments.
                bow = 0.125 * (slope[j] - slope[j + 1]) * (right - left) / width
                single = not averaged or index[j + 1] - index[j] > 1
                jump = (m_right - m_left) / math.sqrt(12.0) if single else bow * math.sqrt(4.0 / 3.0)
                sampling += (height * ds * jump) ** 2
            if mode != 1:
                eps = 0.5 * (left + right) / width
                position = min(eps / step, len(soft) - 1.001)
                cell = int(position)
                rise = soft[cell + 1] - soft[cell]
                loss = soft[cell] + rise * (position - cell)
                middle = 0.5 * (s[j] + s[j + 1])
                apart = max(min(middle - ends[1, 0], ends[1, 1] - middle), 0.0) / (END_PER_WIDTH * width)
                free = math.exp(-apart * apart)
                scale = 0.5 * (factor[j] + factor[j + 1])
                sine2 = g * g / (1 + g * g)
                freed += height * ds * loss * sine2 * scale * free
                scale *= 1.0 - free
                relief += height * ds * loss * sine2 * scale
                turn = kappa * height * scale * loss * 2 * g / (1 + g * g) ** 2
                drift = kappa * height * scale * ds * sine2 * rise / step / (2 * width)
                gradient[j] += turn - drift
                gradient[j + 1] -= turn + drift
        force, turned, branch = 0.0, 0.0, 0.0
        for j in range(first, last + 1):
            force += height * weight[j] * factor[j] * stress[j]
            turned += height * weight[j] * history[2, j] * stress[j]
            branch += height * weight[j] * history[1, j] * stress[j]
            alone[j] = height * weight[j] * factor[j] * slope[j] / width
            gradient[j] += alone[j]
            top = max(top, strain[j])
        enlarged = force
        touch_first, touch_last = first, last
        if mode != 1:
            if mode == 2:
                force -= kappa * relief
            touch_first, touch_last, force = _share(
                s, delta, stress, factor, weight, pressure, first, last, lo, hi, width, height, kappa, mode, force
            )  # fmt: skip
        image = shared_variance(alone, errors[3], first, last)
        # One hysteresis law for all points: its error is common to them.
        systematic = branch * branch + _run_variance(alone, errors[4], first, last)
        zero = 0.0
        common = 0.0
        for j in range(first, last + 1):
            if mode == 0 and (j < touch_first or j > touch_last):
                continue
            image += (gradient[j] * sigma[j]) ** 2
            systematic += (gradient[j] * uncertainty[j]) ** 2
            zero += gradient[j]
            common += gradient[j] * shared[j]
            x = min(strain[j], end) - knots[piece_of[j]]
            beyond = max(strain[j] - end, 0.0)
            for k in range(terms):
                a = basis_pieces[piece_of[j], k, 0]
                b = basis_pieces[piece_of[j], k, 1]
                c = basis_pieces[piece_of[j], k, 2]
                d = basis_pieces[piece_of[j], k, 3]
                value = a + x * (b + x * (c + x * d)) + beyond * (b + x * (2 * c + 3 * x * d))
                sums[count, k] += height * weight[j] * factor[j] * value
        row = table[count]
        row[0], row[1], row[2], row[3], row[4] = first, last, force, image, zero
        row[5], row[6], row[7], row[8] = relief, sampling, top, cut
        row[9], row[10], row[11], row[12], row[13] = touch_first, touch_last, systematic, freed, common
        row[14], row[15] = enlarged, turned
        count += 1
    return count, pressure, pressure_sigma, table, sums
