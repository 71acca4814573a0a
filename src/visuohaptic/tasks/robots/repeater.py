"""A thread that repeats a command, for robots that stop when commands cease."""

from __future__ import annotations

import contextlib
import logging
import threading
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from ...core import FINITE, Closing, MobileBase, above, check_numbers
from ...core.errors import DeviceError, InputError, VisuohapticError
from ...core.resources import end_thread

_log = logging.getLogger(__name__)


class Repeater:
    """Calls a function at a fixed rate in its own thread.

    Robots stop by themselves when commands cease (watchdog), so a constant command has to be sent repeatedly.

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
        check_numbers(name, above(0, 1000), rate_Hz=rate_Hz)
        self._work, self._pause_s, self._name = work, 1.0 / rate_Hz, name
        self._end = threading.Event()
        self.problem: VisuohapticError | None = None  #: why the thread has ended by itself
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
        """Raise an error if the thread has ended by itself."""
        if self.problem is not None:
            raise DeviceError(f"{self._name}: {self.problem}") from self.problem

    def close(self) -> None:
        """End the thread; may be called repeatedly."""
        self._end.set()
        end_thread(self._thread)


class Repeated(Closing):
    """A part of a robot with a thread that may have ended."""

    _repeater: Repeater | None = None

    def _check(self) -> None:
        if self._repeater is not None:
            self._repeater.check()

    def close(self) -> None:
        """Stop sending commands, and release the part; may be called repeatedly."""
        if self._repeater is not None:
            self._repeater.close()


class RepeatedBase(Repeated, MobileBase):
    """A base whose velocities are sent repeatedly until the next command; zero velocities are sent when it is closed.

    Parameters
    ----------
    max_speed_m_s, max_turn_rad_s
        Limits; larger commands are rejected.
    """

    def __init__(self, max_speed_m_s: float, max_turn_rad_s: float) -> None:
        self._limits = {"speed_m_s": max_speed_m_s, "turn_rate_rad_s": max_turn_rad_s}
        self._lock = threading.Lock()
        self._command: tuple[float, float] | None = None

    @abstractmethod
    def _send(self) -> None:
        """Send the velocities once."""

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities; they hold until the next call, :meth:`stop` or :meth:`close`.

        Raises
        ------
        InputError
            A velocity is not finite or larger than allowed.
        DeviceError
            The repeating thread has ended, or the robot does not answer.
        """
        where = f"{type(self).__name__}.drive"
        check_numbers(where, FINITE, speed_m_s=speed_m_s, turn_rate_rad_s=turn_rate_rad_s)
        for (name, limit), value in zip(self._limits.items(), (speed_m_s, turn_rate_rad_s), strict=True):
            if abs(value) > limit:
                raise InputError(where, f"found {value:g}, expected {limit:g}", field=name)
        self._check()
        with self._lock:
            self._command = (float(speed_m_s), float(turn_rate_rad_s))
        self._send()

    def stop(self) -> None:
        """Stand still."""
        with self._lock:
            self._command = (0.0, 0.0)
        self._send()

    def close(self) -> None:
        """Stop, and release the base; may be called repeatedly."""
        if self._command is not None:
            with contextlib.suppress(DeviceError):  # the link may be gone; the robot's watchdog is left
                self.stop()
        super().close()
        self._command = None
