"""Shells of revolution by Fourier series: an independent reference for the triangles, and a fast method.

Displacements are series in the angle and cubic Hermite functions along the meridian; strains are
the exact linear ones of a Koiter shell on the smooth surface. The harmonics are
decoupled, so each is a small block-tridiagonal system, and one sweep from both ends gives the stiffness
at every height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, InputError, Material, check_numbers, finite_array
from .shell_material import IsotropicMaterial


@dataclass(frozen=True, slots=True, eq=False)
class RevolutionShell:
    """A wall of revolution about z with a smooth meridian, from its base upwards."""

    radius_m: Float[np.ndarray, "k"]  #: at the nodes of the meridian, positive
    height_m: Float[np.ndarray, "k"]
    thickness_m: Float[np.ndarray, "k"] | float  #: at the nodes, linear in between
    base_clamped: bool = True
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
    from . import _fourier_kernels as kernels

    material = IsotropicMaterial.of(material)
    size, meridian, thickness, points, weights, hermite, tangent = _meridian(shell)
    nodes = len(shell.radius_m)
    held = np.zeros((nodes, 6), dtype=bool)
    # The slope along the meridian stays free in the surface: only the wall's rotation is fixed.
    if shell.base_clamped:
        held[0, :3] = True
        held[0, 3:] = _turn_held(tangent[0])
    if shell.rim_held:
        held[-1, :3] = True
    loads = np.zeros((nodes, 3))
    loads[:, 0] = 1.0
    chosen = np.arange(0, max(harmonics, 8), 2)
    parts = kernels.nodal_compliance(
        chosen.astype(float), size, meridian, thickness, material.youngs_modulus_Pa,
        material.poisson_ratio, points, weights, hermite, held, loads,
    )  # fmt: skip
    last = int(chosen[-1])
    tail = parts[-1] * np.sum((last / np.arange(last + 2.0, 100 * last, 2)) ** 3)
    with np.errstate(divide="ignore"):
        return 0.5 / (parts.sum(axis=0) + tail)


def _turn_held(tangent: Float[np.ndarray, "2"]) -> list[bool]:
    # A clamp fixes d(u . n)/dt. On an upright wall n is radial, on a flat one vertical; in between
    # both slopes are fixed, which also prevents stretching at this one node.
    upright = abs(tangent[1]) > 1e-6
    flat = abs(tangent[0]) > 1e-6
    return [bool(upright), False, bool(flat)]


def _meridian(shell: RevolutionShell) -> tuple[np.ndarray, ...]:
    """Elements' parameter length, geometry and thickness at the Gauss points, Hermite functions."""
    from scipy.interpolate import CubicSpline

    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(shell.radius_m), np.diff(shell.height_m)))])
    curve = CubicSpline(length, np.column_stack([shell.radius_m, shell.height_m]))
    size = np.diff(length)
    points, weights = np.polynomial.legendre.leggauss(4)
    points, weights = 0.5 * (points + 1), 0.5 * weights
    x = points
    value = np.array([1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2])
    first = np.array([-6 * x + 6 * x**2, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x])
    second = np.array([-6 + 12 * x, -4 + 6 * x, 6 - 12 * x, 6 * x - 2])
    scale = np.where(np.array([0, 1, 0, 1], dtype=bool)[None, :], size[:, None], 1.0)
    hermite = np.empty((size.size, points.size, 3, 4))
    for order, table in enumerate((value, first, second)):
        hermite[:, :, order] = table.T[None] * scale[:, None, :] / size[:, None, None] ** order
    at = length[:-1, None] + points * size[:, None]
    here, rate, bend = curve(at), curve(at, 1), curve(at, 2)
    meridian = np.stack([here[..., 0], rate[..., 0], rate[..., 1], bend[..., 0], bend[..., 1]], axis=-1)
    wall = np.asarray(shell.thickness_m)
    thickness = wall[:-1, None] * (1 - points) + wall[1:, None] * points
    slope = curve(length, 1)
    return (
        size,
        np.ascontiguousarray(meridian),
        np.ascontiguousarray(thickness),
        points,
        weights,
        hermite,
        slope / np.linalg.norm(slope, axis=1)[:, None],
    )
