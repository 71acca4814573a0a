"""A stress curve that is linear in its parameters: cubic as published, or a monotone spline.

Symbols: eps strain, P parameters, N pieces. Every curve is a piecewise cubic,
``m(eps) = sum_j parameters[j] * basis_j(eps)``, so that its covariance
propagates exactly. The stress at zero strain is zero, a negative strain (foam
that protrudes) has no stress, and beyond the last strain the curve is extrapolated
along its tangent, so that it remains monotone.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from ....core import InputError, kernel

CurveKind = Literal["spline", "cubic"]


@dataclass(frozen=True, eq=False)
class StressCurve:
    """Nominal stress over strain, m_P of Eq. (3.2) or its monotone counterpart.

    Examples
    --------
    >>> import numpy as np
    >>> curve = StressCurve("cubic", np.array([0.0, 0.6]), np.array([4e4, -1e5, 1e5]), np.eye(3))
    >>> float(np.round(curve.stress(np.array([0.1]))[0], 6))
    3100.0
    """

    kind: CurveKind
    knots: Float[np.ndarray, "n"]  #: increasing strains from 0 to the end of the calibrated range
    parameters: Float[np.ndarray, "p"]  #: cubic: c1, c2, c3 [Pa]; spline: B-spline coefficients [Pa]
    covariance: Float[np.ndarray, "p p"]  #: of ``parameters`` [Pa^2]

    def __post_init__(self) -> None:
        expected = 3 if self.kind == "cubic" else len(self.knots) + 1
        sound = (
            self.knots.ndim == 1
            and len(self.knots) >= 2
            and bool(np.all(np.isfinite(self.knots)))
            and self.knots[0] == 0.0
            and bool(np.all(np.diff(self.knots) > 0))
            and self.knots[-1] < 1.0
        )
        if not sound:
            raise InputError("StressCurve", "knots must rise from exactly 0 to less than 1", field="knots")
        if self.parameters.shape != (expected,) or self.covariance.shape != (expected, expected):
            raise InputError(
                "StressCurve",
                f"found {self.parameters.shape} parameters and covariance {self.covariance.shape}, "
                f"expected {expected} for a {self.kind} with {len(self.knots)} knots",
                field="parameters",
            )
        if not (np.all(np.isfinite(self.parameters)) and np.all(np.isfinite(self.covariance))):
            raise InputError("StressCurve", "parameters and covariance must be finite", field="parameters")

    @property
    def max_strain(self) -> float:
        """End of the calibrated range."""
        return float(self.knots[-1])

    @cached_property
    def basis_pieces(self) -> Float[np.ndarray, "pieces p 4"]:
        """Polynomial coefficients of every basis function on every piece, lowest power first.

        On piece n, ``basis_j(eps) = sum_k basis_pieces[n, j, k] * (eps - knots[n])**k``.
        """
        if self.kind == "cubic":
            pieces = np.zeros((len(self.knots) - 1, 3, 4))
            for piece, start in enumerate(self.knots[:-1]):
                # Taylor expansion of x, x^2, x^3 about the start of the piece.
                pieces[piece, 0] = [start, 1, 0, 0]
                pieces[piece, 1] = [start**2, 2 * start, 1, 0]
                pieces[piece, 2] = [start**3, 3 * start**2, 3 * start, 1]
            return pieces
        from scipy.interpolate import BSpline, PPoly

        clamped = np.concatenate([np.full(3, self.knots[0]), self.knots, np.full(3, self.knots[-1])])
        count = len(clamped) - 4
        pieces = np.zeros((len(self.knots) - 1, count - 1, 4))
        for j in range(1, count):  # without the first basis function, the stress at zero strain
            poly = PPoly.from_spline(BSpline(clamped, np.eye(count)[j], 3))
            inside = poly.c[::-1, 3 : 3 + len(self.knots) - 1]
            pieces[:, j - 1, :] = inside.T
        return pieces

    @cached_property
    def pieces(self) -> Float[np.ndarray, "pieces 4"]:
        """Polynomial coefficients of the curve itself on every piece [Pa], lowest power first."""
        return np.ascontiguousarray(np.einsum("npk,p->nk", self.basis_pieces, self.parameters))

    def basis(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "... p"]:
        """Basis functions at the strains: the derivative of the stress by each parameter.

        Parameters
        ----------
        strain
            Compressive strain.
        """
        strain = np.asarray(strain, dtype=np.float64)
        clipped = np.clip(strain, 0.0, self.max_strain)
        piece = self._piece(clipped)
        x = (clipped - self.knots[piece])[..., None]
        c = self.basis_pieces[piece]
        value = c[..., 0] + x * (c[..., 1] + x * (c[..., 2] + x * c[..., 3]))
        slope = c[..., 1] + x * (2 * c[..., 2] + 3 * x * c[..., 3])
        beyond = np.maximum(strain - self.max_strain, 0.0)[..., None]
        return value + slope * beyond

    def stress(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Nominal stress [Pa].

        Parameters
        ----------
        strain
            Compressive strain; negative strains have no stress.
        """
        return self._values(strain)[0]

    def slope(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Derivative of the stress by the strain [Pa]; for negative strains that at zero strain.

        Parameters
        ----------
        strain
            Compressive strain.
        """
        return self._values(strain)[1]

    def _values(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "2 ..."]:
        """Stress and slope."""
        strain = np.asarray(strain, dtype=np.float64)
        values = np.empty((2, strain.size))
        curve_values(np.ascontiguousarray(strain.reshape(-1)), self.knots, self.pieces, values)
        return values.reshape(2, *strain.shape)

    def stress_sigma(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Standard deviation of the stress from the fit's covariance [Pa].

        Parameters
        ----------
        strain
            Compressive strain.
        """
        basis = self.basis(strain)
        variance = np.einsum("...p,pq,...q->...", basis, self.covariance, basis)
        return np.sqrt(np.maximum(variance, 0.0))

    def minimum_slope(self) -> tuple[float, float]:
        """The strain in the calibrated range with the lowest slope, and that slope [Pa]."""
        strain = np.linspace(0.0, self.max_strain, 1001)
        slope = self.slope(strain)
        lowest = int(np.argmin(slope))
        return float(strain[lowest]), float(slope[lowest])

    def _piece(self, clipped: Float[np.ndarray, "..."]) -> np.ndarray:
        return np.clip(np.searchsorted(self.knots, clipped, side="right") - 1, 0, len(self.knots) - 2)


@kernel(nogil=True)
def curve_values(strain, knots, pieces, values):
    """Stress of a curve and its slope [Pa]; NaN where the strain is.

    Parameters
    ----------
    strain
        Compressive strains, (n,).
    knots, pieces
        See :class:`StressCurve`.
    values
        Filled, (2, n).
    """
    end, last = knots[-1], len(knots) - 2
    for i in range(len(strain)):
        x = strain[i] if math.isnan(strain[i]) else min(max(strain[i], 0.0), end)
        k = 0
        while k < last and x >= knots[k + 1]:
            k += 1
        x -= knots[k]
        slope = pieces[k, 1] + x * (2 * pieces[k, 2] + 3 * x * pieces[k, 3])
        stress = pieces[k, 0] + x * (pieces[k, 1] + x * (pieces[k, 2] + x * pieces[k, 3]))
        values[0, i] = stress + slope * max(strain[i] - end, 0.0)
        values[1, i] = slope
