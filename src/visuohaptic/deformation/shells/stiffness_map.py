"""Stiffness at every surface point under a dual-tip pinch (Alt 2016, Secs. 6.1.4, 6.1.6).

Two opposing tips press a point and the opposite point across the height axis towards each other. The
compliance of one pinch is ``c = f^T K^-1 f`` for the load f of 1 N on both tips: it is the
distance by which the tips approach per newton. The stiffness is force per deformation of one tip,
``k = 2 / c`` (the mean of the two tips, which a self-centring gripper measures).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from ...core.geometry import vertex_normals
from .shell import ShellMesh, ShellModel


@dataclass(frozen=True, slots=True, eq=False)
class DualTips:
    """Pairs of opposing contacts; "second" may lie inside a face."""

    first: Int[np.ndarray, "m"]  #: vertex of the first tip
    second: Int[np.ndarray, "m 3"]  #: corners of the opposite face
    weights: Float[np.ndarray, "m 3"]  #: barycentric coordinates of the second tip, sum 1
    direction: Float[np.ndarray, "m 3"]  #: unit vector of the first tip's force, towards the second tip
    valid: Bool[np.ndarray, "m"]  #: there is an opposite wall

    def __len__(self) -> int:
        return len(self.first)

    def take(self, chosen: Any) -> DualTips:
        """Some of the pairs.

        Parameters
        ----------
        chosen
            Numbers of the pairs, or a mask.
        """
        return DualTips(*(getattr(self, name)[chosen] for name in self.__slots__))


def opposing_points(
    mesh: ShellMesh,
    vertices: Int[np.ndarray, "m"] | None = None,
    *,
    axis_point_m: tuple[float, float] | None = None,
) -> DualTips:
    """The opposite point across the height axis z of each vertex, at the same height.

    Parameters
    ----------
    mesh
        Object with z as height axis.
    vertices
        First tips; all vertices by default.
    axis_point_m
        x and y of the axis; the middle of the bounding box by default.

    Notes
    -----
    The outermost intersection of the horizontal ray from the vertex through the axis is used. A
    vertex on the axis, or without an opposite wall, is marked invalid.
    """
    points, faces = mesh.vertices_m, mesh.faces
    first = np.arange(len(points)) if vertices is None else np.ascontiguousarray(vertices, dtype=np.int64)
    if axis_point_m is None:
        used = points[np.unique(faces)]
        axis = 0.5 * (used[:, :2].min(axis=0) + used[:, :2].max(axis=0))
    else:
        axis = np.asarray(axis_point_m, dtype=float)
    return _across(mesh, first, np.tile(axis, (len(first), 1)))


def antipodal_points(mesh: ShellMesh, *, max_slant_rad: float) -> DualTips:
    """The opposite point of each vertex along its horizontal normal.

    Parameters
    ----------
    mesh
        Object with z as height axis, faces oriented outwards.
    max_slant_rad
        Angle between force and normals up to which both contacts do not slip, ``atan(friction)``; other pairs are marked
        invalid.
    """
    points, faces = mesh.vertices_m, mesh.faces
    normal = vertex_normals(points, faces)
    level = normal[:, :2]
    size = np.linalg.norm(level, axis=1, keepdims=True)
    start = 1e-3 * float(np.ptp(points, axis=0).max())
    inwards = np.where(size > 1e-6, level / np.maximum(size, 1e-6), 0.0)
    tips = _across(mesh, np.arange(len(points)), points[:, :2] - start * inwards)
    far = np.einsum("mk,mki->mi", tips.weights, normal[tips.second])
    far /= np.maximum(np.linalg.norm(far, axis=1, keepdims=True), 1e-300)
    slants = np.stack(
        [
            -np.einsum("mi,mi->m", normal, tips.direction),
            np.einsum("mi,mi->m", far, tips.direction),
        ]
    )
    valid = tips.valid & (slants > np.cos(max_slant_rad)).all(axis=0)
    return replace(tips, valid=valid)


def _across(mesh: ShellMesh, first: Int[np.ndarray, "m"], axis_m: Float[np.ndarray, "m 2"]) -> DualTips:
    from . import _pinch_kernels as kernels

    faces = mesh.faces
    face, weights, direction = kernels.across(
        mesh.vertices_m, faces, first, np.ascontiguousarray(axis_m, dtype=float)
    )
    valid = face >= 0
    corners = faces[np.maximum(face, 0)]
    # Snap an intersection at a vertex or on an edge onto it: the load is not distributed by rounding errors, and pairs of
    # vertices are recognised.
    weights[weights < 1e-6] = 0.0
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    return DualTips(first, corners, weights, direction, valid)


def tip_loads(nodes: int, tips: DualTips, vertices_m: Float[np.ndarray, "v 3"] | None = None) -> Any:
    """Loads of 1 N on both tips as a sparse (6 nodes, m) array; columns of invalid pairs are empty.

    With linear distribution over the corners of its face, a force inside a face acts like a force on a patch, and the
    wall appears stiffer by some percent than under a point load. With ``vertices_m`` it is distributed by the cubic
    bending shape from the corners' rotations, see :func:`bent_loads`.

    Parameters
    ----------
    nodes
        Number of vertices.
    tips
        The m pairs.
    vertices_m
        Vertices [m], for loads that follow the bending of a face.
    """
    from scipy.sparse import coo_array

    count = len(tips)
    column = np.arange(count)
    first = np.zeros((count, 1, 6))
    first[:, 0, :3] = tips.direction
    second = bent_loads(tips, vertices_m)
    rows, columns, values = [], [], []
    for corners, load in ((tips.first[:, None], first), (tips.second, -second)):
        use = tips.valid[:, None, None] & (load != 0)
        rows.append((corners[:, :, None] * 6 + np.arange(6))[use])
        columns.append(np.broadcast_to(column[:, None, None], load.shape)[use])
        values.append(load[use])
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return coo_array(entries, shape=(6 * nodes, count)).tocsc()


def bent_loads(
    tips: DualTips, vertices_m: Float[np.ndarray, "v 3"] | None = None
) -> Float[np.ndarray, "m 3 6"]:
    """Forces and moments on the corners of the second tips' faces, for 1 N along ``direction``.

    Across the face the displacement is the cubic of Bazeley, Cheung, Irons and Zienkiewicz (1965),
    ``w = sum N_i w_i + sum_ij (L_i^2 L_j + L_1 L_2 L_3 / 2) dw_i . (x_j - x_i)`` with
    ``N_i = L_i + sum_j (L_i^2 L_j - L_i L_j^2)``: on the edges it is that of the element. In the plane of the face
    it is linear, as everywhere without ``vertices_m``.

    Parameters
    ----------
    tips
        Pairs of tips.
    vertices_m
        Vertices [m], (v, 3); ``None`` for linear displacements across a face.
    """
    fraction = tips.weights
    out = np.zeros((len(tips), 3, 6))
    out[..., :3] = fraction[..., None] * tips.direction[:, None]
    if vertices_m is None:
        return out
    corners = vertices_m[tips.second]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    across = np.einsum("mi,mi->m", normal, tips.direction)
    product = 0.5 * fraction.prod(axis=1)
    for i in range(3):
        for j in ((i + 1) % 3, (i + 2) % 3):
            li, lj = fraction[:, i], fraction[:, j]
            out[:, i, :3] += (across * (li * li * lj - li * lj * lj))[:, None] * normal
            # The slope along s of a corner that rotates by omega: n . (omega x s) = omega . (s x n).
            arm = np.cross(corners[:, j] - corners[:, i], normal)
            out[:, i, 3:] += (across * (li * li * lj + product))[:, None] * arm
    return out


def dual_tip_compliance(model: ShellModel, tips: DualTips) -> Float[np.ndarray, "m"]:
    """Approach of the two tips per newton [m/N], NaN where a pair is not valid.

    Parameters
    ----------
    model
        Shell model of the object.
    tips
        The m pairs.
    """
    loads = model.free_loads(tip_loads(model.nodes, tips, model.mesh.vertices_m))
    return np.where(tips.valid, model.factor().compliance(loads), np.nan)


def dual_tip_map(model: ShellModel, tips: DualTips | None = None) -> Float[np.ndarray, "m"]:
    """Exact stiffness [N/m] at every surface point, from one factorisation.

    Opposite vertices form one pinch and are computed once. The value is infinite where
    both tips are on fixed vertices, NaN where there is no opposite wall.

    Parameters
    ----------
    model
        Shell model of the object.
    tips
        Pairs of contacts; by default one for each vertex, about the middle of the bounding box.
    """
    if tips is None:
        tips = opposing_points(model.mesh)
    if not tips.valid.any():
        raise InputError(
            "dual_tip_map",
            "no point has a wall across the height axis",
            remedy="turn the object so that z is its height axis",
        )
    only = tips.weights.max(axis=1) == 1
    other = np.where(only, tips.second[np.arange(len(tips)), tips.weights.argmax(axis=1)], -1)
    low = np.where(only, np.minimum(tips.first, other), tips.first)
    high = np.where(only, np.maximum(tips.first, other), -1)
    _, chosen, inverse = np.unique(low * (model.nodes + 1) + high + 1, return_index=True, return_inverse=True)
    compliance = dual_tip_compliance(model, tips.take(chosen))[inverse]
    with np.errstate(divide="ignore"):
        return np.where(tips.valid, 2.0 / compliance, np.nan)
