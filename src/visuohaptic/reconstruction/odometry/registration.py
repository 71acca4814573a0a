"""Normal equations and likelihood of the relative pose of two depth images: planes and depth steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32, Int

from ...core.camera.model import Camera
from ...core.geometry import so3_exp
from ..fusion.depth_noise import DepthNoise
from ..transparency.pose_refinement import MIN_SIGMA_M
from ..transparency.view_geometry import intrinsics
from .depth_edges import DepthEdges, depth_edges

#: Points of a view on smooth surfaces.
_POINTS = 2000
#: Residuals beyond this many standard deviations are suppressed (Geman-McClure), as in the refinement of poses.
_ROBUST = 3.0
#: Fraction of points whose depth in the other view is of another surface, or of no surface.
_OUTLIERS = 0.1

#: Window of the normals [px], and minimum fraction of it that must be measured.
_WINDOW_PX, _MEASURED = 9, 0.7
#: Over-relaxation: reweighting minimises an upper bound, so that a longer step still descends.
RELAXED = 1.4

Equations = tuple[Float[np.ndarray, "p 6 6"], Float[np.ndarray, "p 6"]]
#: Reach [m], and weights of planes and of depth steps, of one step of Gauss-Newton.
Phase = tuple[float, float, float]


class RegisteredViews:
    """Depth images of one camera, prepared for the comparison of any two of them.

    Parameters
    ----------
    depths_m
        Depth images (n, h, w) of a camera without distortion [m]; NaN: not measured.
    camera
        Its model.
    noise
        Noise of its depths.
    """

    def __init__(self, depths_m: Float32[np.ndarray, "n h w"], camera: Camera, noise: DepthNoise) -> None:
        from ..transparency._view_kernels import smooth_points

        self.depths_m, self.camera = np.ascontiguousarray(depths_m), camera
        self.edges: list[DepthEdges] = [depth_edges(depth_m, camera) for depth_m in self.depths_m]
        self.smooth_m = np.array([_smoothed(*both) for both in zip(self.depths_m, self.edges, strict=True)])
        self.numbers = tuple(float(value) for value in intrinsics(camera))
        self.points: list[Float[np.ndarray, "m 3"]] = []
        height, width = depths_m.shape[1:]
        # Oversampled by 4, so that a view of which a quarter is smooth yields all points.
        stride = max(1, math.isqrt(height * width // (4 * _POINTS)))
        for depth_m in self.smooth_m:
            space = np.empty((math.ceil(height / stride) * math.ceil(width / stride), 3))
            found = space[: smooth_points(depth_m, stride, *self.numbers, space)]
            self.points.append(found[np.linspace(0, len(found) - 1, min(_POINTS, len(found))).astype(int)])
        self.firsts = np.cumsum([0, *map(len, self.points)])
        self.all_points = np.concatenate(self.points)
        self._noise = (noise.quadratic_per_m, noise.constant_m, noise.offset_m, MIN_SIGMA_M)
        #: Matching extends an edge by up to this; within a window, errors are the same.
        self._edge_px = noise.edge_px(camera.focal_px) / math.sqrt(3)
        self._window_px = noise.window_px(camera.focal_px)
        #: Points that share the readings of a matching window; together they count as one.
        pixels = max(int(np.isfinite(self.smooth_m).sum()), 1)
        self.shared = max(1.0, self._window_px**2 * len(self.all_points) / pixels)

    def equations(
        self,
        pairs: Int[np.ndarray, "p 2"],
        poses: Float[np.ndarray, "n 4 4"],
        reach_m: float,
        stride: int = 1,
        weights: tuple[float, float] = (1.0, 1.0),
    ) -> Equations:
        """J^T J and J^T r of each pair of views for a motion of the first view in the world.

        Parameters
        ----------
        pairs
            View of the points, and view that they are compared with.
        poses
            ``T_world_camera`` of all views.
        reach_m
            Maximum distance of a point from its plane or edge [m].
        stride
            Every n-th point is used; it represents the omitted ones.
        weights
            Of planes and of depth steps.
        """
        from ..transparency._view_kernels import plane_equations

        pairs = np.asarray(pairs, np.int64).reshape(-1, 2)
        squares, pulls = np.empty((len(pairs), 6, 6)), np.empty((len(pairs), 6))
        plane_equations(
            pairs, self.all_points, self.firsts, stride, np.ascontiguousarray(poses[:, :3]), self.smooth_m,
            *self.numbers, reach_m, *self._noise, 1.0 / (stride * weights[0]), squares, pulls,
        )  # fmt: skip
        for k, (first, second) in enumerate(pairs if weights[1] else ()):
            rows, residuals = self._edge_rows(first, second, poses, reach_m)
            squares[k] += weights[1] * rows.T @ rows
            pulls[k] += weights[1] * rows.T @ residuals
        return squares, pulls

    def _edge_rows(
        self, first: int, second: int, poses: Float[np.ndarray, "n 4 4"], reach_m: float
    ) -> tuple[Float[np.ndarray, "m 6"], Float[np.ndarray, "m"]]:
        """Weighted Jacobian and residuals of the edge points of a view at the edges of another."""
        edges, there = self.edges[second], poses[second]
        world, u, v, z, i, j = self._projected(self.edges[first].points_m, poses[first], there)
        ni, nj = edges.nearest[:, i, j]
        # An edge that moves aside by the reach can be that much nearer or farther, too.
        near = edges.distance_px[i, j] * z < reach_m * self.numbers[0]
        with np.errstate(invalid="ignore"):
            near &= np.abs(self.depths_m[second][ni, nj] - z) < 2 * reach_m
        world, u, v, z, ni, nj = world[near], u[near], v[near], z[near], ni[near], nj[near]
        ax, ay = edges.across[:, ni, nj].astype(float)
        residual = ax * (u - nj) + ay * (v - ni)
        fx, fy, cx, cy = self.numbers
        slope = np.stack([ax * fx, ay * fy, -(ax * (u - cx) + ay * (v - cy))], axis=1) / z[:, None]
        turned = slope @ there[:3, :3].T
        weight = 1 / (1 + (residual / (_ROBUST * self._edge_px)) ** 2)
        weight /= self._edge_px * math.sqrt(self._window_px)
        rows = np.concatenate([np.cross(world, turned), turned], axis=1) * weight[:, None]
        return rows, residual * weight

    def _projected(
        self,
        points_m: Float[np.ndarray, "m 3"],
        here: Float[np.ndarray, "4 4"],
        there: Float[np.ndarray, "4 4"],
    ) -> tuple[np.ndarray, ...]:
        """Points of a view that lie in the image of another: world, column, row, depth, and pixel."""
        fx, fy, cx, cy = self.numbers
        height, width = self.depths_m.shape[1:]
        world = points_m @ here[:3, :3].T + here[:3, 3]
        x, y, z = ((world - there[:3, 3]) @ there[:3, :3]).T
        ahead = z > 0.05
        far = np.where(ahead, z, 1.0)
        u, v = fx * x / far + cx, fy * y / far + cy
        inside = ahead & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
        u, v = u[inside], v[inside]
        return world[inside], u, v, z[inside], np.rint(v).astype(int), np.rint(u).astype(int)

    def log_ratio(self, first: int, second: int, poses: Float[np.ndarray, "n 4 4"]) -> float:
        """Log-likelihood ratio of the readings of two views: seen at these poses, against of unrelated surfaces.

        Mean over the points of the first view that are in the second; unrelated depths are uniform within a
        tenth of the depth. Points and edges are added.

        Parameters
        ----------
        first, second
            The views.
        poses
            ``T_world_camera`` of all views.
        """
        quadratic, constant, offset, least = self._noise
        _, _, _, z, i, j = self._projected(self.points[first], poses[first], poses[second])
        away = self.depths_m[second][i, j] - z
        z, away = z[np.isfinite(away)], away[np.isfinite(away)]
        sigma = math.sqrt(2) * (constant + quadratic * (z - offset) ** 2) + least
        planes = _mixture(away / sigma, 0.2 * z / sigma)
        _, _, _, z, i, j = self._projected(self.edges[first].points_m, poses[first], poses[second])
        steps = _mixture(
            self.edges[second].distance_px[i, j] / self._edge_px, 0.2 * self.numbers[0] / self._edge_px
        )
        mean = float(planes.mean()) if len(planes) else 0.0
        mean += float(steps.mean()) if len(steps) else 0.0
        return mean

    def polished(
        self,
        index: int,
        others: Sequence[int],
        poses: Float[np.ndarray, "n 4 4"],
        phases: Sequence[Phase],
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 6"]]:
        """Pose of one view relative to others, by Gauss-Newton, and its information matrix in the world.

        Parameters
        ----------
        index, others
            The view, and those that it is compared with.
        poses
            ``T_world_camera`` of all views; that of the view is the start.
        phases
            Steps of Gauss-Newton.
        """
        poses = poses.copy()
        pairs = np.array([(index, k) for k in others] + [(k, index) for k in others])
        sign = np.repeat([1.0, -1.0], len(others))
        matrix = np.eye(6)
        for reach_m, planes, steps in phases:
            stride = 1 if reach_m == phases[-1][0] else 4
            squares, pulls = self.equations(pairs, poses, reach_m, stride, (planes, steps))
            matrix = squares.sum(axis=0)
            poses[index] = moved(poses[index], -RELAXED * _solved(matrix, sign @ pulls))
        return poses[index], matrix


def _smoothed(depth_m: Float32[np.ndarray, "h w"], edges: DepthEdges) -> Float32[np.ndarray, "h w"]:
    """Depth averaged over a window within one surface; NaN at steps.

    Inverse depth is linear on planes. Normals of single readings err by a tenth of a radian, as if planes held a
    camera that slides along them.
    """
    from scipy.ndimage import maximum_filter, uniform_filter

    measured = np.isfinite(depth_m)
    inverse = np.where(measured, 1 / np.where(measured, depth_m, 1.0), 0.0)
    share = uniform_filter(measured.astype(np.float64), _WINDOW_PX)
    mean = uniform_filter(inverse.astype(np.float64), _WINDOW_PX) / np.maximum(share, 1e-6)
    kept = measured & (share > _MEASURED) & ~maximum_filter(edges.distance_px == 0, _WINDOW_PX)
    found: Float32[np.ndarray, "h w"] = np.where(kept, 1 / np.maximum(mean, 1e-6), np.nan).astype(np.float32)
    return found


def _mixture(
    deviations: Float[np.ndarray, "m"], width: Float[np.ndarray, "m"] | float
) -> Float[np.ndarray, "m"]:
    """Log-likelihood ratio of deviations in standard deviations: normal with outliers, against uniform of a width."""
    normal = width / math.sqrt(2 * math.pi) * np.exp(-0.5 * deviations**2)
    found: Float[np.ndarray, "m"] = np.log((1 - _OUTLIERS) * normal + _OUTLIERS)
    return found


def _solved(matrix: Float[np.ndarray, "6 6"], right: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """Solution of normal equations; directions without information do not move."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-9 * max(values[-1], 1e-30)
    found: Float[np.ndarray, "6"] = vectors[:, kept] @ ((vectors[:, kept].T @ right) / values[kept])
    return found


def moved(pose: Float[np.ndarray, "4 4"], step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """A pose after a small motion in the world.

    Parameters
    ----------
    pose
        ``T_world_camera`` (4, 4).
    step
        Rotation vector [rad] and translation [m].
    """
    found = np.eye(4)
    turn = so3_exp(step[:3])
    found[:3, :3] = turn @ pose[:3, :3]
    found[:3, 3] = turn @ pose[:3, 3] + step[3:]
    return found
