"""Surface fusion in spaces too large for a dense grid: bricks of truncated signed distances near surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Int

from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ..mesh import SurfaceMesh
from . import _fusion_kernels as kernels
from ._brick_surface import brick_surface, cube_of_tiles
from ._fusion_view import NO_COLOR, FusionView, checked_sizes


class SparseTsdfVolume:
    """Truncated signed distances in bricks of 8 x 8 x 8 voxels, allocated where surfaces are observed.

    For spaces too large for a dense grid. Free space far from surfaces is not
    stored: an object that moved away is removed only while its own bricks are in view.

    Parameters
    ----------
    voxel_m, truncation_m, max_weight, color
        As of :class:`TsdfVolume`.
    max_bricks
        Maximum number of bricks (4 kB each, 10 kB with colour).
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
        self.voxel_m, self.truncation_m, self.reach_m = checked_sizes(voxel_m, truncation_m)
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
        """Number of allocated bricks."""
        return len(self._rows)

    def integrate(self, frame: DepthFrame, weight: float = 1.0) -> None:
        """Allocate the bricks near the observed surface, and average the view into all bricks in its frustum.

        Parameters
        ----------
        frame, weight
            As of :meth:`.TsdfVolume.integrate`.

        Raises
        ------
        InputError
            The view would need more than ``max_bricks`` bricks.
        """
        view = FusionView(frame, self._use_color)
        self._make_bricks(view)
        places = self._places[: self.bricks]
        # Bricks whose centre projects into the image, with a margin of half a diagonal.
        half_m = kernels.BRICK * self.voxel_m / 2
        middles = view.T_camera_world.apply(places * (2 * half_m) + half_m)
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
            *view.seen_from(np.zeros(3), self.voxel_m),
            np.float32(self.truncation_m),
            np.float32(self.reach_m),
            np.float32(weight),
            np.float32(self.max_weight),
        )
        self.views += 1

    def integrate_all(self, frames: Sequence[DepthFrame]) -> None:
        """Integrate views.

        Parameters
        ----------
        frames
            Views of one camera.
        """
        for frame in frames:
            self.integrate(frame)

    def _make_bricks(self, view: FusionView) -> None:
        """Allocate bricks within the band along the rays of the view."""
        rows, columns = np.nonzero(np.isfinite(view.depth))
        if not len(rows):
            return
        z = view.depth[rows, columns].astype(np.float64)
        fx, fy, cx, cy = (float(value) for value in view.intrinsics)
        rays = np.column_stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(len(z))])
        edge_m = kernels.BRICK * self.voxel_m
        found = []
        count = max(2, int(np.ceil(2 * self.reach_m / edge_m)) + 1)
        for shift_m in np.linspace(-self.truncation_m, self.reach_m, count):
            points = view.T_camera_world.inverse().apply(rays * (z + shift_m)[:, None])
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
            self._color = np.broadcast_to(NO_COLOR[None], (have + more, 1, 1, 1, 3)).copy()

    def mesh(self, min_weight: float = 1.0) -> SurfaceMesh:
        """Extract the zero level set by marching cubes, in the world [m].

        Parameters
        ----------
        min_weight
            As of :meth:`.TsdfVolume.mesh`.

        Raises
        ------
        InputError
            No surface was observed.
        """
        b, count = kernels.BRICK, self.bricks
        rows_of_cells = np.ones((count, b + 1, b + 1, b + 1), dtype=np.float32)
        known_of_cells = np.zeros(rows_of_cells.shape, dtype=np.bool_)
        seen = self._weight[:count] >= max(min_weight, 1e-6)
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
        crossed = np.flatnonzero((low <= 0) & (high > 0))
        side, tiled, known = cube_of_tiles(len(crossed))
        for n, row in enumerate(crossed):
            at = tuple(
                slice(q * (b + 1), (q + 1) * (b + 1)) for q in (n // side**2, n // side % side, n % side)
            )
            tiled[at[0], at[1], at[2]] = rows_of_cells[row]
            known[at[0], at[1], at[2]] = known_of_cells[row]
        vertices, faces = brick_surface(
            tiled, known, self._places[crossed] * b, self.reach_m / self.truncation_m
        )
        return SurfaceMesh(vertices * self.voxel_m, faces)
