"""A simulated bottle, an opener on a beam sensor and a camera, with given initial errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from ..core import Frame, Pose, Reason, Wrench
from ..simulation.tabletop import CrownCapCell, OpenerBeam, SimulatedArm
from ..tasks import CapOpening, CapSettings, open_crown_cap

#: Positions of the scanning motion [m].
SCAN_M = ((0.4, 0.0, 0.6), (0.5, 0.1, 0.5))


@dataclass(frozen=True, slots=True, eq=False)
class OpenerTrial:
    """One bottle: result of the task, and truth."""

    seed: int
    opening: CapOpening
    truly_open: bool

    @property
    def right(self) -> bool:
        """Whether the reported result is correct: open if reported so, otherwise a stated failure."""
        return self.truly_open if self.opening.opened else bool(self.opening.ending.why)


class CapSensor(Protocol):
    """A sensor of the wrench on the opener."""

    rod: OpenerBeam  #: rod that carries the opener

    def reader(self, cell: CrownCapCell, rng: np.random.Generator) -> Callable[[Frame], Wrench]:
        """A function that measures the wrench from the frames of a cell, in the axes of the tool.

        Parameters
        ----------
        cell
            Simulated cell.
        rng
            Noise source.
        """
        ...


def virtual_opener(
    seed: int,
    sight: Literal["tracked", "start", "corner"] = "start",
    *,
    error_m: float = 0.01,
    error_rad: float = math.radians(5.0),
    duration_s: float = 240.0,
    beam: OpenerBeam | None = None,
) -> CrownCapCell:
    """Create the cell of one seed.

    Parameters
    ----------
    seed
        Seed of the cell.
    sight
        Accuracy of the camera near the cap: ``start`` no better than the initial error, up to
        ``error_m`` on each axis; ``corner`` exactly that error on each axis; ``tracked`` as in
        Table 3.1: a millimetre laterally and a centimetre in height, and two millimetres of the arm.
    error_m, error_rad
        Initial errors: position on each axis, and angle of the tool about a random axis.
    duration_s
        Maximum simulated time [s].
    beam
        Rod that carries the opener.
    """
    rng = np.random.default_rng(seed)
    cap = np.array([0.5, 0.1, 0.25]) + rng.uniform(-0.05, 0.05, 3)
    axis = rng.standard_normal(3)
    error = Pose.from_rotation_vector(error_rad * axis / np.linalg.norm(axis), np.zeros(3))
    far = rng.uniform(-error_m, error_m, 3)
    near = far
    if sight == "corner":
        near = np.copysign(error_m, far)
    elif sight == "tracked":
        aside = rng.normal(0.0, math.hypot(0.001, 0.002), 2)
        near = np.array([*aside, rng.uniform(-error_m, error_m)])
    arm = SimulatedArm(Pose(np.eye(3), np.array([0.4, 0.0, 0.6])), error=error, repeat_sigma_m=1e-4, rng=rng)
    x, y, z = (float(value) for value in near)
    return CrownCapCell(
        arm, cap, rng,
        far_error_m=(float(far[0]), float(far[1]), float(far[2])), near_error_m=(x, y, z),
        wrench_gain=float(rng.normal(1.0, 0.02)), open_N=float(rng.uniform(60.0, 110.0)), duration_s=duration_s,
        beam=beam or OpenerBeam(),
    )  # fmt: skip


def open_virtual_cap(
    seed: int,
    sight: Literal["tracked", "start", "corner"] = "start",
    *,
    sensor: CapSensor | None = None,
) -> OpenerTrial:
    """Open the cap of one seed.

    Parameters
    ----------
    seed
        Seed of the cell.
    sight
        As in :func:`virtual_opener`.
    sensor
        Measures the wrench from images of the bending rod; by default the truth with noise.
    """
    cell = virtual_opener(seed, sight, beam=None if sensor is None else sensor.rod)

    def noisy(frame: Frame) -> Wrench:
        wrench, covariance = cell.feel(frame)
        return Wrench(frame.t_s, True, Reason.OK, wrench[:3], wrench[3:], covariance, "tool")

    feel = noisy if sensor is None else sensor.reader(cell, np.random.default_rng([seed, 1]))

    opening = open_crown_cap(cell.arm, cell, feel, cell.look, CapSettings(scan_m=SCAN_M))
    return OpenerTrial(seed, opening, cell.opened)
