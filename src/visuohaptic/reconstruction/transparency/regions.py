"""Clusters of transparent voxels, with hull and position (Alt 2016, 5.2.2), and ``regions.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt16

from ...core.files import write_text
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.volume import SpaceGrid
from ..vessel_shapes import UprightBody
from .ray_evidence import RayEvidence
from .ray_readings import CONTEXTS, FAR, KINDS, SAME, RayImage
from .view_geometry import intrinsics, world_points


@dataclass(frozen=True, slots=True, eq=False)
class TransparentRegion:
    """One connected transparent part of the scene."""

    hull_m: Float[np.ndarray, "vertices 3"]  #: corners of the convex hull, world [m]
    faces: Int[np.ndarray, "faces 3"]  #: triangles of the hull, counter-clockwise from outside
    centroid_m: Float[np.ndarray, "3"]  #: mean of its voxels, world [m]
    size_m: Float[np.ndarray, "3"]  #: edges of its axis-aligned bounding box [m]
    score: float  #: mean score of its voxels
    voxels: int  #: number of voxels
    volume_m3: float  #: volume of the hull [m3]
    #: unit outward normals and offsets of the triangles of the hull, n . x + o <= 0 inside [m]
    planes: Float[np.ndarray, "faces 4"]
    body: UprightBody | None = None  #: upright body fitted to its outlines

    def contains(self, points_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        """Whether points are in the hull.

        Parameters
        ----------
        points_m
            Points (n, 3) of the world [m].
        """
        from .._hull_kernels import hull_distance

        away_m = np.empty(len(points_m))
        hull_distance(np.ascontiguousarray(points_m), np.ascontiguousarray(self.planes.T), away_m)
        return np.asarray(away_m <= 1e-9)


def find_regions(
    score: Float[np.ndarray, "x y z"],
    inside: Bool[np.ndarray, "x y z"],
    grid: SpaceGrid,
    *,
    min_voxels: int = 200,
) -> tuple[TransparentRegion, ...]:
    """Connected components of a mask, largest first.

    Parameters
    ----------
    score
        Score of each voxel; averaged over a region.
    inside
        Mask of the voxels of all regions.
    grid
        Position and size of the voxels.
    min_voxels
        Minimum number of voxels of a region.
    """
    from scipy import ndimage

    labels, found = ndimage.label(inside, np.ones((3, 3, 3)))[0], []
    for label, box in enumerate(ndimage.find_objects(labels), 1):
        cells = np.argwhere(labels[box] == label) + [s.start for s in box]
        if len(cells) >= min_voxels:
            found.append(region_of(cells, score[tuple(cells.T)], grid))
    return tuple(sorted(found, key=lambda region: -region.voxels))


def region_of(
    cells: Int[np.ndarray, "n 3"],
    scores: Float[np.ndarray, "n"],
    grid: SpaceGrid,
    body: UprightBody | None = None,
) -> TransparentRegion:
    """Create the region of a set of voxels.

    Parameters
    ----------
    cells
        Indices (n, 3) of the voxels.
    scores
        Their scores (n).
    grid
        Position and size of the voxels.
    body
        Upright body fitted to the outlines.
    """
    from scipy.spatial import ConvexHull

    # Hull of the corners of every voxel: the hull of one layer of centres would be flat.
    lowest = grid.low_m + grid.voxel_m * cells
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T * grid.voxel_m
    outline = np.unique(cells, axis=0)
    points = (grid.low_m + grid.voxel_m * outline)[:, None] + corners
    hull = ConvexHull(points.reshape(-1, 3))
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = hull.points[used], faces.reshape(-1, 3)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return TransparentRegion(
        vertices,
        faces,
        lowest.mean(axis=0) + 0.5 * grid.voxel_m,
        np.ptp(vertices, axis=0),
        float(scores.mean()),
        len(cells),
        float(hull.volume),
        hull.equations,
        body,
    )


def body_voxels(body: UprightBody, grid: SpaceGrid) -> Int[np.ndarray, "n 3"]:
    """Indices of the voxels inside a body (n, 3).

    Parameters
    ----------
    body
        The body.
    grid
        Position and size of the voxels.
    """
    cells = np.floor((body.points_m(grid.voxel_m) - grid.low_m) / grid.voxel_m).astype(int)
    return cells[((cells >= 0) & (cells < grid.shape)).all(axis=1)]


def seen_behind(
    body: UprightBody,
    rays: RayEvidence,
    images: Sequence[RayImage],
    tables: Float32[np.ndarray, "kinds n"],
    window_px: float,
    voxel_m: float,
) -> float:
    """Evidence that what is behind a body is read through it, of the rays farther inside its outline than half a matching window [nat].

    What is behind it is what rays beside the body see: the readings at a mirror agree by chance, at surfaces that nothing else shows.

    Parameters
    ----------
    body
        The body.
    rays, images, tables
        Rays of all views, their readings, and the log-likelihood ratios of these; see :func:`passing_evidence`.
    window_px
        Matching window of the camera, in which readings count as one and, at the outline, are also of what is beside [px].
    voxel_m
        Spacing of the points of the body [m].
    """
    away_m, inner = _inner_rays(body, rays, window_px, voxel_m)
    inner &= rays.limit_m > np.array(away_m)[:, None, None]
    beside = ~rays.through(body.points_m(voxel_m), voxel_m)
    codes = [
        image.code[inside][_seen_from(world_points(frame, image.predicted_m, inside), rays, images, beside)]
        for image, frame, inside in zip(images, rays.frames, inner, strict=True)
    ]
    return passing_evidence(codes, rays.weights / window_px**2, tables)


def agreed_behind(
    body: UprightBody, rays: RayEvidence, images: Sequence[RayImage], window_px: float, voxel_m: float
) -> float:
    """Evidence that views agree on what is behind a body as often as on what is beside it; at most 0 [nat].

    Other views see past glass, whereas the readings at a mirror agree in no two views.

    Parameters
    ----------
    body, rays, images, window_px, voxel_m
        As of :func:`seen_behind`; the rays beside the outline are those in a ring of two windows, two windows from these.
    """
    import cv2

    _, inner = _inner_rays(body, rays, window_px, voxel_m)
    squares = [np.ones((4 * k * math.ceil(window_px) + 1,) * 2, np.uint8) for k in (1, 2)]
    counts = np.zeros((2, 2))
    for image, inside, weight in zip(images, inner, rays.weights / window_px**2, strict=True):
        near, far = (cv2.dilate(inside.astype(np.uint8), square) > 0 for square in squares)
        for row, chosen in zip(counts, (inside, far & ~near), strict=True):
            row += weight * np.bincount(image.code[chosen] % 5 > 0, minlength=2)
    return agreement_evidence(counts)


def passing_evidence(
    codes: Sequence[UInt16[np.ndarray, "*n"]],
    weights: Float[np.ndarray, "views"],
    tables: Float32[np.ndarray, "kinds n"],
) -> float:
    """Log-likelihood ratio of a body behind which something is read, with a rate of which nothing is known, against an opaque one [nat].

    A black body is read nowhere or on itself. A reading at the surface that other views see behind it, or farther, is wrong, and as
    frequent as one beyond a surface of the same context.

    Parameters
    ----------
    codes
        Codes of the rays of each view that pass the body and end behind it.
    weights
        Weight of each view, in independent views.
    tables
        See :func:`reading_tables` [nat].
    """
    from scipy.special import betaln

    wrong = (KINDS[0] * np.exp(-tables[0].reshape(CONTEXTS, 5)[:, 1:]))[:, FAR - SAME]
    counts = [(len(code), np.count_nonzero(code % 5 <= FAR), wrong[code // 5].sum()) for code in codes]
    number, behind, mistaken = weights @ np.array(counts, np.float64)
    if number == 0:
        return 0.0
    rate, rest = mistaken / number, number - behind
    return float(betaln(behind + 1, rest + 1) - behind * np.log(rate) - rest * np.log1p(-rate))


def agreement_evidence(counts: Float[np.ndarray, "2 2"]) -> float:
    """Log-likelihood ratio of one rate of unknown surfaces inside and beside a body, against a higher rate inside; at most 0 [nat].

    Rates have uniform priors. Where it would be positive, nothing is known of an opaque body on whose surface views agree.

    Parameters
    ----------
    counts
        Independent rays inside and beside (rows) at whose ends the surface is unknown and known (columns).
    """
    from scipy.special import betaln

    inside, beside = counts
    if inside[0] * beside[1] <= beside[0] * inside[1]:
        return 0.0
    one, two = betaln(*(inside + beside + 1)), betaln(*(inside + 1)) + betaln(*(beside + 1))
    return min(float(one - two), 0.0)


def _inner_rays(
    body: UprightBody, rays: RayEvidence, window_px: float, voxel_m: float
) -> tuple[list[float], Bool[np.ndarray, "n h w"]]:
    """Depth of the middle of a body in each view [m], and the rays farther inside its outline than half a window."""
    points_m, middle_m = body.points_m(voxel_m), np.array([[*body.axis_m, np.mean(body.height_m)]])
    away_m = [float(frame.T_world_camera.inverse().apply(middle_m)[0, 2]) for frame in rays.frames]
    half_m = 0.5 * window_px / rays.frames[0].camera.focal_px * float(np.median(away_m))
    return away_m, rays.through(points_m[body.contains(points_m, -half_m)], 0.0)


def _seen_from(
    points_m: Float[np.ndarray, "n 3"],
    rays: RayEvidence,
    images: Sequence[RayImage],
    counted: Bool[np.ndarray, "views h w"],
) -> Bool[np.ndarray, "n"]:
    """Whether a counted ray of some view reads a surface at points, within three standard deviations."""
    seen = np.zeros(len(points_m), dtype=bool)
    for image, frame, some in zip(images, rays.frames, counted, strict=True):
        x, y, z = frame.T_world_camera.inverse().apply(points_m).T
        (fx, fy, cx, cy), (rows, columns) = intrinsics(frame.camera), some.shape
        z = np.where(z > 0.05, z, np.nan)
        u, v = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
        held = (u >= 0) & (v >= 0) & (u < columns) & (v < rows)
        at = v[held].astype(int), u[held].astype(int)
        within_m = image.predicted_m[at] - image.limit_m[at]
        same = some[at] & (image.reading[at] == SAME)
        seen[held] |= same & (np.abs(image.predicted_m[at] - z[held]) <= within_m)
    return seen


def outer_voxels(inside: Bool[np.ndarray, "x y z"]) -> Int[np.ndarray, "n 3"]:
    """Indices of the outer voxels of transparent parts: the approximate shape as in Alt 2016, Fig. 5.6.

    Parameters
    ----------
    inside
        Which voxels (x, y, z) are transparent.
    """
    from scipy import ndimage

    if not inside.any():
        return np.zeros((0, 3), np.int64)
    # The erosion is computed in the bounding box only; voxels on its faces are outer ones.
    box = ndimage.find_objects(inside.view(np.uint8))[0]
    cells: Int[np.ndarray, "n 3"] = np.argwhere(inside[box] & ~ndimage.binary_erosion(inside[box]))
    return cells + [side.start for side in box]


def mask_refracted_rays(
    frame: DepthFrame, regions: Sequence[TransparentRegion], *, min_m: float = 0.01
) -> DepthFrame:
    """The frame without readings through one of the regions: they do not measure a surface.

    An empty bottle refracts little, so the camera sees the inside of its own label through it, and the fusion would create an
    inner wall.

    Parameters
    ----------
    frame
        View to mask.
    regions
        Transparent parts.
    min_m
        Minimum path length inside a hull of a masked reading [m]: hulls are a voxel or two too large, and
        surfaces behind their margins are still seen directly.
    """
    from .._hull_kernels import mask_through

    depth_m = None
    camera, pose = frame.camera, frame.T_world_camera
    matrix = camera.matrix
    for region in regions:
        corners = pose.inverse().apply(region.hull_m)
        if corners[:, 2].max() <= 0.05:
            continue
        if corners[:, 2].min() > 0.05:
            u = matrix[0, 0] * corners[:, 0] / corners[:, 2] + matrix[0, 2]
            v = matrix[1, 1] * corners[:, 1] / corners[:, 2] + matrix[1, 2]
            box = np.array([[v.min(), v.max()], [u.min(), u.max()]])
        else:  # the camera is beside or inside the hull
            box = np.array([[0.0, camera.height], [0.0, camera.width]])
        last = np.array([[camera.height - 1], [camera.width - 1]])
        first_last = np.clip(np.stack([np.floor(box[:, 0]), np.ceil(box[:, 1])], axis=1), 0, last)
        rows, columns = first_last.astype(np.int64)
        planes = region.planes @ pose.matrix
        if depth_m is None:
            depth_m = frame.depth_m.copy()
        mask_through(
            depth_m, planes, rows, columns, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], min_m
        )
    return frame if depth_m is None else replace(frame, depth_m=depth_m)


def _body_entries(body: UprightBody) -> dict[str, Any]:
    rings = body.rings
    return {
        "axis": np.round(body.axis_m, 5).tolist(),
        "axis_sigma": np.round(body.axis_sigma_m, 5).tolist(),
        "radius": np.round(body.radius_m, 5).tolist(),
        "radius_sigma": round(body.radius_sigma_m, 5),
        "height": np.round(body.height_m, 5).tolist(),
        "lean": np.round(body.lean_m, 5).tolist(),
        "ends_sigma": None if body.ends_sigma_m is None else np.round(body.ends_sigma_m, 5).tolist(),
        "evidence": round(body.evidence, 2),
        "rings": np.round(np.column_stack([rings.z_m, rings.radius_m, rings.sigma_m]), 5).tolist(),
        "rings_sigma": round(rings.common_m, 5),
    }


def save_regions(path: Path | str, regions: tuple[TransparentRegion, ...], **about: Any) -> None:
    """Write ``regions.json``: hull, centroid, size [m] and score of each cluster.

    Parameters
    ----------
    path
        File to write.
    regions
        Transparent parts.
    about
        Further top-level entries of the file.
    """
    clusters = [
        {
            "hull": np.round(region.hull_m, 5).tolist(),
            "faces": region.faces.tolist(),
            "centroid": np.round(region.centroid_m, 5).tolist(),
            "size": np.round(region.size_m, 5).tolist(),
            "score": round(region.score, 4),
            "voxels": region.voxels,
            "volume_m3": float(f"{region.volume_m3:.4g}"),
        }
        | (_body_entries(region.body) if region.body else {})
        for region in regions
    ]
    write_text(
        path, json.dumps({**about, "unit": "m", "frame": "world", "clusters": clusters}, indent=1) + "\n"
    )
