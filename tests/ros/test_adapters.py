"""Base, gripper and arm with a robot that executes commands exactly, over the wire."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from visuohaptic.core import (
    BaseState,
    DeviceError,
    Gripper,
    InputError,
    MobileBase,
    ProbeArm,
    StaleFrameError,
)
from visuohaptic.core.camera import Pose
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros import RosNode
from visuohaptic.ros.robots import RosArm, RosBase, RosGripper
from visuohaptic.tasks.framework import check_robot
from visuohaptic.tasks.robots import Repeater

from .conftest import until

COVARIANCE = [0.0] * 36


class Robot:
    """Publishes its state at 200 Hz, and keeps the commands."""

    def __init__(self, node: RosNode) -> None:
        self.node = node
        self.got: list = []
        self.state: tuple = ()
        self.end = threading.Event()

    def obey(self, topic: str, datatype: str) -> None:
        self.node.subscribe(topic, datatype, lambda r: self.got.append(r.message))

    def tell(self, topic: str, datatype: str, message) -> None:
        publisher = self.node.advertise(topic, datatype)

        def run() -> None:
            while not self.end.wait(0.005):
                publisher.publish(message())

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def silence(self) -> None:
        self.end.set()
        self.thread.join()


@pytest.fixture
def machine(robot: RosNode):
    machine = Robot(robot)
    yield machine
    if not machine.end.is_set():
        machine.silence()


def odometry() -> dict:
    pose = Pose.from_rotation_vector([0.0, 0.0, 2.5], [1.0, -2.0, 0.0])
    twist = {"linear": {"x": 0.25, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -0.5}}
    twist = {key: {axis: float(v) for axis, v in part.items()} for key, part in twist.items()}
    return {
        "header": messages.header(12.5, "odom"),
        "child_frame_id": "base_link",
        "pose": {"pose": messages.pose(pose), "covariance": COVARIANCE},
        "twist": {"twist": twist, "covariance": COVARIANCE},
    }


@pytest.mark.parametrize("stamped", [False, True])
def test_a_base_drives_until_it_is_stopped(machine: Robot, ours: RosNode, stamped: bool) -> None:
    machine.obey("cmd_vel", "geometry_msgs/msg/Twist" + ("Stamped" if stamped else ""))
    machine.tell("odom", "nav_msgs/msg/Odometry", odometry)

    def quiet() -> bool:
        count = len(machine.got)
        time.sleep(0.3)
        return len(machine.got) == count

    def speeds() -> list[tuple[float, float]]:
        twists = [m.twist if stamped else m for m in machine.got]
        return [(t.linear.x, t.angular.z) for t in twists]

    with RosBase(ours, stamped_frame="base_link" if stamped else None, rate_Hz=100.0, max_age_s=0.2) as base:
        assert isinstance(base, MobileBase)
        states: list[BaseState] = []
        # The first message may take longer than an adapter waits, on a busy machine.
        assert until(lambda: not _raises(StaleFrameError, lambda: states.append(base.state())))
        state = states[0]
        assert (state.t_s, state.x_m, state.y_m) == pytest.approx((12.5, 1.0, -2.0))
        assert state.heading_rad == pytest.approx(2.5)
        assert (state.speed_m_s, state.turn_rate_rad_s) == pytest.approx((0.25, -0.5))
        time.sleep(0.05)
        assert machine.got == []  # nobody has driven yet: others may
        base.drive(0.3, -0.2)
        assert until(lambda: len(machine.got) >= 10)  # the command is repeated
        np.testing.assert_allclose(speeds(), [(0.3, -0.2)] * len(speeds()))
        for bad in ((math.nan, 0.0), (0.0, math.inf), (0.6, 0.0), (0.0, -2.0)):
            with pytest.raises(InputError, match=r"RosBase\.drive"):
                base.drive(*bad)
        machine.silence()
        assert until(lambda: _raises(StaleFrameError, base.state))
    assert until(lambda: speeds()[-1] == (0.0, 0.0))  # leaving stops it
    assert until(quiet)  # what was sent before is still under way, nothing follows


def _raises(kind: type[Exception], work) -> bool:
    try:
        work()
    except kind:
        return True
    return False


def test_numbers_that_are_not_finite_are_no_state(machine: Robot, ours: RosNode) -> None:
    """A driver without a measurement sends NaN: it is neither a place, nor an opening to hold."""
    lost = odometry()
    lost["pose"]["pose"]["position"]["x"] = math.nan
    machine.tell("odom", "nav_msgs/msg/Odometry", lambda: lost)
    with RosBase(ours) as base:
        assert until(lambda: base._odometry._received is not None)
        with pytest.raises(StaleFrameError, match="not finite"):
            base.state()
    joints = {
        "header": messages.header(3.0, ""),
        "name": ["finger"],
        "position": [math.nan],
        "velocity": [0.0],
    }
    states = machine.node.advertise("joint_states", "sensor_msgs/msg/JointState")
    with RosGripper(ours, "finger") as gripper:
        states.wait_until_heard(60.0)
        states.publish(joints | {"effort": []})
        assert until(lambda: gripper._states._received is not None)
        with pytest.raises(StaleFrameError, match="position NaN of the joint 'finger'"):
            gripper.stop()


def test_a_base_without_odometry_says_so(ours: RosNode) -> None:
    with (
        RosBase(ours, odometry="/wheels") as base,
        pytest.raises(StaleFrameError, match="nothing on /wheels"),
    ):
        base.state()


def joints(position: float, name: str = "finger") -> dict:
    return {
        "header": messages.header(3.0, ""),
        "name": ["other", name],
        "position": [9.0, position],
        "velocity": [9.0, 0.1],
        "effort": [],
    }


def test_a_gripper_moves_in_the_time_that_its_speed_needs(machine: Robot, ours: RosNode) -> None:
    machine.obey("gripper_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
    machine.tell("joint_states", "sensor_msgs/msg/JointState", lambda: joints(0.03))
    # Two fingers that each move by the joint's position, closed at 0.04.
    with RosGripper(ours, "finger", opening_per_joint=-2.0, opening_at_zero_m=0.08) as gripper:
        assert isinstance(gripper, Gripper)
        state = gripper.state()
        assert (state.t_s, state.speed_m_s) == (3.0, pytest.approx(-0.2))
        assert state.opening_m == pytest.approx(0.02)
        gripper.move(0.05, 0.01)
        assert until(lambda: machine.got)
        command = machine.got[0]
        assert command.joint_names == ["finger"]
        assert command.header.stamp.sec == 0
        (point,) = command.points
        assert point.positions.tolist() == pytest.approx([0.015])
        took = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
        assert took == pytest.approx(0.03 / 0.01)
        machine.got.clear()
        gripper.stop()
        assert until(lambda: machine.got)
        assert machine.got[0].points[0].positions.tolist() == pytest.approx([0.03])
        for bad in ((0.2, 0.01), (-0.01, 0.01), (0.05, 0.0), (math.nan, 0.01)):
            with pytest.raises(InputError, match=r"RosGripper\.move"):
                gripper.move(*bad)
    with RosGripper(ours, "thumb") as other, pytest.raises(DeviceError, match="no joint 'thumb', only other"):
        other.state()


def test_a_gripper_without_joint_states_stops_where_its_command_has_led(
    machine: Robot, ours: RosNode
) -> None:
    """The driver reports NaN in the middle of a slow closing: the setpoint of this moment is held, by the clock."""
    position = [0.03]
    machine.obey("gripper_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
    machine.tell("joint_states", "sensor_msgs/msg/JointState", lambda: joints(position[0]))
    with RosGripper(ours, "finger", opening_per_joint=2.0, max_age_s=60.0) as gripper:
        assert until(lambda: not _raises(StaleFrameError, gripper.state))
        before_s = time.monotonic()
        gripper.move(0.01, 0.0005)  # 100 s
        after_s = time.monotonic()
        position[0] = math.nan
        assert until(lambda: _raises(StaleFrameError, gripper.state))
        assert until(lambda: machine.got)
        machine.got.clear()
        begin_s = time.monotonic()
        gripper.stop()
        end_s = time.monotonic()
        assert until(lambda: machine.got)
        (held,) = machine.got[0].points[0].positions.tolist()
        led_s = (0.06 - 2.0 * held) / 0.0005
        assert before_s + led_s <= end_s
        assert after_s + led_s >= begin_s
        # A second stop holds the same opening: the first one was a command to stay.
        machine.got.clear()
        gripper.stop()
        assert until(lambda: machine.got)
        assert machine.got[0].points[0].positions.tolist() == [held]


def test_an_arm_follows_a_straight_line(machine: Robot, ours: RosNode) -> None:
    start = Pose.from_rotation_vector([0.0, 0.0, 0.4], [0.4, 0.0, 0.2])
    end = Pose.from_rotation_vector([0.0, 0.0, 0.8], [0.4, 0.1, 0.25])
    machine.obey("target_frame", "geometry_msgs/msg/PoseStamped")
    machine.tell(
        "current_pose",
        "geometry_msgs/msg/PoseStamped",
        lambda: {"header": messages.header(7.0, "base_link"), "pose": messages.pose(start)},
    )
    with RosArm(ours, (0.1, 0.9), rate_Hz=200.0) as arm:
        assert isinstance(arm, ProbeArm)
        t_s, pose = arm.pose()
        assert t_s == 7.0
        np.testing.assert_allclose(pose.matrix, start.matrix, atol=1e-12)
        assert arm.reach_m().tolist() == pytest.approx([0.1, 0.9])
        way = end.translation_m - start.translation_m
        speed = float(np.linalg.norm(way)) / 0.3
        arm.move_linear(end, speed)
        assert until(lambda: machine.got and abs(machine.got[-1].pose.position.y - 0.1) < 1e-12)
        points = np.array([[m.pose.position.x, m.pose.position.y, m.pose.position.z] for m in machine.got])
        # On the line, in order; the turn about z goes with the way.
        part = (points - start.translation_m) @ way / (way @ way)
        np.testing.assert_allclose(points, start.translation_m + part[:, None] * way, atol=1e-12)
        assert (np.diff(part) > 0).all()
        angles = [2 * math.atan2(m.pose.orientation.z, m.pose.orientation.w) for m in machine.got]
        np.testing.assert_allclose(angles, 0.4 + 0.4 * part, atol=1e-9)
        count = len(machine.got)
        time.sleep(0.05)
        assert len(machine.got) == count  # arrived
        arm.move_linear(end, 0.001)
        arm.stop()
        assert until(lambda: machine.got[-1].pose.position.y == 0.0)
        for pose, speed in ((Pose(np.eye(3), np.array([1.0, 0, 0])), 0.1), (end, 0.0), (end, math.nan)):
            with pytest.raises(InputError, match=r"RosArm\.move_linear"):
                arm.move_linear(pose, speed)


def test_an_arm_whose_pose_gets_lost_stops_where_it_is_told_to(machine: Robot, ours: RosNode) -> None:
    """Its driver sends NaN from some time on: no target follows the stop, which says why it cannot hold the pose."""
    start, end = (Pose(np.eye(3), np.array([0.4, y, 0.2])) for y in (0.0, 0.1))
    sent = messages.pose(start)
    machine.obey("target_frame", "geometry_msgs/msg/PoseStamped")
    machine.tell(
        "current_pose",
        "geometry_msgs/msg/PoseStamped",
        lambda: {"header": messages.header(7.0, "base_link"), "pose": sent},
    )
    with RosArm(ours, (0.1, 0.9), rate_Hz=200.0) as arm:
        arm.move_linear(end, 0.01)
        assert until(lambda: bool(machine.got))
        sent = messages.pose(start) | {"position": {"x": math.nan, "y": 0.0, "z": 0.2}}
        assert until(lambda: _is_lost(arm))
        with pytest.raises(StaleFrameError, match="the pose on /current_pose is not valid"):
            arm.stop()
        time.sleep(0.05)  # what was on its way has arrived
        count = len(machine.got)
        time.sleep(0.05)
        assert len(machine.got) == count


def _is_lost(arm: RosArm) -> bool:
    try:
        arm.pose()
    except StaleFrameError:
        return True
    return False


def test_a_command_that_nobody_hears_is_an_error(machine: Robot, ours: RosNode) -> None:
    machine.tell("odom", "nav_msgs/msg/Odometry", odometry)
    machine.obey("cmd_vel", "geometry_msgs/msg/TwistStamped")  # another type: it would never arrive
    with RosBase(ours) as base, pytest.raises(DeviceError, match="no subscriber to /cmd_vel"):
        base.drive(0.1, 0.0)


def test_a_repeater_that_fails_says_so() -> None:
    def fail() -> None:
        raise DeviceError("gone")

    repeater = Repeater(fail, 500.0, "commands")
    assert until(lambda: repeater.problem is not None)
    with pytest.raises(DeviceError, match="commands: gone"):
        repeater.check()
    repeater.close()
    with pytest.raises(InputError):
        Repeater(fail, 0.0, "commands")


def test_a_simulated_platform_keeps_the_contract(machine: Robot, ours: RosNode) -> None:
    """Five times as fast as real: its odometry has the simulation's time."""
    fast = 5.0
    simulated, began = {"t": 0.0, "x": 0.0, "y": 0.0, "heading": 0.3}, time.monotonic()

    def moved() -> dict:
        speed, turn = (machine.got[-1].linear.x, machine.got[-1].angular.z) if machine.got else (0.0, 0.0)
        dt, simulated["t"] = (
            fast * (time.monotonic() - began) - simulated["t"],
            fast * (time.monotonic() - began),
        )
        simulated["heading"] += dt * turn
        simulated["x"] += dt * speed * math.cos(simulated["heading"])
        simulated["y"] += dt * speed * math.sin(simulated["heading"])
        pose = Pose.from_rotation_vector(
            [0.0, 0.0, simulated["heading"]], [simulated["x"], simulated["y"], 0.0]
        )
        twist = {"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": turn}}
        return {
            "header": messages.header(simulated["t"], "odom"),
            "child_frame_id": "base_link",
            "pose": {"pose": messages.pose(pose), "covariance": COVARIANCE},
            "twist": {"twist": twist, "covariance": COVARIANCE},
        }

    machine.obey("cmd_vel", "geometry_msgs/msg/Twist")
    machine.tell("odom", "nav_msgs/msg/Odometry", moved)
    with RosBase(ours, rate_Hz=100.0) as base:
        rules = check_robot({"base": base, "wait": lambda duration_s: time.sleep(duration_s / fast)})
    assert not [rule for rule in rules if rule.problem]
