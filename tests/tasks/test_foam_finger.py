"""The foam finger as the hand's sensor, on the virtual gripper: a squeeze measures radius and stiffness."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, Reason
from visuohaptic.core.camera import Pose
from visuohaptic.rigs.squeeze_rig import BOTTLE
from visuohaptic.rigs.virtual_gripper import GripperSensor
from visuohaptic.tasks.framework import assert_robot, force_of
from visuohaptic.tasks.manipulation import FoamFinger, Hand, Place, SqueezeSettings, squeeze
from visuohaptic.tasks.manipulation.foam_finger import _touch

OBJECT_M = (0.5, 0.0, 0.0)


class StandingArm:
    """An arm that is where it is to be."""

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None: ...

    def stop(self) -> None: ...

    def reach_m(self) -> np.ndarray:
        return np.array([0.2, 0.8])

    def pose(self) -> tuple[float, Pose]:
        return 0.0, Pose(np.eye(3), np.add(OBJECT_M, (0.0, 0.0, 0.1)))


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    maker = GripperSensor(stripe=False)
    return maker, maker.build(tmp_path_factory.mktemp("finger"), np.random.default_rng(0), zero_frames=6)


def test_a_squeeze_with_the_foam_finger_tells_radius_and_stiffness(rig) -> None:
    """A disc of 35 mm about the middle, its wall on a spring of 20 N/mm: analytic truth."""
    maker, sensor = rig
    gripper = maker.gripper(BOTTLE, rng=np.random.default_rng(1))
    hand = Hand(StandingArm(), gripper, gripper, FoamFinger(sensor, middle_m=0.065))
    settings = SqueezeSettings(
        object_m=OBJECT_M, forces_N=(8.0, 16.0, 24.0, 32.0), open_m=0.1, finger_m_s=0.04, hold_frames=2
    )
    found = squeeze(hand, [Place(0.1)], settings)
    assert found.ending.success, found.ending.why
    curve = found.curves[0]
    # Over a curved body the strain is read 0.1 mm off its foremost point (test_contour_in_the_fixed_frame).
    assert curve.surface_m == pytest.approx(0.035, abs=1.5e-4)
    # Force 3 %, and 0.02 mm from point to point of a way of 1.2 mm.
    assert curve.stiffness_N_per_m == pytest.approx(2e4, rel=0.08)


def test_the_foam_finger_keeps_the_contract_of_a_finger(rig) -> None:
    """Everything that the tasks of the hand read of it, in their units."""
    maker, sensor = rig
    sensor.reset()
    gripper = maker.gripper(rng=np.random.default_rng(3))
    assert_robot({"camera": gripper, "feel": FoamFinger(sensor, middle_m=0.065)})


def test_without_touch_there_is_no_surface(rig) -> None:
    maker, sensor = rig
    sensor.reset()
    finger = FoamFinger(sensor, middle_m=0.065)
    touch = finger(maker.gripper(rng=np.random.default_rng(2)).frame())
    assert touch.valid
    assert np.isnan(touch.surface_m)
    assert abs(touch.force_N) < 0.5
    # Beyond the range of the foam, a hand has to open: the force is not known, but not small.
    full = _touch(sensor.blank(1.0, Reason.SATURATED), False, np.full(len(sensor.setup.geometry.s_m), 0.03))
    assert not full.valid
    assert full.force_N == force_of(full) == np.inf
    with pytest.raises(InputError, match="middle_m: found nan"):
        FoamFinger(sensor, middle_m=float("nan"))
