"""Projection of moving geometry to polygons in one frame of a rolling shutter.

Symbols: K key times spread over the readout of a frame, n points, m pixels of
a polygon. Arrays of points carry their state at all keys, shape (n, K, 3), in
the camera frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Float32, Int

from ...core import Camera, Pose

#: Nothing nearer to the camera than this is drawn [m].
NEAR_M = 0.02

#: Polygons are clipped this far outside the image, in parts of its half size.
MARGIN = 0.1

#: Length of straight pieces of a line that the lens or motion bends [px]; their sagitta
#: is below 1e-3 px for any lens with less than 50 px of distortion.
PIECE_PX = 8.0


@dataclass(frozen=True, eq=False)
class RollingView:
    """A camera during one frame.

    Row v is exposed at its own time; a point whose pixel moves as ``u(v)`` is
    seen where ``v = u_y(v)``. The pixel is interpolated over the keys by cubics.
    """

    camera: Camera
    poses_camera_foam: tuple[Pose, ...]  #: at each key
    key_rows: Float[np.ndarray, "K"]  #: evenly spaced rows whose exposures are the keys

    @property
    def keys(self) -> int:
        """Number of keys; 1 when nothing moves."""
        return len(self.poses_camera_foam)

    @property
    def bends(self) -> bool:
        """Whether straight lines in space can be curved in the image."""
        return self.keys > 1 or bool(self.camera.distortion.any())

    @property
    def centre_foam_m(self) -> Float[np.ndarray, "3"]:
        """Optical centre in frame F in the middle of the frame."""
        return self.poses_camera_foam[self.keys // 2].inverse().translation_m

    @cached_property
    def _rotations(self) -> Float[np.ndarray, "K 3 3"]:
        return np.array([pose.rotation for pose in self.poses_camera_foam])

    @cached_property
    def _translations_m(self) -> Float[np.ndarray, "K 3"]:
        return np.array([pose.translation_m for pose in self.poses_camera_foam])

    @cached_property
    def _row_weights(self) -> Float[np.ndarray, "rows K"]:
        return self.weights(np.arange(self.camera.height))

    def to_camera(self, points_foam_m: Float[np.ndarray, "n K 3"]) -> Float[np.ndarray, "n K 3"]:
        """Points in the camera frame at each key.

        Parameters
        ----------
        points_foam_m
            Points (n, K, 3) in frame F at each key [m].
        """
        return np.einsum("kij,nkj->nki", self._rotations, points_foam_m) + self._translations_m

    def weights(self, rows: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m K"]:
        """Cubic interpolation over the keys at image rows (Lagrange, four nearest keys).

        Parameters
        ----------
        rows
            Image rows (m) [px].
        """
        rows = np.asarray(rows, dtype=np.float64)
        if self.keys == 1:
            return np.ones((len(rows), 1))
        spacing = self.key_rows[1] - self.key_rows[0]
        x = np.nan_to_num((rows - self.key_rows[0]) / spacing)
        x = np.clip(x, -0.5, self.keys - 0.5)
        first = np.clip(np.floor(x).astype(int) - 1, 0, self.keys - 4)
        x = x - first
        result = np.zeros((len(rows), self.keys))
        at = np.arange(len(rows))
        result[at, first] = -(x - 1) * (x - 2) * (x - 3) / 6
        result[at, first + 1] = x * (x - 2) * (x - 3) / 2
        result[at, first + 2] = -x * (x - 1) * (x - 3) / 2
        result[at, first + 3] = x * (x - 1) * (x - 2) / 6
        return result

    def pixels(self, points_camera_m: Float[np.ndarray, "n K 3"]) -> Float[np.ndarray, "n 2"]:
        """Image positions of points in the frame; NaN outside the view and its margin.

        Parameters
        ----------
        points_camera_m
            Points (n, K, 3) in the camera frame at each key [m].
        """
        inside = np.asarray(self._inside(points_camera_m) >= 0).all(axis=0)
        points = np.where(inside.reshape(-1, 1, 1), points_camera_m, np.nan)
        return self._seen(points)

    def _seen(self, points_camera_m: np.ndarray) -> np.ndarray:
        each = self.camera.project(points_camera_m)
        if self.keys == 1:
            return each[:, 0]
        seen = each[:, self.keys // 2]
        # Contracts by (speed of the image) x (row delay), far below 0.1 per iteration.
        for _ in range(8):
            seen = np.einsum("nk,nkd->nd", self.weights(seen[:, 1]), each)
        return seen

    def polyline(self, points_foam_m: Float[np.ndarray, "n K 3"]) -> Float[np.ndarray, "m 2"]:
        """Pixels of an open line, with points added where it is curved in the image.

        Parameters
        ----------
        points_foam_m
            Points (n, K, 3) in frame F at each key [m].
        """
        points = self.to_camera(points_foam_m)
        last = len(points) - 1
        return self.pixels(self._divided(points, np.minimum(np.arange(1, last + 2), last))[0])

    def polygon(self, corners_foam_m: Float[np.ndarray, "n K 3"]) -> Float[np.ndarray, "m 2"]:
        """Pixels of a polygon, clipped at the border of the view; (0, 2) if nothing is left.

        Parameters
        ----------
        corners_foam_m
            Corners (n, K, 3) in frame F at each key [m].
        """
        return self.polygons([corners_foam_m])[0]

    def polygons(
        self, corners_foam_m: Sequence[Float[np.ndarray, "n K 3"]]
    ) -> list[Float[np.ndarray, "m 2"]]:
        """Pixels of each polygon as of :meth:`polygon`; faster for many of a few corners than one by one.

        Parameters
        ----------
        corners_foam_m
            Corners (n, K, 3) of each polygon in frame F at each key [m].
        """
        if not corners_foam_m:
            return []
        points = self.to_camera(np.concatenate(corners_foam_m))
        cuts = np.cumsum([len(corners) for corners in corners_foam_m])[:-1]
        outside = np.split((self._inside(points) < 0).any(axis=0), cuts)
        parts = [
            self._clipped(part) if beyond.any() else part
            for part, beyond in zip(np.split(points, cuts), outside, strict=True)
        ]
        sizes = [len(part) if len(part) >= 3 else 0 for part in parts]
        ends = np.cumsum(sizes)
        after = np.arange(1, ends[-1] + 1)
        for size, end in zip(sizes, ends, strict=True):
            after[end - size : end][-1:] = end - size
        points = np.concatenate([part[:size] for part, size in zip(parts, sizes, strict=True)])
        points, pieces = self._divided(points, after)
        return np.split(self._seen(points), np.append(0, np.cumsum(pieces))[ends[:-1]])

    def plane_matrices(
        self,
        origin_foam_m: Float[np.ndarray, "K 3"],
        along_a: Float[np.ndarray, "K 3"],
        along_b: Float[np.ndarray, "K 3"],
    ) -> Float[np.ndarray, "rows 3 3"]:
        """Matrices from rays (x, y, 1) to plane coordinates (a, b, 1) up to scale, per image row.

        Parameters
        ----------
        origin_foam_m
            Origin of the plane (K, 3) in frame F [m].
        along_a, along_b
            Its unit vectors (K, 3).
        """
        turn = self._rotations
        a, b = np.einsum("kij,kj->ki", turn, along_a), np.einsum("kij,kj->ki", turn, along_b)
        origin = np.einsum("kij,kj->ki", turn, origin_foam_m) + self._translations_m
        # Inverse of the columns (a, b, origin) times the size of its determinant: finite for a plane seen edge-on.
        rows = np.stack([_cross(b, origin), _cross(origin, a), _cross(a, b)], axis=1)
        rows[np.einsum("ki,ki->k", a, rows[:, 0]) < 0] *= -1
        return rows if self.keys == 1 else np.einsum("rk,kij->rij", self._row_weights, rows)

    def _inside(self, points_camera_m: np.ndarray) -> np.ndarray:
        """Distances (5, n) to the borders of the view at the middle key; negative is outside."""
        x, y, z = points_camera_m[:, self.keys // 2].T
        low, high = _ray_limits(self.camera)
        return np.array([z - NEAR_M, x - low[0] * z, high[0] * z - x, y - low[1] * z, high[1] * z - y])

    def _clipped(self, points: np.ndarray) -> np.ndarray:
        inside = self._inside(points)
        beyond = inside < 0
        if beyond.all(axis=1).any():
            return points[:0]
        for count, border in enumerate(np.flatnonzero(beyond.any(axis=1))):
            points = cut_polygon(points, self._inside(points)[border] if count else inside[border])
            if len(points) < 3:
                break
        return points

    def _divided(
        self, points: Float[np.ndarray, "n K 3"], after: Int[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "m K 3"], Int[np.ndarray, "n"]]:
        """Points with more between each and the one that follows it, and the number of pieces there."""
        if not self.bends:
            return points, np.ones(len(points), np.int64)
        pixels = self.camera.project(points[:, self.keys // 2])
        lengths = np.nan_to_num(np.linalg.norm(pixels[after] - pixels, axis=1))
        pieces = np.clip(np.ceil(lengths / PIECE_PX), 1, 1000).astype(np.int64)
        index = np.repeat(np.arange(len(points)), pieces)
        within = np.arange(len(index)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        fraction = (within / pieces[index])[:, None, None]
        return points[index] * (1 - fraction) + points[after[index]] * fraction, pieces


@lru_cache(maxsize=16)
def _ray_limits(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest normalised ray (x, y) of the view and its margin."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 17), np.linspace(-0.5, camera.height - 0.5, 17))
    rays = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))[:, :2]
    low, high = rays.min(axis=0), rays.max(axis=0)
    margin = 0.5 * MARGIN * (high - low)
    return low - margin, high + margin


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (K, 3) of vectors; :func:`numpy.cross` takes several times as long for a few."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def cut_polygon(points: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Part of a polygon where a linear function of its points is not negative (Sutherland, Hodgman 1974).

    ``points`` (n, ...) may carry any attributes, which are interpolated; disconnected
    parts stay joined by lines without area.

    Parameters
    ----------
    points
        Corners with any attributes, (n, ...).
    inside
        Values of the function at the corners, (n,).
    """
    keep = inside >= 0
    if keep.all():
        return points
    if not keep.any():
        return points[:0]
    kept, cut = np.flatnonzero(keep), np.flatnonzero(keep != following(keep))
    start, end = inside[cut], inside[(cut + 1) % len(inside)]
    fraction = (start / (start - end)).reshape(-1, *([1] * (points.ndim - 1)))
    cuts = points[cut] + fraction * (points[(cut + 1) % len(points)] - points[cut])
    # Each cut comes after the point at which its edge starts.
    order = np.argsort(np.concatenate([2 * kept, 2 * cut + 1]))
    return np.concatenate([points[kept], cuts])[order]


def following(points: np.ndarray) -> np.ndarray:
    """The next point of each point of a polygon.

    Parameters
    ----------
    points
        Corners in order, (n, ...).
    """
    return np.concatenate([points[1:], points[:1]])


def ray_table(camera: Camera) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h2 w2"]]:
    """x and y of the rays of all pixels, each (H, W); (1, W) and (H, 1) when the lens does not distort.

    Parameters
    ----------
    camera
        Lens and size of the image.
    """
    grid = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    x, y = (
        np.ascontiguousarray(part, np.float32)
        for part in np.moveaxis(camera.rays(np.stack(grid, 2)), 2, 0)[:2]
    )
    upright = not camera.distortion.any() and camera.matrix[0, 1] == 0
    return (x[:1].copy(), y[:, :1].copy()) if upright else (x, y)
