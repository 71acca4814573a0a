"""How far touches were off what was expected of them, and what follows for the deviations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..surfaces.rbf import RbfSurface
from .symmetry import ShapePrior

__all__ = ["TouchResiduals"]


class TouchResiduals:
    """Standardised residuals of touches: of the spline, and of the rings of similar cross-sections.

    Parameters
    ----------
    prior
        Symmetries of the object; ``None`` without rings.
    size_m
        Size of the region where the surface is missing [m].
    """

    def __init__(self, prior: ShapePrior | None, size_m: float) -> None:
        self._prior, self._size_m = prior, size_m
        self._of_spline: list[float] = []
        self._of_rings: list[float] = []

    def add(
        self,
        fit: RbfSurface,
        contact_m: Float[np.ndarray, "3"],
        sigma_m: float,
        earlier: Sequence[tuple[Float[np.ndarray, "3"], float]],
    ) -> None:
        """Compare a touch with what was expected, before it is joined.

        Parameters
        ----------
        fit
            Spline without the touch.
        contact_m
            Contact (3) [m].
        sigma_m
            Its standard deviation [m].
        earlier
            Contacts so far (3) [m] and their standard deviations [m].
        """
        expected = float(fit.kriging_sigma_m(contact_m[None])[0])
        off_m = abs(float(fit(contact_m[None])[0]))
        self._of_spline.append(off_m / float(np.hypot(expected, sigma_m)))
        if self._prior is None:
            return
        for other, _ in earlier[-8:]:
            # A ring predicts another touch only at its own height.
            if abs(other[2] - contact_m[2]) > 0.05 * self._size_m:
                continue
            points, sigma = self._prior.ring(other, 71)
            near = int(np.argmin(np.linalg.norm(points[:, :2] - contact_m[:2], axis=1)))
            gap = float(np.linalg.norm(points[near, :2] - contact_m[:2]))
            self._of_rings.append(gap / float(np.hypot(sigma[near], 1.5 * sigma_m)))

    @property
    def prior_inflation(self) -> float:
        """Factor on the deviation of rings by how far touches were off them."""
        if not self._of_rings:
            return 1.0
        return float(max(1.0, np.sqrt(np.mean(np.square(self._of_rings)))))

    @property
    def calibration(self) -> float:
        """Root mean square of the standardised residuals of the spline, with two imagined ones of 3.

        The process is fitted to the visible bands, and what is hidden is rougher than
        what is seen: without touches its deviation is too small.
        """
        squares = [9.0, 9.0, *(min(value, 10.0) ** 2 for value in self._of_spline)]
        return float(np.sqrt(np.mean(squares)))
