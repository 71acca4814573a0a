"""Shifts of a template: search for its place, and comparison with other places where its pattern repeats.

Most blocks of a template that repeats (bricks, a keyboard) also show it a period off. Pixels for which both places predict a
grey level (an irregular brick, grain, the border) decide, with the noise of the frame; if they are covered, no place is
probable enough.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...points.homography import apply_homography
from .block_fit import BlockFit, doubt, fit_blocks
from .esm_pyramid import Work
from .esm_template import REPEATS

#: Limits of the work: places that are compared at once (others correlate less), and moves to a more probable one, after which
#: a fit beside a better place is not valid.
_PLACES, _MOVES = 8, 3


def peaks(
    work: Work, k: int, homography: Float[np.ndarray, "3 3"], count: int, *, local: bool = False
) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """Shifts in the template's plane [template px] with the best correlations on level k, and these correlations.

    Parameters
    ----------
    work
        State of the alignment; its homography becomes ``homography``.
    k
        Level of the pyramid, 0 = finest.
    homography
        Template pixels to pixels of the finest image that is used.
    count
        Maximum number of peaks.
    local
        Relative to the mean and contrast within a block, so that a cover counts as much as the area it hides, and half as
        far again as the search range: the fit may already have moved in the wrong direction.
    """
    import cv2

    work.homography = homography
    level, image, _ = work.pair(k)
    a = 2.0**k
    # Pixels of the image's finest level per template pixel.
    relative = max(work.relative, 1e-3)
    search_px = work.settings.search_px * (1.5 if local else 1.0)
    reach = int(np.ceil(search_px / 2.0**work.image_base / (relative * a))) + 1
    rows, columns = level.image.shape
    reach = min(reach, 2 * max(rows, columns))
    bx, by = work.block
    pixel_h = homography @ np.array([[a * bx, 0, (bx - 1) / 2], [0, a * by, (by - 1) / 2], [0, 0, 1.0]])
    pixel_h[:2] *= 0.5**k
    start = pixel_h @ np.array([[1, 0, 1 - reach], [0, 1, 1 - reach], [0, 0, 1.0]])
    view = cv2.warpPerspective(
        image,
        start,
        (columns + 2 * reach, rows + 2 * reach),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    pattern = level.image
    if local:
        view, pattern = _evened(view, level.side), _evened(pattern, level.side)
    scores = cv2.matchTemplate(view, pattern, cv2.TM_CCOEFF_NORMED)
    highest = scores >= cv2.dilate(scores, np.ones((3, 3), np.uint8))
    order = np.argsort(np.where(highest, -scores, np.inf), axis=None)[:count]
    result = []
    for v, u in zip(*np.unravel_index(order, scores.shape), strict=True):
        if highest[v, u]:
            shift = np.array([[1, 0, a * bx * (u - reach)], [0, 1, a * by * (v - reach)], [0, 0, 1.0]])
            result.append((shift, float(scores[v, u])))
    return result


def _evened(image: Float32[np.ndarray, "R C"], side: int) -> Float32[np.ndarray, "R C"]:
    """An image relative to its mean and its contrast within a window of ``side`` pixels."""
    import cv2

    flat = image - cv2.blur(image, (side, side))
    # Less contrast than the noise of a camera is none.
    return flat / np.sqrt(cv2.blur(flat * flat, (side, side)) + np.float32(4.0))


def among_repeats(work: Work, fit: BlockFit, start: Float[np.ndarray, "3 3"]) -> BlockFit:
    """The most probable of a fit and the places where the pattern repeats; its log-odds are against all of them.

    Parameters
    ----------
    work
        State of the alignment; its homography becomes that of the result.
    fit
        On the finest level, accepted.
    start
        Prediction: template pixels to pixels of the finest image that is used.
    """
    if not work.template.repeats:
        return fit
    fit = _near_start(work, fit, start)
    for moves in range(_MOVES, -1, -1):
        places, odds = _rivals(work, fit)
        better = odds.min(initial=0.0) < 0.0 and moves > 0
        other = _accepted(work, fit.homography @ places[int(np.argmin(odds))]) if better else None
        if other is None:
            fit = _against(fit, odds)
            break
        fit = other
    work.homography = fit.homography
    return fit


def _near_start(work: Work, fit: BlockFit, start: Float[np.ndarray, "3 3"]) -> BlockFit:
    """The more probable of a fit that is deformed and that from the best correlation about the prediction."""
    corners = [apply_homography(h, work.template.corners) for h in (start, fit.homography)]
    moved = corners[1] - corners[0]
    deformed = np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() * 2.0**work.image_base
    if deformed <= 2.0 * work.settings.right_px:
        return fit  # found by shifts of the fit, too
    ((shift, score),) = peaks(work, _search_level(work), start, 1, local=True)
    other = _accepted(work, start @ shift) if score >= REPEATS else None
    work.homography = fit.homography
    if other is None or apart(work, other.homography, fit.homography) <= work.settings.right_px:
        return fit
    here = _explained(work, np.eye(3))
    there = _explained(work, np.linalg.solve(fit.homography, other.homography))
    odds = _log_odds(here, there, fit)
    return _against(fit, np.array([odds])) if odds >= 0.0 else _against(other, np.array([-odds]))


def _rivals(work: Work, fit: BlockFit) -> tuple[list[np.ndarray], Float[np.ndarray, "n"]]:
    """Shifts of the fit to other places [template px], and its log-odds against each, as long as they count."""
    found, odds, here = [], [], None
    for shift, score in peaks(work, _search_level(work), fit.homography, _PLACES + 1, local=True):
        if score < REPEATS or apart(work, fit.homography @ shift, fit.homography) <= work.settings.right_px:
            continue
        here = _explained(work, np.eye(3)) if here is None else here
        there = _explained(work, shift)
        found.append(shift)
        odds.append(_log_odds(here, there, fit))
        if min(odds) > (here.whole & there.whole).sum():
            break  # half of what is possible if all blocks agree; places that correlate less are less probable
    return found, np.array(odds)


def _search_level(work: Work) -> int:
    return min(1, work.count - 1)


def _accepted(work: Work, homography: Float[np.ndarray, "3 3"]) -> BlockFit | None:
    work.homography = homography
    fit = fit_blocks(work, 0, 12, 4)
    return None if doubt(fit, work.settings) else fit


def _against(fit: BlockFit, odds: Float[np.ndarray, "n"]) -> BlockFit:
    """A fit whose log-odds are also against other places."""
    return replace(fit, log_odds=-float(np.logaddexp.reduce([-fit.log_odds, *(-odds)])))


def apart(work: Work, a: Float[np.ndarray, "3 3"], b: Float[np.ndarray, "3 3"]) -> float:
    """Largest distance of a corner between two places [px of the image].

    Parameters
    ----------
    work
        State of the alignment, with the template and the level of the image.
    a, b
        Homographies of the two.
    """
    first, second = (apply_homography(h, work.template.corners) for h in (a, b))
    return float(np.linalg.norm(first - second, axis=1).max()) * 2.0**work.image_base


@dataclass(frozen=True, slots=True, eq=False)
class _Explained:
    """How well a displaced template explains each block of the image."""

    #: all of the block is in the template, and enough of it in the image
    whole: Bool[np.ndarray, "down across"]
    number: Float[np.ndarray, "down across"]  #: its pixels
    contrast: Float[np.ndarray, "down across"]  #: variance of the image
    residual: Float[np.ndarray, "down across"]  #: that after the fit of the illumination and a common motion


def _explained(work: Work, warp: Float[np.ndarray, "3 3"]) -> _Explained:
    """Compare the image with the template where it would be if it were displaced in its plane by ``warp`` [template px]."""
    import cv2

    from ._block_kernels import block_sums, template_sums

    level, _, h = work.pair(0)
    (bx, by), (rows, columns) = work.block, level.image.shape
    own = np.array([[bx, 0, 1.5 * bx - 0.5], [0, by, 1.5 * by - 0.5], [0, 0, 1.0]])
    moved = np.linalg.solve(own, warp @ own)
    shown = np.stack([level.image, level.gradient_x, level.gradient_y], axis=-1)
    # The cubic kernel reaches two pixels.
    inner = np.pad(np.ones((rows - 4, columns - 4), np.uint8), 2)
    if (warp[:, :2] == np.eye(3)[:, :2]).all():
        shown = cv2.warpAffine(shown, moved[:2], (columns, rows), flags=cv2.INTER_CUBIC)
        inner = cv2.warpAffine(inner, moved[:2], (columns, rows), flags=cv2.INTER_NEAREST)
    else:
        shown = cv2.warpPerspective(shown, moved, (columns, rows), flags=cv2.INTER_CUBIC)
        inner = cv2.warpPerspective(inner, moved, (columns, rows), flags=cv2.INTER_NEAREST)
    down, across = level.independent.shape
    sums, products = np.zeros((down, across, 28)), np.zeros((down, across, 7, 7))
    parts = np.ascontiguousarray(np.moveaxis(shown, -1, 0))
    template_sums(*parts, level.side, level.border, sums)
    seen = work.samples(0, np.ascontiguousarray(h / h[2, 2]))
    block_sums(*seen, *parts, sums, level.side, level.border, sums)
    upper = np.triu_indices(7)
    products[..., upper[0], upper[1]] = products[..., upper[1], upper[0]] = sums
    # A ridge of a millionth of the trace for blank blocks.
    ridge = 1e-6 + 1e-6 * np.einsum("...ii", products[..., :4, :4])
    solved = np.linalg.solve(
        products[..., :4, :4] + np.eye(4) * ridge[..., None, None], products[..., :4, 4:]
    )
    left = products[..., 4:, 4:] - products[..., 4:, :4] @ solved
    gain, number = solved[..., 3, 2], np.maximum(sums[..., 0], 1.0)
    edges = np.ones((rows, columns), bool)
    edges[level.border : rows - level.border, level.border : columns - level.border] = False
    known = (inner > 0) | edges  # edges are in no sum
    for axis, count in enumerate((down, across)):
        known = np.logical_and.reduceat(known, level.side * np.arange(count), axis=axis)
    known &= number >= 0.5 * level.side**2
    contrast = sums[..., 27] / number - (sums[..., 6] / number) ** 2
    bend = gain[..., None, None] ** 2 * left[..., :2, :2] / number[..., None, None]
    pull = (gain / number)[..., None] * left[..., :2, 2]
    residual = _moved(known, contrast, left[..., 2, 2] / number, bend, pull)
    # A negative of the template does not show it.
    return _Explained(known, number, contrast, np.where(gain > 0, np.maximum(residual, 1 / 12), contrast))


def _moved(
    known: np.ndarray, contrast: np.ndarray, residual: np.ndarray, bend: np.ndarray, pull: np.ndarray
) -> Float[np.ndarray, "down across"]:
    """Residual of each block after the common motion of all, those with little residual first: a peak is exact to a pixel only."""
    explained = 1.0 / np.maximum(residual, 1 / 12) - 1.0 / np.maximum(contrast, 1 / 12)
    weight = np.where(known, np.maximum(explained, 0.0), 0.0)
    total = (weight[..., None, None] * bend).sum(axis=(0, 1))
    total += np.eye(2) * (1e-5 * np.trace(total) + 1e-9)
    step = np.linalg.solve(total, (weight[..., None] * pull).sum(axis=(0, 1)))
    return np.asarray(residual + np.einsum("i,...ij,j", step, bend, step) - 2.0 * pull @ step)


def _log_odds(here: _Explained, there: _Explained, fit: BlockFit) -> float:
    """Log-odds of one place against another, from the blocks of the image for which both predict grey levels.

    Each block shows the template at this place, with the noise of the frame, or other content of its own variance. The sum is
    no more certain than its scatter over the blocks allows: the variance of a log-likelihood ratio is twice its mean
    (composite likelihoods; Varin, Reid and Firth, Statistica Sinica 21 (2011)).
    """
    noise, variance = fit.blocks.noise
    both = here.whole & there.whole
    number = 0.5 * here.number[both] / noise
    other = number * (1.0 + np.log(np.maximum(here.contrast[both] / variance, 1.0)))
    first, second = (
        np.logaddexp(-number * place.residual[both] / variance, -other) for place in (here, there)
    )
    ratios = first - second
    total = float(ratios.sum())
    return total * min(1.0, 2.0 * abs(total) / max(float(ratios @ ratios), 1e-9))
