"""Nodes that publish what was recorded, or what a camera sees, with the recorded timing."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from pydantic import Field

from ...core.camera.model import Camera
from ...io.frames.frames import open_source
from ...io.ros import ros_messages as messages
from ...io.ros.sqlite_bag import open_bag
from ..frames import SENSOR_QOS, info_topic
from ..sink import LATCHED_TYPES
from ..transports.topic_node import RosPublisher
from ..wire import Qos, message_type, parse_definition
from .component import Status, Worker
from .parameters import NodeParameters

_DELAY = "before the first message of a recording: others find the topics"


class PlayParameters(NodeParameters):
    """Parameters of the node play."""

    file: str = Field("", min_length=1, description="bag of rosbag2 (folder, .db3) or .mcap file")
    rate: float = Field(1.0, gt=0.0, le=1000.0, description="times as fast as it was recorded")
    delay_s: float = Field(1.0, ge=0.0, le=600.0, description=_DELAY)


class PlayNode(Worker):
    """Plays from the start at every activation; timestamps in the messages are unchanged."""

    summary = "a recording of rosbag2, SQLite or MCAP: its messages out, on their topics"
    parameter_model = PlayParameters

    def configure(self) -> None:
        self._file = open_bag(Path(self.parameters.file))
        self._outlets: dict[str, RosPublisher] = {}
        kinds = {topic.name: topic.datatype for topic in self._file.topics()}
        texts = {
            s.name: s.data.decode(errors="replace")
            for s in self._file.schemas.values()
            if s.encoding == "ros2msg"
        }
        for topic, name in kinds.items():
            kind = parse_definition(name, texts[name]) if name in texts else message_type(name)
            qos = Qos(latched=name in LATCHED_TYPES or topic.endswith("/tf_static"), depth=100)
            self._outlets[topic] = self.host.node.advertise(topic, kind, qos)
        self._told = Status(True, "not started")

    def run(self, end: threading.Event) -> None:
        begin_s, first_ns = time.monotonic() + self.parameters.delay_s, None
        for count, message in enumerate(self._file.messages()):
            first_ns = message.log_time_ns if first_ns is None else first_ns
            due_s = begin_s + 1e-9 * (message.log_time_ns - first_ns) / self.parameters.rate
            if end.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._outlets[message.topic].send(message.data)
            self._told = Status(True, "playing", {"messages": count + 1})
        damage = str(self._file.damage) if self._file.damage else ""
        self._told = Status(not damage, damage or "played", self._told.values)


class CameraParameters(NodeParameters):
    """Parameters of the node camera."""

    source: str = Field(
        "",
        min_length=1,
        description="camera (0, /dev/video0, rtsp://...), video, folder of images or recording",
    )
    camera: str = Field("", description="camera.yaml of the source; empty: no CameraInfo")
    image: str = Field(
        "image/compressed",
        description="image topic; sensor_msgs/CompressedImage where it ends in /compressed",
    )
    frame: str = Field("camera", description="frame_id of the images")
    quality: int = Field(95, ge=1, le=100, description="of JPEG, for a compressed topic")
    delay_s: float = Field(1.0, ge=0.0, le=600.0, description=_DELAY)


class CameraNode(Worker):
    """Publishes a live camera, or a recording from its start at every activation, as if it were live."""

    summary = "a camera, video or folder of images: Image and CameraInfo out"
    parameter_model = CameraParameters

    def configure(self) -> None:
        parameters, node = self.parameters, self.host.node
        camera = Camera.load(Path(parameters.camera)) if parameters.camera else None
        self._source = open_source(parameters.source, camera=camera)
        image = node.resolve(parameters.image)
        self._compressed = image.endswith("/compressed")
        kind = "sensor_msgs/msg/" + ("CompressedImage" if self._compressed else "Image")
        self._images = node.advertise(image, kind, SENSOR_QOS)
        self._info = node.advertise(info_topic(image), "sensor_msgs/msg/CameraInfo", SENSOR_QOS)
        self._told = Status(True, "not started")

    def run(self, end: threading.Event) -> None:
        frame_id, quality = self.parameters.frame, self.parameters.quality
        live = self._source.frame_count is None
        begin_s = time.monotonic() + self.parameters.delay_s
        start_s = self.host.node.now_s() + self.parameters.delay_s
        first_s = None
        for count, frame in enumerate(self._source):
            first_s = frame.t_s if first_s is None else first_s
            since_s = frame.t_s - first_s
            if end.wait(0.0 if live else max(begin_s + since_s - time.monotonic(), 0.0)):
                return
            t_s = frame.t_s if live else start_s + since_s
            if self._compressed:
                self._images.publish(messages.compressed_image(t_s, frame.image, frame_id, quality))
            else:
                self._images.publish(messages.image(t_s, frame.image, frame_id))
            if (camera := self._source.camera) is not None:
                self._info.publish(messages.camera_info(t_s, camera, frame_id))
            self._told = Status(True, "publishing", {"images": count + 1})
        self._told = Status(True, "played", self._told.values)

    def close(self) -> None:
        super().close()
        self._source.close()
