"""Surface fusion: depth views averaged into truncated signed distances, and their zero surface.

A voxel holds the mean over the views of the distance to the seen surface
along the optical axis, divided by the band width and cut to [-1, 1], positive
towards the camera, with the sum of the weights (Curless and Levoy 1996; the
volume that KinectFusion integrates, Alt 2016, Sec. 2.2.1 and 5.3).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int

from ..camera import Camera, Pose
from ..errors import InputError
from ..recording.depth_sequence import DepthFrame
from . import _fusion_kernels as kernels
from .mesh import SurfaceMesh

__all__ = ["SparseTsdfVolume", "TsdfVolume"]

#: Grids with more voxels are refused before memory is taken.
MAX_VOXELS = 1 << 30


class TsdfVolume:
    """A dense grid of truncated signed distances; its arrays may be read and set.

    Parameters
    ----------
    origin_m
        Place of voxel (0, 0, 0) in the world [m].
    shape
        Number of voxels along x, y, z.
    voxel_m
        Distance between voxels [m].
    truncation_m
        Half width of the band around the surface [m]; 4 voxels by default.
    max_weight
        Weights stop here, so that the volume follows a scene that changes.
    color
        Whether to average colour as well.

    Attributes
    ----------
    distance
        float32, in units of ``truncation_m``; 1 where nothing was seen.
    weight
        float32; 0 where nothing was seen.
    color
        float32 (x, y, z, 3), blue, green, red 0..255, or ``None``.
    """

    def __init__(
        self,
        origin_m: Float[np.ndarray, "3"],
        shape: tuple[int, int, int],
        voxel_m: float = 0.005,
        *,
        truncation_m: float | None = None,
        max_weight: float = 64.0,
        color: bool = True,
    ) -> None:
        if len(shape) != 3 or min(shape) < 2 or np.prod(shape, dtype=np.float64) > MAX_VOXELS:
            raise InputError(
                "TsdfVolume",
                f"found {shape}, expected three sizes, at most {MAX_VOXELS} voxels",
                field="shape",
            )
        self.voxel_m, self.truncation_m = _checked_sizes(voxel_m, truncation_m)
        self.origin_m: Float[np.ndarray, "3"] = np.asarray(origin_m, dtype=np.float64).reshape(3)
        self.max_weight = float(max_weight)
        self.distance: Float32[np.ndarray, "x y z"] = np.ones(shape, dtype=np.float32)
        self.weight: Float32[np.ndarray, "x y z"] = np.zeros(shape, dtype=np.float32)
        self.color: Float32[np.ndarray, "x y z 3"] | None = (
            np.zeros((*shape, 3), dtype=np.float32) if color else None
        )
        self.views = 0  #: how many were integrated

    @classmethod
    def around(
        cls,
        low_m: Float[np.ndarray, "3"],
        high_m: Float[np.ndarray, "3"],
        voxel_m: float = 0.005,
        **more: float,
    ) -> TsdfVolume:
        """A volume that holds the box from ``low_m`` to ``high_m``."""
        low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
        shape = np.ceil((high - low) / voxel_m - 1e-9).astype(int) + 1
        return cls(low, (int(shape[0]), int(shape[1]), int(shape[2])), voxel_m, **more)  # type: ignore[arg-type]

    def integrate(self, frame: DepthFrame, weight: float = 1.0) -> None:
        """Average a view into the grid; NaN depths say nothing."""
        view = _View(frame, self.color is not None)
        origin, steps = view.grid(self.origin_m, self.voxel_m)
        kernels.fuse_dense(
            self.distance,
            self.weight,
            self.color if self.color is not None else _NO_COLOR,
            view.use_color,
            origin,
            steps,
            view.intrinsics,
            view.depth,
            view.image,
            *view.tiles(),
            np.float32(self.truncation_m),
            np.float32(weight),
            np.float32(self.max_weight),
        )
        self.views += 1

    def mesh(self, least_weight: float = 1.0) -> SurfaceMesh:
        """The zero surface between voxels of at least this weight, in the world [m].

        Raises
        ------
        InputError
            No surface was seen.
        """
        bricks = [-(-(n - 1) // kernels.BRICK) for n in self.distance.shape]
        places = np.zeros((int(np.prod(bricks)), 3), dtype=np.int64)
        least = np.float32(max(least_weight, 1e-6))
        count = kernels.active_cells(self.distance, self.weight, least, places)
        places = places[:count]
        side, tiled, known = _cube_of_tiles(count)
        kernels.gather_cells(self.distance, self.weight, least, places, side, tiled, known)
        vertices, faces = _brick_surface(tiled, known, places)
        colors = None
        if self.color is not None:
            near = np.rint(vertices).astype(np.int64)
            near = np.minimum(near, np.array(self.distance.shape) - 1)
            bgr = self.color[near[:, 0], near[:, 1], near[:, 2]]
            colors = np.clip(np.rint(bgr[:, ::-1]), 0, 255).astype(np.uint8)
        return SurfaceMesh(vertices * self.voxel_m + self.origin_m, faces, colors)


class SparseTsdfVolume:
    """Truncated signed distances in bricks of 8 x 8 x 8 voxels, made where surfaces are seen.

    For spaces too large for a dense grid. Free space far from surfaces is not
    stored: what moved away is forgotten only while its own bricks are seen.

    Parameters
    ----------
    voxel_m, truncation_m, max_weight, color
        As of :class:`TsdfVolume`.
    max_bricks
        Bricks beyond this are refused (4 kB each, 10 kB with colour).
    """

    def __init__(
        self,
        voxel_m: float = 0.005,
        *,
        truncation_m: float | None = None,
        max_weight: float = 64.0,
        color: bool = True,
        max_bricks: int = 200_000,
    ) -> None:
        self.voxel_m, self.truncation_m = _checked_sizes(voxel_m, truncation_m)
        self.max_weight = float(max_weight)
        self.max_bricks = max_bricks
        self._rows: dict[tuple[int, int, int], int] = {}
        b = kernels.BRICK
        self._places: Int[np.ndarray, "n 3"] = np.zeros((0, 3), dtype=np.int64)
        self._distance: Float32[np.ndarray, "n 8 8 8"] = np.zeros((0, b, b, b), dtype=np.float32)
        self._weight: Float32[np.ndarray, "n 8 8 8"] = np.zeros((0, b, b, b), dtype=np.float32)
        self._color: Float32[np.ndarray, "n 8 8 8 3"] = np.zeros((0, b, b, b, 3), dtype=np.float32)
        self._use_color = color
        self.views = 0

    @property
    def bricks(self) -> int:
        """How many bricks there are."""
        return len(self._rows)

    def integrate(self, frame: DepthFrame, weight: float = 1.0) -> None:
        """Make the bricks near the seen surface, and average the view into all bricks in sight.

        Raises
        ------
        InputError
            The space would need more than ``max_bricks`` bricks.
        """
        view = _View(frame, self._use_color)
        self._make_bricks(view)
        origin, steps = view.grid(np.zeros(3), self.voxel_m)
        places = self._places[: self.bricks]
        # Bricks whose middle is within the picture, with room for half a diagonal.
        half_m = kernels.BRICK * self.voxel_m / 2
        middles = view.pose_camera_world.apply(places * (2 * half_m) + half_m)
        room_m = np.sqrt(3) * half_m
        fx, fy, cx, cy = (float(value) for value in view.intrinsics)
        z = np.maximum(middles[:, 2], 1e-6)
        room_px = room_m / z * max(fx, fy) + 1
        u, v = fx * middles[:, 0] / z + cx, fy * middles[:, 1] / z + cy
        rows, columns = view.depth.shape
        seen = (middles[:, 2] > -room_m) & (u > -room_px) & (u < columns + room_px)
        seen &= (v > -room_px) & (v < rows + room_px)
        kernels.fuse_bricks(
            self._distance,
            self._weight,
            self._color,
            view.use_color,
            places,
            np.flatnonzero(seen),
            origin,
            steps,
            view.intrinsics,
            view.depth,
            view.image,
            np.float32(self.truncation_m),
            np.float32(weight),
            np.float32(self.max_weight),
        )
        self.views += 1

    def _make_bricks(self, view: _View) -> None:
        """New bricks within the band along the rays of the view."""
        rows, columns = np.nonzero(np.isfinite(view.depth))
        if not len(rows):
            return
        z = view.depth[rows, columns].astype(np.float64)
        fx, fy, cx, cy = (float(value) for value in view.intrinsics)
        rays = np.column_stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(len(z))])
        edge_m = kernels.BRICK * self.voxel_m
        found = []
        count = max(2, int(np.ceil(2 * self.truncation_m / edge_m)) + 1)
        for shift_m in np.linspace(-self.truncation_m, self.truncation_m, count):
            points = view.pose_camera_world.inverse().apply(rays * (z + shift_m)[:, None])
            found.append(np.floor(points / edge_m).astype(np.int64))
        keys = np.unique(np.concatenate(found) @ np.array([1 << 42, 1 << 21, 1]))
        low = ((keys + (1 << 20)) & ((1 << 21) - 1)) - (1 << 20)
        rest = (keys - low) >> 21
        middle = ((rest + (1 << 20)) & ((1 << 21) - 1)) - (1 << 20)
        high = (rest - middle) >> 21
        fresh = [
            place
            for place in zip(high.tolist(), middle.tolist(), low.tolist(), strict=True)
            if place not in self._rows
        ]
        total = self.bricks + len(fresh)
        if total > self.max_bricks:
            raise InputError(
                "SparseTsdfVolume",
                f"needs {total} bricks of {edge_m:.3g} m, expected at most {self.max_bricks}",
                remedy="use larger voxels or raise max_bricks",
            )
        self._reserve(total)
        for place in fresh:
            self._places[self.bricks] = place
            self._rows[place] = self.bricks

    def _reserve(self, total: int) -> None:
        have = len(self._places)
        if total <= have:
            return
        more = max(total, 2 * have, 256) - have
        b = kernels.BRICK
        self._places = np.concatenate([self._places, np.zeros((more, 3), np.int64)])
        self._distance = np.concatenate([self._distance, np.ones((more, b, b, b), np.float32)])
        self._weight = np.concatenate([self._weight, np.zeros((more, b, b, b), np.float32)])
        if self._use_color:
            self._color = np.concatenate([self._color, np.zeros((more, b, b, b, 3), np.float32)])
        else:
            self._color = np.broadcast_to(_NO_COLOR[None], (have + more, 1, 1, 1, 3)).copy()

    def mesh(self, least_weight: float = 1.0) -> SurfaceMesh:
        """The zero surface, in the world [m]; as :meth:`TsdfVolume.mesh`."""
        b, count = kernels.BRICK, self.bricks
        rows_of_cells = np.ones((count, b + 1, b + 1, b + 1), dtype=np.float32)
        known_of_cells = np.zeros(rows_of_cells.shape, dtype=np.bool_)
        seen = self._weight[:count] >= max(least_weight, 1e-6)
        for corner in np.ndindex(2, 2, 2):
            rows = np.arange(count)
            other = rows
            if any(corner):
                keys = (self._places[:count] + corner).tolist()
                other = np.array([self._rows.get((k[0], k[1], k[2]), -1) for k in keys], dtype=np.int64)
            rows, other = rows[other >= 0], other[other >= 0]
            x, y, z = (slice(b, b + 1) if c else slice(0, b) for c in corner)
            i, j, k = (slice(0, 1) if c else slice(0, b) for c in corner)
            rows_of_cells[rows, x, y, z] = self._distance[other, i, j, k]
            known_of_cells[rows, x, y, z] = seen[other, i, j, k]
        low = np.where(known_of_cells, rows_of_cells, np.inf).min(axis=(1, 2, 3))
        high = np.where(known_of_cells, rows_of_cells, -np.inf).max(axis=(1, 2, 3))
        crossed = np.flatnonzero((low < 0) & (high >= 0))
        side, tiled, known = _cube_of_tiles(len(crossed))
        for n, row in enumerate(crossed):
            at = tuple(
                slice(q * (b + 1), (q + 1) * (b + 1)) for q in (n // side**2, n // side % side, n % side)
            )
            tiled[at[0], at[1], at[2]] = rows_of_cells[row]
            known[at[0], at[1], at[2]] = known_of_cells[row]
        vertices, faces = _brick_surface(tiled, known, self._places[crossed] * b)
        return SurfaceMesh(vertices * self.voxel_m, faces)


_NO_COLOR: Float32[np.ndarray, "1 1 1 3"] = np.zeros((1, 1, 1, 3), dtype=np.float32)


def _checked_sizes(voxel_m: float, truncation_m: float | None) -> tuple[float, float]:
    if not (np.isfinite(voxel_m) and voxel_m > 0):
        raise InputError("TsdfVolume", f"found {voxel_m}, expected > 0", field="voxel_m")
    band_m = 4 * voxel_m if truncation_m is None else truncation_m
    if not (np.isfinite(band_m) and band_m >= voxel_m):
        raise InputError(
            "TsdfVolume", f"found {band_m}, expected at least one voxel ({voxel_m})", field="truncation_m"
        )
    return float(voxel_m), float(band_m)


class _View:
    """A frame as the kernels take it: pinhole pixels, float32."""

    def __init__(self, frame: DepthFrame, color: bool) -> None:
        camera = frame.camera
        depth, image = frame.depth_m, frame.color
        if camera.distortion.any() or camera.matrix[0, 1]:
            depth, image = _undistorted(camera, depth, image)
        k = camera.matrix
        self.depth: Float32[np.ndarray, "rows columns"] = np.ascontiguousarray(depth, dtype=np.float32)
        self.use_color = color and image is not None
        self.image = np.ascontiguousarray(image) if image is not None else np.zeros((1, 1, 3), np.uint8)
        self.intrinsics: Float32[np.ndarray, "4"] = np.array(
            [k[0, 0], k[1, 1], k[0, 2], k[1, 2]], dtype=np.float32
        )
        self.pose_camera_world: Pose = frame.pose_world_camera.inverse()

    def grid(
        self, origin_m: Float[np.ndarray, "3"], voxel_m: float
    ) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3 3"]]:
        """First voxel and the steps along x, y, z in the camera frame."""
        origin = self.pose_camera_world.apply(origin_m)
        return origin.astype(np.float32), (self.pose_camera_world.rotation.T * voxel_m).astype(np.float32)

    def tiles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Range of the depth in each tile of the picture."""
        shape = tuple(-(-n // kernels.TILE) for n in self.depth.shape)
        low, high = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        holes = np.zeros(shape, np.uint8)
        kernels.tile_ranges(self.depth, low, high, holes)
        return low, high, holes


def _undistorted(
    camera: Camera, depth: np.ndarray, image: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Pixels of the ideal camera; depth from the nearest pixel, so that edges are not mixed."""
    import cv2

    matrix = camera.matrix.copy()
    matrix[0, 1] = 0.0
    x, y = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, None, matrix, (camera.width, camera.height), cv2.CV_32FC1
    )
    depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderValue=float("nan"))
    if image is not None:
        image = cv2.remap(image, x, y, cv2.INTER_LINEAR)
    return depth, image


def _cube_of_tiles(count: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Room for bricks side by side: tiles along an edge, values, and which of them are known.

    A cube rather than a row, because the coordinates that come back are
    float32 and must stay small.
    """
    side = max(1, int(np.ceil(np.cbrt(count))))
    side += side**3 < count
    layers = -(-count // side**2)
    edge = kernels.BRICK + 1
    shape = (layers * edge, side * edge, side * edge)
    return side, np.ones(shape, dtype=np.float32), np.zeros(shape, dtype=np.bool_)


def _brick_surface(
    tiled: Float32[np.ndarray, "x y z"], known: np.ndarray, places: Int[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Marching cubes over bricks side by side; vertices in voxels, joined where bricks meet."""
    from skimage.measure import marching_cubes

    if not known.any() or not (tiled[known].min() < 0 <= tiled[known].max()):
        raise InputError("TsdfVolume", "no surface was seen", remedy="integrate views of the volume first")
    edge = kernels.BRICK + 1
    # A cell counts when all its corners are known and it is inside one brick.
    cell = known
    for axis in range(3):
        along = np.moveaxis(cell, axis, 0)
        cell = np.moveaxis(along[:-1] & along[1:], 0, axis)
    cell[edge - 1 :: edge] = False
    cell[:, edge - 1 :: edge] = False
    cell[:, :, edge - 1 :: edge] = False
    mask = np.zeros(known.shape, dtype=np.bool_)
    mask[1:, 1:, 1:] = cell  # skimage asks the mask at the upper corner of a cell
    try:
        # Distances fall towards the inside: triangles are counter-clockwise from the seen side.
        vertices, faces, _, _ = marching_cubes(tiled, 0.0, mask=mask, gradient_direction="descent")
    except (RuntimeError, ValueError) as error:
        raise InputError("TsdfVolume", f"no surface was seen ({error})") from error
    side = tiled.shape[1] // edge
    return _welded(vertices.astype(np.float64), faces.astype(np.int64), places, edge, side)


def _welded(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    places: Int[np.ndarray, "n 3"],
    edge: int,
    side: int,
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices put to the place of their brick; those of one edge of the grid become one."""
    # Cells between bricks are masked, so that a vertex is never beyond its own brick.
    tile = (vertices // edge).astype(np.int64)
    vertices -= tile * edge
    border = np.flatnonzero(((vertices == 0) | (vertices == edge - 1)).any(axis=1))
    vertices += places[(tile[:, 0] * side + tile[:, 1]) * side + tile[:, 2]]
    # A vertex lies on one edge of the grid, named by its lower end and its direction.
    low = np.floor(vertices[border]).astype(np.int64)
    along = vertices[border] - low > 0
    axis = np.where(along.any(axis=1), along.argmax(axis=1), 3)
    low -= low.min(axis=0, initial=0)
    packed = ((low[:, 0] << 20 | low[:, 1]) << 20 | low[:, 2]) << 2 | axis
    _, first, where = np.unique(packed, return_index=True, return_inverse=True)
    to = np.arange(len(vertices))
    to[border] = border[first[where]]
    kept = np.flatnonzero(to == np.arange(len(vertices)))
    number = np.zeros(len(vertices), dtype=np.int64)
    number[kept] = np.arange(len(kept))
    faces = number[to[faces]]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[kept], faces[whole]
