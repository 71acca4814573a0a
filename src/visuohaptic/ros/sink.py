"""Publication of measurements on the same topics as in a recording."""

from __future__ import annotations

import threading
from typing import Any

from ..core.measurement import ForceProfile
from ..io.sinks.measurement_sink import MeasurementSink
from .markers import contact_markers
from .transports.topic_node import RosPublisher, TopicNode
from .wire.graph import LATCHED

#: Maps and markers remain until they are replaced: late subscribers also receive them.
LATCHED_TYPES = {"nav_msgs/msg/OccupancyGrid", "visualization_msgs/msg/MarkerArray"}


class RosSink(MeasurementSink):
    """Publishes the messages that :class:`visuohaptic.io.sinks.MeasurementWriter` would write.

    Topics are in the node's namespace: ``/foam/wrench`` of a recording is ``/robot1/foam/wrench`` for a node in
    ``/robot1``.

    Parameters
    ----------
    node
        Node that publishes.
    frame
        Name of the sensor's coordinate frame.
    """

    def __init__(self, node: TopicNode, *, frame: str = "sensor") -> None:
        self.frame = frame
        self._node = node
        self._publishers: dict[str, RosPublisher] = {}
        self._lock = threading.Lock()

    def advertise(self, topic: str, datatype: str) -> RosPublisher:
        """Advertise a topic before its first message.

        Parameters
        ----------
        topic
            Such as ``/foam/wrench``, in the node's namespace.
        datatype
            Such as ``geometry_msgs/msg/WrenchStamped``.
        """
        with self._lock:
            if topic not in self._publishers:
                qos = LATCHED if datatype in LATCHED_TYPES else None
                self._publishers[topic] = self._node.advertise(topic.lstrip("/"), datatype, qos)
            return self._publishers[topic]

    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        """Publish the fields of any supported standard message.

        Parameters
        ----------
        topic, datatype
            As in :meth:`advertise`.
        t_s
            Time of the measurement [s], which the message contains in its header.
        message
            Values by field.
        """
        self.advertise(topic, datatype).publish(message)

    def write_force(self, profile: ForceProfile, name: str = "foam") -> None:
        """Publish as in a recording, plus arrows for RViz on ``/NAME/markers``.

        Parameters
        ----------
        profile
            Measurement of a foam strip; without contact, or if invalid, the arrows are removed.
        name
            First part of the topics.
        """
        super().write_force(profile, name)
        arrows = contact_markers(profile, self.frame, name)
        self.write(f"/{name}/markers", "visualization_msgs/msg/MarkerArray", profile.t_s, arrows)

    @property
    def sent(self) -> int:
        """Number of messages sent so far, on all topics."""
        return sum(publisher.sent for publisher in self._publishers.values())
