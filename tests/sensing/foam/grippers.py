"""Sensors on virtual grippers, built once: ground truth for the tests of finger and stripe."""

from __future__ import annotations

import numpy as np

from visuohaptic.rigs import GripperSensor
from visuohaptic.simulation.foam import Outline, SensorRig
from visuohaptic.simulation.tabletop import GRIPPER_RIG, GraspObject

#: A usual rolling shutter: 30 ms for 896 rows.
ROLLING = SensorRig(look_ahead_m=GRIPPER_RIG.look_ahead_m, row_delay_s=33e-6)
#: Middle between the fingers.
MIDDLE_M = 0.065


def bottle(stiffness_N_per_m: float = 2e4) -> GraspObject:
    return GraspObject(Outline.disc((MIDDLE_M, 0.0), 0.035), stiffness_N_per_m)


def two_posts() -> tuple[GraspObject, GraspObject]:
    """Two posts of 3 cm side by side, the second 0.3 mm further away from the finger."""
    return (
        GraspObject(Outline.disc((MIDDLE_M - 0.01, -0.035), 0.015)),
        GraspObject(Outline.disc((MIDDLE_M - 0.0097, 0.035), 0.015)),
    )


def build(folder, *, stripe: bool, rig: SensorRig = ROLLING):
    """The rig and its sensor with few zero frames."""
    maker = GripperSensor(stripe=stripe, rig=rig)
    return maker, maker.build(folder, np.random.default_rng(1), zero_frames=8)
