"""Depth image without distortion, intrinsics and relative motions of views, as arrays for the kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...io.depth.depth_sequence import DepthFrame
from ..fusion._fusion_view import pinhole_images


def ideal_depth(frame: DepthFrame) -> Float32[np.ndarray, "h w"]:
    """The depth image of a pinhole camera without distortion (nearest pixel, no interpolation).

    Parameters
    ----------
    frame
        View with lens distortion.
    """
    return np.ascontiguousarray(pinhole_images(frame, color=False)[0])


def motions(T_world_this: Pose, others: Sequence[Pose]) -> Float32[np.ndarray, "n 3 4"]:
    """``T_this_other`` of each other view.

    Parameters
    ----------
    T_world_this
        Pose of this view.
    others
        Poses ``T_world_other``.
    """
    turns = np.array([other.rotation for other in others]).reshape(-1, 3, 3)
    places_m = np.array([other.translation_m for other in others]).reshape(-1, 3)
    rotation = T_world_this.rotation
    moved = np.concatenate(
        [rotation.T @ turns, ((places_m - T_world_this.translation_m) @ rotation)[..., None]], axis=2
    )
    return moved.astype(np.float32)


def back_motions(T_world_this: Pose, others: Sequence[Pose]) -> Float32[np.ndarray, "n 3 4"]:
    """``T_other_this`` of each other view.

    Parameters
    ----------
    T_world_this, others
        As in :func:`motions`.
    """
    moved = [motions(other, [T_world_this])[0] for other in others]
    return np.array(moved, np.float32).reshape(-1, 3, 4)


def intrinsics(camera: Camera) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Focal lengths and principal point in single precision [px].

    Parameters
    ----------
    camera
        Camera without distortion.
    """
    matrix = camera.matrix.astype(np.float32)
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
