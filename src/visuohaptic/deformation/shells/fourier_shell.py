"""Shells of revolution by Fourier series: an independent reference for the triangles, and a fast method.

Displacements are series in the angle and cubic Hermite functions along the meridian; strains are
the exact linear ones of a Koiter shell on the smooth surface. The harmonics are
decoupled, so each is a small block-tridiagonal system, and one sweep from both ends gives the stiffness
at every height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core import POSITIVE, InputError, Material, check_numbers, finite_array
from .shell import plane_stress
from .shell_material import IsotropicMaterial

#: Gauss points of an element, in its parameter from 0 to 1, and their weights.
GAUSS, WEIGHTS = (
    0.5 * np.polynomial.legendre.leggauss(4)[0] + 0.5,
    0.5 * np.polynomial.legendre.leggauss(4)[1],
)


@dataclass(frozen=True, slots=True, eq=False)
class RevolutionShell:
    """A wall of revolution about z with a smooth meridian, from its base upwards."""

    radius_m: Float[np.ndarray, "k"]  #: at the nodes of the meridian, positive
    height_m: Float[np.ndarray, "k"]
    thickness_m: Float[np.ndarray, "k"] | float  #: at the nodes, linear in between
    rim_held: bool = False  #: the rim keeps its shape and position, as under a stiff glued cap

    def __post_init__(self) -> None:
        radius = finite_array("RevolutionShell", self.radius_m, None, field="radius_m", least=3)
        height = finite_array("RevolutionShell", self.height_m, len(radius), field="height_m")
        check_numbers("RevolutionShell", POSITIVE, radius_m=radius)
        if not (np.hypot(np.diff(radius), np.diff(height)) > 0).all():
            raise InputError("RevolutionShell", "two neighbouring points of the meridian are the same")
        thickness = np.broadcast_to(np.asarray(self.thickness_m, dtype=float), radius.shape).copy()
        check_numbers("RevolutionShell", POSITIVE, thickness_m=thickness)
        object.__setattr__(self, "radius_m", radius)
        object.__setattr__(self, "height_m", height)
        object.__setattr__(self, "thickness_m", thickness)


def pinch_stiffness(
    shell: RevolutionShell,
    material: IsotropicMaterial | Material | str,
    *,
    harmonics: int = 64,
) -> Float[np.ndarray, "k"]:
    """Dual-tip stiffness at every node of the meridian [N/m]; infinite where fixed.

    Parameters
    ----------
    shell
        Meridian and wall.
    material
        Material of the wall.
    harmonics
        Even harmonics n = 0, 2, ... below this are summed; beyond, the compliance of a point load
        decreases as n^-3 (the curvature becomes irrelevant, as for a plate) and is extrapolated.

    Notes
    -----
    A pinch of two opposite points is the load 2 F (1/2 + cos 2t + cos 4t + ...) / pi, so
    ``1/k = 2 sum_n C_n`` with C_n the compliance of harmonic n for a unit amplitude.
    """
    material = IsotropicMaterial.of(material)
    size, meridian, hermite, tangent = _meridian(shell)
    held = np.zeros((len(shell.radius_m), 6), dtype=bool)
    # The slope along the meridian stays free in the surface: only the wall's rotation d(u . n)/dt is fixed. On an upright wall
    # n is radial, on a flat one vertical; in between both slopes are fixed, which also prevents stretching at this one node.
    held[0, :3] = True
    held[0, [5, 3]] = np.abs(tangent[0]) > 1e-6
    if shell.rim_held:
        held[-1, :3] = True
    chosen = np.arange(0, max(harmonics, 8), 2)
    # Strains are quadratic in n: three harmonics give the coefficients of all.
    zero, plus, minus = _strains(np.array([0, 1, -1])[:, None, None, None], hermite, meridian)
    strain = np.stack([zero, 0.5 * (plus - minus), 0.5 * (plus + minus) - zero])
    radius, rate_r, rate_z = meridian[:3]
    area = WEIGHTS * size[:, None] * np.hypot(rate_r, rate_z) * radius
    law = area[..., None, None] * _section_law(np.asarray(shell.thickness_m), material)
    square = (np.swapaxes(strain[:, None], -1, -2) @ (law @ strain)).sum(axis=3)
    order = np.add.outer(np.arange(3), np.arange(3))[..., None]
    power = np.where(chosen == 0, 2 * np.pi, np.pi) * chosen**order
    stiffness = np.einsum("ijh,ijexy->ehxy", power, square)
    parts = _radial_compliance(stiffness, held)
    last = int(chosen[-1])
    tail = parts[-1] * np.sum((last / np.arange(last + 2.0, 100 * last, 2)) ** 3)
    with np.errstate(divide="ignore"):
        return 0.5 / (parts.sum(axis=0) + tail)


def _meridian(
    shell: RevolutionShell,
) -> tuple[
    Float[np.ndarray, "e"], Float[np.ndarray, "5 e g"], Float[np.ndarray, "3 e g 4"], Float[np.ndarray, "k 2"]
]:
    """Parameter length of the elements; radius, derivatives of the meridian and Hermite functions at the Gauss points.

    Also the unit tangents at the nodes. The Hermite functions are (value, slope) of both nodes, with two derivatives.
    """
    from scipy.interpolate import CubicSpline

    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(shell.radius_m), np.diff(shell.height_m)))])
    curve = CubicSpline(length, np.column_stack([shell.radius_m, shell.height_m]))
    size = np.diff(length)
    x = GAUSS
    value = np.array([1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2])
    first = np.array([-6 * x + 6 * x**2, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x])
    second = np.array([-6 + 12 * x, -4 + 6 * x, 6 - 12 * x, 6 * x - 2])
    scale = np.where([False, True, False, True], size[:, None], 1.0)[:, None]
    hermite = [
        table.T * scale / size[:, None, None] ** order for order, table in enumerate((value, first, second))
    ]
    at = length[:-1, None] + x * size[:, None]
    here, rate, bend = curve(at), curve(at, 1), curve(at, 2)
    slope = curve(length, 1)
    meridian = np.stack([here[..., 0], rate[..., 0], rate[..., 1], bend[..., 0], bend[..., 1]])
    return size, meridian, np.stack(hermite), slope / np.linalg.norm(slope, axis=1)[:, None]


def _strains(
    n: Float[np.ndarray, "h 1 1 1"],
    hermite: Float[np.ndarray, "3 e g 4"],
    meridian: Float[np.ndarray, "5 e g"],
) -> Float[np.ndarray, "h e g 6 12"]:
    """Membrane and bending strain of the degrees of freedom of each element, by harmonic n.

    Degrees of freedom by node: (u_r, u_theta, u_z), then their derivatives by the parameter.
    """
    v, d, dd = hermite
    r, rt, zt, rtt, ztt = meridian[..., None]
    speed2 = rt * rt + zt * zt
    speed = np.sqrt(speed2)
    nr, nz = -zt / speed, rt / speed
    c = dd - (rtt * rt + ztt * zt) / speed2 * d
    tangential, twist = rt / (r * speed2) * d, d - rt / r * v
    zero = np.zeros_like(v)
    rows = (
        (rt * d / speed2, zero, zt * d / speed2),
        (v / r, n * v / r, zero),
        (-rt * n * v / (speed * r), (r * d - rt * v) / (speed * r), -zt * n * v / (speed * r)),
        (nr * c / speed2, zero, nz * c / speed2),
        (
            nr * (tangential - (n * n + 1) * v / (r * r)),
            -nr * 2 * n * v / (r * r),
            nz * (tangential - n * n * v / (r * r)),
        ),
        (-2 * nr * n * twist / (speed * r), -2 * nr * twist / (speed * r), -2 * nz * n * twist / (speed * r)),
    )
    out = np.empty((len(n), *v.shape[:2], 6, 4, 3))
    for q, row in enumerate(rows):
        for component, values in enumerate(row):
            out[..., q, :, component] = values
    return out.reshape(*out.shape[:4], 12)


def _section_law(
    thickness: Float[np.ndarray, "k"], material: IsotropicMaterial
) -> Float[np.ndarray, "e g 6 6"]:
    """Section forces per strain at the Gauss points, membrane first."""
    wall = (thickness[:-1, None] * (1 - GAUSS) + thickness[1:, None] * GAUSS)[..., None, None]
    out = np.zeros((*wall.shape[:2], 6, 6))
    out[..., :3, :3] = wall * plane_stress(material)
    out[..., 3:, 3:] = wall**3 / 12 * plane_stress(material)
    return out


def _radial_compliance(
    stiffness: Float[np.ndarray, "e h 12 12"], held: Bool[np.ndarray, "k 6"]
) -> Float[np.ndarray, "h k"]:
    """Radial displacement of each node by a unit radial load there, for each harmonic.

    The inverse's diagonal blocks result from elimination towards a node from both ends.
    """
    free = ~np.hstack([held[:-1], held[1:]])[:, None]
    parts = np.where(free[..., None] & free[:, :, None], stiffness, np.eye(12) * ~free[:, :, None])
    first, across, second = parts[..., :6, :6], parts[..., :6, 6:], parts[..., 6:, 6:]
    # Schur complements of what lies below and above each node, in its own block.
    below, above = np.zeros((2, len(held), *first.shape[1:]))
    for node in range(1, len(held)):
        before = node - 1
        back = np.swapaxes(across[before], -1, -2)
        below[node] = second[before] - back @ np.linalg.solve(first[before] + below[before], across[before])
    for node in reversed(range(len(held) - 1)):
        back = np.swapaxes(across[node], -1, -2)
        above[node] = first[node] - across[node] @ np.linalg.solve(second[node] + above[node + 1], back)
    own = np.linalg.solve(below + above, np.eye(6, 1))[..., 0, 0]
    return np.where(held[:, 0], 0.0, own.T)
