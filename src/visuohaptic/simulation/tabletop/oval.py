"""Containers of elliptic cross-section that deform between two fingers.

The wall is a thin tube of similar ellipses, with the half-axes ``r(z)`` and ``squash r(z)``. Its displacements, along the height,
around and outwards, are harmonics of the ellipse's parameter with cubic splines of the height as amplitudes (Ritz), its strains
those of Sanders' shell theory, with the local size of a wall that tapers slowly. The library's own models are triangle shells and
harmonics of shells of revolution. The foot is clamped, and the rim is held by a lid.

A pinch of the narrow sides flattens a section and reduces the volume to first order, one of the wide sides increases it. The
pressure of enclosed air therefore adds to the stiffness itself; what is lost to second order, as of a round wall, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded

from ...core.measurement import AIR_PA
from .deformable import MIN_AIR, WATER_FILL, BulkFill, DeformableContainer

if TYPE_CHECKING:
    from ...deformation.shells.shell_material import IsotropicMaterial

#: Number of even harmonics, points of a section for its integrals, and heights.
HARMONICS, POINTS, NODES = 14, 256, 61
#: Maximum deformation of the curves [m].
MAX_M = 0.01
#: Gauss-Legendre points and weights of an element along the height.
_GAUSS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, slots=True, eq=False)
class OvalContainer:
    """Force-deformation curves of pinches across and along an elliptic section, and between them."""

    across: DeformableContainer  #: fingers on the narrow sides
    along: DeformableContainer  #: fingers on the wide sides
    yaw_rad: float = 0.0  #: direction from one narrow side to the other
    _felt: dict[float, DeformableContainer] = field(default_factory=dict)  #: the newest result, by its angle

    @property
    def mass_kg(self) -> float:
        """Mass with its contents."""
        return self.across.mass_kg

    @property
    def friction(self) -> float:
        """Coefficient of friction with the foam of the fingers."""
        return self.across.friction

    def turned(self, angle_rad: float) -> DeformableContainer:
        """What fingers feel that close along a direction.

        Half of the distance between two parallel fingers is the support function of the ellipse. The tips' compliance is that of
        the components of the force along both axes.

        Parameters
        ----------
        angle_rad
            Direction [rad].
        """
        if angle_rad in self._felt:
            return self._felt[angle_rad]
        c2 = math.cos(angle_rad - self.yaw_rad) ** 2
        narrow, wide = self.across, self.along
        support = np.sqrt(c2 * narrow.radius_m**2 + (1.0 - c2) * wide.radius_m**2)
        # The radius of curvature is a^2 b^2 / h^3, with the half-axes a and b and the support function h.
        bend = (narrow.radius_m * wide.radius_m) ** 2 / support**3
        slopes = [one.force_N[:, 1] / one.deformation_m[1] for one in (narrow, wide)]
        stiffness = 1.0 / (c2 / slopes[0] + (1.0 - c2) / slopes[1])
        force = stiffness[:, None] * narrow.deformation_m
        self._felt.clear()
        self._felt[angle_rad] = replace(narrow, radius_m=support, force_N=force, bend_m=bend)
        return self._felt[angle_rad]


def oval_container(
    wall_m: Float[np.ndarray, "k 3"],
    oval: tuple[float, float],
    material: IsotropicMaterial,
    *,
    closed: bool = False,
    fill: float = 0.0,
    filling: BulkFill = WATER_FILL,
    mass_kg: float = 0.05,
) -> OvalContainer:
    """Force-deformation curves of an upright container with similar ellipses as cross-sections.

    Parameters
    ----------
    wall_m
        Larger half-axis, height, and thickness of the wall (k, 3) [m], from the foot upwards.
    oval
        Ratio of the half-axes, at most 1, and direction from one narrow side to the other [rad].
    material
        Material of the wall.
    closed
        The contents cannot escape.
    fill
        Fraction of the volume that is filled; the weight of the filling is always included.
    filling
        Filling.
    mass_kg
        Mass of the empty container [kg].
    """
    z, (squash, yaw_rad) = np.linspace(wall_m[0, 1], wall_m[-1, 1], NODES), oval
    r, t = (np.interp(z, wall_m[:, 1], wall_m[:, k]) for k in (0, 2))
    section = _Section.of(squash, material.poisson_ratio)
    areas = math.pi * squash * r**2
    volume = float(np.sum(0.5 * (areas[1:] + areas[:-1]) * np.diff(z)))
    air_m3 = max(1.0 - filling.solid * fill, MIN_AIR) * volume
    tips, moved, swells = _compliance(section, (z, r, t), material, closed=closed)
    if closed:
        gas = AIR_PA / air_m3
        tips = tips - 2.0 * gas * moved**2 / (1.0 + gas * swells)
    inner = slice(1, -1 if closed else None)
    depth = MAX_M * np.linspace(0.0, 1.0, 25) ** 2
    total = mass_kg + filling.kg_per_m3 * fill * volume
    narrow, wide = (
        DeformableContainer("oval", z[inner], half * r[inner], depth, depth / tips[axis, inner, None], total)
        for axis, half in enumerate((squash, 1.0))
    )
    return OvalContainer(narrow, wide, yaw_rad)


@dataclass(frozen=True, slots=True, eq=False)
class _Term:
    """Part of a strain: a displacement's harmonics, derived by the height, times functions of the section."""

    field: int  #: index of the displacement in u, v, w
    order: int  #: of the derivative by the height
    size: int  #: power of the section's size
    values: Float[np.ndarray, "n p"]  #: of each harmonic, at the points of a section of size 1


@dataclass(frozen=True, slots=True, eq=False)
class _Section:
    """An elliptic section with the half-axes ``squash`` and 1: its strains, and what its tips and its area feel of w."""

    energies: tuple[tuple[_Term, _Term, tuple[float, float], Float[np.ndarray, "n n"]], ...]
    area: Float[np.ndarray, "n"]  #: change of the area by the harmonics of w, for a section of size 1
    tips: Float[np.ndarray, "2 n"]  #: -w at the narrow and the wide sides

    @classmethod
    def of(cls, squash: float, nu: float) -> _Section:
        """Integrate over the ellipse x = squash cos(phi), y = sin(phi).

        An energy is a product of two terms; its factors are those of the membrane and of the plate.
        """
        phi = np.arange(POINTS) * 2.0 * math.pi / POINTS
        n = 2.0 * np.arange(HARMONICS)[:, None]
        g = np.hypot(squash * np.sin(phi), np.cos(phi))  # ds / dphi
        curvature, ds = squash / g**3, 2.0 * math.pi / POINTS * g
        even, odd = np.cos(n * phi), np.sin((n + 2.0) * phi)

        def along(values: np.ndarray) -> np.ndarray:
            """Derivative by the arc length; exact for harmonics."""
            orders = 1j * np.fft.rfftfreq(POINTS, 1.0 / POINTS)
            return np.asarray(np.fft.irfft(orders * np.fft.rfft(values), POINTS) / g)

        u, v, w = range(3)
        stretch = [_Term(u, 1, 0, even)]
        hoop = [_Term(v, 0, -1, along(odd)), _Term(w, 0, -1, curvature * even)]
        shear = [_Term(u, 0, -1, along(even)), _Term(v, 1, 0, odd)]
        bend = [_Term(w, 2, 0, even)]
        ring = [_Term(w, 0, -2, along(along(even))), _Term(v, 0, -2, -along(curvature * odd))]
        twist = [_Term(w, 1, -1, 2.0 * along(even)), _Term(v, 1, -1, -2.0 * curvature * odd)]
        pairs = [
            *((one, one, (1.0, 0.0)) for one in (stretch, hoop)), (shear, shear, (0.5 * (1.0 - nu), 0.0)),
            (stretch, hoop, (nu, 0.0)), (hoop, stretch, (nu, 0.0)),
            *((one, one, (0.0, 1.0)) for one in (bend, ring)), (twist, twist, (0.0, 0.5 * (1.0 - nu))),
            (bend, ring, (0.0, nu)), (ring, bend, (0.0, nu)),
        ]  # fmt: skip
        energies = tuple(
            (a, b, factors, (a.values * ds) @ b.values.T)
            for first, second, factors in pairs
            for a in first
            for b in second
        )
        return cls(energies, even @ ds, -np.column_stack([even[:, 0], even[:, POINTS // 4]]).T)


def _compliance(
    section: _Section,
    wall: tuple[np.ndarray, np.ndarray, np.ndarray],
    material: IsotropicMaterial,
    *,
    closed: bool,
) -> tuple[Float[np.ndarray, "2 k"], Float[np.ndarray, "2 k"], float]:
    """Compliance of both tips by height [m/N], their deformation per pressure [m/Pa], and the volume per pressure [m^3/Pa].

    Each pinch is two forces, so the volume that a force of the tips displaces is twice their deformation per pressure.
    """
    z, r, t = wall
    count, step = 6 * HARMONICS, float(z[1] - z[0])
    size = count * len(z)
    bands, swelling = np.zeros((2 * count, size)), np.zeros(size)
    at, weights = 0.5 + 0.5 * _GAUSS[0], 0.5 * step * _GAUSS[1]
    lower = np.tril_indices(2 * count)
    shapes = [_hermite(float(x), step) for x in at]
    for k in range(len(z) - 1):
        # Shape function, displacement, harmonic; twice.
        whole = np.zeros((4, 3, HARMONICS, 4, 3, HARMONICS))
        for x, weight, shape in zip(at, weights, shapes, strict=True):
            radius, thick = (float((1.0 - x) * one[k] + x * one[k + 1]) for one in (r, t))
            sheet = material.youngs_modulus_Pa * thick / (1.0 - material.poisson_ratio**2)
            stiffness = np.array([sheet, sheet * thick**2 / 12.0])
            for a, b, factors, integral in section.energies:
                scale = weight * float(stiffness @ factors) * radius ** (1 + a.size + b.size)
                part = np.multiply.outer(np.outer(shape[a.order], shape[b.order]), scale * integral)
                whole[:, a.field, :, :, b.field] += part.transpose(0, 2, 1, 3)
            felt = weight * radius * np.outer(shape[0], section.area)
            swelling[count * k : count * (k + 2)].reshape(4, 3, HARMONICS)[:, 2] += felt
        bands[lower[0] - lower[1], count * k + lower[1]] += whole.reshape(2 * count, -1)[lower]
    # Very stiff supports: the foot, also against tilting of the wall, and the rim under a lid.
    half = count // 2
    for low, high in [(0, half), (count - HARMONICS, count), (size - count, size - half)][
        : 3 if closed else 2
    ]:
        bands[0, low:high] *= 1e9
    loads = np.zeros((size, 2 * len(z) + 1))
    for node in range(len(z)):
        loads[count * node + 2 * HARMONICS : count * node + half, 2 * node : 2 * node + 2] = section.tips.T
    loads[:, -1] = swelling
    moved = solveh_banded(bands, loads, lower=True)
    tips = 2.0 * np.einsum("sk,sk->k", loads[:, :-1], moved[:, :-1])
    return tips.reshape(-1, 2).T, (swelling @ moved[:, :-1]).reshape(-1, 2).T, float(swelling @ moved[:, -1])


def _hermite(x: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, first and second derivatives of an element's shape functions: value and slope at either end."""
    x2, x3 = x * x, x**3
    value = np.array([1 - 3 * x2 + 2 * x3, step * (x - 2 * x2 + x3), 3 * x2 - 2 * x3, step * (x3 - x2)])
    slope = np.array([6 * (x2 - x) / step, 1 - 4 * x + 3 * x2, 6 * (x - x2) / step, 3 * x2 - 2 * x])
    bend = np.array([(12 * x - 6) / step, 6 * x - 4, (6 - 12 * x) / step, 6 * x - 2]) / step
    return value, slope, bend
