"""A kitchen table with a container, an arm, and a gripper with foam on its fingers; no image is rendered.

The reading of the finger's camera is ground truth with noise; for rendered
fingers see :class:`visuohaptic.rigs.VirtualHand`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core import POSITIVE, Frame, Gripper, GripperState, Pose, check_numbers, within
from ...core.measurement import GRAVITY_M_S2
from ..rendering.blank_frames import BlankFrames
from .arm import SimulatedArm
from .deformable import DeformableContainer
from .oval import OvalContainer


@dataclass(frozen=True, slots=True)
class FingerObservation:
    """Reading of the finger's sensor for one frame."""

    t_s: float
    valid: bool
    force_N: float
    force_sigma_N: float
    surface_m: float  #: of the touched surface, from the midpoint between the fingers; NaN without contact


@dataclass
class KitchenTable(BlankFrames, Gripper):
    """A container at a pose, between the fingers when the arm is there; ``Gripper`` and ``FrameSource`` in one.

    The tip is the midpoint between the fingers; z of the base is height above the table.
    """

    container: DeformableContainer | OvalContainer
    rng: np.random.Generator
    place_m: tuple[float, float] = (0.5, 0.0)
    open_m: float = 0.12
    foam_N_per_m: float = 6000.0  #: of the rubber on one finger
    foam_N_per_m3: float = 3e8  #: relative increase of its stiffness
    force_sigma_N: float = 0.08
    surface_sigma_m: float = 4e-5
    load_sigma_N: float = 0.05  #: of the vertical load on the fingers, frame by frame
    load_zero_N: float = 0.3  #: offset of that sensor: it has to be tared
    wrist_N_per_m: float = math.inf  #: stiffness of the spring that supports the hand
    frame_rate_Hz: float = 30.0
    force_limit_N: float = 60.0
    slip_at_s: float = math.inf  #: from then on the fingers are wet: a tenth of the friction
    fall_at_s: float = math.inf  #: time at which the object falls over
    sensor_failure_at_s: float = math.inf  #: time from which the sensor is blind

    def __post_init__(self) -> None:
        start = Pose(np.eye(3), np.array([*self.place_m, 0.35]))
        self.arm = SimulatedArm(start, repeat_sigma_m=2e-4, rng=self.rng, turn_rate_rad_s=1.0)
        self._raised_m = 0.0  #: height of the arm above the grasp of the object on the table
        self.fallen = False
        self.force_N = self.deformation_m = 0.0
        self._opening, self._target, self._limit = self.open_m, self.open_m, 0.0
        self._held_z: float | None = None

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Start to move to an opening."""
        check_numbers("move", within(0.0, self.open_m), opening_m=opening_m)
        check_numbers("move", POSITIVE, speed_m_s=speed_m_s)
        self._target, self._limit = opening_m, speed_m_s

    def stop(self) -> None:
        """Hold the current opening."""
        self._target = self._opening

    def state(self) -> GripperState:
        """Newest reading of the drive."""
        moving = (
            math.copysign(self._limit, self._target - self._opening) if self._target != self._opening else 0.0
        )
        return GripperState(self.arm.t_s, self._opening, moving)

    def advance(self, dt_s: float) -> float:
        """Advance the simulation; returns the new time [s]."""
        self.arm.advance(dt_s)
        step = self._limit * dt_s
        way = max(-step, min(step, self._target - self._opening))
        if way > 0 or self.force_N < self.force_limit_N:
            self._opening += way
        # A held object moves before the fingers are read: in the other order they would be
        # at a height on the wall that is wrong by the arm's motion in this frame.
        self._carry()
        self._balance()
        self._held_z = self._tip_z() if self.force_N > 0 else None
        return self.arm.t_s

    def feel(self, frame: Frame) -> FingerObservation:
        """Reading of the finger at the newest frame.

        Parameters
        ----------
        frame
            Newest frame.
        """
        if self.arm.t_s >= self.sensor_failure_at_s:
            return FingerObservation(frame.t_s, False, math.nan, math.inf, math.nan)
        noise = self.rng.standard_normal(2)
        force = self.force_N + self.force_sigma_N * float(noise[0])
        surface = math.nan
        if self.force_N > 3 * self.force_sigma_N:
            surface = self._radius() - self.deformation_m + self.surface_sigma_m * float(noise[1])
        return FingerObservation(frame.t_s, True, force, self.force_sigma_N, surface)

    def weigh(self, frame: Frame) -> float:
        """Vertical load on the fingers [N] including the sensor's offset; NaN when the sensor is blind.

        Parameters
        ----------
        frame
            Newest frame.
        """
        if self.arm.t_s >= self.sensor_failure_at_s:
            return math.nan
        return self.load_N + self.load_zero_N + self.load_sigma_N * float(self.rng.standard_normal())

    @property
    def load_N(self) -> float:
        """True weight on the fingers: none until the spring of the wrist is stretched by it."""
        weight_N = self.container.mass_kg * GRAVITY_M_S2
        return min(weight_N, self.wrist_N_per_m * self._raised_m) if self._raised_m > 0 else 0.0

    @property
    def lifted_m(self) -> float:
        """Height of the object above the table: the arm first has to stretch the spring."""
        return max(0.0, self._raised_m - self.container.mass_kg * GRAVITY_M_S2 / self.wrist_N_per_m)

    def _height(self) -> float:
        """Position of the fingers on the object."""
        return self._tip_z() - self._raised_m

    def _tip_z(self) -> float:
        return float(self.arm.true_pose().translation_m[2])

    def _radius(self) -> float:
        tip = self.arm.true_pose().translation_m
        beside = math.hypot(tip[0] - self.place_m[0], tip[1] - self.place_m[1])
        return 0.0 if self.fallen or beside > 0.01 else self._pinched().radius_at(self._height())

    def _pinched(self) -> DeformableContainer:
        """The container as felt by the fingers at their present angle."""
        turn = self.arm.true_pose().rotation
        return self.container.turned(math.atan2(turn[1, 0], turn[0, 0]))

    def _balance(self) -> None:
        """Force at which the compression of foam and wall equals the penetration of the fingers."""
        self._fall()
        short = self._radius() - 0.5 * self._opening
        if short <= 0:
            self.force_N = self.deformation_m = 0.0
            return
        low, high, felt = 0.0, short, self._pinched()
        for _ in range(40):
            wall = 0.5 * (low + high)
            foam = short - wall
            if felt.force_at(self._height(), wall) > self.foam_N_per_m * foam + self.foam_N_per_m3 * foam**3:
                high = wall
            else:
                low = wall
        self.deformation_m = 0.5 * (low + high)
        self.force_N = felt.force_at(self._height(), self.deformation_m)

    def _fall(self) -> None:
        if self.arm.t_s >= self.fall_at_s and not self.fallen:
            self.fallen, self._raised_m = True, 0.0

    def _carry(self) -> None:
        """The object moves with the fingers as long as friction holds it."""
        z = self._tip_z()
        friction = self.container.friction * (0.1 if self.arm.t_s >= self.slip_at_s else 1.0)
        holds = 2.0 * friction * self.force_N >= self.container.mass_kg * GRAVITY_M_S2
        if holds and self._held_z is not None:
            self._raised_m = max(0.0, self._raised_m + z - self._held_z)
        elif not holds:
            self._raised_m = 0.0  # it falls back onto the table
