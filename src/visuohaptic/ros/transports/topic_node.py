"""A node whatever carries its messages: the same publishers, subscriptions and counts on every transport.

Messages cross every transport as CDR bytes of our own codec, so a transport only sends and receives bytes.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ...core.errors import DeviceError, InputError, VisuohapticError
from ...core.resources import Closing
from ..wire.attachment import Attachment
from ..wire.cdr import decode, encode
from ..wire.graph import Entity, EntityKind, Qos, check_node, resolve_name
from ..wire.message_types import MessageType, message_type
from .session import RosOptions, shown_error

__all__ = ["Execute", "Outlet", "Received", "RosPublisher", "RosSubscription", "TopicNode"]

_log = logging.getLogger(__name__)

#: Goal, feedback, whether it was cancelled -> whether it is reached.
Execute = Callable[[Any, Callable[[Mapping[str, Any]], None], Callable[[], bool]], bool]


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A message that came in."""

    message: Any  #: its fields as attributes
    attachment: Attachment | None  #: number and time of sending; ``None`` where the sender tells neither
    received_s: float  #: seconds since 1970, by the clock of this machine

    @property
    def t_s(self) -> float:
        """Time of the header's stamp [s]; where it is zero, that of sending, or of receiving."""
        stamp, beside = self.message.header.stamp, self.attachment
        if (t_s := float(stamp.sec + 1e-9 * stamp.nanosec)) > 0:
            return t_s
        return self.received_s if beside is None else 1e-9 * beside.source_ns


@dataclass(frozen=True, slots=True)
class Outlet:
    """What a transport sends the bytes of one topic with."""

    #: Sends CDR bytes, and the number of the message, from 1; raises an error of its own where the transport is closed.
    send: Callable[[bytes, int], object]
    heard: Callable[[], bool]  #: whether anybody subscribes now


class RosPublisher:
    """Sends messages of one topic; created by :meth:`TopicNode.advertise`, usable from any thread.

    Parameters
    ----------
    topic
        Absolute name.
    kind
        Type of its messages.
    outlet
        Of the transport.
    closed
        Whether the node is closed.
    """

    def __init__(self, topic: str, kind: MessageType, outlet: Outlet, closed: Callable[[], bool]) -> None:
        self.topic = topic
        self._kind, self._outlet, self._closed = kind, outlet, closed
        self._sequence = 0
        self._lock = threading.Lock()

    def publish(self, message: Mapping[str, Any]) -> None:
        """Send the fields of a message.

        Parameters
        ----------
        message
            Values by field, nested as the type is.

        Raises
        ------
        InputError
            They are not those of the topic's type.
        DeviceError
            The node is closed.
        """
        self.send(encode(message, self._kind))

    def send(self, data: bytes) -> None:
        """Send a message that is CDR already, as a recording holds it.

        Parameters
        ----------
        data
            Of the topic's type, with its encapsulation header.

        Raises
        ------
        DeviceError
            The node is closed.
        """
        with self._lock:
            if self._closed():
                raise DeviceError(f"{self.topic}: cannot be published, its node is closed")
            try:
                self._outlet.send(data, self._sequence + 1)
            except Exception as error:  # of the transport: its classes are not ours
                raise DeviceError(f"{self.topic}: cannot be published ({shown_error(error)})") from error
            self._sequence += 1

    @property
    def heard(self) -> bool:
        """Whether anybody subscribes to it now; over zenoh not known of a latched topic, and no then."""
        return not self._closed() and self._outlet.heard()

    def wait_until_heard(self, timeout_s: float = 1.0) -> None:
        """A command that nobody hears must not be taken for one that is carried out.

        Parameters
        ----------
        timeout_s
            How long a subscriber is waited for [s].

        Raises
        ------
        DeviceError
            Nobody has subscribed in time.
        """
        until = time.monotonic() + timeout_s
        while not self.heard:
            if time.monotonic() > until:
                raise DeviceError(
                    f"nobody listens to {self.topic} ({self._kind.name}); check the robot's "
                    "controller, the topic, the domain and the ROS release"
                )
            time.sleep(0.002)

    @property
    def sent(self) -> int:
        """How many messages so far."""
        return self._sequence


class RosSubscription:
    """Receives messages of one topic; created by :meth:`TopicNode.subscribe`.

    Parameters
    ----------
    topic, kind
        As of :class:`RosPublisher`.
    receive
        Called with each message.
    """

    def __init__(self, topic: str, kind: MessageType, receive: Callable[[Received], None]) -> None:
        self.topic = topic
        self.received = 0  #: messages that were handed on
        self.damaged = 0  #: messages that could not be read
        self.undeclare: Callable[[], None] = lambda: None
        self._kind, self._receive = kind, receive

    def take(self, data: bytes, beside: Attachment | bytes | None) -> None:
        """Called by the transport.

        Parameters
        ----------
        data
            CDR bytes with their encapsulation header.
        beside
            Number and time of sending, as bytes where the transport has not read them.
        """
        try:
            attachment = Attachment.unpack(beside) if isinstance(beside, bytes) else beside
            message = decode(data, self._kind, self.topic)
            self._receive(Received(message, attachment, time.time()))
            self.received += 1
        except VisuohapticError as error:
            self.damaged += 1
            # 1, 2, 4, 8, ...: a stream of errors must not fill a disk
            if self.damaged & (self.damaged - 1) == 0:
                _log.warning("%s: %d messages cannot be read; %s", self.topic, self.damaged, error)

    def close(self) -> None:
        """Receive nothing more; harmless when repeated."""
        undeclare, self.undeclare = self.undeclare, lambda: None
        undeclare()


class TopicNode(Closing):
    """A node that publishes, subscribes and sees who is there; a context manager.

    Parameters
    ----------
    name
        Of the node.
    options
        Domain and namespace, and what the transport needs; the defaults of a ROS 2 node by default.
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        self.options = options or RosOptions()
        self.name, self.namespace = name, self.options.namespace
        check_node(self.namespace, name)
        self._closing: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._closed = False

    def resolve(self, name: str) -> str:
        """Absolute name of a topic, seen from this node.

        Parameters
        ----------
        name
            Absolute, relative to the namespace, or private (``~/name``).
        """
        return resolve_name(name, self.namespace, f"{self.namespace.rstrip('/')}/{self.name}")

    def now_s(self) -> float:
        """Time by which messages are stamped [s since 1970]; simulated time where the node uses it."""
        return time.time()

    def advertise(
        self, topic: str, datatype: str | MessageType, qos: Qos | None = None, *, wait: bool = False
    ) -> RosPublisher:
        """Say that messages will come.

        Parameters
        ----------
        topic
            Its name.
        datatype
            Name of a standard message, or a parsed definition.
        qos
            Quality of service; reliable and volatile by default.
        wait
            Publishing waits where the network is slower than the messages come, instead of losing some.
        """
        place, kind = self._endpoint(topic, datatype)
        outlet = self._outlet(place, kind, qos or Qos(), wait)
        return RosPublisher(place, kind, outlet, lambda: self._closed)

    def subscribe(
        self,
        topic: str,
        datatype: str | MessageType,
        receive: Callable[[Received], None],
        qos: Qos | None = None,
    ) -> RosSubscription:
        """Have a function called with every message, in a thread of the transport; it must be quick.

        Messages that cannot be read are counted, logged and left out.

        Parameters
        ----------
        topic, datatype
            As of :meth:`advertise`.
        receive
            Called with each message.
        qos
            Quality of service; reliable and volatile by default.
        """
        place, kind = self._endpoint(topic, datatype)
        subscription = RosSubscription(place, kind, receive)
        subscription.undeclare = self._listen(subscription, kind, qos or Qos())
        return subscription

    def _endpoint(self, topic: str, datatype: str | MessageType) -> tuple[str, MessageType]:
        if self._closed:
            raise DeviceError(f"the ROS node {self.name} is closed")
        return self.resolve(topic), message_type(datatype) if isinstance(datatype, str) else datatype

    def offer(self, service: str, work: Callable[[], str]) -> None:
        """Offer a ``std_srvs/srv/Trigger``; transports without services refuse it.

        Parameters
        ----------
        service
            Its name.
        work
            Called for each request in a thread of the transport; its text is the answer's message. An error of
            this library is answered with ``success: false`` and its line.

        Raises
        ------
        InputError
            This transport carries topics only.
        """
        raise InputError(
            "transport", f"{self.resolve(service)} is a service; the transport rclpy is needed for services"
        )

    def act(self, action: str, datatype: str, execute: Execute) -> None:
        """Offer an action; transports without actions refuse it.

        Parameters
        ----------
        action, datatype
            As of :meth:`~visuohaptic.ros.nodes.component.Host.act`.
        execute
            Called for each goal with the goal, what publishes fields of the feedback, and what says whether it was
            cancelled; returns whether the goal is reached. An error of this library ends the goal as cancelled where that
            was asked for, else as aborted.

        Raises
        ------
        InputError
            This transport carries topics only, or the interface is not installed.
        """
        raise InputError(
            "transport", f"{self.resolve(action)} is an action; the transport rclpy is needed for actions"
        )

    @abstractmethod
    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> Outlet:
        """Declare a publisher."""

    @abstractmethod
    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        """Declare a subscription; returns what takes it back."""

    @abstractmethod
    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """All nodes, publishers and subscriptions of the domain, this node's own among them.

        Parameters
        ----------
        timeout_s
            How long answers are waited for [s].
        """

    def close(self) -> None:
        """Take back all publishers and subscriptions and leave; harmless when repeated."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for close in reversed(self._closing):
            try:
                close()
            except Exception as error:  # noqa: BLE001 - transports' errors have no common base; the rest must close, too
                _log.debug("while closing: %s", error)
        self._closing.clear()
        self._leave()

    def _seen(self, kind: EntityKind, place: tuple[str, str], *endpoint: Any) -> Entity:
        """A node, or its endpoint (topic, type, type hash, quality of service), in this node's domain.

        Parameters
        ----------
        kind
            What it is.
        place
            Namespace and name of the node.
        *endpoint
            Topic, type, type hash and quality of service.
        """
        return Entity(self.options.domain, "", 0, 0, kind, *place, *endpoint)

    @abstractmethod
    def _leave(self) -> None:
        """Leave the domain."""
