"""A node among ROS 2 nodes with rmw_zenoh: publish, subscribe, query the graph."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...core.errors import InputError
from ..wire import NO_HASH, Attachment, MessageType
from ..wire._gid import publisher_gid
from ..wire.graph import Entity, EntityKind, Qos, all_tokens, topic_key
from .session import RosOptions, open_session
from .topic_node import Outlet, RosSubscription, TopicNode

if TYPE_CHECKING:
    import zenoh

_log = logging.getLogger(__name__)


class RosNode(TopicNode):
    """A node over zenoh; a context manager.

    Parameters
    ----------
    name
        Name of the node.
    options
        Domain, namespace, routers; by default those of a ROS 2 node.

    Raises
    ------
    DeviceError
        No router responds.

    Examples
    --------
    >>> with RosNode("probe") as node:                                              # doctest: +SKIP
    ...     wrench = node.advertise("foam/wrench", "geometry_msgs/msg/WrenchStamped")
    ...     wrench.publish(force_wrench(profile, "foam"))
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        super().__init__(name, options)
        self._session = open_session(self.options)
        self._id = str(self._session.zid())
        self._numbers = itertools.count(1)
        self._closing.append(self._declare(self._entity(EntityKind.NODE, 0)))

    def _entity(self, kind: EntityKind, number: int, *endpoint: Any) -> Entity:
        place = (self.domain, self._id, 0, number, kind, self.namespace, self.name)
        return Entity(*place, *endpoint)

    def _topic_entity(self, kind: EntityKind, topic: str, datatype: MessageType, qos: Qos) -> Entity:
        type_hash = datatype.type_hash() if self.options.type_hashes else NO_HASH
        return self._entity(kind, next(self._numbers), topic, datatype.name, type_hash, qos)

    def _declare(self, entity: Entity) -> Callable[[], None]:
        """Announce an entity in the graph; returns the function that withdraws it."""
        withdraw: Callable[[], None] = self._session.liveliness().declare_token(entity.token()).undeclare
        return withdraw

    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> Outlet:
        import zenoh
        from zenoh import ext

        entity = self._topic_entity(EntityKind.PUBLISHER, topic, kind, qos)
        key = topic_key(entity.domain, topic, entity.datatype, entity.type_hash)
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
        self._closing += [publisher.undeclare, self._declare(entity)]
        gid = publisher_gid(entity.token())

        def send(data: bytes, number: int) -> None:
            publisher.put(data, attachment=Attachment(number, time.time_ns(), gid).pack())

        def heard() -> bool:
            status = getattr(publisher, "matching_status", False)
            return bool(getattr(status, "matching", status))  # zenoh 1.4 returns an object

        return Outlet(send, heard)

    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        from zenoh import ext

        entity = self._topic_entity(EntityKind.SUBSCRIPTION, subscription.topic, kind, qos)
        key = topic_key(entity.domain, entity.topic, entity.datatype, entity.type_hash)

        def take(sample: zenoh.Sample) -> None:
            beside = sample.attachment.to_bytes() if sample.attachment else None
            subscription.take(sample.payload.to_bytes(), beside)

        if qos.latched:
            history = ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth)
            inner = ext.declare_advanced_subscriber(self._session, key, take, history=history)
        else:
            inner = self._session.declare_subscriber(key, take)
        parts: tuple[Callable[[], None], ...] = (self._declare(entity), inner.undeclare)

        def undeclare() -> None:
            for part in parts:
                part()

        return undeclare

    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        found = {}
        for reply in self._session.liveliness().get(all_tokens(self.domain), timeout=timeout_s):
            if reply.ok is None:
                continue
            try:
                entity = Entity.parse(str(reply.ok.key_expr))
            except InputError as error:
                _log.debug("%s", error)
                continue
            found[str(reply.ok.key_expr)] = entity
        return tuple(found[key] for key in sorted(found))

    def _leave(self) -> None:
        self._session.close()
