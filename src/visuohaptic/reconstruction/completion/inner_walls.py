"""Inner sides of a surface's own walls: what a camera saw of them through glass is no outside.

A label on a clear bottle is seen from inside through the far wall, bent and too near to the axis. A part of a
surface is such an inner side when

- it does not look away from the object's upright axis,
- the outside is behind it: a level line from the axis meets another wall farther out, and
- it could not be seen if the glass were opaque: the region, which the detector finds too small, is drawn out along
  the axis and closes the object.

What is seen past the rim of an open cup, and all else in the scene, stays.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ..mesh import SurfaceMesh
from .hole_region import HoleRegion
from .visibility import open_sight

__all__ = ["without_inner_walls"]

#: Part of a unit normal away from the axis from which on a wall looks outwards.
_OUTWARDS = 0.3
#: Part of a unit normal down from which on a part is an underside.
_UNDER = 0.3
#: How far the region is drawn out, and how far from it inner sides are sought, in its sizes.
_DRAWN_OUT, _REACH = 0.5, 1.0
#: Fraction of the half space that what is seen directly sees at least.
_MIN_SIGHT = 0.2
#: Walls compared with each place: the nearest ones in angle and height.
_WALLS = 16


def without_inner_walls(mesh: SurfaceMesh, region: HoleRegion) -> SurfaceMesh:
    """The surface without inner sides of the walls around a region; the same mesh when there are none.

    Parameters
    ----------
    mesh
        Visible surface, triangles counter-clockwise from outside, z up.
    region
        Transparent part of an upright object.
    """
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    near = np.flatnonzero((region.distance_m(middle) < _REACH * region.size_m) & (mesh.face_areas_m2 > 0))
    if not len(near):
        return mesh
    axis = region.hull_m.mean(axis=0)[:2]
    normals = mesh.face_normals[near]
    away = middle[near, :2] - axis
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    out = (away * normals[:, :2]).sum(axis=1)
    outwards = out > _OUTWARDS
    walls, asked = near[outwards], near[~outwards]
    # A wall of a fused surface is rough: one that looks down a little still looks outwards.
    below = near[normals[:, 2] < -np.maximum(_UNDER, out)]
    if not len(walls):
        return mesh
    asked = np.union1d(asked[_behind(mesh, walls, middle[asked], axis)], below)
    if not len(asked):
        return mesh
    lift = _DRAWN_OUT * region.size_m * np.array([0.0, 0.0, 1.0])
    closed = HoleRegion.of_points(np.concatenate([region.hull_m + lift, region.hull_m - lift]))
    sight = open_sight(mesh, closed, middle[asked], mesh.face_normals[asked])
    inner = asked[sight < _MIN_SIGHT]
    if not len(inner):
        return mesh
    return mesh.submesh(np.setdiff1d(np.arange(len(mesh.faces)), inner))


def _behind(
    mesh: SurfaceMesh, walls: np.ndarray, points_m: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "n"]:
    """Whether the level line from the axis through a point goes on to one of the walls."""
    from scipy.spatial import cKDTree

    if not len(points_m):
        return np.zeros(0, dtype=bool)
    theta, rho_m = _polar(points_m, axis)
    corners = mesh.vertices_m[mesh.faces[walls]]
    angle, far_m = _polar(corners, axis)
    middle, _ = _polar(corners.mean(axis=1), axis)
    scale = float(np.median(far_m))
    tree = cKDTree(_around(middle, corners[..., 2].mean(axis=1), scale))
    _, found = tree.query(_around(theta, points_m[:, 2], scale), k=min(_WALLS, len(walls)))
    found = found.reshape(len(points_m), -1)
    # In the plane of angle and height, with the point in the origin.
    u = np.angle(np.exp(1j * (angle[found] - theta[:, None, None]))) * scale
    v = corners[found][..., 2] - points_m[:, 2, None, None]
    fraction = np.stack(
        [
            u[..., (k + 1) % 3] * v[..., (k + 2) % 3] - u[..., (k + 2) % 3] * v[..., (k + 1) % 3]
            for k in range(3)
        ],
        axis=-1,
    )
    area = fraction.sum(axis=-1)
    inside = ((fraction * np.sign(area)[..., None] >= 0).all(axis=-1)) & (np.abs(area) > 1e-15)
    with np.errstate(divide="ignore", invalid="ignore"):
        wall_m = (fraction * far_m[found]).sum(axis=-1) / area
    return (inside & (wall_m > rho_m[:, None] + 1e-4)).any(axis=1)


def _polar(points_m: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle [rad] and distance from the axis [m]."""
    offset = points_m[..., :2] - axis
    return np.arctan2(offset[..., 1], offset[..., 0]), np.hypot(offset[..., 0], offset[..., 1])


def _around(theta: np.ndarray, z_m: np.ndarray, scale: float) -> np.ndarray:
    """Angle and height as points of a cylinder."""
    return np.column_stack([scale * np.cos(theta), scale * np.sin(theta), z_m])
