"""Transport-independent node: the same publishers, subscriptions and counters on every transport.

Messages are CDR bytes from this library's codec on every transport, so that a transport only sends and receives bytes.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...core import Closing, DeviceError, InputError, VisuohapticError
from ..wire import Attachment, MessageType, decode, encode, message_type
from ..wire.graph import Entity, EntityKind, Qos, check_node, resolve_name
from .session import RosOptions, environment_domain, shown_error

_log = logging.getLogger(__name__)

#: Goal, feedback function, whether it was cancelled -> whether the goal was reached.
Execute = Callable[[Any, Callable[[Mapping[str, Any]], None], Callable[[], bool]], bool]


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A received message."""

    message: Any  #: its fields as attributes
    attachment: Attachment | None  #: number and time of sending; ``None`` if the sender provides neither
    received_s: float  #: seconds since 1970, on this machine's clock

    @property
    def t_s(self) -> float:
        """Time of the header's timestamp [s]; if zero, the sending or receiving time."""
        stamp, beside = self.message.header.stamp, self.attachment
        if (t_s := float(stamp.sec + 1e-9 * stamp.nanosec)) > 0:
            return t_s
        return self.received_s if beside is None else 1e-9 * beside.source_ns


@dataclass(frozen=True, slots=True)
class Outlet:
    """Sending side of a transport for one topic."""

    #: Sends CDR bytes with the message number, from 1; raises a transport-specific exception if the transport is closed.
    send: Callable[[bytes, int], object]
    heard: Callable[[], bool]  #: whether there is a subscriber


class RosPublisher:
    """Sends messages of one topic; created by :meth:`TopicNode.advertise`, usable from any thread.

    Parameters
    ----------
    topic
        Absolute name.
    kind
        Type of its messages.
    outlet
        Sending side of the transport.
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
        """Send a message that is already in CDR format, for example from a recording.

        Parameters
        ----------
        data
            Message of the topic's type, with its encapsulation header.

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
            except Exception as error:  # of the transport: no common base class
                raise DeviceError(f"{self.topic}: cannot be published ({shown_error(error)})") from error
            self._sequence += 1

    @property
    def heard(self) -> bool:
        """Whether there is a subscriber; unknown for latched topics over zenoh, where it is False."""
        return not self._closed() and self._outlet.heard()

    def wait_until_heard(self, timeout_s: float = 1.0) -> None:
        """Wait for a subscriber: an unheard command must not be taken as executed.

        Parameters
        ----------
        timeout_s
            Longest wait [s].

        Raises
        ------
        DeviceError
            There was no subscriber in time.
        """
        until = time.monotonic() + timeout_s
        while not self.heard:
            if time.monotonic() > until:
                raise DeviceError(
                    f"no subscriber to {self.topic} ({self._kind.name}); check the robot's "
                    "controller, the topic, the domain and the ROS release"
                )
            time.sleep(0.002)

    @property
    def sent(self) -> int:
        """Number of messages sent so far."""
        return self._sequence


class RosSubscription:
    """Receives messages of one topic; created by :meth:`TopicNode.subscribe`.

    Parameters
    ----------
    topic, kind
        As in :class:`RosPublisher`.
    receive
        Called with each message.
    """

    def __init__(self, topic: str, kind: MessageType, receive: Callable[[Received], None]) -> None:
        self.topic = topic
        self.received = 0  #: messages that were passed on
        self.damaged = 0  #: messages that could not be read
        self.undeclare: Callable[[], None] = lambda: None
        self._kind, self._receive = kind, receive

    def take(self, data: bytes, beside: Attachment | bytes | None) -> None:
        """Process a message; called by the transport.

        Parameters
        ----------
        data
            CDR bytes with their encapsulation header.
        beside
            Number and time of sending; as bytes if the transport has not decoded them.
        """
        try:
            attachment = Attachment.unpack(beside) if isinstance(beside, bytes) else beside
            message = decode(data, self._kind, self.topic)
            self._receive(Received(message, attachment, time.time()))
            self.received += 1
        except VisuohapticError as error:
            self.damaged += 1
            # 1, 2, 4, 8, ...: a stream of errors must not fill the disk
            if self.damaged & (self.damaged - 1) == 0:
                _log.warning("%s: %d messages cannot be read; %s", self.topic, self.damaged, error)

    def close(self) -> None:
        """Unsubscribe; may be called repeatedly."""
        undeclare, self.undeclare = self.undeclare, lambda: None
        undeclare()


class TopicNode(Closing):
    """A node that publishes, subscribes and queries the graph; a context manager.

    Parameters
    ----------
    name
        Name of the node.
    options
        Domain, namespace, and transport settings; by default those of a ROS 2 node.
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        options = options or RosOptions()
        self.domain = environment_domain() if options.domain is None else options.domain
        self.options = replace(options, domain=self.domain)
        self.name, self.namespace = name, self.options.namespace
        check_node(self.namespace, name)
        self._closing: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._closed = False

    def resolve(self, name: str) -> str:
        """Absolute name of a topic, resolved relative to this node.

        Parameters
        ----------
        name
            Absolute, relative to the namespace, or private (``~/name``).
        """
        return resolve_name(name, self.namespace, f"{self.namespace.rstrip('/')}/{self.name}")

    def now_s(self) -> float:
        """Time for message timestamps [s since 1970]; simulated time if the node uses it."""
        return time.time()

    def advertise(
        self, topic: str, datatype: str | MessageType, qos: Qos | None = None, *, wait: bool = False
    ) -> RosPublisher:
        """Create a publisher.

        Parameters
        ----------
        topic
            Name of the topic.
        datatype
            Name of a standard message type, or a parsed definition.
        qos
            Quality of service; reliable and volatile by default.
        wait
            Publishing blocks if the network is slower than the messages, instead of losing some.
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
        """Call a function with every message, in a thread of the transport; it must return quickly.

        Messages that cannot be decoded are counted, logged and skipped.

        Parameters
        ----------
        topic, datatype
            As in :meth:`advertise`.
        receive
            Called with each message.
        qos
            Quality of service; reliable and volatile by default.
        """
        place, kind = self._endpoint(topic, datatype)
        subscription = RosSubscription(place, kind, receive)
        leave = self._listen(subscription, kind, qos or Qos())

        def undeclare() -> None:
            self._closing.remove(subscription.close)
            leave()

        subscription.undeclare = undeclare
        self._closing.append(subscription.close)
        return subscription

    def _endpoint(self, topic: str, datatype: str | MessageType) -> tuple[str, MessageType]:
        if self._closed:
            raise DeviceError(f"the ROS node {self.name} is closed")
        return self.resolve(topic), message_type(datatype) if isinstance(datatype, str) else datatype

    def offer(self, service: str, work: Callable[[], str]) -> None:
        """Offer a ``std_srvs/srv/Trigger``; rejected by transports without services.

        Parameters
        ----------
        service
            Name of the service.
        work
            Called for each request in a thread of the transport; returns the text of the response. An error of
            this library is answered with ``success: false`` and its message.

        Raises
        ------
        InputError
            This transport supports topics only.
        """
        raise InputError(
            "transport", f"{self.resolve(service)} is a service; the transport rclpy is needed for services"
        )

    def act(self, action: str, datatype: str, execute: Execute) -> None:
        """Offer an action; rejected by transports without actions.

        Parameters
        ----------
        action, datatype
            As in :meth:`~visuohaptic.ros.nodes.component.Host.act`.
        execute
            Called for each goal with the goal, a function that publishes feedback fields, and one that returns whether it was
            cancelled; returns whether the goal was reached. After an error of this library, the goal is cancelled if this was
            requested, otherwise aborted.

        Raises
        ------
        InputError
            This transport supports topics only, or the interface is not installed.
        """
        raise InputError(
            "transport", f"{self.resolve(action)} is an action; the transport rclpy is needed for actions"
        )

    @abstractmethod
    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> Outlet:
        """Declare a publisher."""

    @abstractmethod
    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        """Declare a subscription; returns a function that removes it."""

    @abstractmethod
    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """All nodes, publishers and subscriptions of the domain, including this node's.

        Parameters
        ----------
        timeout_s
            Time-out for replies [s].
        """

    def close(self) -> None:
        """Remove all publishers and subscriptions and leave the domain; may be called repeatedly."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for close in self._closing[::-1]:
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
            Kind of the entity.
        place
            Namespace and name of the node.
        *endpoint
            Topic, type, type hash and quality of service.
        """
        return Entity(self.domain, "", 0, 0, kind, *place, *endpoint)

    @abstractmethod
    def _leave(self) -> None:
        """Leave the domain."""
