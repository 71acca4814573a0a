"""The latest message of a topic, with a check of its age."""

from __future__ import annotations

import threading
import time

from ..core.errors import StaleFrameError
from .transports.topic_node import Received, TopicNode
from .wire.graph import Qos


class LatestMessage:
    """The latest message of a topic.

    Parameters
    ----------
    node
        Node that subscribes.
    topic
        Name of the topic; relative names are in the node's namespace.
    datatype
        Message type, such as ``nav_msgs/msg/Odometry``.
    max_age_s
        Older messages are ignored: a robot whose odometry has failed must not appear to be stationary.
    """

    def __init__(self, node: TopicNode, topic: str, datatype: str, max_age_s: float) -> None:
        self.topic, self.max_age_s = node.resolve(topic), max_age_s
        self._new = threading.Condition()
        self._received: tuple[Received, float] | None = None
        self._subscription = node.subscribe(topic, datatype, self._take, Qos(reliable=False, depth=1))

    def _take(self, received: Received) -> None:
        with self._new:
            self._received = (received, time.monotonic())
            self._new.notify_all()

    def get(self, timeout_s: float = 1.0) -> Received:
        """The latest message; waits for the first one.

        Parameters
        ----------
        timeout_s
            Time-out for the first message [s].

        Raises
        ------
        StaleFrameError
            There is no message, or it is too old.
        """
        with self._new:
            self._new.wait_for(lambda: self._received is not None, timeout_s)
            newest = self._received
        if newest is None:
            raise StaleFrameError(f"nothing on {self.topic} for {timeout_s:g} s; check that it is published")
        received, at_s = newest
        age_s = time.monotonic() - at_s
        if age_s > self.max_age_s:
            raise StaleFrameError(
                f"the newest message on {self.topic} is {age_s:.2f} s old, the limit is {self.max_age_s:g} s"
            )
        return received

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()
