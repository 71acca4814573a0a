"""Conversion of a depth view to the arrays of the fusion kernels."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float32

from ...core import InputError, Pose
from ...io.depth.depth_sequence import DepthFrame
from . import _fusion_kernels as kernels

#: Tangent of the angle of incidence beyond which cameras have no reading.
GRAZING_SLOPE = 4.0
#: Voxels that are observed behind a surface, along a ray. They contain both ends of each edge of the grid that crosses it up to
#: that incidence; behind the band they count if nothing else does.
GRAZING_VOXELS = int(math.hypot(1.0, GRAZING_SLOPE))


def checked_sizes(voxel_m: float, truncation_m: float | None) -> tuple[float, float, float]:
    """Voxel spacing, half width of the band, and depth behind a surface to which voxels are observed [m].

    Parameters
    ----------
    voxel_m
        Distance between voxels [m].
    truncation_m
        Half width of the band around the surface [m].

    Raises
    ------
    InputError
        The spacing is not positive, or the band is narrower than a voxel.
    """
    if not (np.isfinite(voxel_m) and voxel_m > 0):
        raise InputError("TsdfVolume", f"found {voxel_m}, expected > 0", field="voxel_m")
    reach_m = GRAZING_VOXELS * voxel_m
    band_m = reach_m if truncation_m is None else truncation_m
    if not (np.isfinite(band_m) and band_m >= voxel_m):
        raise InputError(
            "TsdfVolume", f"found {band_m}, expected at least one voxel ({voxel_m})", field="truncation_m"
        )
    return float(voxel_m), float(band_m), float(max(band_m, reach_m))


class FusionView:
    """Arrays of a frame for the kernels: undistorted pinhole images, float32.

    Parameters
    ----------
    frame
        View of any camera; lens distortion is removed.
    color
        Whether the color image is used.
    """

    def __init__(self, frame: DepthFrame, color: bool) -> None:
        k = frame.camera.matrix
        self.use_color = color and frame.color is not None
        depth, image = pinhole_images(frame, color=self.use_color)
        self.depth: Float32[np.ndarray, "rows columns"] = np.ascontiguousarray(depth, dtype=np.float32)
        self.image = np.ascontiguousarray(image) if image is not None else np.zeros((1, 1, 3), np.uint8)
        self.intrinsics: Float32[np.ndarray, "4"] = np.array(
            [k[0, 0], k[1, 1], k[0, 2], k[1, 2]], dtype=np.float32
        )
        self.T_camera_world: Pose = frame.T_world_camera.inverse()

    def seen_from(
        self, origin_m: Float[np.ndarray, "3"], voxel_m: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """First voxel and steps along x, y, z in the camera frame [m], intrinsics, depth [m] and color image.

        Parameters
        ----------
        origin_m
            Position of voxel (0, 0, 0) in the world [m].
        voxel_m
            Distance between voxels [m].
        """
        origin = self.T_camera_world.apply(origin_m).astype(np.float32)
        steps = (self.T_camera_world.rotation.T * voxel_m).astype(np.float32)
        return origin, steps, self.intrinsics, self.depth, self.image

    def tiles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smallest and largest depth [m] of each tile of the image, and the integral image of missing depths."""
        import cv2

        known, far = np.isfinite(self.depth), np.float32(np.inf)
        low = over_tiles(np.minimum, np.where(known, self.depth, far), kernels.TILE)
        high = over_tiles(np.maximum, np.where(known, self.depth, -far), kernels.TILE)
        return low, high, cv2.integral((~known).astype(np.uint8))


def over_tiles(
    ufunc: np.ufunc, images: Float32[np.ndarray, "*n h w"], edge_px: int
) -> Float32[np.ndarray, "*n a b"]:
    """Reduction of images over square tiles; those at the right and lower border may be smaller.

    Parameters
    ----------
    ufunc
        Binary function, such as the minimum.
    images
        Images (..., h, w).
    edge_px
        Edge of a tile [px].
    """
    for axis in (-2, -1):
        images = ufunc.reduceat(images, np.arange(0, images.shape[axis], edge_px), axis=axis)
    return images


def pinhole_images(frame: DepthFrame, *, color: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Depth and color of a pinhole camera without distortion; depth of the nearest pixel, without interpolation.

    Parameters
    ----------
    frame
        View of any camera.
    color
        Whether the color image is used.
    """
    camera, image = frame.camera, frame.color if color else None
    if not camera.distortion.any():
        return frame.depth_m, image
    import cv2

    size = (camera.width, camera.height)
    x, y = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, None, camera.matrix, size, cv2.CV_32FC1
    )
    depth = cv2.remap(frame.depth_m, x, y, cv2.INTER_NEAREST, borderValue=float("nan"))
    return depth, None if image is None else cv2.remap(image, x, y, cv2.INTER_LINEAR)
