"""Thin walls of revolution under pinches, by degenerated solids and Fourier series around the axis.

The meridian is a polyline of conical frusta. Along each the displacement ``u + zeta (omega x n)`` of the wall is
cubic, with transverse shear (Reissner-Mindlin), integrated at three points along and two across the wall; around
the axis it is a Fourier series with uncoupled harmonics. No assumption is made about changes of curvature: the strains are
those of the solid in cylindrical coordinates, plane stress across the wall.

Per harmonic k the field is ``(u_r cos, u_t sin, u_z cos)(k theta)`` with rotations ``(w_r sin, w_t cos, w_z sin)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solveh_banded

__all__ = ["SHEAR", "Pinch", "Revolution", "opposite", "shape_functions", "side_stiffness"]

#: Points of a cubic frustum on -1 .. 1, degrees of freedom of a node.
_NODES = np.array([-1.0, -1 / 3, 1 / 3, 1.0])
_DOF = 6
_GAUSS = np.polynomial.legendre.leggauss(3)
#: The turn within the wall has no stiffness of its own: three points would miss its cubic part.
_TURN = np.polynomial.legendre.leggauss(4)
_ACROSS = np.polynomial.legendre.leggauss(2)
#: Transverse shear is made stiff: under a point it would be infinite, and tips are wider than such walls are thick.
SHEAR = 50.0


@dataclass(frozen=True, slots=True)
class Pinch:
    """Two tips that press with 1 N each: where, and the unit force on the wall in (r, theta, z) there."""

    angle_rad: tuple[float, float]
    height_m: tuple[float, float]
    force: tuple[tuple[float, float, float], tuple[float, float, float]]


def opposite(height_m: float) -> Pinch:
    """Radial tips across the axis at one height."""
    return Pinch((0.0, np.pi), (height_m, height_m), ((-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))


@dataclass(frozen=True)
class Revolution:
    """A wall of revolution, from its foot upwards; a cap is part of the meridian."""

    meridian_m: np.ndarray  #: (m, 2), radius and height of the middle of the wall
    wall_m: np.ndarray  #: (m - 1,), thickness of each frustum
    youngs_modulus_Pa: float
    poisson_ratio: float
    foot: tuple[int, ...] = (
        0,
        1,
        2,
        3,
        4,
        5,
    )  #: freedoms u_r, u_t, u_z, w_r, w_t, w_z held at the first point
    top: tuple[int, ...] = ()  #: and at the last
    bulk_Pa_per_m3: float = 0.0  #: pressure by volume of what is enclosed (bulk modulus by its volume)

    @cached_property
    def _geometry(self) -> tuple[np.ndarray, ...]:
        points = np.asarray(self.meridian_m, dtype=float)
        step = np.diff(points, axis=0)
        length = np.linalg.norm(step, axis=1)
        tangent = step / length[:, None]
        normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
        return points, length, tangent, normal

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Element matrices (m, 24, 24) of the harmonic's powers 0, 1 and 2."""
        points, length, tangent, normal = self._geometry
        wall = np.broadcast_to(np.asarray(self.wall_m, dtype=float), length.shape)
        young, nu = self.youngs_modulus_Pa, self.poisson_ratio
        shear = young / (2 * (1 + nu))
        plane = young / (1 - nu * nu)
        wall_only = np.diag([plane, plane, shear, SHEAR * shear, SHEAR * shear, 0.0])
        wall_only[0, 1] = wall_only[1, 0] = nu * plane
        turn_only = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, shear])
        parts = [np.zeros((len(length), 4 * _DOF, 4 * _DOF)) for _ in range(3)]
        rules = [
            (*rule, y, w, c)
            for rule, c in ((_GAUSS, wall_only), (_TURN, turn_only))
            for y, w in zip(*_ACROSS, strict=True)
        ]
        for along, weights, y, across, elastic in rules:
            for x, weight in zip(along, weights, strict=True):
                value, slope = shape_functions(x)
                zeta = 0.5 * y * wall
                middle = points[:-1, 0] + 0.5 * (1 + x) * (points[1:, 0] - points[:-1, 0])
                radius = np.maximum(middle + zeta * normal[:, 0], 1e-9)
                rows = _strains(value, slope, length, tangent, normal, radius, zeta)
                area = weight * across * 0.25 * length * wall * radius
                for power, matrix in enumerate(_products(rows, elastic)):
                    parts[power] += area[:, None, None] * matrix
        return parts[0], parts[1], parts[2]

    @cached_property
    def size(self) -> int:
        """Number of freedoms of a harmonic."""
        return _DOF * (3 * (len(self.meridian_m) - 1) + 1)

    @cached_property
    def enclosed_m3(self) -> float:
        """Volume between the axis and the meridian."""
        radius, height = np.asarray(self.meridian_m, dtype=float).T
        a, b = radius[:-1], radius[1:]
        return float(np.pi / 3 * ((a * a + a * b + b * b) * np.diff(height)).sum())

    def _banded(self, harmonic: int) -> np.ndarray:
        constant, linear, square = self._parts
        matrix = constant + harmonic * linear + harmonic**2 * square
        band = np.zeros((4 * _DOF, self.size))
        first = 3 * _DOF * np.arange(len(matrix))
        for i in range(4 * _DOF):
            for j in range(i + 1):
                np.add.at(band[i - j], first + j, matrix[:, i, j])
        scale = float(band[0].max())
        ends = [(k, self.foot) for k in range(_DOF)] + [(k - _DOF, self.top) for k in range(_DOF)]
        for place, held in ends:
            if place % _DOF in held:
                band[0, place] += 1e6 * scale
        for k in (1, 2):
            if harmonic == 0 and k not in (*self.foot, *self.top):
                band[0, k] += (
                    1e-6 * scale
                )  # no net force along the axis and no torque: only fixes the rigid motion
        return band

    def _load(self, height_m: float) -> np.ndarray:
        """Shape functions (freedoms, 3) of the outermost point of the wall at a height."""
        points, *_ = self._geometry
        low, high = points[:-1, 1], points[1:, 1]
        rise = np.where(high == low, np.inf, high - low)
        fraction = (height_m - low) / rise
        some = np.flatnonzero((fraction >= 0) & (fraction <= 1) & (high != low))
        if not some.size:
            raise ValueError(f"no wall at {height_m} m")
        radius = points[some, 0] + fraction[some] * (points[some + 1, 0] - points[some, 0])
        element = int(some[np.argmax(radius)])
        value, _slope = shape_functions(2 * float(fraction[element]) - 1)
        out = np.zeros((self.size, 3))
        for node in range(4):
            for k in range(3):
                out[_DOF * (3 * element + node) + k, k] = value[node]
        return out

    def radius_m(self, height_m: float) -> float:
        """Outermost radius of the middle of the wall at a height."""
        points, *_ = self._geometry
        low, high = np.minimum(points[:-1, 1], points[1:, 1]), np.maximum(points[:-1, 1], points[1:, 1])
        some = np.flatnonzero((low <= height_m) & (height_m <= high))
        rise = points[some + 1, 1] - points[some, 1]
        fraction = np.where(rise == 0, 1.0, (height_m - points[some, 1]) / np.where(rise == 0, 1.0, rise))
        return float((points[some, 0] + fraction * (points[some + 1, 0] - points[some, 0])).max())

    def compliance(self, pinches: Sequence[Pinch], *, harmonics: int = 48) -> np.ndarray:
        """Displacement of each tip along its own force, per newton of its own and of the other's force [m/N].

        Returns (p, 2, 2), symmetric in the last two. The series of a tip's own point falls like the third power of
        the harmonic, by which its tail beyond ``harmonics`` is summed; the other tip's alternates.
        """
        heights, inverse = np.unique([z for p in pinches for z in p.height_m], return_inverse=True)
        place = inverse.reshape(-1, 2)
        loads = np.concatenate([self._load(z) for z in heights], axis=1)
        force = np.array([p.force for p in pinches])
        turn = np.array([p.angle_rad[1] - p.angle_rad[0] for p in pinches])
        across = all(p.height_m[0] == p.height_m[1] for p in pinches) and np.allclose(np.abs(turn), np.pi)
        even = across and np.allclose(force[:, 0], force[:, 1]) and not force[..., 1].any()
        out = np.zeros((len(pinches), 2, 2))
        last = np.zeros((len(pinches), 2))
        for harmonic in range(0, harmonics + 1, 2 if even else 1):
            answer = self._amplitudes(harmonic, loads)
            amplitude = answer.reshape(len(heights), 3, len(heights), 3)
            for row in range(len(pinches)):
                for a, b in ((0, 0), (1, 1), (0, 1)):
                    angle = harmonic * turn[row] * (b - a)
                    block = amplitude[place[row, b], :, place[row, a], :]
                    value = force[row, b] @ _at_angle(block, angle) @ force[row, a]
                    out[row, a, b] += value
                    if a == b:
                        last[row, a] = value
        out[:, 1, 0] = out[:, 0, 1]
        # Of every harmonic beyond, the odd ones too where they were left out (they cancel in the sum of both tips).
        step = 2 if even else 1
        tail = last * harmonics**3 * np.sum(np.arange(harmonics + step, 200 * harmonics, step) ** -3.0)
        out[:, [0, 1], [0, 1]] += tail
        if even:
            out[:, 0, 1] += tail.mean(axis=1)
            out[:, 1, 0] += tail.mean(axis=1)
        return out

    def _amplitudes(self, harmonic: int, loads: np.ndarray) -> np.ndarray:
        weight = 1 / (2 * np.pi) if harmonic == 0 else 1 / np.pi
        band = self._banded(harmonic)
        if harmonic or not self.bulk_Pa_per_m3:
            return weight * loads.T @ solveh_banded(band, loads, lower=True)
        volume = self._volume_gradient()
        moved = weight * solveh_banded(band, np.column_stack([loads, volume]), lower=True)
        gained, own = loads.T @ moved[:, -1], volume @ moved[:, -1]
        closed: np.ndarray = loads.T @ moved[:, :-1] - np.outer(gained, gained) * (
            self.bulk_Pa_per_m3 / (1 + self.bulk_Pa_per_m3 * own)
        )
        return closed

    def _volume_gradient(self) -> np.ndarray:
        points, length, _tangent, normal = self._geometry
        out = np.zeros(self.size)
        first = 3 * _DOF * np.arange(len(length))
        for x, weight in zip(*_GAUSS, strict=True):
            value, _slope = shape_functions(x)
            radius = points[:-1, 0] + 0.5 * (1 + x) * (points[1:, 0] - points[:-1, 0])
            ring = 2 * np.pi * radius * 0.5 * weight * length
            for node in range(4):
                np.add.at(out, first + _DOF * node, value[node] * ring * normal[:, 0])
                np.add.at(out, first + _DOF * node + 2, value[node] * ring * normal[:, 1])
        return out

    def pinch_stiffness(self, heights_m: Sequence[float], *, harmonics: int = 48) -> np.ndarray:
        """Force of a tip by its displacement [N/m] for radial tips across the axis, one for each height."""
        return side_stiffness(self.compliance([opposite(z) for z in heights_m], harmonics=harmonics)).mean(
            axis=1
        )


def side_stiffness(compliance: np.ndarray) -> np.ndarray:
    """Force by displacement of each tip (p, 2) [N/m] while both press alike."""
    out: np.ndarray = 1 / compliance.sum(axis=2)
    return out


def shape_functions(x: float) -> tuple[np.ndarray, np.ndarray]:
    """Cubic Lagrange functions of four nodes and their slopes at x of -1 .. 1."""
    value, slope = np.ones(4), np.zeros(4)
    for i in range(4):
        others = [j for j in range(4) if j != i]
        bottom = np.prod([_NODES[i] - _NODES[j] for j in others])
        value[i] = np.prod([x - _NODES[j] for j in others]) / bottom
        slope[i] = sum(np.prod([x - _NODES[j] for j in others if j != k]) for k in others) / bottom
    return value, slope


def _strains(
    value: np.ndarray,
    slope: np.ndarray,
    length: np.ndarray,
    tangent: np.ndarray,
    normal: np.ndarray,
    radius: np.ndarray,
    zeta: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m, 6, 24) of ss, tt, st, sn, tn and of the turn in the wall: constant and linear in the harmonic."""
    count = len(length)
    still, turning = (np.zeros((count, 6, 4, _DOF)) for _ in range(2))
    tr, tz = tangent.T
    nr, nz = normal.T
    for node in range(4):
        v, d = value[node], 2 * slope[node] / length
        # Columns: displacement of the point at zeta by u_r, u_t, u_z, w_r, w_t, w_z, in r, t, z.
        lift = np.zeros((count, 3, _DOF))
        lift[:, [0, 1, 2], [0, 1, 2]] = 1.0
        arm = np.zeros((count, 3, _DOF))
        arm[:, 0, 4], arm[:, 1, 5], arm[:, 1, 3], arm[:, 2, 4] = nz, nr, -nz, -nr
        whole = lift + zeta[:, None, None] * arm
        here, rate = v * whole, d[:, None, None] * whole
        along = tr[:, None] * here[:, 0] + tz[:, None] * here[:, 2]
        out = nr[:, None] * here[:, 0] + nz[:, None] * here[:, 2]
        per = 1 / radius[:, None]
        still[:, 0, node] = tr[:, None] * rate[:, 0] + tz[:, None] * rate[:, 2]
        still[:, 1, node] = per * here[:, 0]
        turning[:, 1, node] = per * here[:, 1]
        still[:, 2, node] = rate[:, 1] - per * tr[:, None] * here[:, 1]
        turning[:, 2, node] = -per * along
        still[:, 3, node] = nr[:, None] * rate[:, 0] + nz[:, None] * rate[:, 2]
        still[:, 3, node] += v * (tr[:, None] * arm[:, 0] + tz[:, None] * arm[:, 2])
        still[:, 4, node] = v * arm[:, 1] - per * nr[:, None] * here[:, 1]
        turning[:, 4, node] = -per * out
        still[:, 5, node] = 0.5 * (per * tr[:, None] * here[:, 1] + rate[:, 1])
        still[:, 5, node, 3] += v * nr
        still[:, 5, node, 5] += v * nz
        turning[:, 5, node] = 0.5 * per * along
    return still.reshape(count, 6, -1), turning.reshape(count, 6, -1)


def _products(rows: tuple[np.ndarray, np.ndarray], elastic: np.ndarray) -> tuple[np.ndarray, ...]:
    still, turning = rows
    stress, turned = elastic @ still, elastic @ turning
    cross = np.swapaxes(still, 1, 2) @ turned
    return (
        np.swapaxes(still, 1, 2) @ stress,
        cross + np.swapaxes(cross, 1, 2),
        np.swapaxes(turning, 1, 2) @ turned,
    )


def _at_angle(block: np.ndarray, angle: float) -> np.ndarray:
    """Displacement (3) by force (3) an angle away: forces along t belong to the family turned by a quarter."""
    cosine, sine = np.cos(angle), np.sin(angle)
    out = block * cosine
    out[1, [0, 2]] = block[1, [0, 2]] * sine
    out[[0, 2], 1] = -block[[0, 2], 1] * sine
    return out
