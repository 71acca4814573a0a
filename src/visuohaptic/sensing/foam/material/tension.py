"""Lateral tension of a compressed foam: its shear modulus from the stress curve, and how it softens.

Symbols: eps strain, m(eps) calibrated stress, G(eps) shear modulus, kappa ratio of tension. For foam with a Poisson
ratio of zero (usual beyond the first percents of strain), a column that is compressed to 1 - eps and sheared by g
stores ``G g^2 / 2`` more, with

    G(eps) = m(eps) (1 - eps) / (eps (2 - eps)),

and the mean over the thickness of the squared shear of a linear column is a third of that at the front. Columns are
not linear and relieve their shear by moving sideways, which kappa < 1 stands for. It is one number for many foams and
bodies (0.27 +- 0.1, chosen on small simulations of four foams under five bodies), and can be calibrated with a plate
narrower than the strip. The force law that uses it is in :mod:`~visuohaptic.sensing.foam.material.boundary`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ....core.ranges import check_ranges, within
from .stress_curve import StressCurve

__all__ = ["Tension", "shear_modulus", "softening"]

#: Below this strain the quotient m / eps is taken at it: both vanish at zero.
SMALL_STRAIN = 2e-3


@dataclass(frozen=True, slots=True)
class Tension:
    """Lateral tension of the foam, relative to the shear modulus that its own curve implies."""

    #: kappa, dimensionless; the default is the mean over simulated foams and bodies
    ratio: float = field(default=0.27, metadata=within(0.0, 5.0))
    sigma: float = field(
        default=0.10, metadata=within(0.0, 5.0)
    )  #: standard deviation of ``ratio`` over bodies
    calibrated: bool = False  #: True when fitted to a plate narrower than the strip

    def __post_init__(self) -> None:
        check_ranges(self)


def shear_modulus(
    strain: Float[np.ndarray, "..."], stress_Pa: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Shear modulus G of a compressed column, from its stress.

    Parameters
    ----------
    strain
        Compressive strain eps of the column, more than 0.
    stress_Pa
        Stress m at that strain [Pa].

    Returns
    -------
    ndarray
        G(eps) [Pa].
    """
    return stress_Pa * (1 - strain) / (strain * (2 - strain))


def softening(curve: StressCurve, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Loss of stress per sin(theta)^2 and unit kappa, ``- dG/deps / 6``.

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
    return -(slope * factor + stress * factor_slope) / 6
