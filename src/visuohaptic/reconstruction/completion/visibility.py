"""Visibility of surface points from outside, with the surface itself and a region of glass as occluders.

Through an empty bottle a camera sees the inside of its own label, and the fusion of such views creates inner walls.
These walls do not belong to the outline from which a hole is closed, and are removed from the surface. A label on a clear
bottle is seen from inside through the far wall, distorted by refraction and too near to the axis. A
part of a surface is such an inner side if

- it does not face away from the upright axis of the object,
- the outside is behind it: a horizontal line from the axis through it meets another wall farther out, and
- it would be invisible if the glass were opaque: the region, which the detector finds too small, is extended along
  the axis so that it closes the object.

Surfaces seen over the rim of an open cup, and the rest of the scene, are kept.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ...core.geometry import sphere_directions
from ..mesh import SurfaceMesh
from .hole_region import HoleRegion
from .symmetry import polar

#: Number of directions on the sphere, evenly spread.
_DIRECTIONS = 48
#: Number of voxels along the size of the region.
_CELLS = 24
#: Minimum radial component of the unit normal of an outer wall.
_OUTWARDS = 0.3
#: Minimum downward component of the unit normal of an underside.
_UNDER = 0.3
#: Extension of the region up and down, and search distance for inner sides around it, in sizes of the region.
_DRAWN_OUT, _REACH = 0.5, 1.0
#: Minimum visible fraction of the hemisphere of a surface that is seen directly.
MIN_SIGHT = 0.2
#: Number of walls compared with each point: the nearest in angle and height.
_WALLS = 16


def open_sight(
    mesh: SurfaceMesh,
    region: HoleRegion,
    points_m: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Cosine-weighted fraction of the hemisphere of each point that is not occluded by the mesh or the region.

    Parameters
    ----------
    mesh
        Surface, triangles counter-clockwise from outside.
    region
        Region that occludes as well.
    points_m, normals
        Points of the surface (n, 3) [m] and their unit normals (n, 3).
    """
    from .._hull_kernels import seen_fraction

    size_m = region.size_m
    step_m = size_m / _CELLS
    low = region.hull_m.min(axis=0) - size_m
    shape = np.ceil((region.hull_m.max(axis=0) + size_m - low) / step_m).astype(int)
    blocked = _blocked(mesh, region, low, shape, step_m)
    fraction = np.empty(len(points_m))
    starts = (points_m - low) / step_m + 2.0 * normals
    seen_fraction(
        blocked,
        np.ascontiguousarray(starts),
        np.ascontiguousarray(normals),
        sphere_directions(_DIRECTIONS),
        fraction,
    )
    return fraction


def _blocked(
    mesh: SurfaceMesh,
    region: HoleRegion,
    low: Float[np.ndarray, "3"],
    shape: np.ndarray,
    step_m: float,
) -> Bool[np.ndarray, "x y z"]:
    """Cells that contain a part of the surface or lie in the region."""
    blocked = np.zeros(shape, dtype=bool)
    high = low + shape * step_m
    corners = mesh.vertices_m[mesh.faces]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    corners = corners[near]
    # Sample each triangle with a spacing below one cell.
    edge_m = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    for parts in np.unique(np.ceil(edge_m / (0.7 * step_m)).clip(1, 64).astype(int)):
        chosen = corners[np.ceil(edge_m / (0.7 * step_m)).clip(1, 64).astype(int) == parts]
        i, j = (part.ravel() for part in np.mgrid[0 : parts + 1, 0 : parts + 1])
        i, j = i[i + j <= parts] / parts, j[i + j <= parts] / parts
        weights = np.column_stack([i, j, 1 - i - j])
        cell = np.floor((np.einsum("wk,fkx->fwx", weights, chosen).reshape(-1, 3) - low) / step_m).astype(int)
        cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
        blocked[tuple(cell.T)] = True
    axes = [low[k] + step_m * (np.arange(shape[k]) + 0.5) for k in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return blocked | region.within(centres).reshape(tuple(shape))


def remove_back_sides(mesh: SurfaceMesh, region: HoleRegion) -> SurfaceMesh:
    """The surface without back sides of the walls around a region; the same mesh if there are none.

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
    # Fused walls are rough: an outward wall may also be inclined downwards a little.
    below = near[normals[:, 2] < -np.maximum(_UNDER, out)]
    if not len(walls):
        return mesh
    asked = np.union1d(asked[_behind(mesh, walls, middle[asked], axis)], below)
    if not len(asked):
        return mesh
    lift = _DRAWN_OUT * region.size_m * np.array([0.0, 0.0, 1.0])
    closed = HoleRegion.of_points(np.concatenate([region.hull_m + lift, region.hull_m - lift]))
    sight = open_sight(mesh, closed, middle[asked], mesh.face_normals[asked])
    inner = asked[sight < MIN_SIGHT]
    if not len(inner):
        return mesh
    return mesh.submesh(np.setdiff1d(np.arange(len(mesh.faces)), inner))


def _behind(
    mesh: SurfaceMesh, walls: np.ndarray, points_m: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "n"]:
    """Whether the horizontal line from the axis through each point meets one of the walls beyond the point."""
    from scipy.spatial import cKDTree

    if not len(points_m):
        return np.zeros(0, dtype=bool)
    theta, rho_m = polar(points_m, axis)
    corners = mesh.vertices_m[mesh.faces[walls]]
    angle, far_m = polar(corners, axis)
    middle, _ = polar(corners.mean(axis=1), axis)
    scale = float(np.median(far_m))
    tree = cKDTree(_around(middle, corners[..., 2].mean(axis=1), scale))
    _, found = tree.query(_around(theta, points_m[:, 2], scale), k=min(_WALLS, len(walls)))
    found = found.reshape(len(points_m), -1)
    # Barycentric coordinates in the plane of angle and height, with the point at the origin.
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


def _around(theta: np.ndarray, z_m: np.ndarray, scale: float) -> np.ndarray:
    """Angle and height as points on a cylinder of radius ``scale``, for nearest-neighbour search."""
    return np.column_stack([scale * np.cos(theta), scale * np.sin(theta), z_m])
