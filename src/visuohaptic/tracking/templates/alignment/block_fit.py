"""Probability and accuracy of an alignment, and re-alignment of partly covered templates.

The template is divided into blocks. Each has its own illumination (gain, its slope in two directions, bias) and a small
motion whose covariance follows from its residual. A block shows either the template or other content:

- the correlation of other content is due to chance, for the number of independent values in the block; that of the
  template is arbitrary, because noise and blur are unknown;
- the motions of the template's blocks follow one homography plus, where the image is blurrier than the template, the
  apparent motion that this causes in each block; scatter beyond noise is estimated. Motions of other content scatter as
  widely as its texture allows.

Expectation-maximisation gives the homography, its covariance and the probability of each block (Dempster, Laird
and Rubin, J. R. Stat. Soc. B 39 (1977)).
"""

# mypy: allow-untyped-calls

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from .esm_pyramid import EsmSettings, Work
from .esm_template import BLUR_VARIANCES, Level
from .warp import is_proper, motion_jacobian


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Motions of the blocks, and the common motion that was fitted to them."""

    fields: tuple[np.ndarray, np.ndarray, np.ndarray]  #: x, y and apparent motions, as in ``block_step``
    noise: tuple[
        float, float
    ]  #: variance of a sum relative to that of independent pixels; variance of a pixel
    step: Float[np.ndarray, "12"]  #: common motion, blur and curve
    moved: Float[np.ndarray, "8"]  #: motion that was applied
    probability: Float[np.ndarray, "down across"]
    fits: Float[np.ndarray, "down across 9"]
    jacobian: Float[
        np.ndarray, "8 8"
    ]  #: derivative of the corners [px of the image] with respect to the motion

    def covariance(self) -> Float[np.ndarray, "8 8"] | None:
        """Covariance of the corners [px^2 of the image] from the scatter of the blocks; None if they do not determine it.

        Errors of the model (blur, compression, interpolation, paper that is not flat) are common to neighbouring pixels,
        much less to neighbouring blocks: the scatter of the blocks contains them, and needs no independent pixels (Liang
        and Zeger, Biometrika 73 (1986); each block about the fit to the others, as in a jackknife).
        """
        found, ratio = self._scatter(self.step, self.fits, 12)
        # Not better than independent pixels: blocks that scatter are taken for other content, which leaves the others.
        found /= min(max(ratio, 1e-3), 1.0)
        return np.asarray(self.jacobian @ found[:8, :8] @ self.jacobian.T) if ratio > 0.0 else None

    def excess(self, off: Float[np.ndarray, "8"]) -> float:
        """Variance of the motion of a fit to all pixels, relative to that with independent pixels.

        Parameters
        ----------
        off
            Its corners relative to those of this fit [px of the image]: the blocks scatter about it, whose blur and curve
            are those of the level.
        """
        step, fits = np.zeros(12), self.fits.copy()
        step[:8] = self.moved + np.linalg.solve(self.jacobian, off)
        fits[..., 3:5] -= self.fields[2][..., 4]
        return max(self._scatter(step, fits, 8)[1], 1.0)

    def _scatter(self, step: np.ndarray, fits: np.ndarray, count: int) -> tuple[np.ndarray, float]:
        from ._scatter_kernels import block_covariance

        found = np.zeros((12, 12))
        ratio = block_covariance(
            *self.fields, *self.noise, BLUR_VARIANCES[-1], count, step, self.probability, fits, found
        )
        return found, float(ratio)


@dataclass(frozen=True, slots=True, eq=False)
class BlockFit:
    """A homography estimated from all blocks of the finest level."""

    homography: Float[np.ndarray, "3 3"]  #: template pixels to pixels of the finest image that is used
    covariance: Float[np.ndarray, "8 8"]  #: of the corners (x0, y0, x1, ...) [px^2 of the image]
    seen: float  #: fraction of the blocks that show the template, weighted by information, 0..1
    log_odds: float  #: log-odds of the template against other content
    variance: float  #: variance of an image sample after removal of the blocks' illumination [grey levels^2]
    converged: bool  #: whether the last step moved no corner
    softer: float  #: variance of the blur relative to the template [px^2 of the finest level]
    curve: float  #: curve from light to grey levels relative to that of the template
    shade: Float[
        np.ndarray, "6"
    ]  #: illumination as a polynomial in 1, x, y, x^2, x y, y^2 of the centred coordinates, 1 at the middle
    blocks: Blocks

    def probability(self, within_px: float) -> float:
        """Probability that the template is present and all its corners are accurate to ``within_px``.

        Parameters
        ----------
        within_px
            Distance [px].
        """
        present = 1.0 / (1.0 + np.exp(-np.clip(self.log_odds, -50, 50)))
        return float(present * corners_within(self.covariance, within_px))


def corners_within(covariance: Float[np.ndarray, "8 8"], within_px: float) -> float:
    """Probability that all corners are accurate to a distance, from below.

    Parameters
    ----------
    covariance
        Of the corners (x0, y0, x1, ...) [px^2].
    within_px
        Distance [px].
    """
    missed = 0.0
    for k in range(0, 8, 2):
        (xx, xy), (_, yy) = covariance[k : k + 2, k : k + 2].tolist()
        larger = 0.5 * (xx + yy + math.hypot(xx - yy, 2.0 * xy))
        # A corner whose larger variance is v has an error beyond r with probability at most exp(-r^2 / 2 v).
        missed += math.exp(-0.5 * within_px**2 / max(larger, 1e-12))
    return max(0.0, 1.0 - missed)


def doubt(fit: BlockFit | None, settings: EsmSettings) -> str:
    """Why a fit is rejected; empty if it is accepted.

    Parameters
    ----------
    fit
        None if the blocks do not determine one.
    settings
        With the limits.
    """
    if fit is None or not fit.converged:
        return "no convergence"
    if fit.seen < settings.min_seen:
        return f"only {100 * fit.seen:.0f} % of the template is visible"
    probability = fit.probability(settings.right_px)
    if probability < settings.min_probability:
        return f"accurate to {settings.right_px:g} px with a probability of {probability:.3f} only"
    return ""


def fit_blocks(work: Work, k: int, passes: int, turns: int) -> BlockFit | None:
    """Iterate the homography on one level, each step from the blocks that show the template.

    Parameters
    ----------
    work
        State of the alignment; its homography is changed.
    k
        Level of the pyramid, 0 = finest.
    passes
        Maximum number of image evaluations.
    turns
        Expectation-maximisation iterations for each.

    Returns
    -------
    BlockFit or None
        None if the blocks do not determine a homography.
    """
    from ._block_kernels import block_step, block_sums
    from ._esm_kernels import exponential
    from ._scatter_kernels import seen_blurs

    level, _, h = work.pair(k)
    h = np.ascontiguousarray(h / h[2, 2])
    down, across = level.independent.shape
    sums, fits = (np.zeros((down, across, n)) for n in (28, 9))
    probability = np.zeros((down, across))
    matrix, step, growth = np.zeros((12, 12)), np.zeros(12), np.zeros((3, 3))
    # Template pixels that are finer than the image's share its noise.
    noise = max(1.0, 1.0 / work.relative**2)
    x, y = _middles(level.x, level.side), _middles(level.y, level.side)
    variance_here = work.template.variance(work.chain, work.blur if k == 0 else 0) / (
        work.block[0] * work.block[1]
    )
    softened, blurs = np.zeros((down, across, 2, 5)), np.zeros(3)
    seen_blurs(level.softened, x, y, h, level.unit, variance_here, softened, blurs)
    converged, before, factor = False, np.zeros(12), 1.0
    for _ in range(passes):
        block_sums(
            *work.samples(k, h), level.image, level.gradient_x, level.gradient_y, level.products, level.side,
            level.border, sums,
        )  # fmt: skip
        log_odds, variance = block_step(
            sums, x, y, softened, level.independent, 0.5 * level.side**2, noise, BLUR_VARIANCES[-1], turns,
            step, matrix, probability, fits,
        )  # fmt: skip
        if not np.isfinite(log_odds):
            return None
        # Steps are too short by a constant factor if the image is blurrier than the template, too long if it is sharper:
        # the ratio of successive steps gives this factor.
        length = float(before @ matrix @ before)
        if length > 0.0:
            factor = np.clip(factor / (1.0 - min(float(before @ matrix @ step) / length, 0.9)), 0.5, 4.0)
        before[:8] = step[:8]
        moved = factor * step[:8]
        exponential(moved, growth)
        h = h @ growth
        h = h / h[2, 2]
        work.homography = work.uncentred(k, h)
        if not is_proper(work.homography, work.template.corners):
            return None
        converged = np.abs(moved).max() * level.unit < work.settings.tolerance_px
        if converged:
            break
    corners = work.template.corners @ level.from_template[:2, :2].T + level.from_template[:2, 2]
    jacobian = motion_jacobian(h, corners).reshape(8, 8) * 2.0 ** (work.image_base + k)
    blocks = Blocks((x, y, softened), (noise, variance), step, moved, probability, fits, jacobian)
    softer = -float(blurs @ step[8:11]) - variance_here
    return _result(work, level, blocks, log_odds, bool(converged), softer)


def _result(
    work: Work, level: Level, blocks: Blocks, log_odds: float, converged: bool, softer: float
) -> BlockFit | None:
    """The fit with its covariance; None if the blocks do not determine it."""
    covariance = blocks.covariance()
    if covariance is None:
        return None
    x, y, _ = blocks.fields
    variance, probability = blocks.noise[1], blocks.probability
    # Expected squared correlation of each block: blank paper contains no information.
    telling = 1.0 / (1.0 + variance / np.maximum(work.light[0] ** 2 * level.contrast, 1e-9))
    return BlockFit(
        homography=work.homography,
        covariance=covariance,
        seen=float((telling * probability).sum() / telling.sum()),
        log_odds=log_odds,
        variance=variance,
        converged=converged,
        softer=softer,
        curve=-float(blocks.step[11]),
        shade=_shade(x, y, blocks.fits, probability),
        blocks=blocks,
    )


def recover(work: Work, start: Float[np.ndarray, "3 3"]) -> BlockFit | None:
    """Align by blocks alone, starting from the prediction: robust to illumination changes and occlusion.

    Parameters
    ----------
    work
        State of the alignment; its homography is changed.
    start
        Prediction: template pixels to pixels of the finest image that is used.

    Returns
    -------
    BlockFit or None
        Result on the finest level whose blocks determine a homography; None without one.
    """
    work.homography, found = start, None
    for k in range(min(2, work.count - 1), -1, -1):
        finer = fit_blocks(work, k, 12, 8)
        if finer is None:
            break  # the blocks of a template finer than the image may be uninformative
        found = finer
    return found


def _middles(places: np.ndarray, side: int) -> Float[np.ndarray, "blocks"]:
    """Centres of the blocks along one axis; the last block contains the remainder."""
    count = len(places) // side
    ends = [*range(0, count * side, side), len(places)]
    return np.array([0.5 * (places[i] + places[j - 1]) for i, j in pairwise(ends)], float)


def _shade(x: np.ndarray, y: np.ndarray, fits: np.ndarray, probability: np.ndarray) -> Float[np.ndarray, "6"]:
    """Illumination over the template from lamp and lens: a polynomial through the gains of the blocks.

    Uniform illumination if it explains the gains as well, by the criterion of Hannan and Quinn.
    """
    from ..._solve_kernels import solve_step

    flat = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    weight = (probability * fits[..., 8] / np.maximum(fits[..., 6], 1e-9)).ravel()
    count = np.count_nonzero(weight)
    if count < 12:
        return flat
    gain, y = fits[..., 7].ravel(), y[:, None]
    basis = np.ones((6, *probability.shape))
    basis[1], basis[2], basis[3], basis[4], basis[5] = x, y, x * x, x * y, y * y
    basis = basis.reshape(6, -1)
    weighted, found = basis * weight, np.zeros(6)
    if not solve_step(weighted @ basis.T, -(weighted @ gain), np.ones(6, np.bool_), 0.0, found):
        return flat
    off, even = gain - found @ basis, gain - (weight @ gain) / weight.sum()
    if count * np.log((even * even) @ weight / max((off * off) @ weight, 1e-12)) < 10 * np.log(np.log(count)):
        return flat
    return np.asarray(found / found[0])
