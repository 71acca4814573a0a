"""Calibrated correction of the beam's data sheet: a 6 x 6 matrix and its covariance.

The beam model converts observed motions to a wrench g. With the true compliance
C = C_0 (I + E), C_0 that of the model, g = (I + E) f for the true wrench f. The
sensor reads f = (I + E)^-1 g; the uncertainty of E is the systematic part of
its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ...core.geometry import hat
from .mechanics import Beam, compliance

#: Minimum standard deviation of an element of E in units of force: effects that the parts in
#: ``Beam`` do not include (glue, ends of the clamp, a rod that is not exactly round).
FLOOR = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """E of ``g = (I + E) f``; SI units: moments per force in m, forces per moment in 1/m."""

    matrix: Float[np.ndarray, "6 6"]
    #: covariance of each row of E; the rows are assumed to be independent
    row_covariance: Float[np.ndarray, "6 6 6"]
    #: fraction of the errors of the templates' positions that is not in E, for each axis of the load: 1 without
    #: calibration, almost 0 once readings of these templates under known loads are in E
    place_left: Float[np.ndarray, "6"] = field(default_factory=lambda: np.ones(6))

    def apply(self, model_wrench: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """True wrench from the wrench of the beam model.

        Parameters
        ----------
        model_wrench
            (F, M) of the beam model at the tip, frame S [N, Nm].
        """
        return np.linalg.solve(np.eye(6) + self.matrix, model_wrench)

    def transform(self, covariance: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6 6"]:
        """Covariance of the true wrench from the covariance of the beam model's.

        Parameters
        ----------
        covariance
            Covariance of the model's wrench [N, Nm].
        """
        inverse = np.linalg.inv(np.eye(6) + self.matrix)
        return inverse @ covariance @ inverse.T

    def covariance(self, wrench: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
        """Covariance of a true wrench due to the uncertainty of E.

        Parameters
        ----------
        wrench
            True wrench (F, M) [N, Nm].
        """
        return self.transform(np.diag(np.einsum("kij,i,j->k", self.row_covariance, wrench, wrench)))


def prior_correction(beam: Beam) -> Correction:
    """E = 0 with the covariance due to the tolerances of the parts.

    One part at a time is changed by its tolerance, and the change of
    C_0^-1 C at the tip is the effect on E; the effects are added as independent.
    1 mm in 12 cm of length is 2.5 % of F if the moment is known, and 5 % if F
    and M are distinguished by deflection and slope.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    """
    nominal = np.linalg.inv(compliance(beam, 1.0))
    effects = []

    def part(changed: Beam) -> None:
        effects.append(nominal @ compliance(changed, 1.0) - np.eye(6))

    part(replace(beam, length_m=beam.length_m + beam.length_tolerance_m))
    part(replace(beam, diameter_m=beam.diameter_m * (1 + beam.diameter_tolerance)))
    part(replace(beam, youngs_Pa=beam.youngs_Pa * (1 + beam.youngs_tolerance)))
    part(replace(beam, spring_N_per_m=beam.spring_N_per_m * (1 + beam.spring_tolerance)))
    part(replace(beam, spring_Nm_per_rad=beam.spring_Nm_per_rad * (1 + beam.spring_tolerance)))
    for axis in range(3):
        # Axes rotated by a small angle: load and motion are rotated equally.
        turn = np.zeros((3, 3))
        turn[(axis + 1) % 3, (axis + 2) % 3], turn[(axis + 2) % 3, (axis + 1) % 3] = -1.0, 1.0
        both = np.kron(np.eye(2), beam.alignment_tolerance_rad * turn)
        c = compliance(beam, 1.0)
        effects.append(nominal @ (both @ c - c @ both))
    # The load may act at a distance of the length tolerance from the tip.
    for axis in range(3):
        arm = np.zeros(3)
        arm[axis] = beam.length_tolerance_m
        shift = np.zeros((6, 6))
        shift[3:, :3] = hat(arm)
        effects.append(shift)
    scale = np.array([1.0, 1.0, 1.0, beam.length_m, beam.length_m, beam.length_m])
    variance = np.square(effects).sum(axis=0) + (FLOOR * scale[:, None] / scale[None, :]) ** 2
    return Correction(np.zeros((6, 6)), np.stack([np.diag(row) for row in variance]))
