"""Surface fusion: depth views averaged into truncated signed distances, and extraction of their zero level set.

A voxel stores the weighted mean over the views of the distance to the observed surface
along the optical axis, divided by the band width and clipped to 1, positive
towards the camera, and the sum of the weights (Curless and Levoy 1996; the
volume of KinectFusion, Alt 2016, Sec. 2.2.1 and 5.3). Behind the band, down to four
voxels, a view counts only where no other one does: so oblique surfaces have no holes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ..mesh import SurfaceMesh
from . import _fusion_kernels as kernels
from ._brick_surface import brick_surface, cube_of_tiles
from ._fusion_view import NO_COLOR, FusionView, checked_sizes

#: Maximum number of voxels of a grid; checked before memory is allocated.
MAX_VOXELS = 1 << 30


class TsdfVolume:
    """A dense grid of truncated signed distances; its arrays may be read and written.

    Parameters
    ----------
    origin_m
        Position of voxel (0, 0, 0) in the world [m].
    shape
        Number of voxels along x, y, z.
    voxel_m
        Distance between voxels [m].
    truncation_m
        Half width of the band around the surface [m]; 4 voxels by default.
    max_weight
        Upper bound of the weights, so that the volume adapts to a changing scene.
    color
        Whether to average colour as well.

    Attributes
    ----------
    distance
        float32, in units of ``truncation_m``; 1 where nothing was observed.
    weight
        float32; 0 where nothing was observed.
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
        self.voxel_m, self.truncation_m, self.reach_m = checked_sizes(voxel_m, truncation_m)
        self.origin_m: Float[np.ndarray, "3"] = np.asarray(origin_m, dtype=np.float64).reshape(3)
        self.max_weight = float(max_weight)
        self.distance: Float32[np.ndarray, "x y z"] = np.ones(shape, dtype=np.float32)
        self.weight: Float32[np.ndarray, "x y z"] = np.zeros(shape, dtype=np.float32)
        self.color: Float32[np.ndarray, "x y z 3"] | None = (
            np.zeros((*shape, 3), dtype=np.float32) if color else None
        )
        self.views = 0  #: number of integrated views

    @classmethod
    def around(
        cls,
        low_m: Float[np.ndarray, "3"],
        high_m: Float[np.ndarray, "3"],
        voxel_m: float = 0.005,
        **more: Any,
    ) -> TsdfVolume:
        """Create a volume that contains a box of the world.

        Parameters
        ----------
        low_m, high_m
            Lowest and highest corner of the box, world [m].
        voxel_m
            Distance between voxels [m].
        more
            Further arguments of the volume.
        """
        low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
        shape = np.ceil((high - low) / voxel_m - 1e-9).astype(int) + 1
        return cls(low, (int(shape[0]), int(shape[1]), int(shape[2])), voxel_m, **more)

    def integrate(self, frame: DepthFrame, weight: float = 1.0) -> None:
        """Integrate a view; pixels without depth (NaN) change nothing.

        Parameters
        ----------
        frame
            Depth image with the pose of its camera.
        weight
            Weight of the view in the average.
        """
        bricks = tuple(-(-n // kernels.CUBE) for n in self.distance.shape)
        self._fuse(FusionView(frame, self.color is not None), weight, np.ones(bricks, np.uint8))

    def integrate_all(self, frames: Sequence[DepthFrame]) -> None:
        """Integrate views around the surfaces that any of them sees; free space far from surfaces stays unobserved.

        The mesh is that of :meth:`integrate` for each view in turn, in less than half of the time.

        Parameters
        ----------
        frames
            Views of one camera.
        """
        views = [FusionView(frame, self.color is not None) for frame in frames]
        marked = np.zeros([-(-n // kernels.CUBE) for n in self.distance.shape], np.uint8)
        # A margin of one voxel: the surface crosses cells next to the band.
        reach = np.float32(self.reach_m + math.sqrt(3) * self.voxel_m)
        for view in views:
            origin, steps, camera, depth, _ = view.seen_from(self.origin_m, self.voxel_m)
            kernels.mark_surface(
                marked, self.distance.shape, origin, steps, camera, depth, *view.tiles(), reach
            )
        for view in views:
            self._fuse(view, 1.0, marked)

    def _fuse(self, view: FusionView, weight: float, marked: np.ndarray) -> None:
        """Integrate a view into the marked bricks."""
        kernels.fuse_dense(
            self.distance,
            self.weight,
            self.color if self.color is not None else NO_COLOR,
            view.use_color,
            marked,
            *view.seen_from(self.origin_m, self.voxel_m),
            *view.tiles(),
            np.float32(self.truncation_m),
            np.float32(self.reach_m),
            np.float32(weight),
            np.float32(self.max_weight),
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
        bricks = [-(-(n - 1) // kernels.BRICK) for n in self.distance.shape]
        places = np.zeros((int(np.prod(bricks)), 3), dtype=np.int64)
        lowest = np.float32(max(min_weight, 1e-6))
        count = kernels.active_cells(self.distance, self.weight, lowest, places)
        places = places[:count]
        side, tiled, known = cube_of_tiles(count)
        kernels.gather_cells(self.distance, self.weight, lowest, places, side, tiled, known)
        vertices, faces = brick_surface(tiled, known, places, self.reach_m / self.truncation_m)
        colors = None
        if self.color is not None:
            near = np.rint(vertices).astype(np.int64)
            near = np.minimum(near, np.array(self.distance.shape) - 1)
            bgr = self.color[near[:, 0], near[:, 1], near[:, 2]]
            colors = np.clip(np.rint(bgr[:, ::-1]), 0, 255).astype(np.uint8)
        return SurfaceMesh(vertices * self.voxel_m + self.origin_m, faces, colors)
