"""A node of ROS 2 itself, over DDS: rclpy from an installation of ROS 2 or from its wheels.

Messages are handed to rclpy as bytes, so no field of an image is copied into a message of Python's.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Sequence
from typing import Any

from ...core.errors import DeviceError, InputError, MissingExtraError, VisuohapticError
from ..wire.attachment import Attachment
from ..wire.graph import Entity, EntityKind, Qos
from ..wire.message_types import MessageType
from .session import RosOptions, shown_error
from .topic_node import RosSubscription, TopicNode

__all__ = ["RclpyNode", "import_rclpy", "interface"]

#: rclpy does not tell who has sent a message.
_GID = bytes(16)


def import_rclpy() -> Any:
    """The module rclpy.

    Raises
    ------
    MissingExtraError
        Neither an installation of ROS 2 is sourced, nor are the wheels there.
    """
    try:
        import rclpy
        import rclpy.executors
        import rclpy.lifecycle
    except ImportError as error:
        raise MissingExtraError(
            "rclpy", "ros-jazzy", "ROS 2 over DDS (or the setup.bash of an installation)"
        ) from error
    return rclpy


def interface(name: str) -> Any:
    """The class of a message, service or action, from the package of ROS that has it.

    Parameters
    ----------
    name
        As ``sensor_msgs/msg/Image``.

    Raises
    ------
    InputError
        The package is not installed.
    """
    package, middle, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{middle}"), short)
    except (ImportError, AttributeError) as error:
        wheel = package.replace("_", "-")
        raise InputError(
            name,
            "is not among the interfaces of this ROS 2",
            remedy=f"install ros-$ROS_DISTRO-{wheel} (apt) or ros-jazzy-{wheel} (pip)",
        ) from error


class _RclpyOutlet:
    def __init__(self, topic: str, publisher: Any) -> None:
        self._topic, self._publisher = topic, publisher

    @property
    def heard(self) -> bool:
        return bool(self._publisher.get_subscription_count())

    def send(self, data: bytes, number: int) -> None:
        try:
            self._publisher.publish(data)
        except Exception as error:
            raise DeviceError(f"{self._topic}: cannot be published ({shown_error(error)})") from error


class RclpyNode(TopicNode):
    """A node over rclpy with a context and threads of its own; a context manager.

    Parameters
    ----------
    name
        Of the node; ``--ros-args -r __node:=...`` replaces it.
    options
        Domain and namespace; the other fields are of zenoh.
    arguments
        Command line of ROS, as ``("--ros-args", "-p", "use_sim_time:=true")``.
    managed
        A node with a life cycle (``lifecycle_msgs``).

    Raises
    ------
    MissingExtraError
        rclpy is not there.
    InputError
        The arguments are not those of ROS.
    """

    def __init__(
        self,
        name: str = "visuohaptic",
        options: RosOptions | None = None,
        *,
        arguments: Sequence[str] = (),
        managed: bool = False,
    ) -> None:
        super().__init__(name, options)
        rclpy = import_rclpy()
        self._context = rclpy.Context()
        try:
            self._context.init(args=["visuohaptic", *arguments], domain_id=self.options.domain or None)
            make = rclpy.lifecycle.LifecycleNode if managed else rclpy.node.Node
            namespace = None if self.namespace == "/" else self.namespace
            self.inner = make(name, context=self._context, namespace=namespace)
        except Exception as error:
            self._context.try_shutdown()
            raise InputError("ROS node", f"cannot be created ({shown_error(error)})") from error
        self.name, self.namespace = self.inner.get_name(), self.inner.get_namespace()
        self._group = rclpy.callback_groups.ReentrantCallbackGroup()
        # Two threads: a service that takes its time must not hold up the topics.
        self.executor = rclpy.executors.MultiThreadedExecutor(2, context=self._context)
        self.executor.add_node(self.inner)
        self._thread = threading.Thread(target=self._spin, name=f"node {self.name}", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        try:
            while not self._closed and self._context.ok():
                self.executor.spin_once(timeout_sec=0.2)
        except (ExternalShutdownException, ShutdownException):
            return

    @property
    def ok(self) -> bool:
        """Whether the context still runs; ROS's own signal handlers may have ended it."""
        return bool(self._context.ok())

    def now_s(self) -> float:
        """Time of the node's clock [s]: that of ``/clock`` where ``use_sim_time`` is set."""
        return 1e-9 * float(self.inner.get_clock().now().nanoseconds)

    def offer(self, service: str, work: Callable[[], str]) -> None:
        def answer(_: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, work()
            except VisuohapticError as error:
                response.success, response.message = False, str(error)
            return response

        kind = interface("std_srvs/srv/Trigger")
        server = self.inner.create_service(kind, self.resolve(service), answer, callback_group=self._group)
        self._closing.append(lambda: self.inner.destroy_service(server))

    def _qos(self, qos: Qos, *, keep_all: bool = False) -> Any:
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

        return QoSProfile(
            depth=qos.depth,
            history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        )

    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> _RclpyOutlet:
        profile = self._qos(qos, keep_all=wait)
        publisher = self.inner.create_publisher(interface(kind.name), topic, profile)
        self._closing.append(lambda: self.inner.destroy_publisher(publisher))
        return _RclpyOutlet(topic, publisher)

    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        def take(data: bytes, info: dict[str, int | None]) -> None:
            number, sent_ns = info["publication_sequence_number"], info["source_timestamp"]
            if number is None or sent_ns is None:  # a middleware that does not count
                subscription.take(data, None)
            else:
                subscription.take(data, Attachment(number, sent_ns, _GID))

        inner = self.inner.create_subscription(
            interface(kind.name), subscription.topic, take, self._qos(qos), raw=True
        )
        return lambda: self.inner.destroy_subscription(inner)

    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """As told by the middleware now; what it has not discovered yet is not there."""
        found = [
            self._entity(EntityKind.NODE, namespace, name)
            for name, namespace in self.inner.get_node_names_and_namespaces()
        ]
        for topic, _ in self.inner.get_topic_names_and_types():
            for kind, ask in (
                (EntityKind.PUBLISHER, self.inner.get_publishers_info_by_topic),
                (EntityKind.SUBSCRIPTION, self.inner.get_subscriptions_info_by_topic),
            ):
                found += [
                    self._entity(
                        kind,
                        info.node_namespace,
                        info.node_name,
                        topic,
                        info.topic_type,
                        str(info.topic_type_hash),
                        _told_qos(info.qos_profile),
                    )
                    for info in ask(topic)
                ]
        return tuple(found)

    def _entity(self, kind: EntityKind, namespace: str, node: str, *endpoint: Any) -> Entity:
        return Entity(self._context.get_domain_id(), "", 0, 0, kind, namespace, node, *endpoint)

    def _leave(self) -> None:
        if threading.current_thread() is not self._thread:
            self._thread.join()
        self.executor.shutdown(timeout_sec=1.0)
        self.inner.destroy_node()
        self._context.try_shutdown()


def _told_qos(profile: Any) -> Qos:
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    return Qos(
        profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        min(max(profile.depth, 1), 100_000),
    )
