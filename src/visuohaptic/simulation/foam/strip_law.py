"""Material law of the simulated foam: hyperelastic, with hysteresis, slow relaxation and shear coupling.

Symbols
-------
epsilon : strain of a column or of one of its layers, compression positive
sigma : nominal stress, compression positive [Pa]
lambda : stretch, 1 - epsilon
xi_j : state of hysteresis element j, +1 on the loading branch, -1 on the unloading branch
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError

#: Range and number of the tables that the kernel reads; strain below 0 is tension.
TABLE_START, TABLE_END, TABLE_SIZE = -0.6, 0.95, 6201
#: Below this strain (0.2 um of 20 mm) foam counts as unloaded and its memory is reset.
FREE_STRAIN = 1e-5


@dataclass(frozen=True, slots=True)
class StripLaw:
    """The true law of the foam, independent of every estimator.

    The loading branch is the uniaxial nominal stress of the Ogden-Hill
    (Storakers) potential with Poisson ratio 0,

        sigma(epsilon) = sum_i (2 mu_i / alpha_i) (1 - lambda^alpha_i) / lambda.

    Hysteresis multiplies it by ``1 - sum_j r_j (1 - xi_j)`` where every xi_j is
    a stop operator (Maxwell slip element, Prandtl): it follows ``d epsilon /
    e_j`` and slips at +1 and -1. Work done in a closed loop is never negative
    because sigma does not change its sign. An unloaded part of the foam
    resets its memory (xi_j = 1), so every loading from rest is the same curve.

    Neighbouring columns are coupled by shear with the energy
    ``G(epsilon) g0^2 (sqrt(1 + gamma^2 / g0^2) - 1)`` per volume: quadratic
    for small shear gamma, like a string for large. The modulus
    ``G = k (m sigma lambda / (1 - lambda^2) + (1 - m) mu)`` follows the
    tangent shear modulus of the compressed potential with weight m; k < 1
    represents the lateral motion of the foam, which columns do not have.
    """

    mu_Pa: tuple[float, ...] = (11000.0, 50.0)  #: mu_i
    alpha: tuple[float, ...] = (8.0, -2.0)  #: alpha_i
    loss: tuple[float, ...] = (0.015, 0.03, 0.06, 0.08)  #: r_j, their sum < 0.5
    loss_strain: tuple[float, ...] = (0.001, 0.004, 0.015, 0.05)  #: e_j
    relaxation: float = 0.0  #: part of the stress that fast loading adds and that relaxes
    relaxation_strain: float = 0.2  #: strain over which that part builds up
    relaxation_time_s: float = 20.0  #: time constant of its decay
    shear_factor: float = 0.386  #: k
    shear_mix: float = 0.663  #: m
    shear_limit: float = 1.57  #: g0
    layers: tuple[float, ...] = (1 / 3, 1 / 3, 1 / 3)  #: thickness of the layers by w, back to front

    def __post_init__(self) -> None:
        if len(self.mu_Pa) != len(self.alpha) or not self.mu_Pa or 0 in self.alpha:
            raise InputError("StripLaw", f"found {self.mu_Pa} and {self.alpha}, expected pairs, alpha not 0")
        if len(self.loss) != len(self.loss_strain) or any(e <= 0 for e in self.loss_strain):
            raise InputError("StripLaw", f"found loss_strain {self.loss_strain}, expected one > 0 per loss")
        if any(r < 0 for r in self.loss) or sum(self.loss) >= 0.5:
            raise InputError("StripLaw", f"found loss {self.loss}, expected all >= 0 with a sum below 0.5")
        if not (self.layers and min(self.layers) > 0 and abs(sum(self.layers) - 1) < 1e-9):
            raise InputError("StripLaw", f"found layers {self.layers}, expected parts > 0 with sum 1")

    def elastic_stress_Pa(self, strain: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Loading branch: nominal stress at a strain [Pa].

        Parameters
        ----------
        strain
            Compression, 0 to 1.
        """
        stretch = 1.0 - np.asarray(strain, dtype=np.float64)
        return sum(
            (2 * mu / a * (1 - stretch**a) / stretch for mu, a in zip(self.mu_Pa, self.alpha, strict=True)),
            np.zeros_like(stretch),
        )

    def shear_modulus_Pa(self, strain: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """G at a compression [Pa].

        Parameters
        ----------
        strain
            Compression, 0 to 1.
        """
        strain = np.asarray(strain, dtype=np.float64)
        stretch = 1.0 - strain
        # At zero strain the quotient is 0/0 with the limit mu.
        safe = np.where(np.abs(strain) < 1e-7, 1e-7, strain)
        tangent = self.elastic_stress_Pa(safe) * stretch / (1.0 - (1.0 - safe) ** 2)
        return self.shear_factor * (self.shear_mix * tangent + (1 - self.shear_mix) * sum(self.mu_Pa))

    def tables(self) -> tuple[Float[np.ndarray, "t"], Float[np.ndarray, "t"]]:
        """Stress and shear modulus [Pa] at ``TABLE_SIZE`` strains, for the kernel."""
        strain = np.linspace(TABLE_START, TABLE_END, TABLE_SIZE)
        return self.elastic_stress_Pa(strain), self.shear_modulus_Pa(strain)

    def uniaxial(
        self, strain: Float[np.ndarray, "n"], direction: str = "loading", *, max_strain: float = 0.6
    ) -> Float[np.ndarray, "n"]:
        """Stress on a plate over the whole strip [Pa].

        Parameters
        ----------
        strain
            Strains in any order.
        direction
            ``"loading"`` from rest, or ``"unloading"`` after ``max_strain``.
        max_strain
            Strain at which unloading starts.
        """
        strain = np.asarray(strain, dtype=np.float64)
        if direction == "loading":
            return self.elastic_stress_Pa(strain)
        if direction != "unloading":
            raise InputError("uniaxial", f"found direction {direction!r}, expected 'loading' or 'unloading'")
        yields = np.asarray(self.loss_strain)
        xi = np.clip(1.0 - np.maximum(max_strain - strain, 0.0)[:, None] / yields, -1.0, 1.0)
        return self.elastic_stress_Pa(strain) * (1.0 - (1.0 - xi) @ np.asarray(self.loss))


def write_calibration_csv(path: Path | str, rows: Sequence[tuple[float, float, str]]) -> None:
    """Write press rows as the calibration file ``strain,stress_Pa,direction``.

    Parameters
    ----------
    path
        CSV file to write.
    rows
        Strain, stress [Pa] and direction (``loading`` or ``unloading``) of each sample.
    """
    from ...core.files import write_csv

    texts = ((f"{strain:.6f}", f"{stress:.3f}", direction) for strain, stress, direction in rows)
    write_csv(path, ("strain", "stress_Pa", "direction"), texts)


#: Soft PUR: slope about 10 kPa per unit strain in the plateau.
SOFT_FOAM = StripLaw()
#: Constants of the continuum simulation in ``data/foam_continuum``, loading branch only.
REFERENCE_FOAM = StripLaw(mu_Pa=(33600.0, 150.0), alpha=(12.0, -2.0), loss=(), loss_strain=())
