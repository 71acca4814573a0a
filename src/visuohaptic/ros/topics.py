"""Topics of the robot's graph and their messages as plain data, to inspect a robot without an installation of ROS."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..core.errors import DeviceError, InputError
from .transports.topic_node import Received, TopicNode
from .wire.graph import Entity, EntityKind, Qos

#: Longer arrays and byte strings are represented by their number of values.
MAX_VALUES = 128
#: Interval at which the graph is requested [s].
_AGAIN_S = 0.2


def find_topics(node: TopicNode, timeout_s: float, topic: str = "") -> dict[str, Entity]:
    """Publishers by their topic, without those of the node itself; waits until one is known.

    Parameters
    ----------
    node
        Open node.
    timeout_s
        Maximum waiting time [s].
    topic
        Wait for this topic; by default for any.
    """
    end_s = time.monotonic() + timeout_s
    while True:
        found = {
            entity.topic: entity
            for entity in node.graph(timeout_s)
            if entity.kind is EntityKind.PUBLISHER and entity.node != node.name
        }
        if (topic in found if topic else found) or time.monotonic() >= end_s:
            return dict(sorted(found.items()))
        time.sleep(_AGAIN_S)


def echo(node: TopicNode, topic: str, timeout_s: float = 5.0) -> Iterator[dict[str, Any]]:
    """Messages of a topic as they arrive, with the type and quality of service of its publisher; the latest 100 wait.

    Parameters
    ----------
    node
        Open node.
    topic
        Name of the topic.
    timeout_s
        Maximum waiting time for the publisher, and for each message [s].

    Raises
    ------
    InputError
        The topic is not published, or its type is unknown.
    DeviceError
        No message arrived in time.
    """
    place = node.resolve(topic)
    topics = find_topics(node, timeout_s, place)
    if place not in topics:
        known = ", ".join(topics) or "none; check domain, router and transport"
        raise InputError(place, f"is not published; found {known}")
    publisher = topics[place]
    qos = Qos(publisher.qos.reliable, publisher.qos.latched, depth=100)
    waiting: queue.Queue[Any] = queue.Queue(qos.depth)

    def take(received: Received) -> None:
        # As the middleware does: of more than fit, the oldest are dropped.
        with suppress(queue.Empty, queue.Full):
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(received.message)

    with closing(node.subscribe(place, publisher.datatype, take, qos)):
        while True:
            try:
                yield plain_message(waiting.get(timeout=timeout_s))
            except queue.Empty:
                raise DeviceError(
                    f"no message on {place} ({publisher.datatype}) for {timeout_s:g} s; "
                    f"it is published by {publisher.node}"
                ) from None


def plain_message(message: Any) -> Any:
    """Convert a message to mappings, lists, numbers and strings; long arrays are summarised.

    Parameters
    ----------
    message
        Message with its fields as attributes, or the value of a field.
    """
    if isinstance(message, SimpleNamespace):
        return {name: plain_message(value) for name, value in vars(message).items()}
    if isinstance(message, (bytes, bytearray, memoryview, list, tuple, np.ndarray)):
        if len(message) > MAX_VALUES:
            return f"<{len(message)} values>"
        return [plain_message(value) for value in message]
    return message.item() if isinstance(message, np.generic) else message
