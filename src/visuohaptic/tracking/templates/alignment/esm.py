"""Planar tracking by efficient second-order minimisation (ESM) on the homography group.

Alt 2016, Sec. 2.3.2, Eq. (2.10)-(2.12); Benhimane and Malis, Int. J. Robotics
Research 26 (2007). Differences from the dissertation, and their reasons:

- The image is modelled as ``I(w(u)) = gain T(u) + bias``; both are estimated jointly
  with the motion, so that the sum of squares is the (negative) squared correlation.
- The Jacobian is the mean of the template's and the warped image's gradient (ESM) on
  the coarse levels, where it doubles the convergence range; on the finest level it is the
  template's alone. The fixed point is the same, but free of image noise: a noisy
  gradient correlates with the noise of the residual and would bias the scale.
- Residuals beyond three standard deviations are down-weighted.
- Pixels whose expected value is so close to black or white that the noise is clipped
  are excluded at the end: they bias the scale by 20 ppm at a noise of 5 grey levels.
- Intermediate passes use half of the rows, but about a hundred at most (those with the largest gradients); the last
  passes use every pixel and a cubic spline: a bilinear kernel attenuates high frequencies by an amount
  that depends on the sub-pixel position, which shifts the result by up to 0.02 px.
- If the coarse alignment has a low correlation, the translation is searched for.

Every frame is compared with the original template: there is no drift.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...points.homography import apply_homography
from .block_fit import BlockFit, doubt, fit_blocks, recover
from .esm_pyramid import MARGIN_PX, EsmSettings, GaussNewton, Work
from .esm_template import CURVES, EsmTemplate
from .repeats import among_repeats, apart, peaks
from .warp import is_proper, motion_jacobian


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Position of a template in an image, its accuracy, and its validity."""

    homography: Float[np.ndarray, "3 3"]  #: maps template pixels to image pixels, H[2, 2] = 1
    valid: bool
    reason: str  #: empty if valid
    ncc: float  #: normalised cross-correlation with the template, -1..1
    inside: float  #: fraction of the template that is inside the image, 0..1
    weight: float  #: mean weight of the pixels inside, 0..1: neither occluded nor saturated
    noise: float  #: standard deviation of one image pixel as estimated from the residual [grey levels]
    gain: float  #: image = gain * template + bias
    bias: float
    curve: float  #: curve from light to grey levels, from 0 (proportional) to 1 (sRGB)
    corners: Float[np.ndarray, "4 2"]  #: the template's corners in the image [px], offset not included
    corner_covariance: Float[np.ndarray, "8 8"] = field(repr=False)  #: of (x0, y0, x1, ...) [px^2]

    @property
    def corner_sigma_px(self) -> float:
        """Root of the mean over the corners of the variance of x plus that of y [px]."""
        return float(np.sqrt(np.trace(self.corner_covariance) / 4.0))


def align(
    template: EsmTemplate,
    image: UInt8[np.ndarray, "height width"],
    homography: Float[np.ndarray, "3 3"],
    settings: EsmSettings | None = None,
    *,
    offset: Float32[np.ndarray, "2 R C"] | None = None,
    blur: float | None = None,
    curve: float | None = None,
) -> Alignment:
    """Align a template with an image, starting from a predicted homography.

    Parameters
    ----------
    template
        Template to align.
    image
        Grey image.
    homography
        Prediction: template pixels (column, row) to image pixels.
    settings
        Search range and thresholds.
    offset
        Added to the warped position of every template pixel on the finest level [px]:
        lens distortion beyond the homography.
    blur
        Blur of the image relative to the template, as the variance of a Gaussian [template px^2]
        (default: a typical camera's for sharp prints, none for images); see
        :func:`visuohaptic.tracking.templates.alignment.esm_blur.matching_blur`.
    curve
        Curve from light to grey levels, from 0 (proportional) to 1 (sRGB). By default estimated, with a blur 0.

    Returns
    -------
    Alignment
        Invalid, with the reason, if the template is lost.
    """
    settings = settings or EsmSettings()
    homography = np.asarray(homography, dtype=np.float64)
    if homography.shape != (3, 3) or not np.isfinite(homography).all() or abs(homography[2, 2]) < 1e-12:
        return _lost(homography, "the prediction is not a homography")
    if offset is not None and not np.isfinite(offset).all():
        return _lost(homography, "an offset is not a number")
    homography = homography / homography[2, 2]
    if not is_proper(homography, template.corners):
        return _lost(homography, "the prediction mirrors the template")
    work = Work(template, image, homography, settings, offset, blur, curve or 0.0)
    if not work.enough:
        return _lost(homography, "outside the image")

    start = work.homography
    even = _descend(work)
    fit = fit_blocks(work, 0, 12, 4) if even else None
    reason = doubt(fit, settings)
    if reason:
        even, again = False, recover(work, start)
        if fit is None or (again is not None and again.log_odds > fit.log_odds):
            fit, reason = again, doubt(again, settings)
    # Blur and curve have similar effects on the edges: a few steps of both, as long as they explain more.
    for _ in range(6 if blur is None else 0):
        if fit is None or fit.seen < settings.min_seen or not work.soften(fit.softer, fit.curve):
            break
        even, work.homography, again = False, fit.homography, fit_blocks(work, 0, 12, 4)
        if again is None or again.variance >= fit.variance:
            break
        # The blur that explains more has to confirm the place, if only by a doubtful fit that is there as well.
        doubtful = doubt(again, settings)
        if doubtful and not reason and apart(work, again.homography, fit.homography) <= settings.right_px:
            break
        fit, reason = again, doubtful
    if fit is not None and not reason:
        here, fit = fit.homography, among_repeats(work, fit, start)
        fit = _in_even_light(work, fit, even and fit.homography is here)
    return _judged(work, fit, start)


def _descend(work: Work) -> bool:
    """Gauss-Newton from the coarsest level to the finest; returns whether it converged."""
    settings, template = work.settings, work.template
    top = work.count - 1
    if top > 0:
        _coarse(work, top)
    for k in range(top - 1, 0, -1):
        work.refine(k, GaussNewton(6, fraction=0.5, cut=settings.cut_sigmas, damping=1e-3, tolerance=0.2))
        if not is_proper(work.homography, template.corners):
            return False
    if work.count > 1:
        work.refine(0, GaussNewton(6, subset=True, cut=settings.cut_sigmas, tolerance=0.25))
    else:
        work.refine(0, GaussNewton(12, fraction=0.5, cut=settings.cut_sigmas, tolerance=0.05))
    # The spline does not attenuate the noise as the bilinear kernel did (to 4/9 of its variance): with
    # the old standard deviation, valid pixels would be cut and the step shortened.
    work.light[2:4] *= 1.5
    if work.clipped:
        # At 2.5 sigma, the cut-off part shifts the mean by 0.002 sigma.
        work.margin = min(2.5 * work.light[3], 30.0)
    even = _refined(work)
    # The blocks are fitted to the samples of the last pass, which need not be taken again.
    work.homography = work.uncentred(*work.sampled)
    return even


def _refined(work: Work) -> bool:
    """Final passes over every pixel of the finest level; returns whether they converged."""
    settings = work.settings
    how = GaussNewton(3, cubic=True, cut=settings.cut_sigmas, tolerance=settings.tolerance_px)
    return bool(np.isfinite(work.refine(0, how))) and is_proper(work.homography, work.template.corners)


def _coarse(work: Work, top: int) -> None:
    """Align on the coarsest level; search for the translation if that fails.

    The candidates are the highest peaks of the normalised cross-correlation of the
    predicted view; each is refined, and the one with the highest correlation on
    the next finer level is kept.
    """
    predicted = work.homography
    work.refine(top, GaussNewton(12, fraction=0.5, damping=1e-3, tolerance=0.1))
    if work.ncc >= work.settings.ncc_search and is_proper(work.homography, work.template.corners):
        return
    first_light = work.light.copy()
    candidates = [work.homography, *(predicted @ shift for shift, _ in peaks(work, top, predicted, 6))]
    best, best_ncc, best_light = predicted, -1.0, first_light
    for candidate in candidates:
        work.light[:] = first_light
        work.refine(top, GaussNewton(15, fraction=0.5, damping=1e-2, tolerance=0.1), candidate)
        if top > 1 and is_proper(work.homography, work.template.corners):
            work.refine(top - 1, GaussNewton(8, fraction=0.5, damping=1e-3, tolerance=0.2))
        ncc = work.ncc if is_proper(work.homography, work.template.corners) else -1.0
        if ncc > best_ncc:
            best, best_ncc, best_light = work.homography, ncc, work.light.copy()
        if ncc > 0.95:
            break
    work.homography = best
    work.light[:] = best_light


def _lost(homography: np.ndarray, reason: str) -> Alignment:
    """An invalid alignment with a reason."""
    nothing = np.full((8, 8), np.nan)
    return Alignment(
        homography,
        False,
        reason,
        0.0,
        0.0,
        0.0,
        np.nan,
        np.nan,
        np.nan,
        0.0,
        np.full((4, 2), np.nan),
        nothing,
    )


def _judged(work: Work, fit: BlockFit | None, start: Float[np.ndarray, "3 3"]) -> Alignment:
    """The result with its covariance and validity."""
    homography = work.to_image @ (work.homography if fit is None else fit.homography)
    homography = homography / homography[2, 2]
    reason = doubt(fit, work.settings)
    if fit is not None and not reason:
        before, after = (apply_homography(h, work.template.corners) for h in (start, fit.homography))
        moved = float(np.linalg.norm(after - before, axis=1).max()) * 2.0**work.image_base
        # The image was not evaluated beyond this, for example if the template is folded to a strip.
        if moved > work.settings.search_px + MARGIN_PX:
            reason = f"moved by {moved:.0f} px, looked for within {work.settings.search_px:g} px"
    if reason or fit is None:
        return _lost(homography, reason)
    level, _, _ = work.pair(0)
    s1, n = work.stats[0], work.stats[7]
    return Alignment(
        homography=homography,
        valid=True,
        reason="",
        ncc=work.ncc,
        inside=float(n / level.image.size),
        weight=float(s1 / n),
        noise=float(np.sqrt(_noise_variance(work))),
        gain=float(work.light[0]),
        bias=float(work.light[1]),
        curve=float(np.clip(CURVES[work.curve] + fit.curve, 0.0, 1.0)),
        corners=apply_homography(homography, work.template.corners),
        corner_covariance=fit.covariance,
    )


def _in_even_light(work: Work, fit: BlockFit, even: bool) -> BlockFit:
    """The fit by all pixels at once, if a smooth illumination explains the residual as well as one per block.

    By the criterion of Hannan and Quinn, and if both give the same motion, with an error rate of one per cent
    (Hausman, Econometrica 46 (1978)). ``even``: the last passes had the right blur and uniform illumination.
    """
    if not even or fit.shade[1:].any():
        work.homography = fit.homography
        work.shade(fit.shade)
        if not _refined(work):
            return fit
    homography = work.centred @ work.pair(0)[0].from_template
    # Samples that are finer than the image's pixels are not independent.
    samples = work.stats[0] * min(1.0, work.relative**2)
    variance = work.stats[5] * work.light[4] / max(work.stats[0], 1.0)
    blocks = work.pair(0)[0].independent.size
    # Four parameters of illumination and two of motion for every block.
    limit = 2 * 6 * blocks * np.log(np.log(max(samples, 16.0)))
    mine, other = (apply_homography(h, work.template.corners) for h in (homography, fit.homography))
    off = (mine - other).ravel() * 2.0**work.image_base
    if (
        samples * np.log(max(variance, 1e-9) / fit.variance) >= limit
        or off @ np.linalg.solve(fit.covariance, off) >= 20.1  # chi^2 of 8 degrees of freedom
    ):
        return fit
    covariance = fit.blocks.excess(off) * _covariance(work, work.centred)
    # Pixels that scatter by common causes count less than the blocks, whose light is their own.
    if np.trace(covariance) > np.trace(fit.covariance):
        return fit
    return replace(fit, homography=homography, covariance=covariance)


def _noise_variance(work: Work) -> float:
    """Variance of one image pixel [grey levels^2]; residuals of blur and illumination at edges are not noise."""
    samples, squares, energy = work.stats[0], work.stats[5], work.stats[6]
    return float(min(squares * work.light[4], samples * work.light[3] ** 2) / max(energy, 1e-9))


def _covariance(work: Work, centred: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "8 8"]:
    """Covariance of the corners [px^2] if the residual contains only the noise of independent pixels."""
    to_centred = work.pair(0)[0].from_template
    corners = work.template.corners @ to_centred[:2, :2].T + to_centred[:2, 2]
    jacobian = motion_jacobian(centred, corners).reshape(8, 8) * 2.0**work.image_base
    # If the template is the finer of the two, neighbouring samples share image pixels: a sum has 1 / relative^2
    # times the variance. If it is the coarser one, each sample only has less noise, due to averaging by the kernel.
    kept = max(work.stats[6] / max(work.stats[0], 1e-9), 1.0 / work.relative**2)
    covariance = _noise_variance(work) * kept * np.linalg.inv(work.matrix)[:8, :8]
    return np.asarray(jacobian @ covariance @ jacobian.T)
