"""The loop of every task: observe, decide, carry out, until there is an ending; then everything stands."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from typing import Any

from ...core.errors import DeviceError
from .machine import CommandT, Machine, ObservationT

__all__ = ["run_machine"]


def run_machine(
    task: Machine[Any, ObservationT, CommandT],
    observations: Iterable[ObservationT],
    carry_out: Callable[[CommandT], None],
    *stops: Callable[[], None],
    refused: str = "device_failed",
    after: Callable[[], None] | None = None,
) -> None:
    """Step a task with observations until it ends; a device that fails is an ending, not an exception.

    Parameters
    ----------
    task
        Its ending is set.
    observations
        Made one by one, each after the last command was carried out.
    carry_out
        Takes a command that is another one than the last.
    *stops
        Each stops a part of the robot, at the end in any case.
    refused
        Outcome when a command is refused.
    after
        Called after every step, the last one too.
    """
    last: CommandT | None = None
    outcome = "device_failed"
    try:
        for seen in observations:
            command = task.step(seen)
            if command != last and not task.ended:
                outcome, last = refused, command
                carry_out(command)
                outcome = "device_failed"
            if after is not None:
                after()
            if task.ended:
                break
    except DeviceError as error:
        task.interrupt(outcome, str(error))
    finally:
        for stop in stops:
            # What cannot say where it is cannot be told to stay there; the reason is in the ending.
            with contextlib.suppress(DeviceError):
                stop()
    task.interrupt("source_ended", "the camera delivers no more frames")
