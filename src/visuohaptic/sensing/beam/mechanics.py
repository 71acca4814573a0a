"""The beam of the sensor: its parts, and its deflection under small loads (Alt 2016, Sec. 3.2).

Frame and signs, used everywhere in this package: the sensor frame S has its
origin in the clamp (S) of the unloaded sensor, X along the straight rod to the
tip (F), Y and Z across it, right-handed. A wrench f = (F_X, F_Y, F_Z, M_X, M_Y,
M_Z) acts *on* the tip; its directions are those of S and its moment is about
the (displaced) tip. A cross section at xi = x / L moves by d = (d_X, d_Y, d_Z)
and rotates by the rotation vector phi, both in S.

With w_Y = d_Y and w_Z = d_Z, a rotation about +Z raises w_Y along X, but a rotation
about +Y lowers w_Z: phi_Z = dw_Y/dx, phi_Y = -dw_Z/dx. Hence a moment M_Z bends
along +Y and a moment M_Y bends along -Z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError


@dataclass(frozen=True, slots=True)
class Beam:
    """A round rod on a guided spring; the defaults are those of Alt 2016, Sec. 3.6.1.

    The tolerances describe the parts before a calibration with
    known loads; they are the prior of that calibration, and the systematic
    part of the covariance without calibration.
    """

    length_m: float = 0.12  #: L, from the clamp (S) to the tip (F)
    diameter_m: float = 0.0015
    youngs_Pa: float = 206e9  #: E
    poisson: float = 0.29
    spring_N_per_m: float = 500.0  #: of the guided spring along X
    spring_Nm_per_rad: float = 0.2  #: of the guided spring about X
    spring_travel_m: float = 0.01  #: the spring reaches its stops beyond this, in both directions
    spring_turn_rad: float = 0.5
    yield_Pa: float = 1.2e9  #: stress at which the steel yields
    length_tolerance_m: float = 0.0005
    diameter_tolerance: float = 0.007  #: relative; has a fourfold effect on the stiffness
    youngs_tolerance: float = 0.02  #: relative
    spring_tolerance: float = 0.1  #: relative, of both spring constants
    alignment_tolerance_rad: float = 0.01  #: angle between the axes of S and the rod
    place_tolerance_m: float = 0.0005  #: of the templates along the rod
    shape_tolerance: float = 0.002  #: other deviations from the shape of a rod, fraction of the motion

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = float(getattr(self, entry.name))
            bad = not math.isfinite(value) or value < 0 or (value == 0 and "tolerance" not in entry.name)
            if bad:
                raise InputError("beam", f"found {value:g}, expected a positive number", field=entry.name)
        if self.poisson >= 0.5:
            raise InputError("beam", f"found {self.poisson:g}, expected below 0.5", field="poisson")
        if self.diameter_m > 0.1 * self.length_m:
            raise InputError(
                "beam",
                f"found a diameter of {self.diameter_m:g} m on {self.length_m:g} m, expected a slender rod",
                field="diameter_m",
                remedy="give both in metres",
            )

    @property
    def inertia_m4(self) -> float:
        """Second moment of area I = pi r^4 / 4."""
        return 0.25 * math.pi * (0.5 * self.diameter_m) ** 4

    @property
    def bending_Nm2(self) -> float:
        """E I."""
        return self.youngs_Pa * self.inertia_m4

    @property
    def torsion_Nm2(self) -> float:
        """G J of the rod; J = 2 I of a circle."""
        return self.bending_Nm2 / (1 + self.poisson)

    @property
    def axial_N(self) -> float:
        """E A."""
        return self.youngs_Pa * math.pi * (0.5 * self.diameter_m) ** 2

    @property
    def stiffness(self) -> Float[np.ndarray, "5"]:
        """(EI, GJ, EA, spring along X, spring about X), as required by the kernels."""
        return np.array(
            [self.bending_Nm2, self.torsion_Nm2, self.axial_N, self.spring_N_per_m, self.spring_Nm_per_rad]
        )

    @property
    def moment_limit_Nm(self) -> float:
        """Bending moment at which the outermost fibre yields."""
        return self.yield_Pa * self.inertia_m4 / (0.5 * self.diameter_m)

    @property
    def full_scale(self) -> Float[np.ndarray, "6"]:
        """Maximum load of each axis alone [N, Nm]: the rod yields, or the spring reaches its stop."""
        force, moment = self.moment_limit_Nm / self.length_m, self.moment_limit_Nm
        torque = min(self.spring_Nm_per_rad * self.spring_turn_rad, 2 * moment / math.sqrt(3))
        return np.array([self.spring_N_per_m * self.spring_travel_m, force, force, torque, moment, moment])


def compliance(beam: Beam, xi: float) -> Float[np.ndarray, "6 6"]:
    """Motion (d, phi) of the cross section at xi per unit of the wrench at the tip, for small loads.

    Rows d_X, d_Y, d_Z [m], phi_X, phi_Y, phi_Z [rad]; columns F_X ... M_Z. The
    bending terms are Eq. (3.4) and its derivative d/dx = (1/L) d/dxi; X is the
    spring of Sec. 3.4 in series with the rod's own stretch and twist, which
    the dissertation omits (a 12 cm rod twists by 15 times less than a force
    bends it, but as much as its spring).

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    xi
        Position x / L of the cross section.
    """
    if not 0 < xi <= 1:
        raise InputError("xi", f"found {xi:g}, expected 0 < xi <= 1")
    length, ei = beam.length_m, beam.bending_Nm2
    x = xi * length
    by_force = length**3 * (3 * xi**2 - xi**3) / (6 * ei)
    by_moment = x**2 / (2 * ei)
    slope_by_force = length**2 * (2 * xi - xi**2) / (2 * ei)
    slope_by_moment = x / ei
    c = np.zeros((6, 6))
    c[0, 0] = 1 / beam.spring_N_per_m + x / beam.axial_N
    c[3, 3] = 1 / beam.spring_Nm_per_rad + x / beam.torsion_Nm2
    c[1, 1], c[1, 5], c[5, 1], c[5, 5] = by_force, by_moment, slope_by_force, slope_by_moment
    c[2, 2], c[2, 4], c[4, 2], c[4, 4] = by_force, -by_moment, -slope_by_force, slope_by_moment
    return c


def shortening(beam: Beam, xi: float, wrench: Float[np.ndarray, "6"]) -> float:
    """Displacement of the cross section at xi towards the clamp, along X, due to bending [m]; second order.

    Half the integral of the squared slopes of Eq. (3.4) from the clamp to x;
    the dissertation omits it and observes it as crosstalk to F_X (figure 3.8).
    With slope(u) = a u - b u^2, u = x / L, the integral is
    L (a^2 xi^3 / 3 - a b xi^4 / 2 + b^2 xi^5 / 5).

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    xi
        Position x / L of the cross section.
    wrench
        (F, M) at the tip, frame S [N, Nm].
    """
    length, ei = beam.length_m, beam.bending_Nm2
    total = 0.0
    for force, moment in ((wrench[1], wrench[5]), (wrench[2], -wrench[4])):
        a = length * (force * length + moment) / ei
        b = 0.5 * force * length**2 / ei
        total += 0.5 * length * (a * a * xi**3 / 3 - a * b * xi**4 / 2 + b * b * xi**5 / 5)
    return float(total)


def stress_ratio(beam: Beam, moment_Nm: Float[np.ndarray, "3"], axial_N: float = 0.0) -> float:
    """Equivalent (von Mises) stress of the outermost fibre over the yield stress; yields at 1.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    moment_Nm
        Moment in a cross section whose normal is close to X [Nm].
    axial_N
        Force along the rod [N].
    """
    radius = 0.5 * beam.diameter_m
    bending = math.hypot(float(moment_Nm[1]), float(moment_Nm[2])) * radius / beam.inertia_m4
    normal = bending + abs(axial_N) / (math.pi * radius**2)
    shear = float(moment_Nm[0]) * radius / (2 * beam.inertia_m4)
    return math.sqrt(normal**2 + 3 * shear**2) / beam.yield_Pa
