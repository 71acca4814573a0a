"""Containers of elliptic cross-section that deform between two fingers.

The wall is a thin shell of similar ellipses, with the half-axes ``r(z)`` and ``squash r(z)``. The components of its displacement are
harmonics of the ellipse's parameter with cubic splines of the height as amplitudes (Ritz). Strains are those of Koiter's linear shell
theory on the surface as it is, with its shoulders and grooves. The library's own models are triangle shells and
harmonics of shells of revolution. The foot is clamped, and the rim is held by a lid.

A pinch of the narrow sides flattens a section and reduces the volume to first order, one of the wide sides increases it. The
pressure of enclosed air therefore adds to the stiffness itself; what is lost to second order, as of a round wall, is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from ...core.measurement import AIR_PA
from .deformable import MIN_AIR, WATER_FILL, BulkFill, DeformableContainer

if TYPE_CHECKING:
    from ...deformation.shells.shell_material import IsotropicMaterial

#: Number of harmonics of each component, which spread the force of a finger over some millimetres; points of a quarter of a section for
#: its integrals, and heights.
HARMONICS, POINTS, NODES = 15, 45, 61
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
    areas = math.pi * squash * r**2
    volume = float(np.sum(0.5 * (areas[1:] + areas[:-1]) * np.diff(z)))
    air_m3 = max(1.0 - filling.solid * fill, MIN_AIR) * volume
    tips, moved, swells = _compliance(squash, (z, r, t), material, closed=closed)
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


def _compliance(
    squash: float,
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
    half, size = count // 2, count * len(z)
    bands, swelling = np.zeros((2 * count, size)), np.zeros(size)
    at, weights = 0.5 + 0.5 * _GAUSS[0], 0.5 * step * _GAUSS[1]
    x, around = np.polynomial.legendre.leggauss(POINTS)
    phi, quarters = 0.25 * math.pi * (x + 1.0), math.pi * around
    harmonics, lower = _harmonics(phi), np.tril_indices(2 * count)
    smooth, nu = PchipInterpolator(z, r), material.poisson_ratio
    root = np.linalg.cholesky(np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]])).T
    shapes = [_hermite(float(place), step) for place in at]
    for k in range(len(z) - 1):
        whole = np.zeros((2 * count, 2 * count))
        for place, weight, shape in zip(at, weights, shapes, strict=True):
            height, thick = z[k] + place * step, float((1.0 - place) * t[k] + place * t[k + 1])
            sheet = material.youngs_modulus_Pa * thick / (1.0 - nu**2)
            taper = [float(smooth(height, order)) for order in range(3)]
            strains, normal = _strains(squash, taper, phi, harmonics, shape)
            area = np.sqrt((normal**2).sum(axis=0))
            for part, stiffness in zip(strains, (sheet, sheet * thick**2 / 12.0), strict=True):
                scaled = np.sqrt(weight * stiffness * quarters * area) * np.tensordot(root, part, 1)
                flat = scaled.reshape(3, 2 * count, POINTS).transpose(0, 2, 1).reshape(-1, 2 * count)
                whole += flat.T @ flat
            felt = np.einsum("i,dkp,dp,p->idk", shape[0], harmonics[0], normal, weight * quarters)
            swelling[count * k : count * (k + 2)] += felt.ravel()
        bands[lower[0] - lower[1], count * k + lower[1]] += whole[lower]
    # Very stiff supports: the foot, also against tilting of the wall, and the rim under a lid.
    tilt, rim = (half, half + 2 * HARMONICS), (size - count, size - half)
    for low, high in ((0, half), tilt, rim)[: 3 if closed else 2]:
        bands[0, low:high] *= 1e9
    ends = _harmonics(np.array([0.0, 0.5 * math.pi]))[0]
    loads = np.zeros((size, 2 * len(z) + 1))
    for node in range(len(z)):
        for axis in range(2):
            first = count * node + axis * HARMONICS
            loads[first : first + HARMONICS, 2 * node + axis] = -ends[axis, :, axis]
    loads[:, -1] = swelling
    moved = solveh_banded(bands, loads, lower=True)
    tips = 2.0 * np.einsum("sk,sk->k", loads[:, :-1], moved[:, :-1])
    return tips.reshape(-1, 2).T, (swelling @ moved[:, :-1]).reshape(-1, 2).T, float(swelling @ moved[:, -1])


def _harmonics(phi: Float[np.ndarray, "p"]) -> Float[np.ndarray, "3 3 n p"]:
    """Functions of the ellipse's parameter and their first two derivatives, for the components along x, y and z."""
    even = 2.0 * np.arange(HARMONICS)
    order = np.stack([even + 1.0, even + 1.0, even])
    # A sine is a cosine a quarter of a turn later.
    phase = order[..., None] * phi - np.array([0.0, 0.5 * math.pi, 0.0])[:, None, None]
    return np.stack([order[..., None] ** m * np.cos(phase + 0.5 * math.pi * m) for m in range(3)])


def _strains(
    squash: float,
    taper: Sequence[float],
    phi: Float[np.ndarray, "p"],
    harmonics: Float[np.ndarray, "3 3 n p"],
    shape: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> tuple[tuple[Float[np.ndarray, "3 4 3 n p"], Float[np.ndarray, "3 4 3 n p"]], Float[np.ndarray, "3 p"]]:
    """Stretch and bending of the unit displacements, 11, 22 and twice 12 in an orthonormal frame, and X_phi x X_z.

    ``taper`` is the larger half-axis and its first two derivatives by the height. Displacements are by shape function of the height
    and harmonic of each component.
    """
    c, s, nothing = np.cos(phi), np.sin(phi), np.zeros_like(phi)
    size, slope, bend = taper
    along = np.stack([squash * slope * c, slope * s, nothing + 1.0])
    hoop = np.stack([-squash * size * s, size * c, nothing])
    mixed = np.stack([-squash * slope * s, slope * c, nothing])
    curved = {
        (0, 0): bend * np.stack([squash * c, s, nothing]),
        (0, 1): mixed,
        (1, 1): -size * np.stack([squash * c, s, nothing]),
    }
    normal = np.cross(hoop, along, axis=0)
    unit, tangents = normal / np.sqrt((normal**2).sum(axis=0)), np.stack([along, hoop])
    metric = np.einsum("adp,bdp->pab", tangents, tangents)

    def moved(m: int, n: int) -> Float[np.ndarray, "4 3 n p"]:
        """Derivative of the displacements, m times by the height and n times by the parameter."""
        return np.asarray(np.multiply.outer(shape[m], harmonics[n]))

    first = (moved(1, 0), moved(0, 1))
    stretch, bent = {}, {}
    for (a, b), second in curved.items():
        stretch[a, b] = 0.5 * (tangents[a, :, None] * first[b] + tangents[b, :, None] * first[a])
        turn = np.linalg.solve(metric, np.einsum("adp,dp->pa", tangents, second)[..., None])[..., 0].T
        bent[a, b] = unit[:, None] * (moved(2 - a - b, a + b) - turn[0] * first[0] - turn[1] * first[1])
    frame = np.linalg.inv(np.linalg.cholesky(metric)).transpose(1, 2, 0)
    (p, _), (q, o) = frame

    def physical(of: dict[tuple[int, int], np.ndarray]) -> Float[np.ndarray, "3 4 3 n p"]:
        one, two, three = of[0, 0], of[0, 1], of[1, 1]
        shear = p * (q * one + o * two)
        return np.stack([p * p * one, q * q * one + 2.0 * q * o * two + o * o * three, 2.0 * shear])

    return (physical(stretch), physical(bent)), normal


def _hermite(x: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, first and second derivatives of an element's shape functions: value and slope at either end."""
    x2, x3 = x * x, x**3
    value = np.array([1 - 3 * x2 + 2 * x3, step * (x - 2 * x2 + x3), 3 * x2 - 2 * x3, step * (x3 - x2)])
    slope = np.array([6 * (x2 - x) / step, 1 - 4 * x + 3 * x2, 6 * (x - x2) / step, 3 * x2 - 2 * x])
    bend = np.array([(12 * x - 6) / step, 6 * x - 4, (6 - 12 * x) / step, 6 * x - 2]) / step
    return value, slope, bend
