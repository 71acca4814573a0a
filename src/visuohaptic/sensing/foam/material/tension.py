"""Lateral tension of a compressed foam: its shear modulus from the stress curve, and its softening.

Symbols: eps strain, m(eps) calibrated stress, G(eps) shear modulus, kappa ratio of tension. For foam with a Poisson
ratio of zero (usual beyond a few percent of strain), a column that is compressed to 1 - eps and sheared by g
stores an additional energy of ``G g^2 / 2``, with

    G(eps) = m(eps) (1 - eps) / (eps (2 - eps)),

and the mean over the thickness of the squared shear of a linear column is a third of that at the front. Columns are
not linear and relieve their shear by moving sideways, the less the less they are compressed; kappa < 1 accounts for this.
It is nearly constant over bodies and over foams with a Poisson ratio of zero. Other foams expand beside a body, which
the calibration of the curve prevents: under narrow bodies the stress is ``m (1 - lambda eps^2)``. The base holds the foam,
so that the expansion decays from each flank as ``exp(-x / l)`` (shear lag). A body of width b loses the part
``lambda eps^2 tanh(b / 2 l) / (b / 2 l)``, with one lambda for all bodies and depths. The flanks of all these foams are similar,
so that lambda follows only from the force of a plate narrower than the strip; until it is calibrated it is 0 with the
standard deviation over kinds of foam. The force law is in :mod:`~visuohaptic.sensing.foam.material.boundary`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ....core.ranges import check_ranges, within
from .stress_curve import StressCurve

#: Lower limit of the strain in the quotient m / eps, as both vanish at zero.
SMALL_STRAIN = 2e-3
#: Slightly compressed columns have not yet relieved their shear: relative increment of kappa at zero strain, and the strain over
#: which it decays. The force errors of four foams under four bodies at strains of 0.02 to 0.375 are 0.21 % (rms) with one
#: kappa and lambda for each foam; 0.22 to 0.25 % with factors of 2 and 3 and strains of 0.022 and 0.033; 0.42 % with 1
#: and 0.05.
_UNRELIEVED, _RELIEVED_STRAIN = 2.5, 0.027
#: Length l over which the lateral expansion decays from a flank, relative to the width of the strip. Plates of 2 to 20 cm on foam
#: with a Poisson ratio of 0.12 have 1.2 to 1.8 at strains of 0.15 to 0.375.
EXPANSION_PER_WIDTH = 1.6


@dataclass(frozen=True, slots=True)
class Tension:
    """Lateral tension of the foam, relative to the shear modulus that follows from its stress curve."""

    #: kappa, dimensionless; the default is the mean over simulated foams and bodies
    ratio: float = field(default=0.235, metadata=within(0.0, 5.0))
    #: standard deviation of ``ratio``; the default over simulated foams without a Poisson ratio
    sigma: float = field(default=0.025, metadata=within(0.0, 5.0))
    calibrated: bool = False  #: True when fitted to a plate narrower than the strip
    #: lambda, loss of stress by lateral expansion, dimensionless: 0.2 and 0.8 at Poisson ratios of 0.05 and 0.12
    lateral: float = field(default=0.0, metadata=within(-2.0, 3.0))
    #: standard deviation of ``lateral``; the default is its rms over the foams of ``benchmarks.foam_tension``
    lateral_sigma: float = field(default=0.37, metadata=within(0.0, 5.0))
    #: correlation of the errors of ``ratio`` and ``lateral``: the force of one plate determines mainly their sum
    correlation: float = field(default=0.0, metadata=within(-1.0, 1.0))

    def __post_init__(self) -> None:
        check_ranges(self)


def expanded(breadth_m: Float[np.ndarray, "..."], width_m: float) -> Float[np.ndarray, "..."]:
    """Part of the lateral expansion of narrow bodies that remains under wider ones, ``tanh(b / 2 l) / (b / 2 l)``.

    Parameters
    ----------
    breadth_m
        Length b of a contact along the strip, zero or more [m].
    width_m
        Thickness of the strip [m].
    """
    half = np.maximum(np.asarray(breadth_m) / (2.0 * EXPANSION_PER_WIDTH * width_m), 1e-9)
    part: Float[np.ndarray, "..."] = np.tanh(half) / half
    return part


def softening(curve: StressCurve, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Loss of stress per sin(theta)^2 and unit kappa, ``- dG/deps / 6 (1 + 2.5 exp(-eps / 0.027))``.

    Parameters
    ----------
    curve
        Loading curve m of the foam.
    strain
        Compressive strain; below 0.002 the value at 0.002 is returned.

    Returns
    -------
    ndarray
        Loss of stress [Pa].
    """
    eps = np.maximum(np.asarray(strain, dtype=np.float64), SMALL_STRAIN)
    stress, slope = curve.stress(eps), curve.slope(eps)
    factor = (1 - eps) / (eps * (2 - eps))
    # d/deps of (1 - eps) / (2 eps - eps^2) is -(eps^2 - 2 eps + 2) / (2 eps - eps^2)^2.
    factor_slope = -(eps**2 - 2 * eps + 2) / (eps * (2 - eps)) ** 2
    unrelieved = 1 + _UNRELIEVED * np.exp(-eps / _RELIEVED_STRAIN)
    return -unrelieved * (slope * factor + stress * factor_slope) / 6
