"""Playback of a recording as a node: publishes its messages with the recorded timing."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from pydantic import Field

from ...io.ros.sqlite_bag import open_bag
from ..sink import LATCHED_TYPES
from ..transports.topic_node import RosPublisher
from ..wire.graph import Qos
from ..wire.message_types import message_type, parse_definition
from .component import Status, Worker
from .parameters import NodeParameters

__all__ = ["PlayNode", "PlayParameters"]


class PlayParameters(NodeParameters):
    """Parameters of the node play."""

    file: str = Field("", min_length=1, description="bag of rosbag2 (folder, .db3) or .mcap file")
    rate: float = Field(1.0, gt=0.0, le=1000.0, description="times as fast as it was recorded")
    delay_s: float = Field(
        1.0, ge=0.0, le=600.0, description="before the first message: others find the topics"
    )


class PlayNode(Worker):
    """Plays from the start at every activation; timestamps in the messages are unchanged."""

    summary = "a recording of rosbag2, SQLite or MCAP: its messages out, on their topics"
    parameter_model = PlayParameters

    def configure(self) -> None:
        self._file = open_bag(Path(self.parameters.file))
        self._outlets: dict[str, RosPublisher] = {}
        kinds = {topic.name: topic.datatype for topic in self._file.topics()}
        texts = {s.name: s.data.decode() for s in self._file.schemas.values() if s.encoding == "ros2msg"}
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
