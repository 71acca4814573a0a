"""Main loop of all tasks: observe, decide, execute until the task has ended; then stop all parts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from typing import Any

from ...core.errors import DeviceError
from .machine import CommandT, Machine, ObservationT
from .trace import Ending


def run_machine(
    task: Machine[Any, ObservationT, CommandT],
    observations: Iterable[ObservationT],
    execute: Callable[[CommandT], None],
    *stops: Callable[[], None],
    refused: str = "device_failed",
    after: Callable[[], None] | None = None,
) -> Ending:
    """Step a task with observations until it ends, and return its ending; a device error is one, not an exception.

    Parameters
    ----------
    task
        Task to run.
    observations
        Iterable of observations, each made after the previous command was executed.
    execute
        Executes a command; called only if the command has changed.
    *stops
        Functions that stop a part of the robot each; always called at the end.
    refused
        Outcome if a command is refused.
    after
        Called after every step, including the last one.
    """
    last: CommandT | None = None
    outcome = "device_failed"
    try:
        for seen in observations:
            command = task.step(seen)
            if command != last and not task.ended:
                outcome, last = refused, command
                execute(command)
                outcome = "device_failed"
            if after is not None:
                after()
            if task.ended:
                break
    except DeviceError as error:
        task.end(False, outcome, str(error))
    finally:
        for stop in stops:
            # A device without a pose cannot hold it; the reason is in the ending.
            with contextlib.suppress(DeviceError):
                stop()
    task.end(False, "source_ended", "the camera delivers no more frames")
    assert task.ending is not None
    return task.ending
