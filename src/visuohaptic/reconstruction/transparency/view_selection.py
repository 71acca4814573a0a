"""Which views of a sequence are compared with one of them, by angle and overlap and not by their order, and which of their rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.camera.model import Camera
from ...io.depth.depth_sequence import DepthFrame
from .background import ideal_depth

__all__ = ["ViewGraph", "ray_stride", "thinned", "view_graph"]

#: Pixels of a view, down and across, at which its overlap with the others is measured.
_SAMPLES = (9, 12)
#: Fraction of the samples that two views share at least.
_MIN_OVERLAP = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class ViewGraph:
    """How much of each view every other one has in its image, and from what angle."""

    overlap: Float[np.ndarray, "n n"]  #: fraction of the points of a view (row) in the image of another
    angle_rad: Float[np.ndarray, "n n"]  #: median angle between both lines of sight at these points

    def neighbours(self, index: int, count: int, *apart_rad: float) -> list[int]:
        """Views to compare with one: nearest in angle for their overlap, all of them apart from each other.

        Many views that are near each other look through the same glass at what is behind it, and together know no more of
        that than one of them does.

        Parameters
        ----------
        index
            The view.
        count
            Maximum number of neighbours.
        apart_rad
            Angle between the view and its neighbours, and between these [rad]: nearer ones see the same glass alike. Every
            further, smaller one is for sequences of which the angles before leave too few views.
        """
        chosen: list[int] = []
        cost = self.angle_rad[index] / np.maximum(self.overlap[index], 1e-9)
        usable = [k for k in np.argsort(cost, kind="stable") if self.overlap[index, k] >= _MIN_OVERLAP]
        for min_rad in apart_rad or (0.0,):
            for k in usable:
                # No view is its own neighbour, nor anyone's twice.
                away_rad = self.angle_rad[k, [index, *chosen]].min() if k not in (index, *chosen) else -1.0
                if away_rad >= min_rad and len(chosen) < count:
                    chosen.append(int(k))
        return chosen

    def weights(self, angle_rad: float) -> Float[np.ndarray, "n"]:
        """Part of an independent view that each view is: views nearer to each other than an angle share one.

        Parameters
        ----------
        angle_rad
            Angle from which on two views are independent [rad].
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
        # The median angle: one of the middle, or the mean of both.
        number = held.sum(axis=1)
        seen = np.flatnonzero(number)
        both = [np.arccos(cosine[seen, (number[seen] - k) // 2]) for k in (0, 1)]
        angle[i, seen] = np.mean(both, axis=0)
    return ViewGraph(np.minimum(overlap, overlap.T), np.minimum(angle, angle.T))


def ray_stride(focal_px: float, voxel_m: float, away_m: float, window_px: float) -> int:
    """Distance of the rays of a view that are read: half a voxel, and at most a sixth of a matching window [px].

    A voxel uses the ray through its middle, and the readings within a matching window count as one. Thinned by a quarter of a
    window, steps of 5 to 30 mm between surfaces are no longer edges, and more opaque pixels are flagged.

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
    """A view as a pinhole camera without distortion would see it, with every n-th pixel down and across.

    Parameters
    ----------
    frame
        View.
    stride
        Distance of the pixels that are kept [px].
    """
    camera, first = frame.camera, stride // 2
    depth_m = np.ascontiguousarray(ideal_depth(frame)[first::stride, first::stride])
    matrix = camera.matrix.copy()
    matrix[0, 1] = 0.0
    matrix[:2, 2] -= first
    matrix[:2] /= stride
    height, width = depth_m.shape
    return replace(frame, depth_m=depth_m, color=None, camera=Camera(width, height, matrix))
