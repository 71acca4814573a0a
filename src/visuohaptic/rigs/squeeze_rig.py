"""Figure 3.12 of Alt 2016: the shape of a bottle at five grasping forces, in the fixed frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import CalibrationError
from ..core.files import new_figure, save_figure
from ..sensing.foam.finger import FingerReading, FingerSensor
from ..simulation.foam.outline import Outline
from ..simulation.tabletop import GraspObject, GripperTruth, VirtualGripper

#: Five grasping forces [N].
FORCES_N = (10.0, 20.0, 35.0, 50.0, 70.0)
#: A bottle with a diameter of 7 cm and a stiffness of 20 N/mm, between fingers opened by 10 cm.
BOTTLE = GraspObject(Outline.disc((0.065, 0.0), 0.035), stiffness_N_per_m=2e4)


@dataclass(frozen=True, slots=True, eq=False)
class Squeeze:
    """Measurement and truth with the gripper at rest, at one force."""

    target_N: float
    reading: FingerReading
    truth: GripperTruth

    @property
    def contour_error_m(self) -> Float[np.ndarray, "k"]:
        """Distance between the measured and the true contour in the fixed frame, at the contact points."""
        contacts = self.reading.profile.contacts
        if not contacts:
            return np.zeros(0)
        s = self.reading.profile.s_m
        touching = (s > contacts[0].s_start_m) & (s < contacts[0].s_end_m)
        front = self.truth.front_rest_m
        measured = self.reading.contour_m[touching]
        return measured[:, 0] - np.interp(measured[:, 1], front[:, 1], front[:, 0])


def squeeze(
    sensor: FingerSensor,
    gripper: VirtualGripper,
    forces_N: Sequence[float] = FORCES_N,
    *,
    speed_m_s: float = 0.04,
) -> list[Squeeze]:
    """Close until the sensor measures each force, hold, and measure again.

    The gripper is controlled by the sensor alone; readings of its drive are not used.

    Parameters
    ----------
    sensor
        Zeroed sensor.
    gripper
        Simulated gripper with the object.
    forces_N
        Increasing forces to hold [N].
    speed_m_s
        Closing speed [m/s].

    Raises
    ------
    CalibrationError
        A force was not reached before the gripper was fully closed.
    """
    found = []
    gripper.move(0.0, speed_m_s)
    levels_N = list(forces_N)
    for frame in gripper:
        reading = sensor.read_finger(frame)
        if reading.profile.valid and reading.profile.force_N >= levels_N[0]:
            gripper.stop()
            # The next frame starts after the gripper has stopped.
            held = sensor.read_finger(gripper.frame())
            found.append(Squeeze(levels_N.pop(0), held, gripper.truth(held.profile.t_s)))
            if not levels_N:
                return found
            gripper.move(0.0, speed_m_s)
        if gripper.state().opening_m <= 0.0 or frame.t_s > 30.0:
            break
    raise CalibrationError("squeeze", f"{levels_N[0]} N was not reached")


def plot_squeeze(found: Sequence[Squeeze], path: Path | str) -> None:
    """Plot the contours in the fixed frame at each force, measured and true.

    Parameters
    ----------
    found
        Measurements and truth.
    path
        Output image.
    """
    figure, axes = new_figure(1, 2, size=(8.0, 4.8), layout="constrained")
    for index, one in enumerate(found):
        colour = f"C{index}"
        truth, profile = one.truth.front_rest_m, one.reading.profile
        axes[0].plot(1e3 * truth[:, 0], 1e3 * truth[:, 1], color=colour, lw=0.8)
        contour = 1e3 * one.reading.contour_m
        label = f"{profile.force_N:.1f} N (true {one.truth.force_N:.1f})"
        axes[0].plot(contour[:, 0], contour[:, 1], ".", ms=3.5, color=colour, label=label)
        axes[1].plot(1e-3 * profile.pressure_Pa, 1e3 * profile.s_m, color=colour)
    axes[0].set(
        xlabel="x in the fixed frame [mm]", ylabel="y [mm]", title="contour: measured (dots), true (lines)"
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    axes[1].set(xlabel="pressure [kPa]", ylabel="s [mm]", title="pressure")
    for axis in axes:
        axis.grid(alpha=0.3)
    save_figure(path, figure, dpi=130)


def stiffness_N_per_m(found: Sequence[Squeeze]) -> float:
    """Slope of force over displacement of the object's surface (Fig. 3.13), by least squares.

    Parameters
    ----------
    found
        Measurements at two or more forces.
    """
    force, way = [], []
    for one in found:
        if not one.reading.profile.contacts:
            continue
        # The foremost point of the object is where the foam has its maximum deflection.
        way.append(float(np.nanmin(one.reading.contour_m[:, 0])))
        force.append(one.reading.profile.force_N)
    if len(force) < 2:
        return math.nan
    return float(np.polyfit(way, force, 1)[0])
