"""The mobile platform: a velocity-controlled body on the floor with the foam strip in front."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

from ...core import POSITIVE, BaseState, InputError, MobileBase, check_ranges
from ..foam.strip_geometry import FoamStripGeometry


@dataclass(frozen=True, slots=True)
class PlatformConfig:
    """Shape, drive and foam of the platform; its frame is at its centre, x forward."""

    x_m: float = 0.0  #: start in the world
    y_m: float = 0.0
    heading_rad: float = 0.0
    #: of a round platform; half length of a box
    radius_m: float = field(default=0.17, metadata=POSITIVE)
    round: bool = False  #: round with a bent strip, or a box with a straight one
    width_m: float = field(default=0.3, metadata=POSITIVE)  #: of a box
    mass_kg: float = field(default=10.0, metadata=POSITIVE)
    max_acceleration_m_s2: float = 0.5
    max_turn_acceleration_rad_s2: float = 2.0
    max_force_N: float = field(default=40.0, metadata=POSITIVE)  #: of the drive
    kinematic: bool = False  #: moves as commanded, independent of reaction forces
    strip: FoamStripGeometry = field(default_factory=lambda: FoamStripGeometry(spacing_m=0.001))
    #: height of the foam's visible edge above the floor
    floor_below_m: float = field(default=0.05, metadata=POSITIVE)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.round and not math.isclose(self.strip.radius_m, self.radius_m):
            raise InputError(
                "PlatformConfig",
                f"strip bent to {self.strip.radius_m} m on a platform of radius {self.radius_m} m",
                remedy="give the strip the platform's radius_m",
            )

    @property
    def foam_height_m(self) -> float:
        """Height of the foam's centre above the floor, where it pushes."""
        return self.floor_below_m - 0.5 * self.strip.height_m


class DrivenWorld(Protocol):
    """State of the platform in a simulated world."""

    config: PlatformConfig

    @property
    def t_s(self) -> float:
        """Simulated time [s]."""

    def platform_pose(self) -> tuple[float, float, float]:
        """Centre and heading of the platform in the world: (x [m], y [m], heading [rad])."""

    def platform_velocity(self) -> tuple[float, float, float]:
        """Velocity of the platform in its own frame: (forward, left [m/s], turn rate [rad/s])."""


class CommandedBase(MobileBase):
    """Latest command to a simulated platform: ``target_speed_m_s``, ``target_turn_rate_rad_s``."""

    target_speed_m_s = target_turn_rate_rad_s = 0.0

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities; they hold until the next call or :meth:`stop`."""
        if not (math.isfinite(speed_m_s) and math.isfinite(turn_rate_rad_s)):
            raise InputError(
                "drive", f"found {speed_m_s} m/s and {turn_rate_rad_s} rad/s, expected finite numbers"
            )
        self.target_speed_m_s, self.target_turn_rate_rad_s = float(speed_m_s), float(turn_rate_rad_s)

    def stop(self) -> None:
        """Stop as fast as the acceleration limit allows."""
        self.drive(0.0, 0.0)


class SimulatedBase(CommandedBase):
    """The platform of a simulated world as a ``robots.MobileBase``.

    Velocities are reached with limited acceleration; time passes only in the ``step`` of the world.

    Parameters
    ----------
    world
        Simulated world that moves the platform by :meth:`ramp`.
    """

    def __init__(self, world: DrivenWorld) -> None:
        self._world = world
        self._speed_m_s = self._turn_rate_rad_s = 0.0

    def halt(self) -> None:
        """Stop immediately, as after being carried."""
        self.stop()
        self._speed_m_s = self._turn_rate_rad_s = 0.0

    def state(self) -> BaseState:
        """Exact odometry in the world frame."""
        x, y, heading = self._world.platform_pose()
        speed, _, turn = self._world.platform_velocity()
        return BaseState(self._world.t_s, x, y, heading, speed, turn)

    def ramp(self, dt_s: float) -> tuple[float, float]:
        """Velocities of the drive after a time step (speed [m/s], turn rate [rad/s]).

        Parameters
        ----------
        dt_s
            Time step [s].
        """
        config = self._world.config
        self._speed_m_s = towards(self._speed_m_s, self.target_speed_m_s, config.max_acceleration_m_s2 * dt_s)
        self._turn_rate_rad_s = towards(
            self._turn_rate_rad_s, self.target_turn_rate_rad_s, config.max_turn_acceleration_rad_s2 * dt_s
        )
        return self._speed_m_s, self._turn_rate_rad_s


def towards(now: float, target: float, step: float) -> float:
    """Change a velocity towards its target by at most one step.

    Parameters
    ----------
    now, target, step
        Velocities and the step, of one unit.
    """
    return now + max(-step, min(step, target - now))
