"""Recognition of shapes from one side: a global descriptor invariant to rigid motion, then ICP.

Alt 2016, Sec. 2.3.5: local features of simple shapes are not discriminative, so a global descriptor proposes candidates,
which are verified by ICP. A camera observes one side; a stored object therefore has descriptors for many viewing directions.
Sizes are in metres, so that small and large cups are distinguished.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from ...core import InputError, MissingExtraError, finite_array, sphere_directions

#: Limits of the bins of point-pair distances [m], and their number.
_NEAR_M, _FAR_M, _DISTANCE_BINS = 0.004, 2.0, 32
_ANGLE_BINS = 12
#: Weights of the parts of a descriptor, such that noise and holes have similar effects on each.
_ANGLE_WEIGHT, _EXTENT_WEIGHT = 0.5, 0.6
DESCRIPTOR_LENGTH = _DISTANCE_BINS + _ANGLE_BINS + 3
#: Number of points of a described cloud, after thinning; number of pairs and triples that are sampled from them.
_POINTS, _PAIRS, _TRIPLES = 400, 4000, 2000
#: Minimum number of points of a cloud.
MIN_POINTS = 20
#: Number of initial poses that are refined.
_STARTS = 4
#: Maximum number of points of a stored surface.
STORED_POINTS = 1200
#: Directions from which a stored surface is seen, of a Fibonacci lattice.
VIEWS = 32


@dataclass(frozen=True, slots=True, eq=False)
class ShapeViews:
    """A surface and its descriptors from all viewing directions."""

    points_m: Float32[np.ndarray, "n 3"]  #: evenly over the surface, in the object's frame
    directions: Float32[np.ndarray, "views 3"]  #: unit, object to camera; 0 for the whole cloud
    descriptors: Float32[np.ndarray, "views d"]


@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """Registration of a cloud with a stored surface."""

    residual_m: float  #: RMS of truncated distances, cloud to surface and visible surface to cloud
    T_cloud_object: Float[np.ndarray, "4 4"]  #: maps the object's frame to that of the cloud


def describe_cloud(points_m: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "d"]:
    """Histograms of distances (D2) and angles (A3) of random points, and the extents.

    After Osada et al. 2002 and the ESF of Wohlkinger and Vincze 2011, with distances in metres on a logarithmic
    scale. The descriptor contains square roots of fractions, so that the Euclidean distance of descriptors is the
    Hellinger distance of the histograms.

    Parameters
    ----------
    points_m
        At least 20 points of any density.
    """
    cloud = thinned(_checked(points_m), _POINTS)
    rng = np.random.default_rng(len(cloud))  # deterministic for the same cloud
    a, b = (cloud[rng.integers(0, len(cloud), _PAIRS)] for _ in range(2))
    length = np.linalg.norm(a - b, axis=1)
    place = np.log(np.maximum(length, _NEAR_M) / _NEAR_M) / np.log(_FAR_M / _NEAR_M) * (_DISTANCE_BINS - 1)
    distances = _soft_fractions(place, _DISTANCE_BINS)
    p, q, r = (cloud[rng.integers(0, len(cloud), _TRIPLES)] for _ in range(3))
    u, v = q - p, r - p
    size = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    cosine = np.einsum("ij,ij->i", u, v)[size > 0] / size[size > 0]
    angles = _soft_fractions(np.arccos(np.clip(cosine, -1, 1)) / np.pi * (_ANGLE_BINS - 1), _ANGLE_BINS)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(cloud.T)), _NEAR_M**2 / 4))
    return np.concatenate(
        [np.sqrt(distances), _ANGLE_WEIGHT * np.sqrt(angles), _EXTENT_WEIGHT * np.log(spread)]
    ).astype(np.float32)


def shape_views(points_m: Float[np.ndarray, "n 3"]) -> ShapeViews:
    """Descriptors of a whole surface as seen from directions spread over the sphere.

    Parameters
    ----------
    points_m
        Points evenly over the surface, ideally 1000 or more; a cloud of one side is possible as well.
    """
    cloud = thinned(_checked(points_m), STORED_POINTS)
    described = [describe_cloud(cloud)]
    seen = [np.zeros(3)]  # no direction: the cloud as a whole
    for direction in sphere_directions(VIEWS):
        side = cloud[visible_from(cloud, direction)]
        if len(side) >= MIN_POINTS:
            described.append(describe_cloud(side))
            seen.append(direction)
    return ShapeViews(cloud.astype(np.float32), np.array(seen, np.float32), np.array(described, np.float32))


def fit_shape(stored: ShapeViews, points_m: Float[np.ndarray, "n 3"], view: int) -> ShapeFit:
    """Register a stored surface with a cloud that is similar to one of its views, by ICP.

    The principal axes of view and cloud agree up to their signs and, if extents are similar, their order;
    the best of these initial poses are refined.
    Distances are truncated at a tenth of the size. The distances from the part that should be visible to the cloud have a
    quarter of the weight, without their largest fifth: holes are not penalised, a missing half is.

    Parameters
    ----------
    stored
        Surface and its views.
    points_m
        Cloud of one side, in any frame [m].
    view
        Index of the similar view.

    Raises
    ------
    MissingExtraError
        small_gicp is not installed.
    """
    small_gicp = _small_gicp()
    from scipy.spatial import cKDTree

    seen = thinned(_checked(points_m), _POINTS)
    model = stored.points_m.astype(np.float64)
    direction = stored.directions[view].astype(np.float64)
    part = model[visible_from(model, direction)] if direction.any() else model
    cut = 0.1 * float(np.linalg.norm(np.ptp(seen, axis=0)))
    clouds = []
    for points in (model, seen):
        cloud = small_gicp.PointCloud(points)
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_normals_covariances(cloud, tree, 12)
        clouds.append((cloud, tree))
    (target, target_tree), (source, _) = clouds
    surface = _Surface(cKDTree(model), model, np.asarray(target.normals())[:, :3])
    surface_seen = _Surface(cKDTree(seen), seen, np.asarray(source.normals())[:, :3])

    def residual(pose: np.ndarray) -> float:  # pose: T_object_cloud
        there = np.minimum(surface.distances(seen @ pose[:3, :3].T + pose[:3, 3]), cut)
        back = np.minimum(surface_seen.distances((part - pose[:3, 3]) @ pose[:3, :3]), cut)
        back = np.sort(back)[: max(int(0.8 * len(back)), 1)]
        return float(np.sqrt(0.75 * np.mean(there**2) + 0.25 * np.mean(back**2)))

    def roughly(pose: np.ndarray) -> float:
        return float(np.mean(np.minimum(tree.query(few @ pose[:3, :3].T + pose[:3, 3])[0], 4 * cut)))

    tree, few = surface.tree, seen[:: max(len(seen) // 80, 1)]
    starts = sorted(_axis_poses(seen, part), key=roughly)[:_STARTS]
    best, pose = min(((residual(start), start) for start in starts), key=lambda one: one[0])
    for start in starts:
        found = small_gicp.align(
            target, source, target_tree, init_T_target_source=start, registration_type="PLANE_ICP",
            max_correspondence_distance=cut, max_iterations=15,
        ).T_target_source  # fmt: skip
        if np.isfinite(found).all() and (value := residual(found)) < best:
            best, pose = value, found
    return ShapeFit(best, np.linalg.inv(pose))


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Surface of points with normals, for the computation of distances."""

    tree: Any  #: scipy's cKDTree
    points_m: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]

    def distances(self, points_m: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k"]:
        """Distance to the tangent plane of the nearest point; outside the surface's border, to that point."""
        far, nearest = self.tree.query(points_m)
        off = np.abs(np.einsum("ij,ij->i", points_m - self.points_m[nearest], self.normals[nearest]))
        # On the largest tabletop objects, the points have distances up to about 10 mm.
        return np.where(far**2 - off**2 < 0.01**2, off, far)


def visible_from(points_m: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"]) -> np.ndarray:
    """Indices of the points of a surface that are visible to a distant camera in ``direction``.

    The points are projected into an image whose cells are slightly larger than their spacing; a point is hidden
    if a cell around it has a much nearer one.

    Parameters
    ----------
    points_m
        Points of the surface [m], (N, 3).
    direction
        From the surface to the camera, of any length, (3,).
    """
    from scipy.ndimage import maximum_filter

    direction = direction / np.linalg.norm(direction)
    across = np.linalg.svd(direction[None])[2][1:]
    plane, height = points_m @ across.T, points_m @ direction
    low = plane.min(axis=0)
    extent = np.ptp(plane, axis=0)
    # About two points per cell, since both sides of the surface are projected.
    cell = max(2.0 * float(np.sqrt(max(extent[0] * extent[1], 1e-12) / len(points_m))), 1e-6)
    index = ((plane - low) / cell).astype(np.int64)
    shape = index.max(axis=0) + 1
    nearest = np.full(tuple(shape), -np.inf)
    np.maximum.at(nearest, (index[:, 0], index[:, 1]), height)
    # Depth varies within a cell and its neighbours on steep walls; points further behind are hidden.
    around = maximum_filter(nearest, size=3, mode="constant", cval=-np.inf)
    own = nearest[index[:, 0], index[:, 1]]
    near = around[index[:, 0], index[:, 1]]
    return np.flatnonzero((height >= own - 2.0 * cell) & (height >= near - 5.0 * cell))


def thinned(points_m: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "m 3"]:
    """At most ``count`` points of uniform density: the means of voxels of the smallest suitable size.

    Parameters
    ----------
    points_m
        Cloud [m].
    count
        Maximum number of points.
    """
    if len(points_m) <= count // 2:
        return points_m
    centred = points_m - points_m.min(axis=0)
    size = float(centred.max())
    if not size > 0:
        return points_m[:1]
    low, high = size / 200, size
    for _ in range(7):  # bisection: the number of voxels decreases with their size
        middle = float(np.sqrt(low * high))
        if len(np.unique(_cube(centred, middle))) > count:
            low = middle
        else:
            high = middle
    cubes, label = np.unique(_cube(centred, high), return_inverse=True)
    sums = np.stack(
        [np.bincount(label, points_m[:, axis], minlength=len(cubes)) for axis in range(3)], axis=1
    )
    return np.asarray(sums / np.bincount(label)[:, None])


def _cube(centred: np.ndarray, side: float) -> np.ndarray:
    x, y, z = (centred / side).astype(np.int64).T
    return np.asarray((x * 1024 + y) * 1024 + z)


def _soft_fractions(place: np.ndarray, bins: int) -> Float[np.ndarray, "bins"]:
    """Normalised histogram in which each value is interpolated between its two nearest bins."""
    place = np.clip(place, 0, bins - 1)
    low = np.minimum(place.astype(np.int64), bins - 2)
    rest = place - low
    out = np.bincount(low, 1 - rest, minlength=bins) + np.bincount(low + 1, rest, minlength=bins)
    return out / max(len(place), 1)


def _axis_poses(seen: np.ndarray, part: np.ndarray) -> list[np.ndarray]:
    """The 24 rigid transforms that map the principal axes of ``seen`` to those of ``part``."""
    axes_seen = np.linalg.eigh(np.cov(seen.T))[1]
    axes_part = np.linalg.eigh(np.cov(part.T))[1]
    poses = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            rotation = (axes_part[:, order] * np.array(signs)) @ axes_seen.T
            if np.linalg.det(rotation) > 0:
                pose = np.eye(4)
                pose[:3, :3] = rotation
                pose[:3, 3] = part.mean(axis=0) - rotation @ seen.mean(axis=0)
                poses.append(pose)
    return poses


def _checked(points_m: np.ndarray) -> Float[np.ndarray, "n 3"]:
    points = finite_array("cloud", points_m, None, 3, least=MIN_POINTS)
    if not 1e-3 < float(np.ptp(points, axis=0).max()) < 100.0:
        raise InputError("cloud", f"found a size of {np.ptp(points, axis=0).max():.3g}, expected metres")
    return points


def _small_gicp() -> Any:
    try:
        import small_gicp
    except ImportError as error:
        raise MissingExtraError("small_gicp", "geometry", "registration of point clouds") from error
    return small_gicp
