"""LeRobot's robots satisfy our contract, with the stand-in ``lekiwi``."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from tests.tasks.lekiwi import KiwiCamera, LeKiwi

from visuohaptic.core import DeviceError, InputError
from visuohaptic.io.frames.live import LiveSource
from visuohaptic.tasks.framework import RobotParts, check_robot
from visuohaptic.tasks.robots import LeRobotBase, LeRobotCamera, LeRobotGripper, LeRobotLink

#: Position of the motor -> opening [m], of a jaw that turns.
JAW = {0.0: 0.0, 40.0: 0.02, 100.0: 0.09}
STEP_s = 0.02


@pytest.fixture
def robot() -> LeKiwi:
    return LeKiwi()


@pytest.fixture
def parts(robot: LeKiwi) -> Iterator[RobotParts]:
    link = LeRobotLink(robot, clock=lambda: robot.t_s)
    base = LeRobotBase(link, rate_Hz=None)
    gripper = LeRobotGripper(link, JAW, motor="arm_gripper", rate_Hz=None)

    def wait(duration_s: float) -> None:
        for _ in range(round(duration_s / STEP_s)):
            robot.advance(STEP_s)
            base.step()
            gripper.step()

    with LiveSource(LeRobotCamera(KiwiCamera())) as camera:
        yield RobotParts(base=base, gripper=gripper, camera=camera, wait=wait)


def test_base_gripper_and_camera_keep_the_contract(parts: RobotParts) -> None:
    rules = check_robot(parts)
    assert not [rule for rule in rules if rule.problem]
    assert {rule.part for rule in rules} == {"base", "gripper", "camera"}


def test_degrees_are_not_radians_and_the_arm_stays(robot: LeKiwi, parts: RobotParts) -> None:
    assert parts.base is not None
    assert robot.actions == []  # nobody has driven yet: a teleoperator may
    arm = {name: value for name, value in robot.at.items() if name != "arm_gripper.pos"}
    parts.base.drive(0.2, math.pi / 4)
    assert robot.actions[-1]["theta.vel"] == pytest.approx(45.0)
    parts.wait(2.0)
    state = parts.base.state()
    # A quarter turn in two seconds, less the 5 cm/s the wheels lag: the way is an arc of radius v / w.
    assert state.heading_rad == pytest.approx(math.pi / 2, abs=math.pi / 4 * 2 * 0.05)
    radius_m = 0.2 / (math.pi / 4)
    assert (state.x_m, state.y_m) == pytest.approx((radius_m, radius_m), abs=0.2 * 2 * 0.05)
    assert {name: robot.at[name] for name in arm} == arm
    for bad in ((math.nan, 0.0), (0.5, 0.0), (0.0, -2.0)):
        with pytest.raises(InputError, match="LeRobotBase"):
            parts.base.drive(*bad)


def test_what_the_gripper_holds_is_kept_while_the_base_drives(robot: LeKiwi, parts: RobotParts) -> None:
    assert parts.base is not None
    assert parts.gripper is not None
    parts.gripper.move(0.02, 0.05)
    parts.wait(1.0)
    parts.base.drive(0.1, 0.0)
    parts.wait(0.5)
    assert robot.actions[-1]["arm_gripper.pos"] == pytest.approx(40.0)
    assert parts.gripper.state().opening_m == pytest.approx(0.02)
    with pytest.raises(InputError, match=r"opening_m: found 0.1, expected 0 to 0.09"):
        parts.gripper.move(0.1, 0.05)
    with pytest.raises(InputError, match="openings_m"):
        LeRobotGripper(LeRobotLink(robot), {0.0: 0.0, 1.0: 0.1, 2.0: 0.05})


def test_a_robot_that_is_gone_is_an_error_of_ours(robot: LeKiwi, parts: RobotParts) -> None:
    assert parts.base is not None
    robot.is_connected = False
    with pytest.raises(DeviceError, match=r"LeRobot: DeviceNotConnectedError: .* is it connected\?"):
        parts.base.drive(0.1, 0.0)
    robot.is_connected = True
    with pytest.raises(DeviceError, match=r"has no observation 'gripper.pos', only arm_"):
        LeRobotGripper(LeRobotLink(robot), JAW)


def test_a_thread_drives_it_by_itself_and_leaving_stops_it(robot: LeKiwi) -> None:
    with LeRobotBase(LeRobotLink(robot), rate_Hz=200.0) as base:
        base.drive(0.1, 0.0)
        count = len(robot.actions)
        while len(robot.actions) < count + 3:
            base.state()
    assert robot.actions[-1]["x.vel"] == 0.0


def test_images_are_blue_green_red(robot: LeKiwi) -> None:
    camera = KiwiCamera()
    driver = LeRobotCamera(camera)
    driver.open()
    image, _ = driver.read()
    np.testing.assert_array_equal(image[0, 0], (0, 0, 255))
    camera.lost = True
    with pytest.raises(DeviceError, match="LeRobot camera: TimeoutError"):
        driver.read()
    driver.close()
    assert not camera.is_connected
