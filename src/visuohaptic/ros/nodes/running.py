"""State machine of a component, controlled by a ROS lifecycle or by the command line."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from ...core import Closing, VisuohapticError
from ...io.ros import ros_messages as messages
from ...tasks.robots.repeater import Repeater
from ..transports.topic_node import TopicNode
from .component import Component, Host, Status
from .parameters import checked


class Running(Closing):
    """Configures, activates, deactivates and cleans up a component, and publishes its diagnostics.

    Parameters
    ----------
    kind
        Class of the component.
    open_topics
        Opens the node used by the component; closed at clean-up.
    log
        Called with the text of each error, for the ROS log.
    """

    def __init__(
        self,
        kind: type[Component],
        open_topics: Callable[[], TopicNode],
        log: Callable[[str], object] = lambda line: None,
    ) -> None:
        self._kind, self._open, self._log = kind, open_topics, log
        self.component: Component | None = None  #: while it is configured
        self._host: Host | None = None
        self._diagnostics: Repeater | None = None
        self.problem: BaseException | None = None  #: the last error, until the next successful transition
        self.failed = threading.Event()  #: set when an active component has failed

    @property
    def configured(self) -> bool:
        """Whether there is a component; its parameters are then fixed."""
        return self.component is not None

    def _fail(self, error: BaseException) -> None:
        self._log(str(error))
        self.problem = error
        self.failed.set()

    def configure(self, values: Mapping[str, Any]) -> None:
        """Read files and declare topics and services.

        Parameters
        ----------
        values
            Parameters by name.

        Raises
        ------
        VisuohapticError
            A parameter, or a file that it names, is invalid; nothing is left open.
        """
        self.problem = None
        node = self._open()
        try:
            parameters = checked(values, self._kind.parameter_model, node.name)
            self._host = Host(node, self._fail)
            self.component = self._kind(self._host, parameters)
        except BaseException:
            self._host = None
            node.close()
            raise
        topic = node.advertise("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")

        def tell() -> None:
            status = self._status()
            told = (status.valid, status.reason, status.values)
            topic.publish(messages.diagnostics(node.now_s(), node.name, node.name, *told))

        # Once per second, as usual for ROS diagnostics.
        self._diagnostics = Repeater(tell, 1.0, f"diagnostics of {node.name}")

    def _status(self) -> Status:
        if self.problem is not None:
            return Status(False, str(self.problem))
        if self.component is None or self._host is None or not self._host.active.is_set():
            return Status(True, "inactive")
        return self.component.status()

    def activate(self) -> None:
        """Activate the component; it remains inactive after a :class:`VisuohapticError`."""
        assert self.component is not None
        assert self._host is not None
        self.problem = None
        self.failed.clear()
        self.component.activate()
        self._host.active.set()

    def deactivate(self) -> None:
        """Deactivate; no effect if it is not active."""
        if self.component is not None and self._host is not None and self._host.active.is_set():
            self._host.active.clear()
            self.component.deactivate()

    def close(self) -> None:
        """Clean up, from any state; may be called repeatedly."""
        self.deactivate()
        if self._diagnostics is not None:
            self._diagnostics.close()
        if self.component is not None:
            self.component.close()
        if self._host is not None:
            self._host.node.close()
        self.component = self._host = self._diagnostics = None

    def attempt(self, step: Callable[[], None]) -> bool:
        """Execute a lifecycle transition; an error of this library is stored, and False is returned.

        Parameters
        ----------
        step
            A transition of this object.
        """
        try:
            step()
        except VisuohapticError as error:
            self.problem = error
            self._log(str(error))
            return False
        return True
