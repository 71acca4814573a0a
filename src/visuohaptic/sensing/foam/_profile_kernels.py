"""Compiled integration over a contour; plain arrays in and out. Everything else is in ``profile.py``."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ...tracking.contours.contour import SHARED_POINTS
from .material.stress_curve import curve_values

#: Columns of the region table, named in ``profile.py``.
COLUMNS = 17
#: Effective tension of the flanks of simulated foams in bending, relative to that of the force law.
FLANK = 2.5
#: A point bears load when the pressure minus the tension exceeds this fraction of m(eps).
TOUCH = 0.5


#: Foam near a free end relieves its shear by moving with the end: at a distance x from the end, a fraction
#: 1 - exp(-(x / d)^2) of the shear loss remains, with d this fraction of the width. The force errors of plates 2 to 45 mm from
#: the ends of four simulated foams are 0.6 % with it and 1.0 % without, and at most a fiftieth larger for 0.7 to 0.9.
END_PER_WIDTH = 0.8

#: A region ends one point beyond the last one whose deflection, averaged over three neighbours, exceeds this.
EDGE_SIGMAS = 1.0
OF_THREE = EDGE_SIGMAS / math.sqrt(3.0)
#: Added to the variance of a deflection, so that exact ones have weights [m^2].
EXACT_VAR = 1e-18


@kernel
def _total(sigma, uncertainty, zero_sigma, i):
    """Standard deviation of one deflection, noise and systematic error."""
    return np.sqrt(sigma[i] ** 2 + uncertainty[i] ** 2 + zero_sigma**2)


@kernel
def shared_variance(alone, noise, first, last):
    """Contribution of the covariance of neighbouring points to the variance of a force [N^2].

    The tracker fits the levels on both sides of the edge jointly over neighbouring points, which therefore share
    the error of the levels.

    Parameters
    ----------
    alone, noise
        Derivative of the force by each deflection [N/m], and the part of its noise that neighbours share [m], (n,).
    first, last
        First and last point of the force.
    """
    total = 0.0
    for j in range(first, last + 1):
        for i in range(j + 1, min(j + SHARED_POINTS, last) + 1):
            total += 2.0 * alone[j] * noise[j] * alone[i] * noise[i]
    return total


@kernel
def _run_variance(alone, error, first, last):
    """Contribution of the covariance to the variance [N^2] where runs of neighbours have a common error."""
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
    """Distribute the force of a region over its points by the Pasternak law; find the touched part."""
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
        # Two neighbours are required: in the shallow tail noise bends the contour at single points.
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

    All points are valid. Returns the number of regions, pressure, pressure sigma, the region
    table, and the sums of basis functions per region.

    Parameters
    ----------
    s, delta
        Position along the strip and deflection of the observed points [m], (n,).
    errors
        Of each deflection [m], (5, n): noise, systematic error, error that all points share, the part of the noise that
        neighbours share, and the part of the systematic error that runs of points share.
    index
        Index of each point on the strip, (n,); a jump in it is a gap.
    history
        Ratio of stress to loading stress (hysteresis), its standard deviation, and 1 where a point is unloading, (3, n).
    ends
        Length of foam beyond the first and the last observed point, and positions of the strip's free ends
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
        Threshold in sigmas of two neighbours, and of one point, from which a region grows.
    max_gap
        Maximum number of missing points in a gap within a region.
    averaged
        Whether each deflection is the mean over the spacing of the points, or the value at the point.
    knots, pieces, basis_pieces
        Loading curve, see :class:`~visuohaptic.sensing.foam.material.stress_curve.StressCurve`.
    soft, soft_end
        Softening at equidistant strains from 0 [Pa], and the last of these strains.
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
        # Negative strains due to noise count as negative stress, so that noise at rest averages to zero.
        stress[i] += slope[i] * min(strain[i], 0.0)
        pressure_sigma[i] = (
            factor[i]
            * slope[i]
            / width
            * np.sqrt(sigma[i] ** 2 + uncertainty[i] ** 2 + shared[i] ** 2 + zero_sigma**2)
        )
    # At most n regions: long gaps may separate all points.
    table = np.zeros((n, COLUMNS))
    sums = np.zeros((n, terms))
    count = 0
    step = soft_end / (len(soft) - 1)
    gradient, alone = np.zeros(n), np.zeros(n)
    # The mean over three neighbours keeps noise from cutting off the shallow end of a contact.
    mean, known = np.zeros(n), np.zeros(n)
    for i in range(n):
        total, number, weighted, weights = 0.0, 0, 0.0, 0.0
        for j in range(max(i - 1, 0), min(i + 2, n)):
            if abs(index[j] - index[i]) <= max_gap + 1:
                total += delta[j]
                number += 1
                inverse = 1.0 / (_total(sigma, uncertainty, 0.0, j) ** 2 + EXACT_VAR)
                weighted += inverse * delta[j]
                weights += inverse
        # The mean that is weighted by the errors, in standard errors.
        mean[i], known[i] = total / number, weighted / math.sqrt(weights)
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
        # Free foam whose deflection is within its own error does not belong to the contact.
        while first < last and mean[first + 1] <= OF_THREE * _total(sigma, uncertainty, 0.0, first + 1):
            first += 1
        while last > first and mean[last - 1] <= OF_THREE * _total(sigma, uncertainty, 0.0, last - 1):
            last -= 1
        # Foam beyond an end may bear load up to where it is known to be free: at kinks, where a gap opens in front of a body.
        beyond = 0.0
        for way in (-1, 1):
            j, k = (first, first - 1) if way < 0 else (last, last + 1)
            while known[j] > EDGE_SIGMAS and 0 <= k < n and abs(index[k] - index[j]) <= max_gap + 1:
                j, k = k, k + way
                ds = 0.5 * (s[min(j + 1, n - 1)] - s[max(j - 1, 0)])
                beyond += (height * ds * slope[j] / width * uncertainty[j]) ** 2
        cut = 0.0
        # The trapezoid extends to the neighbour outside, where the stress is zero.
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
        relief, freed, sheared = 0.0, 0.0, 0.0
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
                # A jump at a uniformly distributed position between two points. The mean over the spacing has the right
                # area; its error is due to the curvature of the stress over the jump, spread over two segments.
                bow = 0.125 * (slope[j] - slope[j + 1]) * (right - left) / width
                single = not averaged or index[j + 1] - index[j] > 1
                jump = (m_right - m_left) / math.sqrt(12.0) if single else bow * math.sqrt(4.0 / 3.0)
                sampling += (height * ds * jump) ** 2
            sine2 = g * g / (1 + g * g)
            sheared += 0.5 * height * ds * (m_left + m_right) * sine2
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
        # All points share one hysteresis law, and therefore its error.
        systematic = branch * branch + beyond + _run_variance(alone, errors[4], first, last)
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
        row[14], row[15], row[16] = enlarged, turned, sheared
        count += 1
    return count, pressure, pressure_sigma, table, sums
