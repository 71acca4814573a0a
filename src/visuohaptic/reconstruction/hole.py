"""Holes of a visual surface: their rims, the region where the surface is missing, the band around it.

The transparency region is a rough estimate of the missing part and a bit
smaller than it. It is grown until it touches the visual surface at every rim,
and by a band more: the known points in it are what the surface is extended
from (Alt 2016, Sec. 5.3.1).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from ..errors import InputError
from .mesh import SurfaceMesh

__all__ = ["HoleRegion", "boundary_loops", "load_hole_regions", "support_band"]

_MAX_FILE_BYTES = 1 << 26
#: Rims farther from the region than this part of its size belong to other holes.
_RIM_REACH = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class HoleRegion:
    """Where the surface is missing: a convex hull."""

    hull_m: Float[np.ndarray, "v 3"]  #: its corners [m]
    planes: Float[np.ndarray, "p 4"]  #: unit normals outwards and offsets, n . x + o <= 0 inside
    score: float = 1.0  #: of the transparency detector

    @classmethod
    def of_points(cls, points_m: Float[np.ndarray, "n 3"], score: float = 1.0) -> HoleRegion:
        """The hull of points.

        Raises
        ------
        InputError
            The points span no volume.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
            raise InputError("HoleRegion", f"found shape {points.shape}, expected at least 4 finite points")
        try:
            hull = ConvexHull(points)
        except QhullError as error:
            raise InputError(
                "HoleRegion", "its points span no volume, expected corners of a solid"
            ) from error
        return cls(points[hull.vertices], np.asarray(hull.equations), score)

    def distance_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """How far the hull must grow to hold a point; negative inside."""
        points = np.asarray(points_m, dtype=np.float64)
        result = np.full(len(points), -np.inf)
        for plane in self.planes:
            np.maximum(result, points @ plane[:3] + plane[3], out=result)
        return result

    @property
    def size_m(self) -> float:
        """Longest edge of its box."""
        return float(np.ptp(self.hull_m, axis=0).max())


class _Cluster(BaseModel):
    model_config = ConfigDict(extra="ignore")
    hull: list[tuple[FiniteFloat, FiniteFloat, FiniteFloat]] = Field(min_length=4, max_length=100_000)
    score: FiniteFloat = 1.0


class _RegionsFile(BaseModel):
    model_config = ConfigDict(extra="ignore")
    clusters: list[_Cluster] = Field(min_length=1, max_length=10_000)


def load_hole_regions(path: Path | str) -> list[HoleRegion]:
    """Read ``regions.json``: ``clusters`` with ``hull`` (corners [m]) and ``score``.

    Raises
    ------
    InputError
        The file is missing, no JSON, or has no usable cluster.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise InputError(path, f"is larger than {_MAX_FILE_BYTES} bytes")
        data = json.loads(path.read_text(encoding="utf-8"))
        found = _RegionsFile.model_validate(data if isinstance(data, dict) else {"clusters": data})
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in problem["loc"])
        raise InputError(path, f"{problem['msg']}; expected clusters with hull", field=place) from error
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"is not valid JSON ({error})") from error
    regions = []
    for number, cluster in enumerate(found.clusters):
        try:
            regions.append(HoleRegion.of_points(np.array(cluster.hull), cluster.score))
        except InputError as error:
            raise InputError(path, error.problem, field=f"clusters.{number}.hull") from error
    return regions


def boundary_loops(mesh: SurfaceMesh) -> list[Int[np.ndarray, "k"]]:
    """Vertices of the rims of a welded mesh, longest rim first.

    A rim is a connected set of edges that have one triangle only; vertices
    where rims meet join them.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = mesh.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    rim = unique[counts == 1]
    if not len(rim):
        return []
    n = len(mesh.vertices_m)
    links = coo_matrix((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(n, n))
    _, labels = connected_components(links, directed=False)
    on_rim = np.unique(rim)
    groups = [on_rim[labels[on_rim] == label] for label in np.unique(labels[on_rim])]
    return sorted(groups, key=len, reverse=True)


@dataclass(frozen=True, slots=True, eq=False)
class SupportBand:
    """Known points near a hole."""

    points_m: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    gap_m: float  #: growth of the region until it touched the surface at every rim
    margin_m: float  #: growth that holds the band


def support_band(
    mesh: SurfaceMesh, region: HoleRegion, *, most: int = 320, band_m: float | None = None
) -> SupportBand:
    """Points of the visual surface around a hole, evenly spread, at most ``most``.

    Parameters
    ----------
    band_m
        Width of the band behind each rim [m]; a quarter of the region by default.

    Raises
    ------
    InputError
        The surface has no part near the region.
    """
    width = 0.25 * region.size_m if band_m is None else band_m
    welded = mesh.welded()
    reach = region.distance_m(welded.vertices_m)
    rims = [float(reach[loop].min()) for loop in boundary_loops(welded) if len(loop) > 4]
    near = [gap for gap in rims if gap < _RIM_REACH * region.size_m]
    nearest = float(reach.min())
    if nearest > region.size_m:
        raise InputError(
            "support_band",
            f"the region is {nearest:.3g} m away from the surface and {region.size_m:.3g} m large",
            remedy="check that model and region are in the same frame",
        )
    gap = max([*near, nearest, 0.0])
    margin = gap + width
    centres = welded.vertices_m[welded.faces].mean(axis=1)
    kept = np.flatnonzero((region.distance_m(centres) < margin) & (welded.face_areas_m2 > 0))
    if len(kept) < 4:
        raise InputError(
            "support_band",
            f"found {len(kept)} triangles within {margin:.3g} m of the region, expected a surface around it",
            remedy="check that model and region are in the same frame",
        )
    part = welded.submesh(kept)
    normals = part.face_normals
    # Many samples, thinned to even spacing: a mesh's own vertices may crowd.
    rng = np.random.default_rng(0)
    points, face = part.sampled(max(8 * most, 400), rng)
    chosen = _spread(points, most)
    return SupportBand(points[chosen], normals[face[chosen]], gap, margin)


def _spread(points: Float[np.ndarray, "n 3"], most: int) -> Int[np.ndarray, "k"]:
    """About ``most`` of the points, one for each cell of a grid whose step is searched for."""
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    best = np.arange(len(points))
    if len(points) <= most:
        return best
    for _ in range(20):
        step = 0.5 * (low + high)
        keys = np.floor((points - points.min(axis=0)) / step).astype(np.int64)
        _, first = np.unique(keys @ np.array([1 << 40, 1 << 20, 1]), return_index=True)
        if len(first) > most:
            low = step
        else:
            high, best = step, np.sort(first)
    return best
