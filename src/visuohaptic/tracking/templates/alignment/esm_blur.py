"""Blur of a camera's image relative to the template.

It depends on lens, pixels, distance and focus, so that it is constant or changes slowly. A
template that is sharper than the image has gradients that the image lacks: its residual
is not noise, and its declared covariance is too small; a template with sharp print (a tag) leaves
large residuals along its edges, and its declared covariance is too large. The blur with the smallest
residual corrects both.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, UInt8

from .esm import Alignment
from .esm_pyramid import EsmSettings, GaussNewton, Work
from .esm_template import BLUR_VARIANCES, EsmTemplate


def matching_blur(
    template: EsmTemplate,
    image: UInt8[np.ndarray, "height width"],
    alignment: Alignment,
    settings: EsmSettings | None = None,
    *,
    offset: Float32[np.ndarray, "2 R C"] | None = None,
    start: float | None = None,
) -> float:
    """Variance of the Gaussian [template px^2] with which the template best matches an aligned image.

    Parameters
    ----------
    template, image, alignment
        A valid alignment of both.
    settings, offset
        As for :func:`visuohaptic.tracking.templates.alignment.esm.align`.
    start
        Initial blur; the search descends from there.
    """
    settings = settings or EsmSettings()
    work = Work(template, image, alignment.homography, settings, offset, start, alignment.curve)
    if not work.enough:
        return 0.0 if start is None else start
    # No outlier rejection: with a wrong blur, the residual is concentrated at edges, which would be rejected as
    # outliers. Occluded pixels match no blur, so that they have no effect.
    light = np.array([alignment.gain, alignment.bias, 1e6, 1e6, 1.0])
    misfits: dict[int, float] = {}

    def residual(blur: int) -> float:
        """Mean squared residual after the best gain and bias [grey levels^2]."""
        if blur not in misfits:
            work.finest = template.finest(work.chain, blur, work.curve)
            level, _, h = work.pair(0)
            h = np.ascontiguousarray(h / h[2, 2])
            work.light[:] = light
            how = GaussNewton(1, cubic=True, cut=1.0, tolerance=np.inf)
            work.run(0, level, work.spline(h), h, level.rows, how)
            s1, t, tt, r, tr, rr = work.stats[:6]
            if s1 <= 0:
                return np.inf
            # Regression of the residual on the template: gain and bias belong to another blur.
            spread = max(tt - t * t / s1, 1e-9)
            misfits[blur] = float((rr - r * r / s1 - (tr - t * r / s1) ** 2 / spread) / s1)
        return misfits[blur]

    best, last = work.blur, len(BLUR_VARIANCES) - 1
    while True:
        near = [blur for blur in (best - 1, best, best + 1) if 0 <= blur <= last]
        lower = min(near, key=residual)
        if lower == best:
            return template.variance(work.chain, best)
        best = lower
