"""Detection of transparent objects as a node: takes depth images and camera poses, publishes transparent parts."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from ...core import Camera, DeviceError, Pose
from ...io.depth.depth_sequence import DepthFrame
from ...io.ros import ros_messages as messages
from ...io.ros.ros_image import camera_from_message, decode_depth
from ...reconstruction.fusion import sensor_noise, space_of_interest
from ...reconstruction.pipeline import Reconstruction, reconstruct
from ..frames import info_topic, message_pose
from ..markers import LINES, clear_marker, points_marker, text_marker
from ..transports.topic_node import Received
from ..wire.graph import LATCHED, Qos
from .component import Component, Status
from .parameters import NodeParameters


class TransparencyParameters(NodeParameters):
    """Parameters of the node transparency."""

    depth: str = Field("depth/image", description="topic of sensor_msgs/Image, 16UC1 [mm] or 32FC1 [m]")
    pose: str = Field("camera_pose", description="topic of geometry_msgs/PoseStamped, T_world_camera")
    sensor: str = Field("realsense_d435", description="depth camera, for its noise")
    max_views: int = Field(60, ge=3, le=1000, description="views that are kept; beyond that the oldest goes")
    pause_s: float = Field(0.2, ge=0.0, le=60.0, description="between two views that are kept [s]")
    match_s: float = Field(
        0.02, ge=0.0, le=1.0, description="largest difference of the stamps of image and pose [s]"
    )
    voxel_m: float = Field(0.005, gt=0.0, lt=0.5, description="edge of a voxel [m]")


class TransparentPartsNode(Component):
    """Collects views while active; ``~/complete`` detects transparent parts in them."""

    summary = "transparent objects: depth images and poses in, service complete, PointCloud2 and markers out"
    parameter_model = TransparencyParameters

    def configure(self) -> None:
        host, parameters = self.host, self.parameters
        self._noise = sensor_noise(parameters.sensor)
        self._views: deque[DepthFrame] = deque(maxlen=parameters.max_views)
        self._poses: deque[tuple[float, str, Pose]] = deque(maxlen=200)
        self._camera: Camera | None = None
        self._lock = threading.Lock()
        self._missed = 0
        node, sensor = host.node, Qos(reliable=False, depth=5)
        self._points = node.advertise("~/points", "sensor_msgs/msg/PointCloud2", LATCHED)
        self._parts = node.advertise("~/parts", "visualization_msgs/msg/MarkerArray", LATCHED)
        node.subscribe(info_topic(parameters.depth), "sensor_msgs/msg/CameraInfo", self._describe, sensor)
        node.subscribe(parameters.pose, "geometry_msgs/msg/PoseStamped", self._place, sensor)
        node.subscribe(parameters.depth, "sensor_msgs/msg/Image", self._take, sensor)
        host.offer("~/complete", self.complete)

    def _describe(self, received: Received) -> None:
        self._camera = camera_from_message(
            received.message, info_topic(self.parameters.depth), self.parameters.depth
        )

    def _place(self, received: Received) -> None:
        posed = message_pose(received.message.pose)
        with self._lock:
            self._poses.append((received.t_s, received.message.header.frame_id, posed))

    def _take(self, received: Received) -> None:
        t_s, camera = received.t_s, self._camera
        if not self.host.active.is_set() or camera is None:
            return
        with self._lock:
            if (
                self._views and t_s <= self._views[0].t_s
            ):  # a recording that starts again, or a clock set back
                self._views.clear()
            if self._views and t_s - self._views[-1].t_s < self.parameters.pause_s:
                return
            near = min(self._poses, key=lambda posed: abs(posed[0] - t_s), default=None)
            if near is None or abs(near[0] - t_s) > self.parameters.match_s:
                self._missed += 1
                return
            depth_m = decode_depth(received.message, self.parameters.depth)
            self._views.append(DepthFrame(t_s, depth_m, None, near[2], camera, len(self._views)))

    def complete(self) -> Mapping[str, Any]:
        """Detect transparent parts and panes in the views collected so far; publish and return both.

        Raises
        ------
        DeviceError
            There are too few views with a pose.
        """
        with self._lock:
            views, frame = list(self._views), self._poses[-1][1] if self._poses else ""
        if len(views) < 3:
            topics = (
                f"{self.parameters.depth}, {info_topic(self.parameters.depth)} and {self.parameters.pose}"
            )
            raise DeviceError(f"{len(views)} views with a pose, expected 3 or more; check {topics}")
        grid = space_of_interest(views, voxel_m=self.parameters.voxel_m)
        found = reconstruct(views, grid=grid, noise=self._noise)
        t_s = self.host.node.now_s()
        columns = [(axis, "float32", found.points_m[:, place]) for place, axis in enumerate("xyz")]
        cloud = messages.cloud(t_s, frame, [*columns, ("score", "float32", found.scores)])
        self._points.publish(cloud)
        self._parts.publish({"markers": part_markers(t_s, frame, found)})
        parts = [
            {"centroid_m": region.centroid_m, "size_m": region.size_m, "score": region.score}
            for region in found.regions
        ]
        panes = [{"corners_m": pane.corners_m, "sigma_m": pane.sigma_m} for pane in found.panes]
        return {
            "parts": parts,
            "panes": panes,
            "views": found.search.compared,
            "reason": found.search.text,
        }

    def status(self) -> Status:
        return Status(True, "ok", {"views": len(self._views), "without_pose": self._missed})


def part_markers(t_s: float, frame: str, found: Reconstruction) -> list[dict[str, Any]]:
    """Markers that replace those of the last detection: the score of each part at its centroid, the edges of all panes.

    Parameters
    ----------
    t_s, frame
        Time [s], and the frame of the camera poses.
    found
        The detected parts and panes.
    """
    edges_m = [
        corner
        for pane in found.panes
        for pair in zip(pane.corners_m, np.roll(pane.corners_m, -1, axis=0), strict=True)
        for corner in pair
    ]
    return [
        clear_marker(t_s, frame, "transparent"),
        *(
            text_marker(t_s, frame, "transparent", number, region.centroid_m, f"{region.score:.2f}")
            for number, region in enumerate(found.regions)
        ),
        points_marker(t_s, frame, "panes", LINES, edges_m, size_m=0.005),
    ]
