"""Sensors of a robot as they are seen through a supervisor."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...core.camera.frame import Frame
from ...core.camera.model import Camera
from ...core.resources import Closing
from ...core.robots import FrameSource
from .supervisor import SupervisorCore

__all__ = ["WatchedFrames", "WatchedSenses", "WatchedSensor", "force_of"]


def force_of(reading: Any) -> float:
    """Size of the force in a reading [N]; NaN where it is not valid, infinite where foam is full.

    Parameters
    ----------
    reading
        With ``force_N``, a number or a vector; what is not ``valid`` counts where it is only saturated: that is a
        force of at least as much, and of any size where it was not read.
    """
    force = float(np.linalg.norm(np.atleast_1d(np.asarray(reading.force_N, dtype=float))))
    reason = str(getattr(reading, "reason", ""))
    if reason == "saturated" and math.isnan(force):
        return math.inf
    return force if getattr(reading, "valid", True) or reason in ("saturated", "unloading") else math.nan


class WatchedFrames(Closing):
    """Frames whose times and contents are watched.

    Parameters
    ----------
    guard
        Takes every reading.
    source
        A camera.
    name
        For messages.
    """

    def __init__(self, guard: SupervisorCore, source: FrameSource, name: str) -> None:
        self._guard, self._source, self._name = guard, source, name

    @property
    def camera(self) -> Camera | None:
        """Of the source."""
        return self._source.camera

    @property
    def frame_count(self) -> int | None:
        """Of the source."""
        return self._source.frame_count

    def __iter__(self) -> Iterator[Frame]:
        last = -1
        for frame in self._source:
            # A sensor's noise makes every row another one; what is drawn in a single grey says nothing.
            rows = np.ascontiguousarray(frame.image[:: 1 + len(frame.image) // 200])
            newest = zlib.crc32(rows.data)
            frozen = newest == last and bool(rows.min() != rows.max())
            last = newest
            self._guard.note(self._name, frame.t_s, frozen=frozen)
            yield frame

    def close(self) -> None:
        """Release the source."""
        self._source.close()


class WatchedSensor:
    """A sensor whose method ``read`` is another one; see :meth:`.Supervisor.sensor`.

    Parameters
    ----------
    sensor
        Of forces.
    read
        Its reader, with every force held against the limit.
    """

    def __init__(self, sensor: Any, read: Callable[[Frame], Any]) -> None:
        self._sensor, self.read = sensor, read

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)


class WatchedSenses:
    """Pose and force of a travel; see :meth:`.Supervisor.senses`.

    Parameters
    ----------
    guard
        Takes every reading.
    senses
        Of the robot.
    """

    def __init__(self, guard: SupervisorCore, senses: Any) -> None:
        self._guard, self._senses = guard, senses
        self._pose: tuple[object, int] = (None, 0)
        self._touch: tuple[object, int] = (None, 0)

    def pose(self) -> tuple[float, float, float]:
        """Where the robot is in the map: x, y [m], heading [rad]."""
        pose: tuple[float, float, float] = self._senses.pose()
        self._pose = self._since(pose, self._pose)
        now_s = self._guard.now_s() if all(map(math.isfinite, pose)) else math.nan
        self._guard.note("the localizer", now_s, frozen=self._pose[1] != self._guard.odometry)
        return pose

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim [N], and where it acts in the map [m]."""
        force_N, point_m = self._senses.touch()
        self._touch = self._since(force_N, self._touch)
        frozen = force_N != 0.0 and self._touch[1] != self._guard.odometry
        self._guard.note_force(self._guard.now_s(), force_N, frozen=frozen)
        return force_N, point_m

    def _since(self, value: object, before: tuple[object, int]) -> tuple[object, int]:
        """A value, and the count of the odometry when it was another one."""
        return before if value == before[0] else (value, self._guard.odometry)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._senses, name)
