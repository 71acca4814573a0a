"""Functionality of a node between its topics, services and actions, independent of how it is run."""

from __future__ import annotations

import logging
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from ...core import Closing, DeviceError, InputError, Pose
from ...core.files.plain_json import dumps
from ...core.resources import end_thread
from ...io.ros import ros_messages as messages
from ..transports.topic_node import Execute, RosPublisher, TopicNode
from ..wire.graph import Qos
from .parameters import NodeParameters

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Status:
    """State of a node, for its diagnostics."""

    valid: bool = True
    reason: str = "ok"
    values: Mapping[str, Any] = field(
        default_factory=dict
    )  #: numbers and strings by name, with the unit in the name


class Host:
    """Environment of a component: a node for communication, services, and failure handling.

    Parameters
    ----------
    node
        Node of any transport.
    fail
        Called with the error that terminated a thread of the component.
    """

    def __init__(self, node: TopicNode, fail: Callable[[BaseException], None]) -> None:
        self.node = node
        self.fail = fail
        self.active = threading.Event()  #: set while the component may measure, move and answer
        self._transforms: RosPublisher | None = None

    def offer(self, service: str, work: Callable[[], Mapping[str, Any]]) -> None:
        """Offer a ``std_srvs/srv/Trigger`` whose message is JSON; rejected while the node is not active.

        Parameters
        ----------
        service
            Private name, such as ``~/complete``.
        work
            Called for each request; returns the answer as a mapping.
        """

        self._declare(lambda: self.node.offer(service, self._while_active(lambda: dumps(work()))))

    def act(self, action: str, datatype: str, execute: Execute) -> None:
        """Offer an action; if its interface or actions are unavailable, this is logged.

        Parameters
        ----------
        action
            Name of the action.
        datatype
            Action type, such as ``nav2_msgs/action/NavigateToPose``.
        execute
            Called for each goal in a separate thread; see :meth:`TopicNode.act`.
        """

        self._declare(lambda: self.node.act(action, datatype, self._while_active(execute)))

    def _while_active(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            if not self.active.is_set():
                raise DeviceError(f"the node {self.node.name} is not active; activate it first")
            return work(*arguments)

        return run

    def _declare(self, offer: Callable[[], None]) -> None:
        try:
            offer()
        except InputError as error:
            _log.warning("%s", error)

    def transform(self, t_s: float, parent: str, child: str, parent_child: Pose) -> None:
        """Publish ``T_parent_child`` on ``/tf``.

        Parameters
        ----------
        t_s
            Timestamp [s].
        parent, child
            Names of the coordinate frames.
        parent_child
            Rigid transformation [m] from the child's to the parent's coordinates.
        """
        if self._transforms is None:
            self._transforms = self.node.advertise("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=100))
        moved = messages.pose(parent_child)
        motion = {"translation": moved["position"], "rotation": moved["orientation"]}
        stamped = {"header": messages.header(t_s, parent), "child_frame_id": child, "transform": motion}
        self._transforms.publish({"transforms": [stamped]})


class Component(Closing):
    """One type of node. It is created when the node is configured, and closed when it is cleaned up.

    Parameters
    ----------
    host
        Node, services, failure handling.
    parameters
        Configured parameters.
    """

    summary: ClassVar[str]  #: one line for lists
    parameter_model: ClassVar[type[NodeParameters]]

    def __init__(self, host: Host, parameters: Any) -> None:
        self.host, self.parameters = host, parameters
        self._told = Status()
        self.configure()

    @abstractmethod
    def configure(self) -> None:
        """Open topics and services, and read the files named in the parameters."""

    def activate(self) -> None:
        """Start to measure, answer or move."""

    def deactivate(self) -> None:
        """Stop activity; the configuration remains."""

    def status(self) -> Status:
        """State for the diagnostics, requested once per second."""
        return self._told

    def close(self) -> None:
        """Release what was configured; may be called repeatedly."""


class Worker(Component):
    """A component with its own thread while it is active."""

    _thread: threading.Thread | None = None

    @abstractmethod
    def run(self, end: threading.Event) -> None:
        """Body of the thread, runs until ``end`` is set; exceptions of other types than the library's terminate the node.

        Parameters
        ----------
        end
            Event of this activation; every activation has a new one.
        """

    def activate(self) -> None:
        self._end = threading.Event()
        self._thread = threading.Thread(
            target=self._guarded, args=(self._end,), name=self.host.node.name, daemon=True
        )
        self._thread.start()

    def _guarded(self, end: threading.Event) -> None:
        try:
            self.run(end)
        except Exception as error:  # noqa: BLE001 - raised in the caller's thread
            self.host.fail(error)

    def deactivate(self) -> None:
        if self._thread is not None:
            self._end.set()
            end_thread(self._thread)
            self._thread = None

    def close(self) -> None:
        self.deactivate()
