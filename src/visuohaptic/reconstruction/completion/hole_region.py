"""The region where a surface is missing: a convex hull of points, or one read from ``regions.json``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Bool, Float
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
)

from ...core import InputError, finite_array
from ...core.files import field_problems, load_json
from ..vessel_shapes import OutlineRings, UprightBody


@dataclass(frozen=True, slots=True, eq=False)
class HoleRegion:
    """Where the surface is missing: a convex hull.

    Examples
    --------
    >>> corners_m = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    >>> region = HoleRegion.of_points(corners_m)
    >>> np.round(region.distance_m(np.array([[0.05, 0.05, 0.05], [0.3, 0.05, 0.05]])), 6)
    array([-0.05,  0.2 ])
    """

    hull_m: Float[np.ndarray, "v 3"]  #: corners of the hull [m]
    planes: Float[np.ndarray, "p 4"]  #: unit outward normals and offsets, n . x + o <= 0 inside
    body: UprightBody | None = None  #: upright body fitted to its outlines

    @classmethod
    def of_points(cls, points_m: Float[np.ndarray, "n 3"], body: UprightBody | None = None) -> HoleRegion:
        """The convex hull of points.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        body
            Upright body fitted to its outlines.

        Raises
        ------
        InputError
            The points span no volume.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = finite_array("HoleRegion", points_m, None, 3, least=4)
        try:
            hull = ConvexHull(points)
        except QhullError as error:
            raise InputError(
                "HoleRegion", "its points span no volume, expected corners of a solid"
            ) from error
        # Merge the coplanar facets of the triangulated hull.
        return cls(points[hull.vertices], np.unique(np.round(hull.equations, 9), axis=0), body)

    def distance_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Growth of the hull at which it contains each point [m]; negative inside.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        """
        from .._hull_kernels import hull_distance

        points = np.ascontiguousarray(points_m, dtype=np.float64)
        result = np.empty(len(points))
        hull_distance(points, np.ascontiguousarray(self.planes.T), result)
        return result

    def within(self, points_m: Float[np.ndarray, "n 3"], reach_m: float = 0.0) -> Bool[np.ndarray, "n"]:
        """Whether points are inside the grown hull.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        reach_m
            Growth of the hull [m].
        """
        return self.distance_m(points_m) <= reach_m

    def with_surface(self, points_m: Float[np.ndarray, "n 3"], gap_m: float, floor_m: float) -> HoleRegion:
        """Convex hull of the hull grown by ``gap_m`` and the surface points, cut off below a floor.

        Parameters
        ----------
        points_m
            Points (n, 3) of the surface [m].
        gap_m
            Growth of the hull [m].
        floor_m
            Height of the surface on which the object stands [m].
        """
        middle = self.hull_m.mean(axis=0)
        way = self.hull_m - middle
        grown = self.hull_m + gap_m * way / np.linalg.norm(way, axis=1, keepdims=True)
        points = np.vstack([points_m, grown])
        points[:, 2] = np.maximum(points[:, 2], floor_m)
        return HoleRegion.of_points(points)

    def clipped(self, axis_m: Float[np.ndarray, "2"], walls_m: Float[np.ndarray, "n 3"]) -> HoleRegion:
        """The part of the hull that is not farther from an upright axis than the known walls.

        A detector sees glass in a whole matching window of the camera at once, so its region may be wider than the object: by half
        a window on each side, 11 mm for a Kinect with 240 columns at 1 m, and by a voxel.

        Parameters
        ----------
        axis_m
            x and y of the axis [m].
        walls_m
            Known points (n, 3) of the walls around the hole [m]; without any, the region is not changed.
        """
        if not len(walls_m):
            return self
        away = self.hull_m[:, :2] - axis_m
        reach_m = np.hypot(*(walls_m[:, :2] - axis_m).T).max()
        corners_m = self.hull_m.copy()
        corners_m[:, :2] = (
            axis_m + away * np.minimum(1.0, reach_m / np.maximum(np.hypot(*away.T), 1e-9))[:, None]
        )
        return HoleRegion.of_points(corners_m)

    def core(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
        """Corners and centroid of the hull shrunk to 0.6, and the depth of each inside the hull [m]."""
        middle = self.hull_m.mean(axis=0)
        points = np.concatenate([[middle], middle + 0.6 * (self.hull_m - middle)])
        return points, -self.distance_m(points)

    @property
    def size_m(self) -> float:
        """Longest edge of its axis-aligned bounding box [m]."""
        return float(np.ptp(self.hull_m, axis=0).max())


def _rising(height: tuple[float, float]) -> tuple[float, float]:
    if height[0] >= height[1]:
        raise ValueError("expected the lower end before the upper end")
    return height


_Positive = Annotated[FiniteFloat, Field(gt=0)]
_NotNegative = Annotated[FiniteFloat, Field(ge=0)]
_Pair = tuple[FiniteFloat, FiniteFloat]
_Sigmas = tuple[_NotNegative, _NotNegative]
_Point = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class _Cluster(BaseModel):
    model_config = ConfigDict(extra="ignore")
    hull: list[_Point] = Field(min_length=4, max_length=100_000)
    axis: _Pair | None = None
    axis_sigma: _Sigmas | None = None
    radius: tuple[_Positive, _Positive] | None = None
    radius_sigma: _NotNegative | None = None
    height: Annotated[_Pair, AfterValidator(_rising)] | None = None
    lean: _Pair = (0.0, 0.0)
    ends_sigma: tuple[_Sigmas, _Sigmas] | None = None
    evidence: FiniteFloat = 0.0
    rings: list[tuple[FiniteFloat, _Positive, _Positive]] = Field(default=[], max_length=1000)
    rings_sigma: _NotNegative = 0.0

    def body(self) -> UprightBody | None:
        """The upright body; ``None`` if the file lacks any of its entries."""
        axis, sigma, radius, height = self.axis, self.axis_sigma, self.radius, self.height
        if axis is None or sigma is None or radius is None or self.radius_sigma is None or height is None:
            return None
        z_m, radius_m, sigma_m = np.array(self.rings).reshape(-1, 3).T
        rings = OutlineRings(z_m, radius_m, sigma_m, self.rings_sigma)
        place = np.array(axis), np.array(sigma), radius, self.radius_sigma, height
        ends = None if self.ends_sigma is None else np.array(self.ends_sigma)
        return UprightBody(*place, self.evidence, rings, self.lean, ends)


class _Pane(BaseModel):
    model_config = ConfigDict(extra="ignore")
    corners: tuple[_Point, _Point, _Point, _Point]
    sigma: _Positive

    def hull_m(self) -> Float[np.ndarray, "8 3"]:
        """Corners of the sheet, three standard deviations to both sides of it [m]."""
        corners = np.array(self.corners)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused as a hull
            normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
            side = 3 * self.sigma * normal / max(float(np.linalg.norm(normal)), 1e-12)
        return np.concatenate([corners - side, corners + side])


class _RegionsFile(BaseModel):
    model_config = ConfigDict(extra="ignore")
    clusters: list[_Cluster] = Field(max_length=10_000)
    panes: list[_Pane] = Field(default=[], max_length=10_000)


def load_hole_regions(path: Path | str) -> list[HoleRegion]:
    """Read ``regions.json``: ``clusters`` with ``hull`` (corners [m]) and the upright body of the outlines.

    Flat panes are not among them: their surface is known.

    Parameters
    ----------
    path
        JSON file, as :func:`~visuohaptic.reconstruction.transparency.regions.save_regions` writes it.

    Raises
    ------
    InputError
        The file is missing, not JSON, or has no usable cluster.
    """
    found = _load(path)
    if not found.clusters:
        beside = f"; the surface of flat panes (found {len(found.panes)}) is known" if found.panes else ""
        raise InputError(path, f"found no part{beside}", field="clusters", remedy="expected at least one")
    return _hole_regions(path, found)


def load_glass_hulls(path: Path | str) -> list[Float[np.ndarray, "n 3"]]:
    """Read from ``regions.json`` what is to be avoided: corners (n, 3) around each transparent part and each flat pane [m].

    Parameters
    ----------
    path
        As of :func:`load_hole_regions`.

    Raises
    ------
    InputError
        The file is missing, not JSON, or has neither a part nor a pane.
    """
    found = _load(path)
    if not found.clusters and not found.panes:
        raise InputError(path, "found no part and no pane", field="clusters", remedy="expected at least one")
    parts = [region.hull_m for region in _hole_regions(path, found)]
    panes = (_region(path, f"panes.{k}.corners", pane.hull_m()) for k, pane in enumerate(found.panes))
    return [*parts, *(pane.hull_m for pane in panes)]


def _load(path: Path | str) -> _RegionsFile:
    def parsed(data: Any) -> _RegionsFile:
        try:
            return _RegionsFile.model_validate(data if isinstance(data, dict) else {"clusters": data})
        except ValidationError as error:
            place, said = field_problems(error, _RegionsFile)[0]
            raise InputError(path, said, field=place, remedy="expected clusters with hull") from error

    return load_json(path, "a file of regions", parsed)


def _hole_regions(path: Path | str, found: _RegionsFile) -> list[HoleRegion]:
    return [
        _region(path, f"clusters.{number}.hull", np.array(cluster.hull), cluster.body())
        for number, cluster in enumerate(found.clusters)
    ]


def _region(
    path: Path | str, field: str, points_m: np.ndarray, body: UprightBody | None = None
) -> HoleRegion:
    try:
        return HoleRegion.of_points(points_m, body)
    except InputError as error:
        raise InputError(path, error.problem, field=field) from error
