"""The exact rod, integrated from the clamp to the tip."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.kernels import kernel


@kernel(error_model="numpy")
def _rates(
    state: Float[np.ndarray, "4 3"],
    force: Float[np.ndarray, "3"],
    moment: Float[np.ndarray, "3"],
    stiffness: Float[np.ndarray, "5"],
    clamp_x: float,
    out: Float[np.ndarray, "4 3"],
) -> None:
    """d/ds of rows (position; three columns of the frame), for the state of one cross section.

    The frame rotates by u = m / EI + (1 / GJ - 1 / EI) (t . m) t, with tangent t and
    m = m_0 - (r - r_S) x F.
    """
    rx, ry, rz = state[0, 0] - clamp_x, state[0, 1], state[0, 2]
    mx = moment[0] - (ry * force[2] - rz * force[1])
    my = moment[1] - (rz * force[0] - rx * force[2])
    mz = moment[2] - (rx * force[1] - ry * force[0])
    tx, ty, tz = state[1, 0], state[1, 1], state[1, 2]
    soft = 1.0 / stiffness[0]
    extra = (1.0 / stiffness[1] - soft) * (tx * mx + ty * my + tz * mz)
    ux, uy, uz = soft * mx + extra * tx, soft * my + extra * ty, soft * mz + extra * tz
    stretch = 1.0 + (tx * force[0] + ty * force[1] + tz * force[2]) / stiffness[2]
    out[0, 0], out[0, 1], out[0, 2] = stretch * tx, stretch * ty, stretch * tz
    for k in range(1, 4):
        ax, ay, az = state[k, 0], state[k, 1], state[k, 2]
        out[k, 0] = uy * az - uz * ay
        out[k, 1] = uz * ax - ux * az
        out[k, 2] = ux * ay - uy * ax


@kernel(error_model="numpy")
def integrate_rod(
    base: Float[np.ndarray, "6"],
    stiffness: Float[np.ndarray, "5"],
    stations: Float[np.ndarray, "n"],
    steps: int,
    out: Float[np.ndarray, "n 4 3"],
) -> None:
    """Cross sections of a rod whose clamp carries a known force and moment.

    Parameters
    ----------
    base
        (F_X, F_Y, F_Z, m_X, m_Y, m_Z) in the clamp [N, Nm], (6,).
    stiffness
        (EI, GJ, EA, k_X, k_phi), (5,).
    stations
        Ascending positions along the rod [m], (n,); the last one is the tip.
    steps
        Runge-Kutta steps from the clamp to the tip.
    out
        (n, 4, 3): position [m] and the three columns of the frame of each station.
    """
    force, moment = base[:3].copy(), base[3:].copy()
    clamp_x = force[0] / stiffness[3]
    twist = moment[0] / stiffness[4]
    state = np.zeros((4, 3))
    state[0, 0] = clamp_x
    state[1, 0] = 1.0
    state[2, 1], state[2, 2] = np.cos(twist), np.sin(twist)
    state[3, 1], state[3, 2] = -np.sin(twist), np.cos(twist)
    k1, k2, k3, k4 = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
    trial = np.zeros((4, 3))
    total = stations[-1]
    s = 0.0
    for n in range(len(stations)):
        span = stations[n] - s
        count = max(1, int(np.ceil(steps * span / total)))
        h = span / count
        for _ in range(count):
            _rates(state, force, moment, stiffness, clamp_x, k1)
            for i in range(4):
                for j in range(3):
                    trial[i, j] = state[i, j] + 0.5 * h * k1[i, j]
            _rates(trial, force, moment, stiffness, clamp_x, k2)
            for i in range(4):
                for j in range(3):
                    trial[i, j] = state[i, j] + 0.5 * h * k2[i, j]
            _rates(trial, force, moment, stiffness, clamp_x, k3)
            for i in range(4):
                for j in range(3):
                    trial[i, j] = state[i, j] + h * k3[i, j]
            _rates(trial, force, moment, stiffness, clamp_x, k4)
            for i in range(4):
                for j in range(3):
                    state[i, j] += h / 6.0 * (k1[i, j] + 2.0 * (k2[i, j] + k3[i, j]) + k4[i, j])
        s = stations[n]
        for i in range(4):
            for j in range(3):
                out[n, i, j] = state[i, j]


@kernel(error_model="numpy")
def rod_jacobian(
    base: Float[np.ndarray, "6"],
    stiffness: Float[np.ndarray, "5"],
    stations: Float[np.ndarray, "n"],
    steps: int,
    step: Float[np.ndarray, "6"],
    out: Float[np.ndarray, "n 4 3"],
    jacobian: Float[np.ndarray, "n 6 6"],
) -> None:
    """Cross sections as in :func:`integrate_rod`, and the derivatives of their motion by the base wrench.

    Parameters
    ----------
    base, stiffness, stations, steps, out
        As in :func:`integrate_rod`.
    step
        Half step of the central difference of each component, (6,).
    jacobian
        (n, 6, 6): d(position, rotation about the axes of S) / d(base).
    """
    integrate_rod(base, stiffness, stations, steps, out)
    count = len(stations)
    ahead, behind = np.zeros((count, 4, 3)), np.zeros((count, 4, 3))
    moved = base.copy()
    for c in range(6):
        moved[c] = base[c] + step[c]
        integrate_rod(moved, stiffness, stations, steps, ahead)
        moved[c] = base[c] - step[c]
        integrate_rod(moved, stiffness, stations, steps, behind)
        moved[c] = base[c]
        scale = 0.5 / step[c]
        for n in range(count):
            for j in range(3):
                jacobian[n, j, c] = scale * (ahead[n, 0, j] - behind[n, 0, j])
            # Half the sum of a x da over the three axes is the small rotation between two frames.
            for j in range(3, 6):
                jacobian[n, j, c] = 0.0
            for k in range(1, 4):
                ax, ay, az = out[n, k, 0], out[n, k, 1], out[n, k, 2]
                bx = ahead[n, k, 0] - behind[n, k, 0]
                by = ahead[n, k, 1] - behind[n, k, 1]
                bz = ahead[n, k, 2] - behind[n, k, 2]
                jacobian[n, 3, c] += 0.5 * scale * (ay * bz - az * by)
                jacobian[n, 4, c] += 0.5 * scale * (az * bx - ax * bz)
                jacobian[n, 5, c] += 0.5 * scale * (ax * by - ay * bx)
