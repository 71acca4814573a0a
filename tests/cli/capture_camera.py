"""A depth camera that moves around a printed tag on a table: rendered here, with its true poses."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from unittest import mock

import cv2
import numpy as np

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthColorImage
from visuohaptic.tracking.templates import Template

SIZE_M = 0.08
CAMERA = Camera.simple(640, 480, 600.0)


class TableCamera:
    """Images from a circle around the tag; ``hidden`` numbers of images do not show it."""

    def __init__(self, tag: int = 7, hidden: tuple[int, ...] = ()) -> None:
        self.camera, self.hidden, self.count = CAMERA, hidden, 0
        self.tag = Template.from_tag(tag, size_m=SIZE_M)
        self.poses: list[Pose] = []

    def __enter__(self) -> TableCamera:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def read(self) -> DepthColorImage:
        index, self.count = self.count, self.count + 1
        angle = 0.02 * index
        pose = Camera.pose_of_view([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.35], [0, 0, 0])
        self.poses.append(pose)
        rays = CAMERA.rays(np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1).reshape(-1, 2))
        in_world = rays @ pose.rotation.T
        depth_m = (-pose.translation_m[2] / in_world[:, 2] * rays[:, 2]).reshape(480, 640).astype(np.float32)
        image = np.full((480, 640), 140, np.uint8)
        if index not in self.hidden:
            rows, columns = self.tag.image.shape
            corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=np.float64)
            flat_m = (corners - [columns / 2, rows / 2]) * self.tag.pixel_m * [1, -1]
            px = CAMERA.project(pose.inverse().apply(np.column_stack([flat_m, np.zeros(4)])))
            warp = cv2.getPerspectiveTransform((corners - 0.5).astype(np.float32), px.astype(np.float32))
            image = cv2.warpPerspective(
                self.tag.image, warp, (640, 480), flags=cv2.INTER_AREA, borderValue=140
            )
        color = cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 0.7), cv2.COLOR_GRAY2BGR)
        return DepthColorImage(depth_m, color, 0.1 * index, index)


@contextlib.contextmanager
def connected(camera: TableCamera | None = None) -> Iterator[TableCamera]:
    """The camera in place of a connected one."""
    camera = camera or TableCamera()
    with (
        mock.patch("visuohaptic.io.depth.open_depth_camera", return_value=camera),
        mock.patch("visuohaptic.cli._extras._is_there", return_value=True),
    ):
        yield camera
