"""Is the edge of the foam still where it was at rest? A shadow's edge on bare foam is no contact.

A shadow multiplies the light: beyond its edge there is still foam, and the foam's own edge stands at the
place x0 of rest, with the step that it had there times the light that is left. Foam that is pressed has
left x0, and a body lies there. So each line is read as steps at the tracked front x1 and at x0, both blurred alike,

    grey(x) = A + B1 step(x - x1) + B0 step(x - x0),    r = B0 / (a C),    a = (A + B1) / F,

with the foam's grey level F and the signed step C at its edge at rest: r is 1 under a shadow and 0
for foam that is pressed. Both scatter alike by the texture behind the front, so that the likelier one is decided by
r = 1/2. Where x1 and x0 are closer than the blur resolves, there is one step: it stands
at x0 where the residuals speak for it with odds of a hundred to one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ..strip.zero import ZeroReference

__all__ = ["EdgeLines", "resting_edge"]

#: Samples along each line, from so far before x0 to so far behind it [px]; of x1 from so far before it.
_BEFORE_PX, _BEHIND_PX, _AHEAD_PX = 12, 5, 4
#: Pixels across each line that are averaged, to either side: few, for a front that is tilted to the line.
_ACROSS_PX = 2
#: Two edges are resolved from this distance on, in blurs: there two blurred steps have a dip of light between.
_APART_BLURS = 2.0
#: Odds for the place of rest by residuals, from which on a single step is said to stand there.
_ODDS = 100.0
#: Points to either side of one whose median is taken: a body's texture is not alike at five points.
_NEIGHBOURS = 2


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLines:
    """Lines from the base over the front, in one image; K of them."""

    grey: UInt8[np.ndarray, "rows columns"]  #: the image
    base_px: Float[np.ndarray, "K 2"]  #: origins
    direction_px: Float[np.ndarray, "K 2"]  #: unit directions
    front_px: Float[np.ndarray, "K"]  #: x1, position of the front along each line as tracked
    rest_px: Float[np.ndarray, "K"]  #: x0, the same at rest
    blur_px: float  #: standard deviation of the blur of the edges, pixel included
    noise_grey: float  #: standard deviation of one pixel [grey levels]

    def select(self, index: Int[np.ndarray, "n"]) -> EdgeLines:
        """Some of the lines.

        Parameters
        ----------
        index
            Their numbers.
        """
        names = ("base_px", "direction_px", "front_px", "rest_px")
        return replace(self, **{name: getattr(self, name)[index] for name in names})


def resting_edge(
    lines: EdgeLines, deflected: Bool[np.ndarray, "K"], zero: ZeroReference
) -> Bool[np.ndarray, "K"]:
    """Points whose front was found elsewhere although the foam's edge is still at its place of rest.

    Parameters
    ----------
    lines
        The image, and where the front is on each line now and at rest.
    deflected
        Points to test.
    zero
        Grey levels of the foam and step of its edge at rest.
    """
    fraction = np.full(len(lines.front_px), np.nan)
    index = np.flatnonzero(deflected & np.isfinite(lines.front_px) & np.isfinite(lines.rest_px))
    if not len(index) or not np.isfinite(lines.blur_px) or zero.front_ratio is None or zero.contrast is None:
        return np.zeros(len(fraction), dtype=bool)
    foam = (zero.front_ratio * zero.foam_grey)[index]
    fraction[index] = _fraction(lines.select(index), foam, zero.contrast[index])
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(fraction, _NEIGHBOURS, constant_values=np.nan), 2 * _NEIGHBOURS + 1
    )
    result: Bool[np.ndarray, "K"] = np.zeros(len(fraction), dtype=bool)
    known = np.isfinite(fraction)
    result[known] = np.nanmedian(around[known], axis=1) > 0.5
    return result


def _fraction(
    lines: EdgeLines, foam: Float[np.ndarray, "n"], contrast: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """r of each line; 0 or 1 where the two edges are too close to be resolved."""
    from scipy.special import ndtr

    front_px, rest_px, blur_px = lines.front_px, lines.rest_px, lines.blur_px
    along = rest_px[:, None] + np.arange(-_BEFORE_PX, _BEHIND_PX + 1.0)
    values, inside = _sampled(lines, along)
    close = np.abs(rest_px - front_px) < _APART_BLURS * blur_px
    nearer = np.minimum(front_px, rest_px)[:, None]
    weight = inside & (along > nearer - _AHEAD_PX)
    at_front, at_rest = (ndtr((along - x[:, None]) / blur_px) for x in (front_px, rest_px))
    one = np.ones_like(along)
    levels, _ = _fitted(np.stack([one, at_front, at_rest], axis=-1), values, weight)
    light = (levels[:, 0] + levels[:, 1]) / foam
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = levels[:, 2] / (light * contrast)
    # One step: over the pixels that it changes.
    weight &= np.abs(along - rest_px[:, None]) < _AHEAD_PX + np.abs(rest_px - front_px)[:, None]
    left = [_fitted(np.stack([one, at], axis=-1), values, weight)[1] for at in (at_front, at_rest)]
    variance = lines.noise_grey**2 / (2 * _ACROSS_PX + 1)
    unmoved = left[0] - left[1] > 2.0 * variance * np.log(_ODDS)
    result: Float[np.ndarray, "n"] = np.where(close, np.where(unmoved, 1.0, 0.0), fraction)
    return result


def _sampled(
    lines: EdgeLines, along: Float[np.ndarray, "n m"]
) -> tuple[Float[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """Grey level at places along the lines, mean over a few pixels across, and whether the image has it."""
    import cv2

    grey = lines.grey
    across = np.stack([-lines.direction_px[:, 1], lines.direction_px[:, 0]], axis=-1)
    places = lines.base_px[:, None] + along[..., None] * lines.direction_px[:, None]
    total = np.zeros(along.shape)
    for shift in range(-_ACROSS_PX, _ACROSS_PX + 1):
        x, y = np.moveaxis(places + shift * across[:, None], -1, 0).astype(np.float32)
        total += cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    size = np.array([grey.shape[1] - 1, grey.shape[0] - 1])
    return total / (2 * _ACROSS_PX + 1), ((places >= 0) & (places <= size)).all(axis=-1)


def _fitted(
    design: Float[np.ndarray, "n m p"], values: Float[np.ndarray, "n m"], weight: Bool[np.ndarray, "n m"]
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "n"]]:
    """Least squares on each line, with its sum of squared residuals; the smallest solution of several."""
    masked, target = design * weight[..., None], values * weight
    levels = np.einsum("npm,nm->np", np.linalg.pinv(masked, rcond=1e-3), target)
    rest = target - np.einsum("nmp,np->nm", masked, levels)
    return levels, np.einsum("nm,nm->n", rest, rest)
