"""Views as arrays for the kernels, and their selection for comparison, by angle and overlap rather than order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core import Camera, Pose
from ...io.depth.depth_sequence import DepthFrame
from ..fusion._fusion_view import pinhole_images

#: Number of sample pixels of a view, down and across, for its overlap with the others.
_SAMPLES = (9, 12)
#: Minimum fraction of the samples in common of two views that are compared.
_MIN_OVERLAP = 0.15


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


def world_points(
    frame: DepthFrame, depth_m: Float32[np.ndarray, "h w"], chosen: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "n 3"]:
    """Points at depths of some pixels, in the world [m].

    Parameters
    ----------
    frame
        View, without distortion; its own depths are not used.
    depth_m
        Depth of every pixel along the optical axis [m].
    chosen
        Mask of the pixels.
    """
    (v, u), z = np.nonzero(chosen), depth_m[chosen]
    fx, fy, cx, cy = intrinsics(frame.camera)
    return frame.T_world_camera.apply(np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z]))


@dataclass(frozen=True, slots=True, eq=False)
class ViewGraph:
    """Overlap and angle between all pairs of views."""

    #: fraction of the sample points of a view (row) in the image of another
    overlap: Float[np.ndarray, "n n"]
    angle_rad: Float[np.ndarray, "n n"]  #: median angle between the lines of sight to these points

    def neighbours(self, index: int, count: int, *apart_rad: float) -> list[int]:
        """Views to compare with one view: smallest angle relative to the overlap, and apart from each other.

        Adjacent views see the same background through the same glass, so that many of them are no more informative than
        one.

        Parameters
        ----------
        index
            Index of the view.
        count
            Maximum number of neighbours.
        apart_rad
            Minimum angles between the view and its neighbours, and among these [rad]: nearer views see glass alike. Each
            further, smaller angle applies if the previous ones yield too few views.
        """
        chosen: list[int] = []
        cost = self.angle_rad[index] / np.maximum(self.overlap[index], 1e-9)
        usable = [k for k in np.argsort(cost, kind="stable") if self.overlap[index, k] >= _MIN_OVERLAP]
        for min_rad in apart_rad or (0.0,):
            for k in usable:
                # Exclude the view itself and views already chosen.
                away_rad = self.angle_rad[k, [index, *chosen]].min() if k not in (index, *chosen) else -1.0
                if away_rad >= min_rad and len(chosen) < count:
                    chosen.append(int(k))
        return chosen

    def weights(self, angle_rad: float) -> Float[np.ndarray, "n"]:
        """Weight of each view in independent views: views within ``angle_rad`` of each other share one.

        Parameters
        ----------
        angle_rad
            Minimum angle between independent views [rad].
        """
        alike = np.maximum(0.0, 1 - self.angle_rad / angle_rad)
        np.fill_diagonal(alike, 1.0)
        weights: Float[np.ndarray, "n"] = 1 / alike.sum(axis=1)
        return weights


def view_graph(frames: Sequence[DepthFrame]) -> ViewGraph:
    """Overlap and angle of every pair of views.

    Parameters
    ----------
    frames
        Views of one camera, at least one.
    """
    count = len(frames)
    overlap, angle = np.zeros((count, count)), np.full((count, count), np.inf)
    eyes = np.array([frame.T_world_camera.translation_m for frame in frames])
    back = np.array([frame.T_world_camera.inverse().matrix[:3] for frame in frames])
    camera = frames[0].camera
    fx, fy, cx, cy = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]
    middles = (np.indices(_SAMPLES).reshape(2, -1) + 0.5) / np.array(_SAMPLES)[:, None]
    v, u = middles * np.array([[camera.height], [camera.width]])
    rays = camera.rays(np.column_stack([u, v]))
    for i, frame in enumerate(frames):
        depth_m = frame.depth_m[v.astype(int), u.astype(int)]
        known = depth_m > 0
        if not known.any():
            continue
        points = frame.T_world_camera.apply(rays[known] * depth_m[known, None])
        there = points @ back[:, :, :3].transpose(0, 2, 1) + back[:, None, :, 3]
        z = np.maximum(there[..., 2], 1e-6)
        column, row = fx * there[..., 0] / z + cx, fy * there[..., 1] / z + cy
        held = (there[..., 2] > 0.05) & (column >= 0) & (row >= 0)
        held &= (column < camera.width) & (row < camera.height)
        overlap[i] = held.mean(axis=1)
        sight = points - eyes[:, None]
        sight /= np.maximum(np.linalg.norm(sight, axis=2, keepdims=True), 1e-9)
        cosine = np.clip((sight * sight[i]).sum(axis=2), -1.0, 1.0)
        cosine = np.sort(np.where(held, cosine, np.inf), axis=1)
        # The median angle: mean of the two middle values of an even number.
        number = held.sum(axis=1)
        seen = np.flatnonzero(number)
        both = [np.arccos(cosine[seen, (number[seen] - k) // 2]) for k in (0, 1)]
        angle[i, seen] = np.mean(both, axis=0)
    return ViewGraph(np.minimum(overlap, overlap.T), np.minimum(angle, angle.T))


def ray_stride(focal_px: float, voxel_m: float, away_m: float, window_px: float) -> int:
    """Stride of the rays of a view that are used: half a voxel, and at most a sixth of a matching window [px].

    A voxel uses the ray through its centre, and the readings within a matching window count as one. With a stride of a quarter
    of a window, depth steps of 5 to 30 mm are no longer detected as edges, and more opaque pixels are flagged.

    Parameters
    ----------
    focal_px
        Focal length of the camera [px].
    voxel_m
        Edge length of a voxel [m].
    away_m
        Distance of the camera from the space [m].
    window_px
        Size of the matching window of the stereo camera [px].
    """
    return max(1, min(round(focal_px * voxel_m / away_m / 2), round(window_px / 6)))


def thinned(frame: DepthFrame, stride: int) -> DepthFrame:
    """A view as a pinhole image without distortion, subsampled to every n-th pixel down and across.

    Parameters
    ----------
    frame
        View.
    stride
        Stride of the pixels that are kept [px].
    """
    camera, first = frame.camera, stride // 2
    depth_m = np.ascontiguousarray(ideal_depth(frame)[first::stride, first::stride])
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= first
    matrix[:2] /= stride
    height, width = depth_m.shape
    return replace(frame, depth_m=depth_m, color=None, camera=Camera(width, height, matrix))
