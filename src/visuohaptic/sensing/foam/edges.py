"""Deflection of the edges of one frame if all of them belonged to the foam, and their errors.

Uneven light: the edge of a shadow at a distance u from the front, with a fraction a of the whole step, merges with the front
into one step that is shifted by a u and whose variance is increased by a (1 - a) u^2. Hence shift^2 = a / (1 - a) times the
excess of the squared blur over that of the base in the same image. The excess is negative where light increases as grey
decreases. The edge of a shadow farther away tilts the grey levels beside the front: the level that is extrapolated over a
plateau with a step of d in its middle has an error of d / 4, which shifts an edge of blur b and contrast C by
sqrt(2 pi) / 4 b d / C. Both errors are shared by neighbours, as far as these agree beyond their own scatter.

If a body lies beyond the edge, behind a narrow gap, the edge is shifted by that gap. Beside the edge of a shadow it looks alike. The
texture beyond distinguishes them: where the floor as at rest lies there, in any light, there is no body. The shift is weighed by
the probability of a body, and its scatter is error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Num

from ...core.kernels import kernel
from ...core.measurement import SIGMA_PER_MAD
from ...tracking._solve_kernels import median
from ...tracking.contours.contour import PIXEL_PX, quick_median
from ._chain_kernels import ALIKE
from ._light_kernels import floor_beyond
from .strip import ObservedStrip, ZeroReference

#: Fraction a of the step that is due to a shadow within the blur: the ratio of squared shift to excess squared blur is 0.05
#: to 0.19 over 1,300 positions of shadows of 10 to 60 %.
_SHADOW_PART = 0.11
#: Neighbours to either side that share the light.
BESIDE = 4
#: Length of each of the two parts of the plateau between which the light is compared [px].
_PLATEAU_PX = 4.0
#: Number of edges at rest for estimating their scatter, to a fifth.
SCATTER_POINTS = 24
#: An excess blur of more than this many standard deviations is attributed to a gap, such a change of light to a shadow: the
#: false-alarm rate is one in forty edges at rest.
_CHANCE_SIGMAS = 2.0
#: Largest mean squared residual of a clean step, in noise variances: over some hundred pixels it scatters by a seventh.
_MISFIT = 2.0
#: Relative error of the shift due to encoding: cameras with exponents from 2.07 to 2.33.
_SHIFT_ERROR = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEdges:
    """Edges of K points in one frame, normalised with the zero reference."""

    delta_m: Float[np.ndarray, "K"]  #: deflection if every edge belonged to the foam
    sigma_m: Float[np.ndarray, "K"]  #: its standard deviation due to noise and texture
    noise_m: Float[np.ndarray, "K"]  #: the part of it that varies from frame to frame
    systematic_m: Float[np.ndarray, "K"]  #: error of kinks, of gaps before a body, and of the zero reference
    encoding_m: Float[np.ndarray, "K"]  #: error due to the camera's encoding, shared by all points
    light_m: Float[np.ndarray, "K"]  #: standard deviation due to uneven light, shared by neighbours
    unclean_m: Float[np.ndarray, "K"]  #: part of the systematic error that neighbours share
    floor: Float[np.ndarray, "K"]  #: probability that the floor as at rest lies beyond the edge, and no body


def measure_edges(
    strip: ObservedStrip, zero: ZeroReference, width_m: float, last_m: Float[np.ndarray, "K"]
) -> MeasuredEdges:
    """Deflection of each edge and its errors.

    Parameters
    ----------
    strip, zero
        Observation of the strip in one image, and the strip at rest.
    width_m
        Width of the strip at rest [m].
    last_m
        Last observed deflection of the foam [m], NaN where there is none.
    """
    part = zero.encoding
    # A zero reference without the shift due to encoding is assumed to have been taken in the present light.
    encoded = np.where(np.isfinite(zero.encoded_m), zero.encoded_m, strip.encoded_m)
    rest = zero.width_m - part * encoded
    scale = width_m / rest
    raw = scale * (rest - strip.width_m + part * strip.encoded_m)
    excess = blur_excess_px2(strip, zero, np.abs(raw - last_m) / strip.pixel_m)
    floor = floor_probability(strip, zero, excess)
    body = 1.0 - floor
    gap, gap_sigma = gap_shift_px(strip, zero, excess)
    # The edge before a gap is that between foam and floor, as at rest.
    to_floor = np.where(gap == 0.0, 0.0, encoded - strip.encoded_m)
    ahead = scale * (strip.pixel_m * gap + part * to_floor)
    raw = raw + body * ahead
    noise = scale * strip.width_noise_m
    kink = scale * np.hypot(edge_uncertainty_m(strip), strip.pixel_m * gap_sigma * np.sqrt(body))
    # Derivative of the deflection by the fraction of the encoding's shift that is present.
    shift = scale * (strip.encoded_m - encoded * (1.0 - raw / width_m))
    encoding = math.hypot(math.sqrt(part * (1.0 - part)), _SHIFT_ERROR * part) * np.where(
        np.isfinite(shift), shift, 0.0
    )
    clean = strip.usable & (kink == 0.0)
    sigma = with_cancelled_texture(raw, scale * strip.width_sigma_m, noise, clean, strip.pixel_m)
    excess = np.where((gap == 0.0) | (body < 0.5), excess, np.nan)
    light_m = strip.pixel_m * light_shift_px(strip, zero, excess)
    # The error of the zero reference is the same in every frame; it is not noise of this image.
    systematic = np.hypot(kink, np.hypot(scale * zero.width_sigma_m, np.sqrt(body * (1.0 - body)) * ahead))
    # Neighbours share the error of widths that were inferred at rest, and not that of kinks: over 640 pairs its correlation is -0.1.
    unclean = np.where(zero.inferred & zero.known, systematic, 0.0)
    return MeasuredEdges(raw, sigma, noise, systematic, encoding, light_m, unclean, floor)


def blur_excess_px2(
    strip: ObservedStrip, zero: ZeroReference, moved_px: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Excess of the squared blur of each edge over that of lens and motion [px^2]; NaN where no edge was observed.

    Parameters
    ----------
    strip, zero
        Observation of the strip in this image, and the strip at rest.
    moved_px
        Distance that each edge has moved since the last frame [px], NaN where that is unknown.
    """
    seen = strip.usable & (not strip.stripe)
    excess = np.where(seen, strip.front.blur_px**2 - (zero.blur_ratio * strip.lens_px) ** 2, np.nan)
    # Upper limit of motion blur: a shutter open for the whole frame interval (box filter).
    smear = np.where(np.isfinite(moved_px), moved_px, 0.0) ** 2 / 12.0
    return np.where(excess > 0.0, np.maximum(excess - smear, 0.0), excess)


def floor_probability(
    strip: ObservedStrip, zero: ZeroReference, excess_px2: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Probability that the floor as at rest lies beyond each edge, in any light, and no other surface; 0 where it is not seen.

    Beside floor, the samples scatter about the zero image in other light as they do beside edges without excess blur; another
    surface scatters by any variance. Both are as probable a priori, and five neighbours share their surface.

    Parameters
    ----------
    strip, zero, excess_px2
        As in :func:`gap_shift_px`.
    """
    found = np.full((3, len(excess_px2)), np.nan)
    if not strip.stripe:
        begin = np.fmax(strip.rest_px, strip.front.position_px) + 2.0 * np.hypot(strip.lens_px, PIXEL_PX)
        floor_beyond(strip.image, zero.image, strip.step_px, begin, begin + _PLATEAU_PX, found)
    lit, plain, count = found
    measured = np.isfinite(lit + excess_px2)
    if not measured.any():
        return np.zeros(len(lit))
    even = measured & (np.abs(excess_px2) <= quick_median(np.abs(excess_px2[measured])))
    beside = np.log(lit[even & (lit > 0.0)])
    if not len(beside):
        return np.zeros(len(lit))  # black or saturated: without texture and noise
    usual = quick_median(beside)
    scatter = max(SIGMA_PER_MAD * quick_median(np.abs(beside - usual)), 1e-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.log(lit) - usual
        odds = 0.5 * (count - 2.0) * np.log(plain / lit) - 0.5 * (away / scatter) ** 2
        # Any variance up to the squared contrast: log-uniform.
        others = np.maximum(np.log(strip.front.contrast**2) - usual, 1.0)
        odds += np.log(others / (math.sqrt(2.0 * math.pi) * scatter))
    shared = ALIKE * np.convolve(np.nan_to_num(odds), np.ones(round(1.0 / ALIKE)), "same")
    return np.where(np.isfinite(odds), 1.0 / (1.0 + np.exp(-np.clip(shared, -40.0, 40.0))), 0.0)


def gap_shift_px(
    strip: ObservedStrip,
    zero: ZeroReference,
    excess_px2: Float[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Shift of each edge beyond the front due to a gap in front of a body, and its error [px].

    Between foam and body there is a gap of floor. If it is narrower than the blur, its two edges merge into one. The fraction
    a of this edge that is due to the body follows from the excess contrast relative to the floor at rest.

    Parameters
    ----------
    strip, zero
        As in :func:`blur_excess_px2`.
    excess_px2
        From :func:`blur_excess_px2`; its scatter over edges at rest is its uncertainty.
    """
    ends = 2.0 * np.hypot(strip.lens_px, PIXEL_PX) + _PLATEAU_PX * np.array([0.0, 2.0])
    rest_px, step_px = strip.rest_px, strip.step_px[:, None]
    at_rest = mean_between(zero.image, (rest_px[:, None] + np.concatenate([-ends[::-1], ends])) / step_px)
    contrast, beyond = strip.front.contrast, strip.front.level
    moved = np.abs(strip.front.position_px - rest_px)
    scatter = excess_px2[(moved < 1.0) & np.isfinite(excess_px2)]
    if len(scatter) < SCATTER_POINTS:
        return np.zeros(len(rest_px)), np.zeros(len(rest_px))
    # Median absolute deviation: a standard deviation would include edges beside a gap. An edge that has moved has other texture than at rest,
    # and a blurred step has half as much information on its blur as on its position.
    still = SIGMA_PER_MAD * quick_median(np.abs(scatter - quick_median(scatter)))
    texture = (strip.front.sigma_px**2 - strip.front.noise_px**2) * (1.0 - np.exp(-0.5 * moved**2))
    error = np.sqrt(still**2 + 8.0 * strip.front.blur_px**2 * np.maximum(texture, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        part = 1.0 + (beyond / contrast - 1.0) * (1.0 - at_rest[:, 2] / at_rest[:, 0])
        square, sigma = part / (1.0 - part) * excess_px2, np.abs(part / (1.0 - part)) * error
        shift = np.sqrt(np.maximum(square - _CHANCE_SIGMAS * sigma, 0.0))
        sigma = np.where(shift > 0.0, 0.5 * sigma / shift, 0.0)
    found = np.isfinite(shift) & np.isfinite(sigma)
    return np.where(found, np.sign(part) * shift, 0.0), np.where(found, np.minimum(sigma, shift), 0.0)


def light_shift_px(
    strip: ObservedStrip, zero: ZeroReference, excess_px2: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Standard deviation of the position of each edge due to uneven light [px], shared by neighbours.

    Parameters
    ----------
    strip, zero
        As in :func:`blur_excess_px2`.
    excess_px2
        From :func:`blur_excess_px2`; NaN where a gap explains it.
    """
    if strip.stripe:
        return np.zeros(len(strip.width_m))
    rest_px, step_px = strip.rest_px, strip.step_px[:, None]
    front = np.where(strip.usable & (strip.edge_px == 0.0), strip.front.position_px, np.nan)
    local, blur = [excess_px2], np.hypot(strip.lens_px, PIXEL_PX)
    ends = blur * 2.0 + _PLATEAU_PX * np.arange(3.0)
    for edges in (front[:, None] - ends[::-1], rest_px[:, None] + ends):
        now, rest = (mean_between(image, edges / step_px) for image in (strip.image, zero.image))
        with np.errstate(invalid="ignore", divide="ignore"):
            step = np.diff(now / rest, axis=1)[:, 0] * rest.mean(axis=1) / strip.front.contrast
        local.append(np.where(np.isfinite(step), step, np.nan))
    # What neighbours have in common by chance is not attributed to light.
    (shadow, error), *steps = (local_statistics(values) for values in local)
    unlike = np.abs(shadow) > _CHANCE_SIGMAS * error
    variance = _SHADOW_PART / (1.0 - _SHADOW_PART) * np.where(unlike, np.abs(shadow) - error, 0.0)
    for step, error in steps:
        unlike = np.abs(step) > _CHANCE_SIGMAS * error
        variance += 0.125 * math.pi * blur**2 * np.where(unlike, step**2 - error**2, 0.0)
    return np.asarray(np.sqrt(np.where(np.isfinite(variance), variance, 0.0)))


def edge_uncertainty_m(strip: ObservedStrip) -> Float[np.ndarray, "K"]:
    """Error of a width where the edge is not a clean step [m], at kinks or beside a narrow gap; 0 at clean steps.

    The errors of its pixels are correlated, so that the error due to noise grows with the residual itself instead of its
    root: a power of 1.9 fits the squared errors of 1,800 such points of 18 pressed continuum foams best, with a factor of 1.2.
    The contribution of texture to the residual is already part of the error of the width.

    Parameters
    ----------
    strip
        Observation of the strip in one image.
    """
    misfit = np.maximum(strip.front.chi2, 1.0)
    unclean = strip.low_confidence | (strip.usable & (misfit > _MISFIT))
    return np.where(unclean, strip.width_noise_m * misfit, 0.0)


def with_cancelled_texture(
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
    noise_m: Float[np.ndarray, "K"],
    clean: Bool[np.ndarray, "K"],
    pixel_m: Float[np.ndarray, "K"],
) -> Float[np.ndarray, "K"]:
    """Standard deviation of each deflection [m], without the shift due to texture that cancels with the zero reference.

    The texture shifts an edge at its old position as it did at rest, unless light, focus or floor have changed; the
    scatter of such edges in the same frame shows how much of the shift remains. An edge that has moved by some pixels
    is shifted by other texture.

    Parameters
    ----------
    delta_m, sigma_m, noise_m
        Deflection, its standard deviation, and the part of it due to noise alone [m].
    clean
        Edges that are clean steps.
    pixel_m
        Length of a pixel [m].
    """
    texture = np.maximum(sigma_m**2 - noise_m**2, 0.0)
    alike = np.where(clean, np.exp(-0.5 * (delta_m / pixel_m) ** 2), 0.0)
    rest = clean & (np.abs(delta_m) < pixel_m)
    middle = rest[:-2] & rest[1:-1] & rest[2:]
    if middle.sum() < SCATTER_POINTS:
        return sigma_m
    # Second differences have six times the variance of a point, squares of a normal one a median of 0.455.
    bend = (delta_m[:-2] - 2.0 * delta_m[1:-1] + delta_m[2:])[middle]
    scatter = quick_median(bend**2) / (6.0 * 0.455)
    excess = scatter - quick_median(noise_m[rest] ** 2)
    return np.sqrt(noise_m**2 + alike * max(excess, 0.0) + (1.0 - alike) * texture)


@kernel(nogil=True)
def mean_between(
    image: Num[np.ndarray, "K parallels samples"], place: Float[np.ndarray, "K n"]
) -> Float[np.ndarray, "K m"]:
    """Mean grey levels between consecutive positions on each line, (K, n - 1); NaN where there is no sample.

    Parameters
    ----------
    image
        Grey levels along the lines, (K, parallels, samples).
    place
        Positions in ascending order [samples]; clipped to the line, NaN where there is none, (K, n).
    """
    parallels, samples = image.shape[1], image.shape[2]
    result = np.empty((place.shape[0], place.shape[1] - 1))
    for k in range(place.shape[0]):
        for i in range(place.shape[1] - 1):
            if not math.isfinite(place[k, i] + place[k, i + 1]):
                result[k, i] = math.nan
                continue
            first = int(round(min(max(place[k, i], 0.0), samples)))
            last = int(round(min(max(place[k, i + 1], 0.0), samples)))
            total = 0.0
            for lane in range(parallels):
                for j in range(first, last):
                    total += image[k, lane, j]
            result[k, i] = total / (parallels * (last - first)) if last > first else math.nan
    return result


@kernel(nogil=True)
def local_statistics(values: Float[np.ndarray, "K"]) -> Float[np.ndarray, "2 K"]:
    """Median over each point and ``BESIDE`` neighbours to either side, and its standard error from their scatter.

    Parameters
    ----------
    values
        One value for each point, NaN where unknown; where all are unknown, both are zero, (K,).
    """
    result = np.zeros((2, len(values)))
    near, work = np.empty(2 * BESIDE + 1), np.empty(2 * BESIDE + 1)
    for k in range(len(values)):
        count = 0
        for j in range(max(k - BESIDE, 0), min(k + BESIDE + 1, len(values))):
            if math.isfinite(values[j]):
                near[count] = values[j]
                count += 1
        if count > 0:
            result[0, k] = median(near, count, work)
            for i in range(count):
                near[i] = abs(near[i] - result[0, k])
            result[1, k] = SIGMA_PER_MAD * median(near, count, work) * math.sqrt(0.5 * math.pi / count)
    return result
