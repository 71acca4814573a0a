"""Front of the foam on lines where the edge of a shadow hides it from the tracker.

The edge of a shadow that crosses the strip is often stronger than the front in the shadow, so that the contour follows it. The
front is a second edge, farther from the base: it is tracked from the place where the foam was last seen, beyond the first edge. Where
the edge of the shadow crosses the front, both merge into one step. Its line is known from where both are resolved, and the
front is the place at which foam in one light, foam in the other one and the surface beyond leave the least residual.

Whether the first edge is that of a shadow, and the second one that of the foam, is inferred in ``posterior.py``.
"""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...core.kernels import kernel
from ...tracking.contours._refine_kernels import NEAR
from ...tracking.contours.contour import PIXEL_PX, Contour, ContourSettings, ContourTracker, PointReason
from ._chain_kernels import SAME_BLUR
from ._posterior_kernels import INDEPENDENT, edge_ramp, pixel_weights, solve
from .strip import ObservedStrip

#: Length of the plateaus beside an edge, and half the width of its pixels along it, short beside one that crosses it [px].
_PLATEAU_PX, _HALF_PX = 2.0, 2.0
#: Beyond this many blurs an edge has ended (0.6 % of its step).
_TAIL = 2.5
#: Spacing of the places of a merged front that are tried [samples], that of places near the most likely one, and their number
#: to either side, up to the second place of the wider spacing.
_EVERY, _FINE = 0.5, 0.25
_NEAR = round(2.0 * _EVERY / _FINE)
#: Number of places of the edge of the shadow that are tried, and their spacing [samples]: 2.4 standard deviations of an edge
#: that is extrapolated over five lines, see the test.
_SHIFTS, _SHIFT = 9, 0.125
#: Values of a contour at its points.
_POINTS = (
    "position_px", "sigma_px", "noise_px", "valid", "reason", "contrast", "level", "blur_px", "slope", "chi2"
)  # fmt: skip
#: Number of lines from which the edge of a shadow is extrapolated, and standard deviation of the place [px] and of the slope of each
#: (measured on 5,000 lines of two worlds: 0.08 to 0.12 px, 0.02 to 0.03).
_NEAREST, _PLACE_SIGMA, _SLOPE_SIGMA = 5, 0.1, 0.025


def second_front(
    grey: UInt8[np.ndarray, "rows columns"],
    strip: ObservedStrip,
    polarity: int,
    tested: Bool[np.ndarray, "K"],
    last_m: Float[np.ndarray, "K"],
) -> tuple[Contour, Float[np.ndarray, "K"]] | None:
    """Front beyond the first edge of the tested lines, where that is the edge of a shadow.

    Parameters
    ----------
    grey
        The image.
    strip
        Observation of the strip in it.
    polarity
        Sign of the step from the foam to what is in front of it, 0 if unknown.
    tested
        Lines whose first edge is not that of the foam.
    last_m
        Last observed deflection of the foam [m], NaN where there is none.

    Returns
    -------
    tuple
        The contour with second edges, and the place of the edge of the shadow on lines where it is known and beside the front, 0
        elsewhere [px], (K,); ``None`` if no line has a second edge.
    """
    first, blur = strip.front, math.hypot(strip.lens_px, PIXEL_PX)
    lines, seen = first.lines, tested & first.valid
    tracker = ContourTracker(ContourSettings(polarity=polarity, plateau_px=_PLATEAU_PX))
    guess = strip.rest_px - np.nan_to_num(last_m) / strip.pixel_m
    guess = np.where(~tested & first.valid, first.position_px, guess)
    side = np.array([-lines.direction_px[:, 1].mean(), lines.direction_px[:, 0].mean()])
    s_px = (lines.origin_px - lines.origin_px[0]) @ side
    # A softer edge, that of a penumbra, has no place that could be told from the front's.
    sharp = np.hypot(first.blur_px, PIXEL_PX) < (1.0 + 3.0 * SAME_BLUR) * blur
    edge_px, edge_slope = np.where(seen, first.position_px, np.inf), np.zeros(len(seen))
    second = first
    for _ in range(2):
        # The edge of a shadow extends to lines that the contour has left or has not reached.
        start = np.where(edge_px < guess, edge_px + _TAIL * blur, lines.start_px)
        start = np.clip(start, lines.start_px, lines.stop_px)
        thin = replace(lines, start_px=start, half_width_px=np.full(len(start), _HALF_PX))
        second = tracker.near(grey, thin, np.clip(guess, start, lines.stop_px))
        resolved = second.position_px - first.position_px > _TAIL * blur
        shadow = seen & sharp & second.valid & resolved
        if not shadow.any():
            return None
        edge_px, edge_slope = _extended(first, shadow, s_px)
    clear = tested & second.valid & (second.position_px - edge_px > _TAIL * blur)
    found = np.where(clear, second.position_px, first.position_px)
    known = np.flatnonzero(clear | (~tested & first.valid))
    known = known[np.argsort(s_px[known])]
    front_px = np.interp(s_px, s_px[known], found[known])
    # The fit of a front includes pixels behind the edge of the shadow, or both merge.
    apart, slant = front_px - edge_px, _HALF_PX * np.abs(edge_slope)
    merged = (apart < (NEAR + _TAIL) * blur + _PLATEAU_PX + slant) & (apart > -_TAIL * blur - slant)
    merged |= tested & ~clear & (edge_px > lines.start_px) & (apart > 0.0)
    fitted = _fit_merged(
        strip, tracker.settings, merged, edge_px, edge_slope, front_px, np.gradient(front_px, s_px)
    )
    hidden = tested & ~clear & (np.abs(first.position_px - edge_px) < _TAIL * blur)
    lost = (merged | hidden) & ~fitted.valid
    front = _where(fitted.valid, fitted, _where(clear & ~merged, second, first))
    front.valid[lost], front.reason[lost] = False, PointReason.OCCLUDED
    return front, np.where(fitted.valid | (clear & ~merged), np.maximum(edge_px, 0.0), 0.0)


def _where(chosen: Bool[np.ndarray, "K"], one: Contour, other: Contour) -> Contour:
    """The chosen points of one contour, and the others of another one."""
    return replace(
        other, **{name: np.where(chosen, getattr(one, name), getattr(other, name)) for name in _POINTS}
    )


def _fit_merged(
    strip: ObservedStrip,
    settings: ContourSettings,
    merged: Bool[np.ndarray, "K"],
    edge_px: Float[np.ndarray, "K"],
    edge_slope: Float[np.ndarray, "K"],
    front_px: Float[np.ndarray, "K"],
    slope: Float[np.ndarray, "K"],
) -> Contour:
    """Fronts that merge with the edge of a shadow; place and slope of both as far as they are known without."""
    first, step, ones = strip.front, strip.step_px, np.ones(len(merged))
    blur, across = math.hypot(strip.lens_px, PIXEL_PX), strip.across_px / step
    lines = np.column_stack([first.lines.origin_px, first.lines.direction_px, step, strip.across_px])
    reach = (NEAR + _TAIL) * blur + _PLATEAU_PX + _HALF_PX * np.abs(edge_slope)
    found = np.full((len(merged), 4), np.nan)
    merged_fronts(
        strip.image, lines, edge_px / step, edge_slope * across, front_px / step, slope * across, blur / step,
        reach / step, strip.rest_px / step, merged, found,
    )  # fmt: skip
    place, sigma, foam, level = found.T
    place, sigma, contrast = place * step, sigma * step, level - foam
    seen = (sigma < 1.0) & (np.abs(contrast) >= settings.min_contrast) & (contrast * settings.polarity >= 0.0)
    return Contour(
        first.lines, place, sigma, sigma, seen, np.zeros_like(first.reason), contrast, level,
        strip.lens_px * ones, slope, ones, False,
    )  # fmt: skip


def _extended(
    first: Contour, shadow: Bool[np.ndarray, "K"], s_px: Float[np.ndarray, "K"]
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Place and slope of the edge of the nearest shadow on each line, from lines where it is resolved."""
    at = np.flatnonzero(shadow)
    near = at[np.abs(s_px[:, None] - s_px[at]).argsort(axis=1)[:, :_NEAREST]]
    s, x = s_px[near], first.position_px[near]
    away = s - s.mean(axis=1, keepdims=True)
    # Weighted by their variances, the direction of the edges and the line through their places agree.
    ratio = (_PLACE_SIGMA / _SLOPE_SIGMA) ** 2
    slope = (np.sum(away * x, axis=1) + ratio * first.slope[near].sum(axis=1)) / (
        np.sum(away**2, axis=1) + ratio * near.shape[1]
    )
    edge = x.mean(axis=1) + slope * (s_px - s.mean(axis=1))
    return np.where(shadow, first.position_px, edge), slope


@kernel(nogil=True)
def _levels(now, over, out, first, last, normal, solution):
    """Least-squares grey levels of foam in the light, in the shadow, and of the surface beyond; returns the squared residuals.

    ``over`` and ``out`` are the fractions of each sample beyond the edge of the shadow and beyond the front.
    """
    normal[:, :], solution[:], square = 0.0, 0.0, 0.0
    part = np.empty(3)
    for lane in range(now.shape[0]):
        for j in range(first, last + 1):
            value, part[2] = float(now[lane, j]), out[lane, j]
            part[1] = max(over[lane, j] - part[2], 0.0)
            part[0] = 1.0 - part[1] - part[2]
            square += value * value
            for a in range(3):
                solution[a] += part[a] * value
                for b in range(a + 1):
                    normal[a, b] += part[a] * part[b]
    n10, n20, n21 = normal[1, 0], normal[2, 0], normal[2, 1]
    n00, n11, n22 = normal[0, 0], normal[1, 1], normal[2, 2]
    r0, r1, r2 = solution
    solve(normal, solution)
    a, b, c = solution
    square += a * (a * n00 - 2.0 * r0) + b * (b * n11 - 2.0 * r1) + c * (c * n22 - 2.0 * r2)
    return max(square + 2.0 * (a * b * n10 + a * c * n20 + b * c * n21), 0.0)


@kernel(nogil=True)
def merged_fronts(image, lines, edge, edge_slope, guess, slope, blur, reach, rest, chosen, found):
    """Locate fronts that merge with the edge of a shadow: foam in one light, in the other one, and a surface beyond.

    Parameters
    ----------
    image
        Grey levels along the lines, (K, parallels, samples).
    lines
        See :func:`~visuohaptic.sensing.foam._posterior_kernels.shadow_odds`, (K, 6).
    edge, edge_slope
        Place of the edge of the shadow [samples], and its shift from one parallel to the next, (K,).
    guess, slope
        The same of the front, from its neighbours, (K,).
    blur, reach
        Blur of the edges, and distance from both edges up to which pixels are compared [samples], (K,).
    rest
        Front at rest [samples], (K,).
    chosen
        Lines to fit, (K,).
    found
        Filled, (K, 4): place and its standard deviation [samples], grey levels of the foam at the front and of the surface
        beyond; left as it is where the front is not between the places that are tried, and where the image is blank.
    """
    parallels, samples = image.shape[1], image.shape[2]
    over, out = np.zeros((parallels, samples)), np.zeros((parallels, samples))
    taps, solution, normal = np.zeros((3, parallels, samples)), np.zeros(3), np.zeros((3, 3))
    each, left = np.zeros((_SHIFTS, 3)), np.zeros(max(samples, 2 * _NEAR + 1))
    for k in range(len(edge)):
        if not chosen[k]:
            continue
        first = max(int(min(edge[k], guess[k]) - reach[k]), 0)
        last = min(int(max(edge[k], guess[k]) + reach[k]), samples - 1)
        apart = pixel_weights(lines[k], taps, first, last)
        begin = max(min(edge[k], guess[k]) - _TAIL * blur[k], first + _TAIL * blur[k])
        end = min(rest[k] + 2.0 * blur[k], last - _TAIL * blur[k])
        count = min(int((end - begin) / _EVERY) + 1, samples)
        if count < 3:
            continue
        # The most likely place of the front for the extrapolated edge of the shadow, and near it for each edge that is possible.
        middle, least = begin, 1e300
        for m in range(_SHIFTS + 1):
            shadow = edge[k] + ((m - 1 - _SHIFTS // 2) * _SHIFT if m > 0 else 0.0)
            edge_ramp(over, shadow, edge_slope[k], blur[k], taps, apart, first, last)
            tries = 2 * _NEAR + 1 if m > 0 else count
            best = 0
            for i in range(tries):
                at = middle + (i - _NEAR) * _FINE if m > 0 else begin + i * _EVERY
                edge_ramp(out, at, slope[k], blur[k], taps, apart, first, last)
                left[i] = _levels(image[k], over, out, first, last, normal, solution)
                best = i if left[i] < left[best] else best
            if m == 0:
                middle, least = begin + best * _EVERY, left[best]
                continue
            each[m - 1] = 0.0, 1e300, 1.0
            bend = left[best - 1] - 2.0 * left[best] + left[best + 1] if 0 < best < tries - 1 else 0.0
            if bend > 0.0:
                shift = 0.5 * (left[best - 1] - left[best + 1]) / bend
                at = middle + (best - _NEAR + shift) * _FINE
                each[m - 1] = at, left[best] - 0.5 * bend * shift * shift, bend / _FINE**2
                least = min(least, each[m - 1, 1])
        if least <= 0.0:
            continue  # blank: black or saturated, without noise
        noise = least / (INDEPENDENT * parallels * (last + 1 - first))
        total, at, square, shadow = 0.0, 0.0, 0.0, edge[k]
        for m in range(_SHIFTS):
            var = 2.0 * noise / each[m, 2]
            weight = math.exp(-0.5 * (each[m, 1] - least) / noise) * math.sqrt(var)
            total, at = total + weight, at + weight * each[m, 0]
            shadow += weight * (m - _SHIFTS // 2) * _SHIFT
            square += weight * ((each[m, 0] - middle) ** 2 + var)
        if not total > 0.0:
            continue
        at, shadow = at / total, edge[k] + (shadow - edge[k]) / total
        edge_ramp(over, shadow, edge_slope[k], blur[k], taps, apart, first, last)
        edge_ramp(out, at, slope[k], blur[k], taps, apart, first, last)
        _levels(image[k], over, out, first, last, normal, solution)
        found[k, 0], found[k, 1] = at, math.sqrt(max(square / total - (at - middle) ** 2, 0.0))
        found[k, 2], found[k, 3] = solution[1 if at > shadow else 0], solution[2]
