"""Surface fusion: depth views averaged into truncated signed distances, and extraction of their zero level set.

A voxel stores the weighted mean over the views of the distance to the observed surface
along the optical axis, divided by the band width and clipped to 1, positive
towards the camera, and the sum of the weights (Curless and Levoy 1996; the
volume of KinectFusion, Alt 2016, Sec. 2.2.1 and 5.3). Behind the band, down to four
voxels, a view counts only where no other one does: so oblique surfaces have no holes.
Voxels are stored in bricks of 8 x 8 x 8 where a view may see a surface; free space far from surfaces is not stored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ..mesh import SurfaceMesh
from . import _fusion_kernels as kernels
from ._brick_surface import brick_surface, cube_of_tiles
from ._fusion_view import FusionView, checked_sizes

#: Voxels of a brick, as stored: cubes and voxels of a cube.
_CUBES, _VOXELS = (kernels.BRICK // kernels.CUBE) ** 3, kernels.CUBE**3
#: Maximum number of bricks in which a view is searched for surfaces, and of bricks along an axis: indices have 21 bits.
_MAX_BOX, _MAX_INDEX = 1 << 30, 1 << 20
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


class TsdfVolume:
    """Truncated signed distances in bricks of 8 x 8 x 8 voxels, allocated where surfaces are observed.

    An object that moved away is removed only while its own bricks are in view.

    Parameters
    ----------
    voxel_m
        Distance between voxels [m].
    low_m, high_m
        Lowest and highest corner of a box of the world to which the volume is limited [m]; a voxel is at the lowest.
    truncation_m
        Half width of the band around the surface [m]; 4 voxels by default.
    color
        Whether to average colour as well.
    max_bricks
        Maximum number of bricks (4 kB each, 10 kB with colour).

    Raises
    ------
    InputError
        A size is not positive, or the box has more than 2^30 voxels.
    """

    def __init__(
        self,
        voxel_m: float = 0.005,
        *,
        low_m: Float[np.ndarray, "3"] | None = None,
        high_m: Float[np.ndarray, "3"] | None = None,
        truncation_m: float | None = None,
        color: bool = True,
        max_bricks: int = 200_000,
    ) -> None:
        self.voxel_m, self.truncation_m, self.reach_m = checked_sizes(voxel_m, truncation_m)
        self.origin_m: Float[np.ndarray, "3"] = (
            np.zeros(3) if low_m is None else np.asarray(low_m, np.float64)
        )
        self.max_bricks = max_bricks
        self.views = 0  #: number of integrated views
        self._shape: Int[np.ndarray, "3"] | None = None
        if high_m is not None:
            self._shape = np.ceil((np.asarray(high_m) - self.origin_m) / voxel_m - 1e-9).astype(np.int64) + 1
            if self._shape.min() < 2 or self._shape.max() >= kernels.BRICK * _MAX_INDEX:
                raise InputError(
                    "TsdfVolume", f"found {self._shape} voxels, expected at least 2 along each axis"
                )
        self._places: Int[np.ndarray, "n 3"] = np.zeros((0, 3), dtype=np.int64)
        self._distance: Float32[np.ndarray, "n 8 64"] = np.zeros((0, _CUBES, _VOXELS), dtype=np.float32)
        self._weight: Float32[np.ndarray, "n 8 64"] = np.zeros_like(self._distance)
        self._color: Float32[np.ndarray, "n 8 64 3"] | None = (
            np.zeros((0, _CUBES, _VOXELS, 3), dtype=np.float32) if color else None
        )

    @classmethod
    def around(
        cls,
        low_m: Float[np.ndarray, "3"],
        high_m: Float[np.ndarray, "3"],
        voxel_m: float = 0.005,
        **more: Any,
    ) -> TsdfVolume:
        """Create a volume limited to a box of the world.

        Parameters
        ----------
        low_m, high_m
            Lowest and highest corner of the box, world [m].
        voxel_m
            Distance between voxels [m].
        more
            Further arguments of the volume.
        """
        return cls(voxel_m, low_m=low_m, high_m=high_m, **more)

    @property
    def bricks(self) -> int:
        """Number of allocated bricks."""
        return len(self._places)

    def integrate(self, frame: DepthFrame) -> None:
        """Allocate the bricks near the observed surface, and average the view into all bricks; pixels without depth change nothing.

        Parameters
        ----------
        frame
            Depth image with the pose of its camera.

        Raises
        ------
        InputError
            The view would need more than ``max_bricks`` bricks.
        """
        self.integrate_all([frame])

    def integrate_all(self, frames: Sequence[DepthFrame]) -> None:
        """Integrate views into the bricks near the surfaces that any of them sees, in any order.

        Parameters
        ----------
        frames
            Views of one camera.

        Raises
        ------
        InputError
            The views would need more than ``max_bricks`` bricks.
        """
        views = [FusionView(frame, self._color is not None) for frame in frames]
        tiles = [view.tiles() for view in views]
        for view, own in zip(views, tiles, strict=True):
            self._allocate(view, own)
        for view, own in zip(views, tiles, strict=True):
            self._fuse(view, own)

    def _allocate(self, view: FusionView, tiles: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Allocate the bricks in which the view may see a surface."""
        box = self._box(view)
        if box is None:
            return
        first, size = box
        marked = np.zeros(size, dtype=np.bool_)
        origin, steps, camera, depth, _ = view.seen_from(self.origin_m, self.voxel_m)
        # A margin of one voxel: the surface crosses cells next to the band.
        reach = np.float32(self.reach_m + math.sqrt(3) * self.voxel_m)
        kernels.mark_bricks(marked, first, origin, steps, camera, depth, *tiles, reach)
        found = np.argwhere(marked) + first
        fresh = found[_rows_of(self._places, found) < 0]
        if (total := self.bricks + len(fresh)) > self.max_bricks:
            edge_m = kernels.BRICK * self.voxel_m
            raise InputError(
                "TsdfVolume",
                f"needs {total} bricks of {edge_m:.3g} m, expected at most {self.max_bricks}",
                remedy="use larger voxels or raise max_bricks",
            )
        if len(fresh):
            shape = (len(fresh), _CUBES, _VOXELS)
            self._places = np.concatenate([self._places, fresh])
            self._distance = np.concatenate([self._distance, np.ones(shape, np.float32)])
            self._weight = np.concatenate([self._weight, np.zeros(shape, np.float32)])
            if self._color is not None:
                self._color = np.concatenate([self._color, np.zeros((*shape, 3), np.float32)])

    def _box(self, view: FusionView) -> tuple[np.ndarray, tuple[int, int, int]] | None:
        """First brick and numbers of bricks of a box around all that a view sees; ``None`` for a view of nothing."""
        if not np.isfinite(view.depth).any():
            return None
        fx, fy, cx, cy = (float(value) for value in view.intrinsics)
        rows, columns = view.depth.shape
        x, y = (np.array([-0.5, columns - 0.5]) - cx) / fx, (np.array([-0.5, rows - 0.5]) - cy) / fy
        far = np.array([[x[i], y[j], 1.0] for i, j in np.ndindex(2, 2)])
        ends = np.vstack([np.zeros(3), far * (float(np.nanmax(view.depth)) + self.reach_m)])
        around = view.T_camera_world.inverse().apply(ends) - self.origin_m
        edge_m = kernels.BRICK * self.voxel_m
        low = np.floor((around.min(axis=0) - self.reach_m) / edge_m - 1).astype(np.int64)
        high = np.ceil((around.max(axis=0) + self.reach_m) / edge_m + 1).astype(np.int64)
        if self._shape is not None:
            low, high = np.maximum(low, 0), np.minimum(high, -(-self._shape // kernels.BRICK))
        size = np.maximum(high - low, 0)
        if np.prod(size.astype(np.float64)) > _MAX_BOX or max(-low.min(), high.max()) >= _MAX_INDEX:
            raise InputError(
                "TsdfVolume",
                f"a view reaches over {size} bricks of {edge_m:.3g} m",
                remedy="use larger voxels",
            )
        return low, (int(size[0]), int(size[1]), int(size[2]))

    def _fuse(self, view: FusionView, tiles: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Integrate a view into the allocated bricks."""
        color = np.zeros((self.bricks, 1, 1, 3), np.float32) if self._color is None else self._color
        kernels.fuse_bricks(
            self._distance,
            self._weight,
            color,
            view.use_color,
            self._places,
            *view.seen_from(self.origin_m, self.voxel_m),
            *tiles,
            np.float32(self.truncation_m),
            np.float32(self.reach_m),
        )
        self.views += 1

    def mesh(self, min_weight: float = 1.0) -> SurfaceMesh:
        """Extract the zero level set by marching cubes, in the world [m].

        Parameters
        ----------
        min_weight
            Minimum weight of a voxel for extraction; with 0 also voxels that are observed only behind the band.

        Raises
        ------
        InputError
            No surface was observed.
        """
        seen = self._weight >= max(min_weight, 1e-6)
        # A brick contains the cells between its voxels and the first voxels of the next bricks.
        order = np.lexsort(self._places.T[::-1])
        beside = _rows_of(self._places, (self._places[order, None] + _CORNERS).reshape(-1, 3)).reshape(-1, 8)
        low = np.append(np.where(seen, self._distance, np.inf).min(axis=(1, 2)), np.inf)[beside].min(axis=1)
        high = np.append(np.where(seen, self._distance, -np.inf).max(axis=(1, 2)), -np.inf)[beside].max(
            axis=1
        )
        crossed = (low <= 0) & (high > 0)
        places, beside = self._places[order][crossed], beside[crossed]
        b, (values, known, tile) = kernels.BRICK, cube_of_tiles(len(places))
        used, beside = np.unique(beside, return_inverse=True)
        used, absent = used[used >= 0], np.count_nonzero(used < 0)
        distance, seen_bricks = _as_bricks(self._distance[used]), _as_bricks(seen[used])
        for corner, rows in zip(_CORNERS, beside.reshape(-1, 8).T - absent, strict=True):
            to: Any = tuple(slice(b, b + 1) if side else slice(0, b) for side in corner)
            of: Any = tuple(slice(0, 1) if side else slice(0, b) for side in corner)
            own = np.flatnonzero(rows >= 0)
            values[(*tile[:, own], *to)] = distance[(rows[own], *of)]
            known[(*tile[:, own], *to)] = seen_bricks[(rows[own], *of)]
        if self._shape is not None:
            for axis in range(3):
                over = places[:, axis, None] * b + np.arange(b + 1) >= self._shape[axis]
                brick, layer = np.nonzero(over)
                np.moveaxis(known, 3 + axis, 3)[(*tile[:, brick], layer)] = False
        np.copyto(values, 1.0, where=~known)
        vertices, faces = brick_surface(values, known, places * b, self.reach_m / self.truncation_m)
        return SurfaceMesh(vertices * self.voxel_m + self.origin_m, faces, self._colors(vertices))

    def _colors(self, vertices: Float[np.ndarray, "v 3"]) -> np.ndarray | None:
        """Red, green, blue of the voxels nearest to vertices; ``None`` without colour."""
        if self._color is None:
            return None
        near = np.rint(vertices).astype(np.int64)
        if self._shape is not None:
            near = np.minimum(near, self._shape - 1)
        row, (x, y, z) = _rows_of(self._places, near // kernels.BRICK), (near % kernels.BRICK).T
        cube, half = kernels.CUBE, kernels.BRICK // kernels.CUBE
        of = ((x // cube) * half + y // cube) * half + z // cube
        bgr = self._color[row, of, ((x % cube) * cube + y % cube) * cube + z % cube]
        bgr[row < 0] = 0
        return np.clip(np.rint(bgr[:, ::-1]), 0, 255).astype(np.uint8)


def _rows_of(places: Int[np.ndarray, "n 3"], targets: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "m"]:
    """Row of each target among places; -1 where there is none."""
    keys, sought = (
        ((p[:, 0] + _MAX_INDEX << 21) + (p[:, 1] + _MAX_INDEX) << 21) + p[:, 2] + _MAX_INDEX
        for p in (places, targets)
    )
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys, sought, sorter=order), max(len(keys) - 1, 0))
    if not len(keys):
        return np.full(len(sought), -1)
    return np.where(keys[order[at]] == sought, order[at], -1)


def _as_bricks(cubes: np.ndarray) -> np.ndarray:
    """Voxels (n, x, y, z) of bricks that are stored cube by cube."""
    half, cube, edge = kernels.BRICK // kernels.CUBE, kernels.CUBE, kernels.BRICK
    parts = cubes.reshape(-1, half, half, half, cube, cube, cube).transpose(0, 1, 4, 2, 5, 3, 6)
    return parts.reshape(-1, edge, edge, edge)
