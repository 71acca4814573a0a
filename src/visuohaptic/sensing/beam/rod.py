"""The geometrically exact rod (Kirchhoff, with stretch): large deflections, twist, and all couplings.

The rod carries one force F along its whole length, and in the cross section at
r(s) the moment m(s) = m_0 - (r - r_S) x F, with m_0 in the clamp. Its frame R
(tangent t = R[:, 0]) therefore obeys an initial value problem in the *base
wrench* b = (F, m_0):

    r' = t (1 + t . F / EA)
    R' = [u]x R,  u = m / EI + (1 / GJ - 1 / EI) (t . m) t
    r(0) = (F_X / k_X, 0, 0),  R(0) = rotation about X by m_0,X / k_phi

Reading the sensor requires no boundary value problem: b is fitted to the observed
poses by Newton's method, and the moment at the tip follows as m(L).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import hat
from . import _kernels
from .mechanics import Beam

#: Runge-Kutta steps; the error of the tip is below 1e-9 of the length at the yield limit.
STEPS = 24


@dataclass(frozen=True, slots=True, eq=False)
class RodShape:
    """The bent rod at n cross sections, and its derivatives by the base wrench."""

    base: Float[np.ndarray, "6"]  #: (F, m_0) in the clamp [N, Nm]
    position_m: Float[np.ndarray, "n 3"]  #: of each cross section, frame S
    rotation: Float[np.ndarray, "n 3 3"]
    jacobian: Float[np.ndarray, "n 6 6"]  #: d(position, rotation vector about the axes of S) / d(base)
    wrench: Float[np.ndarray, "6"]  #: at the tip
    wrench_jacobian: Float[np.ndarray, "6 6"]  #: d(wrench) / d(base)


def rod_from_base(beam: Beam, base: Float[np.ndarray, "6"], xi: Float[np.ndarray, "n"]) -> RodShape:
    """Shape of the rod for a known force and moment in the clamp.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    base
        (F, m_0) [N, Nm].
    xi
        Ascending positions x / L of the requested cross sections.
    """
    xi = np.asarray(xi, dtype=np.float64)
    if len(xi) and (xi.min() < 0 or xi.max() > 1 or np.any(np.diff(xi) < 0)):
        raise InputError("xi", f"found {xi}, expected rising values in 0 to 1")
    stations = beam.length_m * np.append(xi, 1.0)
    scale = 1e-3 * beam.moment_limit_Nm
    step = np.array([scale / beam.length_m] * 3 + [scale] * 3)
    out = np.empty((len(stations), 4, 3))
    jacobian = np.empty((len(stations), 6, 6))
    base = np.ascontiguousarray(base, dtype=np.float64)
    _kernels.rod_jacobian(base, beam.stiffness, stations, STEPS, step, out, jacobian)
    arm = out[-1, 0] - np.array([base[0] / beam.spring_N_per_m, 0.0, 0.0])
    arm_jacobian = jacobian[-1, :3].copy()
    arm_jacobian[0, 0] -= 1 / beam.spring_N_per_m
    wrench_jacobian = np.eye(6)
    wrench_jacobian[3:] += hat(base[:3]) @ arm_jacobian
    wrench_jacobian[3:, :3] -= hat(arm)
    wrench = np.concatenate([base[:3], base[3:] - np.cross(arm, base[:3])])
    rotation = out[:, 1:].transpose(0, 2, 1)
    return RodShape(base, out[:-1, 0], rotation[:-1], jacobian[:-1], wrench, wrench_jacobian)


def base_wrench(beam: Beam, wrench: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """(F, m_0) of a straight rod under a wrench at its tip: the initial guess of Newton's method.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    wrench
        (F, M) at the tip, frame S [N, Nm].
    """
    wrench = np.asarray(wrench, dtype=np.float64)
    return np.concatenate([wrench[:3], wrench[3:] + np.cross([beam.length_m, 0.0, 0.0], wrench[:3])])
