"""Wrappers of sensors that report every reading to the safety supervisor."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...core import Camera, Closing, Frame, FrameSource
from .supervisor import SupervisorCore


def force_of(reading: Any) -> float:
    """Magnitude of the force in a reading [N]; NaN if invalid, infinite if the sensor is beyond its range.

    Parameters
    ----------
    reading
        Reading with ``force_N``, a number or a vector. Unloading and saturated readings count although not ``valid``;
        a saturated one is a lower bound, infinite without a number.
    """
    force = float(np.linalg.norm(np.atleast_1d(np.asarray(reading.force_N, dtype=float))))
    reason = str(getattr(reading, "reason", ""))
    if math.isinf(force) or (reason == "saturated" and math.isnan(force)):
        return math.inf
    return force if getattr(reading, "valid", True) or reason in ("saturated", "unloading") else math.nan


class WatchedFrames(Closing):
    """Frame source whose times and contents are monitored.

    Parameters
    ----------
    guard
        Supervisor that records every reading.
    source
        Camera.
    name
        Name in messages.
    """

    def __init__(self, guard: SupervisorCore, source: FrameSource, name: str) -> None:
        self._guard, self._source, self._name = guard, source, name

    @property
    def camera(self) -> Camera | None:
        """Camera model of the source."""
        return self._source.camera

    @property
    def frame_count(self) -> int | None:
        """Number of frames of the source."""
        return self._source.frame_count

    def __iter__(self) -> Iterator[Frame]:
        last = -1
        for frame in self._source:
            # Sensor noise makes images differ; a uniform synthetic image is no evidence of a frozen camera.
            rows = np.ascontiguousarray(frame.image[:: 1 + len(frame.image) // 200])
            newest = zlib.crc32(rows.data)
            frozen = newest == last and bool(rows.min() != rows.max())
            last = newest
            self._guard.note(self._name, frame.t_s, as_of_s=-math.inf if frozen else math.inf)
            yield frame

    def close(self) -> None:
        """Release the source."""
        self._source.close()


class WatchedSensor:
    """A sensor whose method ``read`` is replaced; see :meth:`.Supervisor.sensor`.

    Parameters
    ----------
    sensor
        Force sensor.
    read
        Replacement that reports every force to the supervisor.
    """

    def __init__(self, sensor: Any, read: Callable[[Frame], Any]) -> None:
        self._sensor, self.read = sensor, read

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)


class WatchedSenses:
    """Pose and force of a navigation task; see :meth:`.Supervisor.senses`.

    Parameters
    ----------
    guard
        Supervisor that records every reading.
    senses
        Senses of the robot.
    """

    def __init__(self, guard: SupervisorCore, senses: Any) -> None:
        self._guard, self._senses = guard, senses
        self._pose: tuple[object, int] = (None, 0)
        self._touch: tuple[object, int] = (None, 0)

    def pose(self) -> tuple[float, float, float]:
        """Pose of the robot in the map: x, y [m], heading [rad]."""
        pose: tuple[float, float, float] = self._senses.pose()
        self._pose = self._since(pose, self._pose)
        now_s = self._guard.now_s() if all(map(math.isfinite, pose)) else math.nan
        self._guard.note("the localizer", now_s, as_of_s=self._as_of_s(self._pose))
        return pose

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim [N], and its point of application in the map [m]."""
        force_N, point_m = self._senses.touch()
        self._touch = self._since(force_N, self._touch)
        as_of_s = self._as_of_s(self._touch) if force_N != 0.0 else math.inf
        self._guard.note_force(self._guard.now_s(), force_N, as_of_s=as_of_s)
        return force_N, point_m

    def _as_of_s(self, since: tuple[object, int]) -> float:
        """A value is frozen if it is constant although the odometry has changed."""
        return math.inf if since[1] == self._guard.odometry else -math.inf

    def _since(self, value: object, before: tuple[object, int]) -> tuple[object, int]:
        """The value, with the odometry count at its last change."""
        return before if value == before[0] else (value, self._guard.odometry)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._senses, name)
