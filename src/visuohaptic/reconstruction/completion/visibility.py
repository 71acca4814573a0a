"""Visibility of surface points from outside, with the surface itself and a region of glass as occluders.

Through an empty bottle a camera sees the inside of its own label, and the fusion of such views creates inner walls.
These walls do not belong to the outline from which a hole is closed.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ...core.geometry import sphere_directions
from ..mesh import SurfaceMesh
from .hole_region import HoleRegion

#: Number of directions on the sphere, evenly spread.
_DIRECTIONS = 48
#: Number of voxels along the size of the region.
_CELLS = 24


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
