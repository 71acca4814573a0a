"""Thin walls of oval section under pinches along an axis of symmetry, by degenerated solids and coupled Fourier series.

Sections are ellipses ``(a(z) cos, b(z) sin)(theta)``, between two levels a ruled surface. Displacement and rotation
are Cartesian: cubic along the wall, Fourier series in theta that are symmetric about both planes of the section and
coupled. The strains are those of the solid at the Gauss points, plane stress across the wall, as in :mod:`.shells`, whose
circle is a special case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solveh_banded

from .shells import SHEAR, shape_functions

__all__ = ["Oval"]

#: Of u_x, u_y, u_z and the rotations about x, y, z: sine or cosine, and odd or even harmonics.
_SINE = np.array([False, True, False, True, False, True])
_ODD = np.array([True, True, False, True, True, False])


@dataclass(frozen=True)
class Oval:
    """A wall of ellipses, from its clamped foot upwards; a cap is part of the levels."""

    levels_m: np.ndarray  #: (m, 3), half-axes along x and y and height
    wall_m: np.ndarray  #: (m - 1,), thickness between levels
    youngs_modulus_Pa: float
    poisson_ratio: float
    terms: int = 24  #: harmonics of each component, a multiple of 3
    foot: bool = True  #: clamped; else free, and only where it is along the axis is fixed

    @cached_property
    def _angles(self) -> tuple[np.ndarray, np.ndarray]:
        x, weight = np.polynomial.legendre.leggauss(3 * self.terms)
        return 0.25 * np.pi * (x + 1), 0.25 * np.pi * weight

    def _series(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Functions (t, 6, k) of each component and their slopes; the sine of harmonic 0 is replaced by the next one."""
        order = 2 * np.arange(self.terms)[None, :] + np.where(_ODD, 1, np.where(_SINE, 2, 0))[:, None]
        phase = angle[:, None, None] * order
        value = np.where(_SINE[:, None], np.sin(phase), np.cos(phase))
        slope = order * np.where(_SINE[:, None], np.cos(phase), -np.sin(phase))
        return value, slope

    def _element(self, number: int) -> np.ndarray:
        """Stiffness of a quarter of the wall between two levels."""
        (a0, b0, z0), (a1, b1, z1) = self.levels_m[number], self.levels_m[number + 1]
        rate = 0.5 * np.array([a1 - a0, b1 - b0, z1 - z0])
        angle, quarter = self._angles
        value, slope = self._series(angle)
        young, nu, wall = self.youngs_modulus_Pa, self.poisson_ratio, float(self.wall_m[number])
        shear = young / (2 * (1 + nu))
        root = np.zeros((6, 6))
        root[:2, :2] = np.linalg.cholesky(young / (1 - nu * nu) * np.array([[1, nu], [nu, 1]])).T
        root[[2, 3, 4, 5], [2, 3, 4, 5]] = np.sqrt(shear * np.array([1, SHEAR, SHEAR, 1]))
        size = 4 * 6 * self.terms
        out = np.zeros((size, size))
        # The turn within the wall at four points along it, all other strains at three; see :mod:`.shells`.
        for points, across, rows in ((3, 2, slice(0, 5)), (4, 1, slice(5, 6))):
            for x, along in zip(*np.polynomial.legendre.leggauss(points), strict=True):
                half = np.array([a0, b0, z0]) + (1 + x) * rate
                for y, deep in zip(*np.polynomial.legendre.leggauss(across), strict=True):
                    coefficients, volume = _strains(half, rate, angle, 0.5 * wall * y)
                    by_rate, by_turn, plain = (root @ part for part in coefficients)
                    scale = np.sqrt(along * deep * 0.5 * wall * quarter * volume)[:, None, None]
                    phi, step = shape_functions(x)
                    strain = np.concatenate(
                        [
                            (scale * (step[i] * by_rate + phi[i] * plain))[:, rows, :, None] * value[:, None]
                            + (scale * phi[i] * by_turn)[:, rows, :, None] * slope[:, None]
                            for i in range(4)
                        ],
                        axis=2,
                    ).reshape(-1, size)
                    out += strain.T @ strain
        return out

    @cached_property
    def _banded(self) -> np.ndarray:
        block = 6 * self.terms
        width, count = 4 * block, len(self.levels_m) - 1
        band = np.zeros((width, block * (3 * count + 1)))
        for number in range(count):
            matrix, first = self._element(number), 3 * block * number
            for column in range(width):
                band[: width - column, first + column] += matrix[column:, column]
        held = slice(0, block) if self.foot else 2 * self.terms  # all of the first level, or its mean height
        band[0, held] += (1e6 if self.foot else 1e-6) * band[0].max()
        return band

    @cached_property
    def _fewer(self) -> Oval:
        return replace(self, terms=2 * self.terms // 3)

    def pinch_stiffness(self, heights_m: Sequence[float], axis: int) -> np.ndarray:
        """Force of a tip by its displacement [N/m] under tips along x (0) or y (1), one for each height.

        The terms of a point's displacement fall like their third power and what is left out like the second: it is
        extrapolated from two thirds of the terms.
        """
        fewer = self._fewer
        most, less = self._compliance(heights_m, axis), fewer._compliance(heights_m, axis)
        rest = self.terms**-2.0 / (fewer.terms**-2.0 - self.terms**-2.0)
        stiffness: np.ndarray = 1 / (most + rest * (most - less))
        return stiffness

    def _compliance(self, heights_m: Sequence[float], axis: int) -> np.ndarray:
        value = self._series(np.array([0.5 * np.pi * axis]))[0][0, axis]
        loads = np.zeros((self._banded.shape[1], len(heights_m)))
        block = 6 * self.terms
        for row, height in enumerate(heights_m):
            low, high = self.levels_m[:-1, 2], self.levels_m[1:, 2]
            number = int(np.flatnonzero((low <= height) & (height <= high) & (low < high))[0])
            phi, _step = shape_functions(2 * (height - low[number]) / (high - low)[number] - 1)
            for node in range(4):
                first = block * (3 * number + node) + self.terms * axis
                loads[first : first + self.terms, row] = phi[node] * value
        # Two quarters share a tip, and each of them is pushed by half of it.
        moved: np.ndarray = 0.5 * np.einsum("ij,ij->j", loads, solveh_banded(self._banded, loads, lower=True))
        return moved


def _strains(
    half: np.ndarray, rate: np.ndarray, angle: np.ndarray, zeta: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Strains 11, 22, 12, 1n, 2n and the turn in the wall, by the slopes along and around of the six components.

    Returns three arrays (t, 6, 6), the factors of the slope along, of the slope around and of the component itself,
    and the volume per unit of the parameters (t,).
    """
    cosine, sine, nothing = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    along = np.stack([rate[0] * cosine, rate[1] * sine, rate[2] + nothing], 1)
    around = np.stack([-half[0] * sine, half[1] * cosine, nothing], 1)
    mixed = np.stack([-rate[0] * sine, rate[1] * cosine, nothing], 1)
    curved = np.stack([-half[0] * cosine, -half[1] * sine, nothing], 1)
    upright = np.cross(around, along)
    size = np.linalg.norm(upright, axis=1, keepdims=True)
    normal = upright / size

    def turning(change: np.ndarray) -> np.ndarray:
        out: np.ndarray = (change - normal * np.sum(normal * change, axis=1, keepdims=True)) / size
        return out

    normal_along, normal_around = (
        turning(np.cross(mixed, along)),
        turning(np.cross(curved, along) + np.cross(around, mixed)),
    )
    basis = np.stack([along + zeta * normal_along, around + zeta * normal_around, normal], axis=2)
    first = basis[:, :, 0] / np.linalg.norm(basis[:, :, 0], axis=1, keepdims=True)
    frame = np.stack([first, np.cross(normal, first), normal], axis=2)
    # Directions of the frame in the (oblique) basis: (t, 3 of the basis, 3 of the frame).
    parts = np.linalg.solve(basis, frame)
    unit = np.eye(3)
    turned, turned_along, turned_around = (
        np.cross(unit[None], vector[:, None]) for vector in (normal, normal_along, normal_around)
    )
    # Displacement's slopes along the three of the basis, (t, 6 components, 3 of space), by kind of factor.
    empty = np.zeros((len(angle), 3, 3))
    space = np.broadcast_to(unit, empty.shape)
    by_rate = np.stack(
        [
            np.concatenate([space, zeta * turned], 1),
            np.zeros((len(angle), 6, 3)),
            np.zeros((len(angle), 6, 3)),
        ]
    )
    by_turn = np.stack(
        [
            np.zeros((len(angle), 6, 3)),
            np.concatenate([space, zeta * turned], 1),
            np.zeros((len(angle), 6, 3)),
        ]
    )
    plain = np.stack([
        np.concatenate([empty, zeta * turned_along], 1),
        np.concatenate([empty, zeta * turned_around], 1),
        np.concatenate([empty, turned], 1),
    ])  # fmt: skip
    own = np.concatenate([np.zeros((len(angle), 3)), normal], axis=1)

    def rows(slopes: np.ndarray) -> np.ndarray:
        # gradient[t, a, b, d]: component a of the slope along b in the frame.
        gradient = np.einsum("jtds,tsa,tjb->tabd", slopes, frame, parts)
        return np.stack(
            [
                gradient[:, 0, 0], gradient[:, 1, 1], gradient[:, 0, 1] + gradient[:, 1, 0],
                gradient[:, 0, 2] + gradient[:, 2, 0], gradient[:, 1, 2] + gradient[:, 2, 1],
                -0.5 * (gradient[:, 1, 0] - gradient[:, 0, 1]),
            ],
            axis=1,
        )  # fmt: skip

    found = rows(plain)
    found[:, 5] += own
    return (rows(by_rate), rows(by_turn), found), np.abs(np.linalg.det(basis))
