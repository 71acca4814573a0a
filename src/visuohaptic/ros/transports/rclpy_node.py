"""A node of ROS 2 itself, over DDS: rclpy from a ROS 2 installation or from its wheels.

Messages are passed to rclpy as bytes, so that image data is not copied into Python message objects.
"""

from __future__ import annotations

import importlib
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.errors import InputError, VisuohapticError, needs
from ...core.resources import Closing, end_thread
from ..wire import Attachment, MessageType
from ..wire.graph import Entity, EntityKind, Qos, check_node
from .session import RosOptions, shown_error
from .topic_node import Execute, Outlet, RosSubscription, TopicNode

#: rclpy does not provide the sender of a message.
_GID = bytes(16)
#: If none of these is set, Fast DDS gets buffers large enough for raw images: with its default, nine of ten were lost.
_FASTDDS = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")


def import_rclpy() -> Any:
    """The module rclpy.

    Raises
    ------
    MissingExtraError
        No ROS 2 installation is sourced, and the wheels are not installed.
    """
    with needs("rclpy", "ros-jazzy", "ROS 2 over DDS (or the setup.bash of an installation)"):
        import rclpy
        import rclpy.executors
        import rclpy.lifecycle
    return rclpy


def interface(name: str) -> Any:
    """The class of a message, service or action, from its ROS package.

    Parameters
    ----------
    name
        Such as ``sensor_msgs/msg/Image``.

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


class RclpyTopics(TopicNode):
    """Topics and services of an rclpy node that is run elsewhere; a context manager.

    Parameters
    ----------
    inner
        The node, as in :class:`RclpyProcess`.
    """

    def __init__(self, inner: Any) -> None:
        from rclpy.callback_groups import ReentrantCallbackGroup

        domain = inner.context.get_domain_id()
        super().__init__(inner.get_name(), RosOptions(domain, inner.get_namespace()))
        self.inner = inner
        self._group = ReentrantCallbackGroup()

    def now_s(self) -> float:
        """Time of the node's clock [s]: that of ``/clock`` if ``use_sim_time`` is set."""
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

    def act(self, action: str, datatype: str, execute: Execute) -> None:
        from rclpy.action import ActionServer, CancelResponse

        kind = interface(datatype)

        def run(goal: Any) -> Any:
            def tell(fields: Mapping[str, Any]) -> None:
                feedback = kind.Feedback()
                for name, value in fields.items():
                    setattr(feedback, name, value)
                goal.publish_feedback(feedback)

            reached = False
            try:
                reached = execute(goal.request, tell, lambda: bool(goal.is_cancel_requested))
            except VisuohapticError as error:
                self.inner.get_logger().error(str(error))
            if reached:
                goal.succeed()
            elif goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            return kind.Result()

        server = ActionServer(
            self.inner,
            kind,
            self.resolve(action),
            run,
            callback_group=self._group,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._closing.append(server.destroy)

    def _qos(self, qos: Qos, *, keep_all: bool = False) -> Any:
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

        return QoSProfile(
            depth=qos.depth,
            history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        )

    def _outlet(self, topic: str, kind: MessageType, qos: Qos, wait: bool) -> Outlet:
        profile = self._qos(qos, keep_all=wait)
        publisher = self.inner.create_publisher(interface(kind.name), topic, profile)
        self._closing.append(lambda: self.inner.destroy_publisher(publisher))
        return Outlet(lambda data, _: publisher.publish(data), lambda: publisher.get_subscription_count() > 0)

    def _listen(self, subscription: RosSubscription, kind: MessageType, qos: Qos) -> Callable[[], None]:
        def take(data: bytes, info: dict[str, int | None]) -> None:
            number, sent_ns = info["publication_sequence_number"], info["source_timestamp"]
            if number is None or sent_ns is None:  # the middleware does not number messages
                subscription.take(data, None)
            else:
                subscription.take(data, Attachment(number, sent_ns, _GID))

        inner = self.inner.create_subscription(
            interface(kind.name), subscription.topic, take, self._qos(qos), raw=True
        )

        def undeclare() -> None:
            self.inner.destroy_subscription(inner)

        return undeclare

    def graph(self, timeout_s: float = 1.0) -> tuple[Entity, ...]:
        """The graph as currently known to the middleware; undiscovered entities are missing.

        Parameters
        ----------
        timeout_s
            Not used: returns what is currently known.
        """
        found = [
            self._seen(EntityKind.NODE, (namespace, name))
            for name, namespace in self.inner.get_node_names_and_namespaces()
        ]
        for topic, _ in self.inner.get_topic_names_and_types():
            for kind, ask in (
                (EntityKind.PUBLISHER, self.inner.get_publishers_info_by_topic),
                (EntityKind.SUBSCRIPTION, self.inner.get_subscriptions_info_by_topic),
            ):
                found += [
                    self._seen(
                        kind, (info.node_namespace, info.node_name),
                        topic, info.topic_type, str(info.topic_type_hash), _told_qos(info.qos_profile),
                    )
                    for info in ask(topic)
                ]  # fmt: skip
        return tuple(found)

    def _leave(self) -> None:
        """The node continues without these topics."""


class RclpyProcess(Closing):
    """An rclpy node with its own context and threads; a context manager.

    Parameters
    ----------
    name
        Name of the node; ``--ros-args -r __node:=...`` overrides it.
    options
        Domain and namespace. The other fields apply to zenoh.
    arguments
        ROS command line, such as ``("--ros-args", "-p", "use_sim_time:=true")``.
    managed
        Whether the node has a lifecycle (``lifecycle_msgs``).

    Raises
    ------
    MissingExtraError
        rclpy is not available.
    InputError
        The arguments are not valid ROS arguments.
    """

    def __init__(
        self,
        name: str,
        options: RosOptions | None = None,
        arguments: Sequence[str] = (),
        *,
        managed: bool = False,
    ) -> None:
        rclpy = import_rclpy()
        options = options or RosOptions()
        if not any(name in os.environ for name in _FASTDDS):
            os.environ[_FASTDDS[0]] = str(Path(__file__).with_name("fastdds.xml"))
        self._context = rclpy.Context()
        try:
            self._context.init(args=["visuohaptic", *arguments], domain_id=options.domain)
            make = rclpy.lifecycle.LifecycleNode if managed else rclpy.node.Node
            namespace = None if options.namespace == "/" else options.namespace
            self.inner = make(name, context=self._context, namespace=namespace)
        except Exception as error:
            self._context.try_shutdown()
            raise InputError("ROS node", f"cannot be created ({shown_error(error)})") from error
        # A driving action and its cancellation, a slow service, and topics at the same time.
        self._executor = rclpy.executors.MultiThreadedExecutor(4, context=self._context)
        self._executor.add_node(self.inner)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=f"node {name}", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        try:
            while not self._end.is_set() and self._context.ok():
                self._executor.spin_once(timeout_sec=0.2)
        except (ExternalShutdownException, ShutdownException):
            return

    def close(self) -> None:
        """Leave the graph; may be called repeatedly."""
        if self._end.is_set():
            return
        self._end.set()
        self._executor.wake()
        end_thread(self._thread)
        self._executor.shutdown(timeout_sec=1.0)
        self.inner.destroy_node()
        self._context.try_shutdown()


class RclpyNode(RclpyTopics):
    """A node over rclpy; a context manager.

    Parameters
    ----------
    name, options
        As in :class:`.CycloneNode`.

    Raises
    ------
    MissingExtraError
        rclpy is not available.
    """

    def __init__(self, name: str = "visuohaptic", options: RosOptions | None = None) -> None:
        options = options or RosOptions()
        check_node(options.namespace, name)
        self._process = RclpyProcess(name, options)
        super().__init__(self._process.inner)

    def _leave(self) -> None:
        self._process.close()


def _told_qos(profile: Any) -> Qos:
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    return Qos(
        profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        min(max(profile.depth, 1), 100_000),
    )
