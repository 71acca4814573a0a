"""What adapters share: the newest message of a topic, and a thread that repeats a command."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from ..core.errors import DeviceError, InputError, StaleFrameError, VisuohapticError
from .transports.topic_node import Received, TopicNode
from .wire.graph import Qos

__all__ = ["LatestMessage", "Repeater", "finite"]

_log = logging.getLogger(__name__)


class LatestMessage:
    """The newest message of a topic.

    Parameters
    ----------
    node
        Node that subscribes.
    topic
        Its name, relative names in the node's namespace.
    datatype
        As ``nav_msgs/msg/Odometry``.
    max_age_s
        An older one counts as none: a robot whose odometry has stopped must not be taken for one that stands.
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
        """The newest message; the first one is waited for.

        Parameters
        ----------
        timeout_s
            How long the first message is waited for [s].

        Raises
        ------
        StaleFrameError
            There is none, or it is too old.
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
                f"the newest message on {self.topic} is {age_s:.2f} s old, allowed are {self.max_age_s:g} s"
            )
        return received

    def close(self) -> None:
        """Receive nothing more."""
        self._subscription.close()


class Repeater:
    """Calls a function at a rate from a thread of its own.

    Robots stop by themselves when commands cease, as they should; so a command that holds is sent again.

    Parameters
    ----------
    work
        Called without arguments; an error of this library ends the thread.
    rate_Hz
        Calls per second, more than 0 to 1000 Hz.
    name
        Of the thread, for messages.
    """

    def __init__(self, work: Callable[[], Any], rate_Hz: float, name: str) -> None:
        if not 0 < rate_Hz <= 1000:
            raise InputError(name, f"found {rate_Hz} Hz, expected more than 0 and at most 1000 Hz")
        self._work, self._pause_s, self._name = work, 1.0 / rate_Hz, name
        self._end = threading.Event()
        self.problem: VisuohapticError | None = None  #: why it has ended by itself
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.wait(self._pause_s):
            try:
                self._work()
            except VisuohapticError as error:
                self.problem = error
                _log.error("%s: %s", self._name, error)
                return

    def check(self) -> None:
        """Complain when it has ended by itself."""
        if self.problem is not None:
            raise DeviceError(f"{self._name}: {self.problem}") from self.problem

    def close(self) -> None:
        """End the thread; harmless when repeated."""
        self._end.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()


def finite(where: str, **values: float) -> None:
    """Refuse commands that are not finite numbers: a motor could do anything.

    Parameters
    ----------
    where
        What was called, for the message.
    **values
        Commands by their names.
    """
    for name, value in values.items():
        if not abs(value) < float("inf"):
            raise InputError(where, f"found {value}, expected a finite number", field=name)
