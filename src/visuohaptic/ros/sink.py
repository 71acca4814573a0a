"""Measurements onto topics, the same ones that a recording holds."""

from __future__ import annotations

import threading
from typing import Any

from ..core.measurement import ForceProfile
from ..io.sinks.measurement_sink import MeasurementSink
from .markers import contact_markers
from .transports.topic_node import RosPublisher, TopicNode
from .wire.graph import LATCHED

__all__ = ["LATCHED_TYPES", "RosSink"]

#: Maps and markers stay until they are replaced: who comes late sees them, too.
LATCHED_TYPES = {"nav_msgs/msg/OccupancyGrid", "visualization_msgs/msg/MarkerArray"}


class RosSink(MeasurementSink):
    """Publishes what :class:`visuohaptic.io.sinks.MeasurementWriter` would write.

    Topics are in the node's namespace: ``/foam/wrench`` of a recording is ``/robot1/foam/wrench`` of a node in
    ``/robot1``.

    Parameters
    ----------
    node
        Node that publishes.
    frame
        Name of the sensor's frame of coordinates.
    """

    def __init__(self, node: TopicNode, *, frame: str = "sensor") -> None:
        self.frame = frame
        self._node = node
        self._publishers: dict[str, RosPublisher] = {}
        self._lock = threading.Lock()

    def advertise(self, topic: str, datatype: str) -> RosPublisher:
        """Say that messages will come, before the first one does.

        Parameters
        ----------
        topic
            As ``/foam/wrench``, in the node's namespace.
        datatype
            As ``geometry_msgs/msg/WrenchStamped``.
        """
        with self._lock:
            if topic not in self._publishers:
                qos = LATCHED if datatype in LATCHED_TYPES else None
                self._publishers[topic] = self._node.advertise(topic.lstrip("/"), datatype, qos)
            return self._publishers[topic]

    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        """Publish the fields of any standard message that this library knows.

        Parameters
        ----------
        topic, datatype
            As of :meth:`advertise`.
        t_s
            Time of the measurement [s]; the message has it in its header.
        message
            Values by field.
        """
        self.advertise(topic, datatype).publish(message)

    def write_force(self, profile: ForceProfile, name: str = "foam") -> None:
        """As in a recording, and arrows for RViz on ``/NAME/markers``.

        Parameters
        ----------
        profile
            Of a foam strip; without contact, or not valid, the arrows are taken away.
        name
            First part of the topics.
        """
        super().write_force(profile, name)
        arrows = contact_markers(profile, self.frame, name)
        self.write(f"/{name}/markers", "visualization_msgs/msg/MarkerArray", profile.t_s, arrows)

    @property
    def sent(self) -> int:
        """Messages so far, of all topics."""
        return sum(publisher.sent for publisher in self._publishers.values())
