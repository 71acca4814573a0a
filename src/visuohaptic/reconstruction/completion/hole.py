"""Holes of a visual surface: their rims, the region where the surface is missing, the support band around it.

The transparency region is an approximation of the missing part, slightly too
small. It is grown until it reaches the visual surface at every rim, and
further by the width of the band: the surface is extrapolated from the known
points in the grown region (Alt 2016, Sec. 5.3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from ...io.meshes.mesh_state import boundary_edges, face_parts
from ..mesh import SurfaceMesh
from .hole_region import HoleRegion
from .symmetry import MAX_WALL_NZ
from .visibility import MIN_SIGHT, open_sight

#: Rims farther from the region than this fraction of its size belong to other holes.
_RIM_REACH = 0.5
#: Width of the band beyond each rim, in sizes of the region.
_WIDTH = 0.25
#: Points deeper in the region than this fraction of its size are readings through the glass, not surface.
_DEEPEST = 0.1
#: Minimum cosine between a normal and the direction to the centre of the region of a surface that faces the region.
_FACING = 0.3
#: Connected components with a smaller fraction of the area near the region are spurious.
_MIN_PART = 0.03
#: Maximum size of a region, in extents of the surface: the grid on which touches are planned then has four cells along the surface.
_LARGEST = 8.5
#: Standard deviation of the visible surface at a rim, in cells: it is anywhere within the last one (uniform distribution).
_RIM = 12**-0.5
#: Number of surface samples around a region.
_SAMPLES = 12_000


def boundary_loops(mesh: SurfaceMesh) -> list[Int[np.ndarray, "k"]]:
    """Vertices of the rims of a welded mesh, longest rim first.

    A rim is a connected set of boundary edges (edges of one triangle only);
    rims with a common vertex are one rim.

    Parameters
    ----------
    mesh
        Mesh with welded vertices.
    """
    rim = np.unique(np.sort(boundary_edges(mesh.faces), axis=1), axis=0)
    if not len(rim):
        return []
    part = face_parts(rim[:, [0, 1, 1]])
    return sorted((np.unique(rim[part == k]) for k in range(part.max() + 1)), key=len, reverse=True)


@dataclass(frozen=True, eq=False)
class SupportBand:
    """Known points near a hole."""

    points_m: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    gap_m: float  #: growth of the region at which it reaches the surface at every rim
    margin_m: float  #: growth of the region that contains the band
    #: dense samples of the surface around the region, also beyond the band
    samples_m: Float[np.ndarray, "k 3"]
    sample_normals: Float[np.ndarray, "k 3"]
    area_m2: float  #: area of the sampled surface
    rim_m: Float[np.ndarray, "n"]  #: distance of each point from the nearest rim [m]
    cell_m: float  #: edge of a pair of triangles of the surface [m]

    @property
    def rim_sigma_m(self) -> Float[np.ndarray, "n"]:
        """Standard deviation of each point for being near a rim [m]: a fused surface curls within its last cell."""
        found: Float[np.ndarray, "n"] = _RIM * self.cell_m * np.exp(-self.rim_m / self.cell_m)
        return found

    @property
    def walls_m(self) -> Float[np.ndarray, "w 3"]:
        """The points of walls [m]."""
        walls_m: Float[np.ndarray, "w 3"] = self.points_m[np.abs(self.normals[:, 2]) < MAX_WALL_NZ]
        return walls_m

    @cached_property
    def tree(self) -> Any:
        """``scipy.spatial.cKDTree`` of the samples."""
        from scipy.spatial import cKDTree

        return cKDTree(self.samples_m)

    @property
    def spacing_m(self) -> float:
        """Radius r within which all but 1 in 10,000 points have a sample: exp(-pi r^2 samples / area) = 1e-4 [m]."""
        return float(np.sqrt(np.log(1e4) * self.area_m2 / (np.pi * len(self.samples_m))))

    def away(self, points_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        """Whether points are farther from the visible surface than its sample spacing.

        Parameters
        ----------
        points_m
            Points (n, 3) near the surface [m].
        """
        return np.isinf(self.tree.query(points_m, distance_upper_bound=self.spacing_m)[0])

    def in_front(
        self, targets_m: Float[np.ndarray, "n 3"], starts_m: Float[np.ndarray, "n 3"], near_m: float
    ) -> Bool[np.ndarray, "n"]:
        """Whether lines from starts to targets meet nothing visible before.

        Parameters
        ----------
        targets_m, starts_m
            Points (n, 3) [m].
        near_m
            What is visible nearer to a target may be beside it [m].
        """
        way = starts_m - targets_m
        length_m = np.linalg.norm(way, axis=1)
        along_m = np.arange(near_m, length_m.max(initial=0.0), self.spacing_m)
        row, column = np.nonzero(along_m < length_m[:, None])
        places_m = targets_m[row] + (along_m[column] / length_m[row])[:, None] * way[row]
        return np.bincount(row[~self.away(places_m)], minlength=len(targets_m)) == 0

    def behind(self, points_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        """Whether points are on the inner side of the nearest visible surface sample.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        """
        _, near = self.tree.query(points_m)
        inner: np.ndarray = ((points_m - self.samples_m[near]) * self.sample_normals[near]).sum(axis=1) < 0
        return inner


def support_band(mesh: SurfaceMesh, region: HoleRegion, *, max_points: int = 320) -> SupportBand:
    """Points of the visual surface around a hole, evenly spread.

    Parameters
    ----------
    mesh
        Visual surface, triangles counter-clockwise from outside.
    region
        Where the surface is missing.
    max_points
        Maximum number of points.

    Raises
    ------
    InputError
        The surface has no part near the region.
    """
    width = _WIDTH * region.size_m
    welded = mesh.welded()
    nearest = float(region.distance_m(welded.vertices_m).min(initial=np.inf))
    if nearest > region.size_m:
        raise InputError(
            "support_band",
            f"the region is {nearest:.3g} m away from the surface and {region.size_m:.3g} m large",
            remedy="check that model and region are in the same frame",
        )
    if region.size_m > _LARGEST * (extent_m := float(np.ptp(welded.vertices_m, axis=0).max())):
        raise InputError(
            "support_band",
            f"found a region of {region.size_m:.3g} m, expected at most {_LARGEST * extent_m:.3g} m for a surface of {extent_m:.3g} m",
            remedy="give a box around the missing part only",
        )
    outline = _outline(welded, region, max(_RIM_REACH * region.size_m, nearest) + width)
    if not len(outline.faces):
        raise InputError(
            "support_band",
            "the surface near the region cannot be seen from outside",
            remedy="check the orientation of the model's triangles",
        )
    gap = max([*_gaps(outline, region), nearest, 0.0])
    margin = gap + width
    centres = outline.vertices_m[outline.faces].mean(axis=1)
    kept = np.flatnonzero((region.distance_m(centres) < margin) & (outline.face_areas_m2 > 0))
    if len(kept) < 4:
        raise InputError(
            "support_band",
            f"found {len(kept)} triangles within {margin:.3g} m of the region, expected a surface around it",
            remedy="check that model and region are in the same frame",
        )
    # Dense samples, thinned to even spacing: the vertices of a mesh may be unevenly distributed.
    rng = np.random.default_rng(0)
    part = outline.submesh(kept)
    points, face = part.sampled(max(8 * max_points, 400), rng)
    chosen = _spread(points, max_points)
    samples, near = outline.sampled(_SAMPLES, rng)
    area_m2 = float(outline.face_areas_m2.sum())
    normals = part.face_normals[face[chosen]], outline.face_normals[near]
    cell_m = float(np.sqrt(2 * part.face_areas_m2.mean()))
    return SupportBand(
        points[chosen],
        normals[0],
        gap,
        margin,
        samples,
        normals[1],
        area_m2,
        _rim_distance_m(outline, points[chosen]),
        cell_m,
    )


def _rim_distance_m(outline: SurfaceMesh, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distance of points from the nearest vertex of a rim; infinite without rims [m]."""
    from scipy.spatial import cKDTree

    rims = boundary_loops(outline)
    if not rims:
        return np.full(len(points_m), np.inf)
    found: np.ndarray = cKDTree(outline.vertices_m[np.concatenate(rims)]).query(points_m)[0]
    return found


def _outline(welded: SurfaceMesh, region: HoleRegion, reach_m: float) -> SurfaceMesh:
    """The surface near a region without inner walls, readings through the glass, and surfaces that face the region.

    On a convex body no normal points to a missing part. A surface that faces the region is the support of the object,
    or a rim of a fused surface that curls inwards where its truncated distances end.
    """
    centres = welded.vertices_m[welded.faces].mean(axis=1)
    distance = region.distance_m(centres)
    near = np.flatnonzero((distance < reach_m) & (distance > -_DEEPEST * region.size_m))
    ways = region.hull_m.mean(axis=0) - centres[near]
    facing = (welded.face_normals[near] * ways).sum(axis=1) > _FACING * np.linalg.norm(ways, axis=1)
    near = near[~facing]
    sight = open_sight(welded, region, centres[near], welded.face_normals[near])
    outline = welded.submesh(near[sight >= MIN_SIGHT])
    part = face_parts(outline.faces)
    areas = np.bincount(part, weights=outline.face_areas_m2)
    return outline.submesh(np.flatnonzero((areas >= _MIN_PART * areas.sum())[part]))


def _gaps(outline: SurfaceMesh, region: HoleRegion) -> list[float]:
    """Distance of each rim and each separate component of an outline from the region [m]."""
    reach = region.distance_m(outline.vertices_m)
    max_m = _RIM_REACH * region.size_m
    # Rims beyond the band are cut edges of the outline.
    rims = [float(reach[loop].min()) for loop in boundary_loops(outline) if len(loop) > 4]
    part = face_parts(outline.faces)
    parts = [float(reach[outline.faces[part == number]].min()) for number in range(part.max() + 1)]
    return [gap for gap in (*rims, *parts) if gap < max_m]


def _spread(points: Float[np.ndarray, "n 3"], max_points: int) -> Int[np.ndarray, "k"]:
    """Indices of at most ``max_points`` points, one in each cell of a grid; the cell size is found by bisection."""
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    best = np.arange(len(points))
    if len(points) <= max_points:
        return best
    for _ in range(20):
        step = 0.5 * (low + high)
        keys = np.floor((points - points.min(axis=0)) / step).astype(np.int64)
        _, first = np.unique(keys @ np.array([1 << 40, 1 << 20, 1]), return_index=True)
        if len(first) > max_points:
            low = step
        else:
            high, best = step, np.sort(first)
    return best
