"""Simply supported plates of plies by Navier's double series: an independent implementation of lamination theory.

Plies are fourth-order tensors that are rotated as tensors, stiffnesses are integrals through the thickness by quadrature,
and each harmonic of the series is a three by three system from the virtual work of (u, v, w).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Layer", "centre_deflection_m", "wall_stiffness"]

#: Tensor components of the strains 11, 22, 2 12.
PAIRS = ((0, 0), (1, 1), (0, 1))


@dataclass(frozen=True)
class Layer:
    """One ply: moduli along and across [Pa], Poisson's ratio, shear modulus [Pa], angle [rad], thickness [m]."""

    along: float
    across: float
    poisson: float
    shear: float
    angle: float
    thickness: float


def wall_stiffness(layers: Sequence[Layer]) -> np.ndarray:
    """A, B, D (3, 3, 3) of layers from below upwards, about the middle."""
    top = np.cumsum([layer.thickness for layer in layers]) - 0.5 * sum(layer.thickness for layer in layers)
    points, weights = np.polynomial.legendre.leggauss(3)
    out = np.zeros((3, 3, 3))
    for layer, end in zip(layers, top, strict=True):
        z = end - 0.5 * layer.thickness * (1 - points)
        moments = [0.5 * layer.thickness * weights @ z**power for power in (0, 1, 2)]
        out += np.multiply.outer(moments, _turned(layer))
    return out


def _turned(layer: Layer) -> np.ndarray:
    """Plane stress stiffness (3, 3) of a ply, turned as a tensor."""
    compliance = np.array(
        [
            [1 / layer.along, -layer.poisson / layer.along, 0],
            [-layer.poisson / layer.along, 1 / layer.across, 0],
            [0, 0, 1 / layer.shear],
        ]
    )
    stiff = np.linalg.inv(compliance)
    tensor = np.zeros((2, 2, 2, 2))
    for p, (i, j) in enumerate(PAIRS):
        for q, (k, m) in enumerate(PAIRS):
            for a, b in {(i, j), (j, i)}:
                for c, d in {(k, m), (m, k)}:
                    tensor[a, b, c, d] = stiff[p, q]
    c, s = np.cos(layer.angle), np.sin(layer.angle)
    turn = np.array([[c, -s], [s, c]])
    tensor = np.einsum("ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, tensor)
    return np.array([[tensor[i, j, k, m] for k, m in PAIRS] for i, j in PAIRS])


def centre_deflection_m(
    layers: Sequence[Layer], size_m: tuple[float, float], pressure_Pa: float, terms: int = 41
) -> float:
    """Deflection of the middle under a pressure.

    Edges may move across themselves where plies lie along the edges, and along themselves where equal plies lie at two
    opposite angles: the supports for which each harmonic is a solution of its own.
    """
    law = wall_stiffness(layers)
    slanted = np.abs(law[1, :2, 2]).max() > 1e-9 * np.abs(law[1]).max()
    deflection = 0.0
    for m in range(1, terms + 1, 2):
        for n in range(1, terms + 1, 2):
            alpha, beta = m * np.pi / size_m[0], n * np.pi / size_m[1]
            # Amplitudes of (xx, yy, 2 xy) for those of (u, v, w); u = cos sin, v = sin cos or the other way round.
            sign = 1.0 if slanted else -1.0
            membrane = np.array([[sign * alpha, 0, 0], [0, sign * beta, 0], [-sign * beta, -sign * alpha, 0]])
            bending = np.array([[0, 0, alpha**2], [0, 0, beta**2], [0, 0, -2 * alpha * beta]])
            work = membrane.T @ law[0] @ membrane + bending.T @ law[2] @ bending
            mixed = membrane.T @ law[1] @ bending
            work = work + mixed + mixed.T
            load = 16 * pressure_Pa / (np.pi**2 * m * n)
            amplitude = np.linalg.solve(work, np.array([0, 0, load]))[2]
            deflection += amplitude * np.sin(m * np.pi / 2) * np.sin(n * np.pi / 2)
    return float(deflection)
