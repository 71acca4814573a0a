"""A node among ROS 2 nodes that run rmw_zenoh: publish, subscribe, see who is there."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..core.errors import DeviceError, InputError, VisuohapticError
from ..core.resources import Closing
from .session import RosOptions, open_session, shown_error
from .wire._gid import publisher_gid
from .wire.attachment import Attachment
from .wire.cdr import decode, encode
from .wire.graph import Entity, EntityKind, Qos, all_tokens, check_node, resolve_name, topic_key
from .wire.message_types import NO_HASH, MessageType, message_type

if TYPE_CHECKING:
    import zenoh

__all__ = ["Received", "RosNode", "RosPublisher", "RosSubscription"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A message that came in."""

    message: Any  #: its fields as attributes
    attachment: Attachment | None  #: ``None`` from a sender that is not rmw_zenoh
    received_s: float  #: seconds since 1970


class RosNode(Closing):
    """A node; a context manager.

    Parameters
    ----------
    name
        Of the node.
    options
        Domain, namespace, routers; the defaults of a ROS 2 node by default.

    Raises
    ------
    DeviceError
        No router answers.

    Examples
    --------
    >>> with RosNode("probe") as node:                                              # doctest: +SKIP
    ...     wrench = node.advertise("foam/wrench", "geometry_msgs/msg/WrenchStamped")
    ...     wrench.publish(force_wrench(profile, "foam"))
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        self.options = options or RosOptions()
        self.name, self.namespace = name, self.options.namespace
        check_node(self.namespace, name)
        self._session = open_session(self.options)
        self._id = str(self._session.zid())
        self._numbers = itertools.count(1)
        self._closing: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._closed = False
        self._declare(self._entity(EntityKind.NODE, 0))

    def _entity(self, kind: EntityKind, number: int) -> Entity:
        return Entity(self.options.domain, self._id, 0, number, kind, self.namespace, self.name)

    def _endpoint(self, kind: EntityKind, topic: str, datatype: MessageType, qos: Qos) -> Entity:
        if self._closed:
            raise DeviceError(f"the ROS node {self.name} is closed")
        entity = self._entity(kind, next(self._numbers))
        return Entity(
            entity.domain,
            entity.session,
            0,
            entity.entity_id,
            kind,
            entity.namespace,
            entity.node,
            self.resolve(topic),
            datatype.name,
            datatype.type_hash() if self.options.type_hashes else NO_HASH,
            qos,
        )

    def _declare(self, entity: Entity) -> None:
        token = self._session.liveliness().declare_token(entity.token())
        self._closing.append(token.undeclare)

    def resolve(self, name: str) -> str:
        """Absolute name of a topic, seen from this node.

        Parameters
        ----------
        name
            Absolute, relative to the namespace, or private (``~/name``).
        """
        return resolve_name(name, self.namespace, f"{self.namespace.rstrip('/')}/{self.name}")

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
        import zenoh
        from zenoh import ext

        kind = message_type(datatype) if isinstance(datatype, str) else datatype
        qos = qos or Qos()
        entity = self._endpoint(EntityKind.PUBLISHER, topic, kind, qos)
        key = topic_key(entity.domain, entity.topic, entity.datatype, entity.type_hash)
        congestion = zenoh.CongestionControl.BLOCK if wait else zenoh.CongestionControl.DROP
        if qos.latched:
            publisher = ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=congestion,
                cache=ext.CacheConfig(qos.depth),
                publisher_detection=True,
            )
        else:
            publisher = self._session.declare_publisher(key, congestion_control=congestion)
        self._closing.append(publisher.undeclare)
        self._declare(entity)
        return RosPublisher(entity, kind, publisher)

    def subscribe(
        self,
        topic: str,
        datatype: str | MessageType,
        receive: Callable[[Received], None],
        qos: Qos | None = None,
    ) -> RosSubscription:
        """Have a function called with every message, in a thread of zenoh's; it must be quick.

        Messages that cannot be read are counted, logged and left out.

        Parameters
        ----------
        topic
            Its name.
        datatype
            Name of a standard message, or a parsed definition.
        receive
            Called with each message.
        qos
            Quality of service; reliable and volatile by default.
        """
        from zenoh import ext

        kind = message_type(datatype) if isinstance(datatype, str) else datatype
        qos = qos or Qos()
        entity = self._endpoint(EntityKind.SUBSCRIPTION, topic, kind, qos)
        key = topic_key(entity.domain, entity.topic, entity.datatype, entity.type_hash)
        subscription = RosSubscription(entity, kind, receive)
        if qos.latched:
            history = ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth)
            inner = ext.declare_advanced_subscriber(self._session, key, subscription.take, history=history)
        else:
            inner = self._session.declare_subscriber(key, subscription.take)
        subscription.undeclare = inner.undeclare
        self._closing.append(inner.undeclare)
        self._declare(entity)
        return subscription

    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """All nodes, publishers and subscriptions of the domain, this node's own among them.

        Parameters
        ----------
        timeout_s
            How long answers are waited for [s].
        """
        found = {}
        for reply in self._session.liveliness().get(all_tokens(self.options.domain), timeout=timeout_s):
            if reply.ok is None:
                continue
            try:
                entity = Entity.parse(str(reply.ok.key_expr))
            except InputError as error:
                _log.debug("%s", error)
                continue
            found[str(reply.ok.key_expr)] = entity
        return tuple(found[key] for key in sorted(found))

    def close(self) -> None:
        """Take back all tokens and leave; harmless when repeated."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for close in reversed(self._closing):
            try:
                close()
            except Exception as error:  # noqa: BLE001 - zenoh's errors have no common base; the rest must close, too
                _log.debug("while closing: %s", error)
        self._session.close()


class RosPublisher:
    """Sends messages of one topic; made by :meth:`RosNode.advertise`, usable from any thread.

    Parameters
    ----------
    entity
        As declared to the graph.
    kind
        Type of its messages.
    publisher
        Of zenoh.
    """

    def __init__(self, entity: Entity, kind: MessageType, publisher: Any) -> None:
        self.entity = entity
        self._kind, self._publisher = kind, publisher
        self._gid = publisher_gid(entity.token())
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
            The session is closed.
        """
        data = encode(message, self._kind)
        with self._lock:
            beside = Attachment(self._sequence + 1, time.time_ns(), self._gid).pack()
            try:
                self._publisher.put(data, attachment=beside)
            except Exception as error:
                raise DeviceError(
                    f"{self.entity.topic}: cannot be published ({shown_error(error)})"
                ) from error
            self._sequence += 1

    @property
    def heard(self) -> bool:
        """Whether anybody subscribes to it now; not known of a latched topic, and no then."""
        status = getattr(self._publisher, "matching_status", False)
        return bool(getattr(status, "matching", status))  # zenoh 1.4 has an object there

    def wait_until_heard(self, timeout_s: float = 1.0) -> None:
        """A command that nobody hears must not be taken for one that is carried out.

        Parameters
        ----------
        timeout_s
            At most so long [s].

        Raises
        ------
        DeviceError
            Nobody has subscribed in time.
        """
        until = time.monotonic() + timeout_s
        while not self.heard:
            if time.monotonic() > until:
                raise DeviceError(
                    f"nobody listens to {self.entity.topic} ({self.entity.datatype}); check the robot's "
                    "controller, the topic, the domain and the ROS release"
                )
            time.sleep(0.002)

    @property
    def sent(self) -> int:
        """How many messages so far."""
        return self._sequence


class RosSubscription:
    """Receives messages of one topic; made by :meth:`RosNode.subscribe`.

    Parameters
    ----------
    entity
        As declared to the graph.
    kind
        Type of its messages.
    receive
        Called with each message.
    """

    def __init__(self, entity: Entity, kind: MessageType, receive: Callable[[Received], None]) -> None:
        self.entity = entity
        self.received = 0  #: messages that were handed on
        self.damaged = 0  #: messages that could not be read
        self.undeclare: Callable[[], None] = lambda: None
        self._kind, self._receive = kind, receive

    def take(self, sample: zenoh.Sample) -> None:
        """Called by zenoh.

        Parameters
        ----------
        sample
            Payload and attachment.
        """
        try:
            beside = Attachment.unpack(sample.attachment.to_bytes()) if sample.attachment else None
            message = decode(sample.payload.to_bytes(), self._kind, self.entity.topic)
            self._receive(Received(message, beside, time.time()))
            self.received += 1
        except VisuohapticError as error:
            self.damaged += 1
            if (
                self.damaged & (self.damaged - 1) == 0
            ):  # 1, 2, 4, 8, ...: a stream of errors must not fill a disk
                _log.warning("%s: %d messages cannot be read; %s", self.entity.topic, self.damaged, error)

    def close(self) -> None:
        """Receive nothing more."""
        self.undeclare()
