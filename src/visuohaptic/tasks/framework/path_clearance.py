"""Clearance of a tool on a straight motion from known obstacles: fused surfaces, maps, points.

The tool is a set of capsules in the frame of the tip. Obstacles are surfaces, sampled so densely that no point of the
surface is farther than 0.58 ``resolution_m`` from a sample (SciPy's k-d tree finds the nearest one). The
motion is checked by conservative advancement (Mirtich 1996): at distance d no point of the tool can collide before it
has moved by d, so the next configuration that is checked is the one after that motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import InputError, Pose
from ...reconstruction.mesh import SurfaceMesh

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within a radius of a line segment, in the frame of the tip."""

    start_m: Point
    end_m: Point
    radius_m: float


@dataclass(frozen=True, slots=True)
class PathClearance:
    """Smallest clearance of a motion."""

    #: smallest distance between tool and obstacles on the checked part [m]; negative: depth inside the tool
    clearance_m: float
    fraction: float  #: fraction of the path at which the clearance is smallest
    point_m: Point  #: nearest obstacle point there [m]
    free: bool  #: whether the clearance stays above the required one, or above that at the start

    def __str__(self) -> str:
        where = ", ".join(f"{value:.3f}" for value in self.point_m)
        return (
            f"{1e3 * self.clearance_m:.0f} mm from ({where}) m after {100 * self.fraction:.0f} % of the path"
        )


class KnownObstacles:
    """Obstacles of the tool of an arm, in the base frame of the arm.

    Parameters
    ----------
    tool
        Capsules of the tool.
    surfaces
        Meshes, or points (n, 3) [m].
    keep_m
        Required clearance [m].
    resolution_m
        Resolution of the surface samples and of the axes of the tool [m]: the reported clearance is less than the true
        one by at most this.

    Raises
    ------
    InputError
        A distance is not positive, or there is no capsule.

    Examples
    --------
    A ball of 1 cm on a line 5 cm above a table:

    >>> table = SurfaceMesh(
    ...     np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]) * 0.3, np.array([[0, 1, 2]])
    ... )
    >>> known = KnownObstacles((Capsule((0, 0, 0), (0, 0, 0), 0.01),), [table])
    >>> ends = [Pose(np.eye(3), np.array([x, 0.0, 0.05])) for x in (-0.2, 0.2)]
    >>> found = known.along(*ends)
    >>> found.free, abs(found.clearance_m - 0.04) < 0.0025
    (True, True)
    """

    def __init__(
        self,
        tool: Sequence[Capsule],
        surfaces: Iterable[SurfaceMesh | Float[np.ndarray, "n 3"]],
        keep_m: float = 0.005,
        resolution_m: float = 0.002,
    ) -> None:
        from scipy.spatial import cKDTree

        if not (keep_m > 0 and resolution_m > 0 and tool):
            raise InputError(
                "KnownObstacles",
                f"found {len(tool)} capsules, {keep_m} m and {resolution_m} m, expected one or more, and more than 0",
            )
        self.keep_m, self.resolution_m = keep_m, resolution_m
        points = [_dense(surface, resolution_m) for surface in surfaces]
        self._points = np.concatenate([np.zeros((0, 3)), *points])
        self._tree = cKDTree(self._points)
        self._axes: list[tuple[Float[np.ndarray, "k 3"], float]] = []
        for capsule in tool:
            start, end = np.array(capsule.start_m, dtype=float), np.array(capsule.end_m, dtype=float)
            count = math.ceil(2.0 * float(np.linalg.norm(end - start)) / resolution_m) + 1
            axis = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
            self._axes.append((axis, capsule.radius_m))

    def along(self, T_base_start: Pose, T_base_end: Pose) -> PathClearance:
        """Check the motion of the tip from one pose to another, with linear position and uniform rotation.

        Parameters
        ----------
        T_base_start, T_base_end
            Poses of the tip in the base frame of the arm.
        """
        if not len(self._points):
            return PathClearance(math.inf, 0.0, (math.nan,) * 3, True)
        way = T_base_end.translation_m - T_base_start.translation_m
        reach_m = max(float(np.linalg.norm(axis, axis=1).max()) for axis, _ in self._axes)
        # Upper bound of the distance that any point of the tool moves on the whole path.
        length_m = float(np.linalg.norm(way)) + T_base_start.angle_to(T_base_end) * reach_m
        fraction, nearest, first_m = 0.0, PathClearance(math.inf, 0.0, (math.nan,) * 3, True), math.nan
        while True:
            distance_m, point = self._distance(T_base_start.interpolated(T_base_end, fraction))
            first_m = distance_m if math.isnan(first_m) else first_m
            if distance_m < nearest.clearance_m:
                # An obstacle that is near at the start may be left, but not approached.
                free = distance_m >= min(self.keep_m, first_m - self.resolution_m)
                nearest = PathClearance(distance_m, fraction, point, free)
            if not nearest.free or fraction >= 1.0:
                return nearest
            # No obstacle can be nearer than the clearance found so far before this step, up to the resolution.
            step_m = distance_m - nearest.clearance_m + self.resolution_m
            fraction = min(1.0, fraction + step_m / max(length_m, 1e-12))

    def _distance(self, pose: Pose) -> tuple[float, Point]:
        """Distance of the tool from the obstacles at a pose (a lower bound), and the nearest obstacle point."""
        best_m, best = math.inf, 0
        for axis, radius_m in self._axes:
            far, index = self._tree.query(pose.apply(axis))
            at = int(np.argmin(far))
            # Errors: a quarter of the resolution along the axis, and e / sqrt(3) in a triangle with longest edge e.
            distance_m = float(far[at]) - radius_m - self.resolution_m
            if distance_m < best_m:
                best_m, best = distance_m, int(index[at])
        x, y, z = (float(value) for value in self._points[best])
        return best_m, (x, y, z)


def _dense(surface: SurfaceMesh | Float[np.ndarray, "n 3"], resolution_m: float) -> Float[np.ndarray, "m 3"]:
    """Sample a surface with a spacing of the resolution."""
    if not isinstance(surface, SurfaceMesh):
        return np.asarray(surface, dtype=np.float64).reshape(-1, 3)
    corners = surface.vertices_m[surface.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    steps = np.maximum(np.ceil(edges / resolution_m), 1).astype(int)
    found = [surface.vertices_m]
    for count in np.unique(steps):
        u, v = np.meshgrid(np.arange(count + 1), np.arange(count + 1))
        inside = u + v <= count
        weights = np.column_stack([u[inside], v[inside], count - u[inside] - v[inside]]) / count
        found.append(np.einsum("kc,fcd->fkd", weights, corners[steps == count]).reshape(-1, 3))
    return np.concatenate(found)
