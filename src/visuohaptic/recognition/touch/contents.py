"""Lid, filling and fill level of a round container from firm squeezes and its mass.

A pinch of a round wall preserves its volume to first order (errata). A ring that is bent to an ellipse of the same
perimeter loses the area pi (3 d^2 - d^3 / r) / 2, over a length of about one diameter. Enclosed air obeys Boyle's law, so
that its force starts with the third power of the deformation, and is larger the less air is left above a filling; the
pressure p of a liquid at the place adds 3 pi r p to the stiffness. Wall thickness and modulus are known only roughly and scale
the linear part, which is therefore a free parameter, as are the zero of the deformation and a small curvature of the wall's
own curve. States are discriminated by the remaining shape of the curve, and by the mass: for an open container, this shape
does not depend on the contents.

A hypothesis is a lid (open, closed), a filling (nothing, liquid, grain) and a fill level, as a fraction of the volume in steps
of ``FILL_STEP``. With ``G`` the force of the enclosed air, the linear part ``L = k d`` of a measured curve has the
slope k that fits best, and the curve is Gaussian with mean ``F = L + G`` and covariance
``diag(sigma^2) + L L^T + (b L d/D)(...)^T + (q G)(q G)^T + (z F')(z F')^T``; the vectors in brackets are the
uncertain quantities. The deviation of the slopes from those of the measured outline and wall is a separate piece of evidence:
``log(k / k_h)`` is Gaussian with the uncertainty of wall and modulus (``SCALE``), correlated over ``ALONG_M`` so that adjacent
heights count once, and the covariance of the stiffness among outlines with the error of the measured one. A lid
has clearance, or deforms: anything between a free rim and a held one is equally probable of a closed container, so that near
the rim, where a held one doubles the stiffness and more, a soft wall is weak evidence, and a stiff one shows a lid. If the
error of the slope were part of the hypothesis's own stiffness, a stiffer hypothesis would be penalised for noise that is
not in its data. The mass is Gaussian about that of the hypothesis. The likelihoods of curves and mass multiply; contents that
fit no hypothesis are unknown, see :func:`.posterior_with_unknown`. Symbols: n levels of a curve, k points of an outline, h hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ..data import HEIGHTS, SqueezeSamples
from ._round_body import (
    EMPTY,
    FILLINGS,
    NECK,
    Filling,
    alike,
    round_body,
    stiffness_scatter,
    wall_from_stiffness,
)
from .haptic_model import UNKNOWN
from .unknown_class import posterior_with_unknown

__all__ = [
    "EMPTY",
    "FILLINGS",
    "FORCES_N",
    "MAX_DEFORMATION_M",
    "ContentsModel",
    "ContentsPosterior",
    "Filling",
    "SqueezeSamples",
    "wall_from_stiffness",
]  # fmt: skip

#: Force levels of a firm squeeze [N], and the deformation of one side at which it ends [m].
FORCES_N = (1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 26.0, 33.0, 40.0, 47.0, 54.0)
MAX_DEFORMATION_M = 0.007
#: Standard deviations: of wall and modulus, logarithmic; of the curvature of the wall's own curve at the deepest level, and of
#: the force of the enclosed air, both relative; and of the zero of the deformation [m].
SCALE, BEND, ENCLOSED, ZERO_M = 0.4, 0.01, 0.12, 1e-4
#: Standard deviations of the mean of a level: force [N] and surface [m].
FORCE_N, SURFACE_M = 0.05, 3e-5
#: Mass of a cap, which is not part of the outline [kg].
CAP_KG = 0.003
#: Minimum distance of two places, and margin at the foot, where the stiffness depends most on the height.
APART, FOOT = 2, 4
#: Gauss-Legendre nodes and weights for how far a lid holds the rim, from not at all to fully.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
HELD, HELD_WEIGHTS = 0.5 + 0.5 * _NODES, 0.5 * _WEIGHTS
#: Step of the fill levels that are compared, as a fraction of the volume.
FILL_STEP = 0.025
#: Prior of any container: about as likely empty as not; bottles usually contain liquids.
PRIOR = {EMPTY: 0.4, "liquid": 0.45, "grain": 0.15}


@dataclass(frozen=True, slots=True, eq=False)
class ContentsPosterior:
    """Probability of every hypothesis; those and ``unknown`` sum to 1."""

    closed: Bool[np.ndarray, "h"]  #: airtight, and the rim keeps its shape
    filling: tuple[str, ...]  #: ``EMPTY`` or one of ``FILLINGS``, by hypothesis
    fill: Float[np.ndarray, "h"]  #: fill level as a fraction of the volume
    probability: Float[np.ndarray, "h"]
    unknown: float  #: contents that this model does not know

    def belief(self) -> dict[str, float]:
        """Probabilities of ``open``, ``closed`` and ``UNKNOWN``, summed over all fillings."""
        closed = float(self.probability[self.closed].sum())
        return {"open": max(1.0 - self.unknown - closed, 0.0), "closed": closed, UNKNOWN: self.unknown}

    @property
    def filled(self) -> float:
        """Probability that it contains something, given that the contents are known."""
        empty = np.array([name == EMPTY for name in self.filling])
        return 1.0 - float(self.probability[empty].sum() / self.probability.sum())

    def fill_of(self, lid: str | None = None) -> tuple[float, float]:
        """Mean and standard deviation of the fill.

        Parameters
        ----------
        lid
            ``open`` or ``closed``: conditional on this state; by default over all known hypotheses.
        """
        weight = self.probability if lid is None else self.probability * (self.closed == (lid == "closed"))
        if (total := float(weight.sum())) <= 0.0:
            return math.nan, math.nan
        mean = float(weight @ self.fill) / total
        return mean, math.sqrt(float(weight @ (self.fill - mean) ** 2) / total + FILL_STEP**2 / 12)


class ContentsModel:
    """Model of the curves and the mass for each lid and filling, given a measured outline and wall.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    wall_m
        Thickness of the wall [m]; the material is PET.
    outline_sigma_m
        Standard deviation of the outline's radius [m].
    prior
        Probability of ``EMPTY`` and of some or all ``FILLINGS``; all levels of a filling are equally probable.

    Raises
    ------
    InputError
        The prior names another filling, or does not sum to 1.

    Examples
    --------
    >>> import numpy as np
    >>> model = ContentsModel(np.array([[0.03, 0.0], [0.03, 0.2]]), 4e-4)
    >>> posterior = model.posterior([], mass_kg=(0.3, 0.003))  # weighed, not squeezed
    >>> round(posterior.belief()["closed"], 2)
    0.5
    """

    def __init__(
        self,
        outline_m: Float[np.ndarray, "k 2"],
        wall_m: float,
        prior: Mapping[str, float] = PRIOR,
        *,
        outline_sigma_m: float = 0.0,
    ) -> None:
        if not set(prior) <= {EMPTY, *FILLINGS} or not math.isclose(sum(prior.values()), 1.0):
            raise InputError(
                "ContentsModel",
                f"found {dict(prior)}, expected fractions of {EMPTY}, {', '.join(FILLINGS)} that sum to 1",
                field="prior",
            )
        self.height_m = float(outline_m[-1, 1])
        self._body = round_body(outline_m, wall_m)
        self._scatter = stiffness_scatter(outline_m, wall_m, outline_sigma_m)
        fills = np.arange(FILL_STEP, 1.0 + 0.5 * FILL_STEP, FILL_STEP)
        levels = [(name, float(fill)) for name in prior for fill in ((0.0,) if name == EMPTY else fills)]
        self._hypotheses = [(closed, name, fill) for closed in (False, True) for name, fill in levels]
        parts = [prior[name] / (1 if name == EMPTY else len(fills)) for _, name, _ in self._hypotheses]
        self._log_prior = np.log(0.5 * np.array(parts))

    def mass_kg(self, fill: float, filling: str = "liquid") -> tuple[float, float]:
        """Mass of container and contents, and its standard deviation [kg].

        Parameters
        ----------
        fill
            Fill level as a fraction of the volume.
        filling
            ``EMPTY`` or one of ``FILLINGS``.
        """
        heap, sigma = 0.0, 0.0
        if filling != EMPTY:
            heap = FILLINGS[filling].kg_per_m3 * fill * float(self._body.below_m3[-1])
            sigma = FILLINGS[filling].sigma * heap
        # The thickness is estimated from a stiffness that is proportional to about its square.
        return self._body.wall_kg + heap, math.hypot(0.5 * SCALE * self._body.wall_kg, sigma, CAP_KG)

    def force_N(
        self,
        height_m: float,
        deformation_m: Float[np.ndarray, "n"],
        *,
        closed: bool,
        fill: float = 0.0,
        filling: str = "liquid",
    ) -> Float[np.ndarray, "n"]:
        """Expected force of one finger [N].

        Parameters
        ----------
        height_m
            Above the bottom [m].
        deformation_m
            Of one side [m].
        closed
            Whether it is airtight.
        fill
            Fill level as a fraction of the volume.
        filling
            ``EMPTY`` or one of ``FILLINGS``.
        """
        wall, air = self._body.force_N((closed, filling, fill), height_m, deformation_m)
        return wall + air

    def heights_m(self) -> list[float]:
        """Heights of squeezes at a minimum distance, best first [m]: where a lid changes the firmest one most.

        Each is there twice, the second time for a squeeze from the side: that may tell more than the next height.
        """
        levels = [k for k in range(FOOT, HEIGHTS + 1) if k / HEIGHTS < NECK]
        heights = {k: (k - 0.5) / HEIGHTS * self.height_m for k in levels}
        gain = {k: self._distances(z) for k, z in heights.items()}
        found: list[int] = []
        for k in sorted(levels, key=lambda level: -gain[level][0]):
            if all(abs(k - other) >= APART for other in found):
                found.append(k)
        gains = [(time, k) for time in (0, 1) for k in found]
        return [heights[k] for time, k in sorted(gains, key=lambda one: -gain[one[1]][one[0]])]

    def _distances(self, height_m: float) -> tuple[float, float]:
        """Squared Mahalanobis distance between closed and open in a squeeze, and what a second one there adds: that of enclosed
        air, up to the deformation that an open container reaches, and, once, the mean of that of the slope."""
        rim = self._rim(height_m) ** 2 / 3.0 / float(self._slopes_covariance([height_m])[0, 0])
        d = np.linspace(0.0, MAX_DEFORMATION_M, 200)[1:]
        reached = d[self.force_N(height_m, d, closed=False, filling=EMPTY) <= FORCES_N[-1]]
        if len(reached) < 4:
            return rim, 0.0
        at = np.linspace(0.0, reached[-1], len(FORCES_N) + 1)[1:]
        wall, air = self._body.force_N((True, EMPTY, 0.0), height_m, at)
        once, twice = (float(air @ np.linalg.solve(_covariance(at, wall, air, n), air)) for n in (1, 2))
        return rim + once, twice - once

    def _rim(self, height_m: float) -> float:
        """Logarithm of the stiffness with a held rim by that with a free one."""
        return math.log(self._body.wall_N_per_m(height_m, True) / self._body.wall_N_per_m(height_m, False))

    def _explained(
        self, hypothesis: tuple[bool, str, float], one: SqueezeSamples
    ) -> tuple[float, float, float]:
        """chi^2 of a curve, log determinant of its covariance, and log(k / k_h) of its slope."""
        d = np.maximum(one.deformation_m, 1e-6)
        wall, enclosed = self._body.force_N(hypothesis, one.height_m, d)
        slope = float(d @ (one.force_N - enclosed) / (d @ d))
        # If the force is below that of the gas alone, the slope has a lower bound, and the residual is large.
        slope = max(slope, 0.05 * float(d @ one.force_N / (d @ d)), 1.0)
        residual = one.force_N - slope * d - enclosed
        covariance = _covariance(d, slope * d, enclosed)
        chi2 = float(residual @ np.linalg.solve(covariance, residual))
        return chi2, float(np.linalg.slogdet(covariance)[1]), math.log(slope * d[-1] / wall[-1])

    def _slopes_covariance(self, heights_m: Sequence[float]) -> Float[np.ndarray, "m m"]:
        """Covariance of log(k / k_h) at the heights of squeezes."""
        z = np.array(heights_m)
        scatter = np.array([np.interp(z, self._body.z_m, one) for one in self._scatter])
        of_outline = scatter.T @ scatter / (len(scatter) - 1)
        return SCALE**2 * alike(z) + of_outline + 0.05**2 * np.eye(len(z))

    def posterior(
        self, squeezes: Sequence[SqueezeSamples], mass_kg: tuple[float, float] | None = None
    ) -> ContentsPosterior:
        """Probability of every lid, filling and level, and of "none of them".

        Parameters
        ----------
        squeezes
            Curves of large deformation, at any heights.
        mass_kg
            Mass measured on lifting, and its standard deviation [kg]; ``None``: not lifted.
        """
        squeezes = [one for one in squeezes if len(one.force_N)]
        weighed, many = mass_kg is not None, len(self._hypotheses)
        # Without evidence, open, closed and unknown are equally probable.
        probability, unknown = np.exp(self._log_prior) * 2.0 / 3.0, 1.0 / 3.0
        if squeezes or weighed:
            chi2, log_det = np.zeros((many, len(squeezes) + bool(squeezes) + weighed)), np.zeros(many)
            heights_m = [one.height_m for one in squeezes]
            slopes, rim = self._slopes_covariance(heights_m), np.array([self._rim(z) for z in heights_m])
            for h, hypothesis in enumerate(self._hypotheses):
                if squeezes:
                    parts = np.array([self._explained(hypothesis, one) for one in squeezes])
                    # With a free rim, and with one that is held in part.
                    off = parts[:, 2:] + rim[:, None] * (1.0 - HELD) * hypothesis[0]
                    each = (off * np.linalg.solve(slopes, off)).sum(axis=0)
                    chi2[h, : len(parts)], chi2[h, len(parts)] = parts[:, 0], each.min()
                    mean = float(np.exp(-0.5 * (each - each.min())) @ HELD_WEIGHTS)
                    log_det[h] = parts[:, 1].sum() - 2.0 * math.log(mean)
                if mass_kg is not None:
                    expected, sigma = self.mass_kg(hypothesis[2], hypothesis[1])
                    variance = sigma**2 + mass_kg[1] ** 2
                    chi2[h, -1] = (mass_kg[0] - expected) ** 2 / variance
                    log_det[h] += math.log(variance)
            pieces = [len(one.force_N) for one in squeezes] + [len(squeezes)] * bool(squeezes)
            freedom = np.array(pieces + [1] * weighed)
            log_joint = self._log_prior - 0.5 * (chi2.sum(axis=1) + log_det)
            whole, best = np.logaddexp.reduce(log_joint), int(np.argmax(log_joint))
            # All hypotheses form one model, which is accepted if its best hypothesis passes the test.
            known, unknown = posterior_with_unknown(whole[None], chi2[best][None], freedom)
            probability = known[0] * np.exp(log_joint - whole)
        closed, filling, fill = zip(*self._hypotheses, strict=True)
        return ContentsPosterior(np.array(closed), filling, np.array(fill), probability, unknown)


def _covariance(
    d: Float[np.ndarray, "n"],
    linear: Float[np.ndarray, "n"],
    enclosed: Float[np.ndarray, "n"],
    curves: int = 1,
) -> Float[np.ndarray, "n n"]:
    """Covariance of the forces of a curve, or of the mean of several at one height, given their two parts [N^2]."""
    slope = (linear + 3.0 * enclosed) / d
    own = np.stack([linear, ZERO_M * slope])
    common = np.stack([BEND * linear * d / d.max(), ENCLOSED * enclosed])
    return (np.diag(FORCE_N**2 + (SURFACE_M * slope) ** 2) + own.T @ own) / curves + common.T @ common
