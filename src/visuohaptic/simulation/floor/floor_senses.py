"""Perception of a robot on the simulated floor: ground truth with small errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .floor_world import FloorWorld


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Standard deviations, and time constant of the localisation error."""

    place_m: float = 0.006  #: of the robot, per axis
    heading_rad: float = 0.008
    drift_time_s: float = 5.0  #: time over which these errors change
    look_m: float = 0.005  #: of an object, independent in every observation
    look_rad: float = 0.015
    force_fraction: float = 0.05
    contact_m: float = 0.004
    range_m: float = 4.0  #: objects farther away are not detected


class FloorSenses:
    """Pose, touch and observed objects, as required by ``tasks.travel.TravelSenses``.

    Parameters
    ----------
    world
        Simulated world.
    rng
        Source of the errors.
    errors
        Their standard deviations.
    """

    def __init__(
        self, world: FloorWorld, rng: np.random.Generator, errors: SensorErrors | None = None
    ) -> None:
        self._world, self._rng = world, rng
        self._errors = errors if errors is not None else SensorErrors()
        e = self._errors
        self._sigma = np.array([e.place_m, e.place_m, e.heading_rad])
        self._bias = self._sigma * rng.standard_normal(3)
        self._t_s = world.t_s

    def pose(self) -> tuple[float, float, float]:
        """Estimated pose of the robot, with a slowly varying error."""
        passed_s, self._t_s = self._world.t_s - self._t_s, self._world.t_s
        if passed_s > 0:
            keep = math.exp(-passed_s / self._errors.drift_time_s)
            self._bias = keep * self._bias + math.sqrt(
                1.0 - keep * keep
            ) * self._sigma * self._rng.standard_normal(3)
        x, y, heading = self._world.pose_m() + self._bias
        return float(x), float(y), float(heading)

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim and its point of application."""
        touch = self._world.touch
        if touch is None:
            return 0.0, None
        e = self._errors
        force = touch.force_N * max(0.0, 1.0 + e.force_fraction * float(self._rng.standard_normal()))
        # The rim measures the contact in its own frame: in the map it has the error of localisation.
        x, y = np.array(touch.point_m) + self._bias[:2] + e.contact_m * self._rng.standard_normal(2)
        return force, (float(x), float(y))

    def look(self, id: str) -> tuple[float, float, float] | None:
        """Measured pose (x [m], y [m], yaw [rad]) of an object; ``None`` if it is not visible, or not there.

        Parameters
        ----------
        id
            Name of the object.
        """
        if all(obj.id != id for obj in self._world.objects):
            return None
        place = self._world.object_pose_m(id)
        if np.hypot(*(place[:2] - self._world.pose_m()[:2])) > self._errors.range_m:
            return None
        e = self._errors
        x, y, yaw = place + np.array([e.look_m, e.look_m, e.look_rad]) * self._rng.standard_normal(3)
        return float(x), float(y), float(yaw)
