"""MITC4 quadrilateral shell element: an independent element and theory to verify the triangles.

Dvorkin and Bathe 1984: a bilinear degenerated solid with transverse shear, whose covariant shear
strains are tied at the midpoints of the sides. It needs about twice as many nodes as the triangles.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ...deformation.shells.factor import Factor, factorise
from ...deformation.shells.ordering import front_tree
from ...deformation.shells.shell_material import IsotropicMaterial

#: Drilling stiffness, as a fraction of the plate's; small, for a degree of freedom that bilinear quads lack.
DRILLING = 1e-3


def mitc4_stiffness(
    vertices_m: Float[np.ndarray, "v 3"],
    quads: Int[np.ndarray, "q 4"],
    normals: Float[np.ndarray, "v 3"],
    thickness_m: float,
    material: IsotropicMaterial,
) -> Float[np.ndarray, "q 24 24"]:
    """Element matrices in (displacement, rotation) per corner, global axes.

    Parameters
    ----------
    vertices_m
        Nodes (v, 3) [m].
    quads
        Corners (q, 4) of the elements.
    normals
        Directors (v, 3), unit vectors.
    thickness_m
        Wall thickness [m].
    material
        Elastic constants.
    """
    corners, directors = vertices_m[quads], normals[quads]
    young, nu = material.youngs_modulus_Pa, material.poisson_ratio
    law = np.zeros((5, 5))
    law[:2, :2] = young / (1 - nu * nu) * np.array([[1, nu], [nu, 1]])
    law[2, 2] = young / (2 * (1 + nu))
    law[3, 3] = law[4, 4] = 5 / 6 * law[2, 2]
    out = np.zeros((len(quads), 24, 24))
    gauss = 1 / np.sqrt(3)
    for r in (-gauss, gauss):
        for s in (-gauss, gauss):
            for zeta in (-gauss, gauss):
                strain, size = _strain(corners, directors, thickness_m, r, s, zeta)
                out += np.einsum("q,qai,ab,qbj->qij", size, strain, law, strain, optimize=True)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1
    )
    spring = DRILLING * law[2, 2] * thickness_m**3 / 12
    for k in range(4):
        block = slice(6 * k + 3, 6 * k + 6)
        turn = np.einsum("qi,qj->qij", directors[:, k], directors[:, k])
        out[:, block, block] += spring * area[:, None, None] / thickness_m**2 * turn
    return out


def mitc4_factor(
    vertices_m: Float[np.ndarray, "v 3"],
    quads: Int[np.ndarray, "q 4"],
    matrices: Float[np.ndarray, "q 24 24"],
    fixed: np.ndarray,
) -> Factor:
    """Factorised stiffness matrix.

    Parameters
    ----------
    vertices_m, quads
        As of :func:`mitc4_stiffness`.
    matrices
        Element matrices (q, 24, 24).
    fixed
        Mask (v, 6) of fixed degrees of freedom.
    """
    from ...deformation.shells._front_kernels import constrain

    held = matrices.copy()
    constrain(held, np.ascontiguousarray(quads), fixed)
    return factorise(front_tree(vertices_m, quads), held, fixed.astype(float))


def _interpolation(r: float, s: float) -> tuple[np.ndarray, np.ndarray]:
    r_corner, s_corner = np.array([-1.0, 1, 1, -1]), np.array([-1.0, -1, 1, 1])
    value = 0.25 * (1 + r * r_corner) * (1 + s * s_corner)
    slope = 0.25 * np.stack([r_corner * (1 + s * s_corner), s_corner * (1 + r * r_corner)])
    return value, slope


def _base(
    corners: np.ndarray, directors: np.ndarray, thickness: float, r: float, s: float, zeta: float
) -> tuple[np.ndarray, np.ndarray]:
    """Covariant base vectors (q, 3, 3) and derivatives of the displacement (q, 3, 3, 24), by r, s, zeta."""
    value, slope = _interpolation(r, s)
    half = 0.5 * thickness
    points = corners + zeta * half * directors
    base = np.concatenate(
        [np.einsum("dk,qki->qdi", slope, points), half * np.einsum("k,qki->qi", value, directors)[:, None]],
        axis=1,
    )
    # theta x V = -skew(V) theta
    x, y, z = np.moveaxis(directors, 2, 0)
    zero = np.zeros_like(x)
    turned = -np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    rate = np.zeros((len(corners), 3, 3, 24))
    for k in range(4):
        for d in range(2):
            rate[:, d, :, 6 * k : 6 * k + 3] = slope[d, k] * np.eye(3)
            rate[:, d, :, 6 * k + 3 : 6 * k + 6] = slope[d, k] * zeta * half * turned[:, k]
        rate[:, 2, :, 6 * k + 3 : 6 * k + 6] = value[k] * half * turned[:, k]
    return base, rate


def _strain(
    corners: np.ndarray, directors: np.ndarray, thickness: float, r: float, s: float, zeta: float
) -> tuple[np.ndarray, np.ndarray]:
    """Strain (q, 5, 24) in local axes (11, 22, 12, 23, 31) and the volume of the Gauss point (q,)."""
    base, rate = _base(corners, directors, thickness, r, s, zeta)

    def covariant(i: int, j: int, vectors: np.ndarray, rates: np.ndarray) -> np.ndarray:
        one = np.einsum("qi,qin->qn", vectors[:, i], rates[:, j])
        return 0.5 * (one + np.einsum("qi,qin->qn", vectors[:, j], rates[:, i]))

    tensor = np.zeros((len(corners), 3, 3, 24))
    for i in range(2):
        for j in range(2):
            tensor[:, i, j] = covariant(i, j, base, rate)
    # Shear tied at the midpoints of the sides.
    for i, at, (low, high) in ((0, s, ((0, -1), (0, 1))), (1, r, ((-1, 0), (1, 0)))):
        tied = np.zeros_like(tensor[:, 0, 0])
        for place, fraction in ((low, 0.5 * (1 - at)), (high, 0.5 * (1 + at))):
            tied = tied + fraction * covariant(i, 2, *_base(corners, directors, thickness, *place, 0.0))
        tensor[:, i, 2] = tensor[:, 2, i] = tied
    dual = np.linalg.inv(base).transpose(0, 2, 1)
    normal = np.cross(base[:, 0], base[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    along = base[:, 0] / np.linalg.norm(base[:, 0], axis=1)[:, None]
    axes = np.stack([along, np.cross(normal, along), normal], axis=1)
    mixed = np.einsum("qij,qaj->qai", dual, axes)
    local = np.einsum("qai,qbj,qijn->qabn", mixed, mixed, tensor, optimize=True)
    strain = np.stack(
        [local[:, 0, 0], local[:, 1, 1], 2 * local[:, 0, 1], 2 * local[:, 1, 2], 2 * local[:, 2, 0]], axis=1
    )
    return strain, np.linalg.det(base)
