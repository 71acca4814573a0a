"""The estimated surface in the grown region: evaluation grids, zero level set, supported components."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...io.meshes.mesh_state import face_parts
from ..fusion.volume import SpaceGrid
from ..mesh import SurfaceMesh
from ..surfaces.rbf import RbfSurface, isosurface
from .hole import SupportBand
from .hole_region import HoleRegion


class HoleSpace:
    """The region grown by the band, and cached grids over it.

    Parameters
    ----------
    region
        Where the surface is missing.
    band
        Support band around the region.
    """

    def __init__(self, region: HoleRegion, band: SupportBand) -> None:
        self._region, self._band = region, band
        self._grids: dict[int, tuple[SpaceGrid, Bool[np.ndarray, "x y z"]]] = {}

    def grid(self, nodes: int) -> tuple[SpaceGrid, Bool[np.ndarray, "x y z"]]:
        """Grid over the grown region, and which of its nodes are inside it; both are cached.

        Parameters
        ----------
        nodes
            Number of nodes along the longest edge.
        """
        if nodes not in self._grids:
            margin = self._band.margin_m
            low, high = self._region.hull_m.min(axis=0) - margin, self._region.hull_m.max(axis=0) + margin
            step_m = float((high - low).max()) / (nodes - 1)
            grid = SpaceGrid.around(low - 0.5 * step_m, high + 0.5 * step_m, step_m)
            inside = self._region.within(grid.all_centres_m, margin)
            self._grids[nodes] = grid, inside.reshape(grid.shape)
        return self._grids[nodes]

    def surface(self, fit: RbfSurface, nodes: int, supports_m: Float[np.ndarray, "s 3"]) -> SurfaceMesh:
        """Zero level set in the grown region, without components that have no supports.

        Parameters
        ----------
        fit
            Signed distance, positive outside.
        nodes
            Number of nodes along the longest edge.
        supports_m
            Known points of the surface (s, 3) [m].

        Raises
        ------
        InputError
            The surface does not pass through the region.
        """
        grid, inside = self.grid(nodes)
        vertices, faces = isosurface(fit, grid, inside)
        if not len(faces):
            raise InputError(
                "Completion",
                "the estimated surface does not pass through the region",
                remedy="check the orientation of the model's triangles",
            )
        return supported_part(SurfaceMesh(vertices, faces), supports_m, 2.0 * grid.voxel_m)


def supported_part(mesh: SurfaceMesh, supports_m: Float[np.ndarray, "s 3"], near_m: float) -> SurfaceMesh:
    """Connected components of a mesh that pass near enough supports.

    Parameters
    ----------
    mesh
        Extracted surface.
    supports_m
        Known points of the surface (s, 3) [m].
    near_m
        Maximum distance of a support from a component [m].
    """
    from scipy.spatial import cKDTree

    part = face_parts(mesh.faces)
    if not part.any():
        return mesh
    part_of_vertex = np.zeros(len(mesh.vertices_m), dtype=np.int64)
    part_of_vertex[mesh.faces] = part[:, None]
    gaps, near = cKDTree(mesh.vertices_m).query(supports_m)
    kept = np.bincount(part_of_vertex[near[gaps < near_m]], minlength=part.max() + 1)
    # A component that passes near a few supports only is spurious.
    good = kept >= max(1, 0.02 * kept.sum())
    if not good.any():
        good = np.bincount(part_of_vertex) == np.bincount(part_of_vertex).max()
    return mesh.submesh(np.flatnonzero(good[part]))
