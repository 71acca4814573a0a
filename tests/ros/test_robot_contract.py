"""The adapters of ROS keep the contract of a robot, over the wire, against a stand-in that does what it is told.

The stand-in's clock is in its messages; that of base and fingers runs ten times as fast as the host's, and only
while somebody waits: no busy machine changes what is found.
"""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from tests.tasks import example_robot as right
from visuohaptic.core.camera import Pose
from visuohaptic.core.errors import StaleFrameError
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros import RosNode
from visuohaptic.ros.robots import RosArm, RosBase, RosGripper
from visuohaptic.tasks.framework import assert_robot

from .conftest import until

PERIOD_S = 0.005
COVARIANCE = [0.0] * 36


class StandIn:
    """Steps the parts of the example robot, and publishes what they say."""

    def __init__(self, node: RosNode, faster: float) -> None:
        self.node, self.faster, self.lock = node, faster, threading.Lock()
        self.work: list = []
        self.left_s = 0.0  #: simulated time that somebody waits for
        self.end = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def obey(self, topic: str, datatype: str, take) -> None:
        def locked(received) -> None:
            with self.lock:
                take(received.message)

        self.node.subscribe(topic, datatype, locked)

    def tell(self, topic: str, datatype: str, part, message) -> None:
        publisher = self.node.advertise(topic, datatype)
        self.work.append((part, publisher, message))

    def run(self) -> None:
        last_s = time.monotonic()
        while not self.end.wait(PERIOD_S):
            now_s = time.monotonic()
            step_s = min(self.faster * PERIOD_S, self.left_s) if self.faster > 1.0 else now_s - last_s
            self.left_s -= step_s
            for part, publisher, message in self.work:
                with self.lock:
                    part.wait(step_s)
                    told = message()
                publisher.publish(told)
            last_s = now_s


def known(read) -> bool:
    """Whether the first message about a part has arrived, which reading it requires."""
    try:
        read()
    except StaleFrameError:
        return False
    return True


@pytest.fixture
def stand_in(robot: RosNode, request: pytest.FixtureRequest):
    made = StandIn(robot, request.param)
    yield made
    made.end.set()
    made.thread.join()


class Base(right.Base):
    """Its clock starts at one: a stamp of zero is none."""

    def __init__(self) -> None:
        super().__init__()
        self.t_s = 1.0

    def wait(self, duration_s: float) -> None:
        speed, turn = self.velocity
        middle = self.pose[2] + 0.5 * turn * duration_s
        self.pose += duration_s * np.array([speed * np.cos(middle), speed * np.sin(middle), turn])
        self.t_s += duration_s


def odometry(base: Base) -> dict:
    x, y, heading = (float(v) for v in base.pose)
    speed, turn = (float(v) for v in base.velocity)
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {
        "header": messages.header(base.t_s, "odom"),
        "child_frame_id": "base_link",
        "pose": {
            "pose": messages.pose(Pose.from_rotation_vector([0.0, 0.0, heading], [x, y, 0.0])),
            "covariance": COVARIANCE,
        },
        "twist": {
            "twist": {"linear": zero | {"x": speed}, "angular": zero | {"z": turn}},
            "covariance": COVARIANCE,
        },
    }


@pytest.mark.parametrize("stand_in", [10.0], indirect=True)
def test_base_and_gripper_keep_the_contract(stand_in: StandIn, ours: RosNode) -> None:
    base, fingers = Base(), right.Fingers()
    fingers.t_s = 1.0

    def twist(message) -> None:
        base.velocity = np.array([message.linear.x, message.angular.z])

    def trajectory(message) -> None:
        (point,) = message.points
        took_s = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
        goal_m = float(point.positions[0])
        if abs(goal_m - fingers.opening_m) < 1e-6:
            fingers.stop()
        else:
            fingers.move(goal_m, abs(goal_m - fingers.opening_m) / max(took_s, 1e-3))

    def joints() -> dict:
        state = fingers.state()
        rate = state.speed_m_s if state.opening_m != fingers.target_m else 0.0
        return {
            "header": messages.header(state.t_s, ""),
            "name": ["finger"],
            "position": [state.opening_m],
            "velocity": [rate],
            "effort": [],
        }

    stand_in.obey("cmd_vel", "geometry_msgs/msg/Twist", twist)
    stand_in.tell("odom", "nav_msgs/msg/Odometry", base, lambda: odometry(base))
    stand_in.obey("gripper_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", trajectory)
    stand_in.tell("joint_states", "sensor_msgs/msg/JointState", fingers, joints)
    stand_in.thread.start()
    with (
        RosBase(ours, max_age_s=PATIENCE_S) as ros_base,
        RosGripper(ours, "finger", max_age_s=PATIENCE_S) as gripper,
    ):
        assert until(lambda: known(ros_base.state) and known(gripper.state), PATIENCE_S)

        def wait(duration_s: float) -> None:
            time.sleep(0.05)  # what was commanded is under way
            end_s = base.t_s + duration_s - 1e-6
            stand_in.left_s = duration_s
            assert until(lambda: ros_base.state().t_s >= end_s and gripper.state().t_s >= end_s, 30.0)

        assert_robot({"base": ros_base, "gripper": gripper, "wait": wait})


@pytest.mark.parametrize("stand_in", [1.0], indirect=True)
def test_an_arm_keeps_the_contract(stand_in: StandIn, ours: RosNode) -> None:
    """In real time: the adapter makes the straight line by the host's clock."""
    arm = right.Arm()
    arm.t_s = 1.0

    def target(message) -> None:
        place = message.pose.position
        arm.at = np.array([place.x, place.y, place.z])

    def pose() -> dict:
        return {
            "header": messages.header(arm.t_s, "base_link"),
            "pose": messages.pose(Pose(np.eye(3), arm.at)),
        }

    stand_in.obey("target_frame", "geometry_msgs/msg/PoseStamped", target)
    stand_in.tell("current_pose", "geometry_msgs/msg/PoseStamped", arm, pose)
    stand_in.thread.start()
    with RosArm(ours, (0.1, 0.8), max_age_s=PATIENCE_S) as ros_arm:
        assert until(lambda: known(ros_arm.pose), PATIENCE_S)
        assert_robot({"arm": ros_arm})
