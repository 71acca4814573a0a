"""Driving to a goal over topics, with a simulated platform behind them, and actions with their cancelling.

The wheels of ROS 2 have no nav2_msgs, so Nav2's own client cannot call the node here: its goal is handed over by a
stand-in with the fields of ``NavigateToPose`` (nav2_msgs/action/NavigateToPose.action), and the action itself is shown on the
graph with an interface that the wheels have.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from visuohaptic.core import DeviceError
from visuohaptic.core.camera import Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros.transports import RclpyNode, RosOptions, interface
from visuohaptic.ros.wire import LATCHED
from visuohaptic.simulation.floor import FloorWorld

from . import test_nodes
from .conftest import until
from .test_nodes import DOMAIN, PATIENCE_S, Robot
from .test_task_nodes import running

robot = test_nodes.robot  #: the fixture
FIBONACCI = "test_msgs/action/Fibonacci"


@pytest.fixture
def server() -> Iterator[RclpyNode]:
    with RclpyNode("server", RosOptions(domain=DOMAIN)) as node:
        yield node


def send(robot: Robot, order: int, hear: Callable[[Any], None]) -> Any:
    """A goal that is accepted; its handle."""
    from rclpy.action import ActionClient

    client = ActionClient(robot.inner, interface(FIBONACCI), "/count")
    assert client.wait_for_server(PATIENCE_S)
    goal = interface(FIBONACCI).Goal(order=order)
    future = client.send_goal_async(goal, feedback_callback=hear)
    assert until(future.done, PATIENCE_S)
    assert future.result().accepted
    return future.result()


def test_an_action_reaches_its_goal_and_is_cancelled(server: RclpyNode, robot: Robot) -> None:
    ended: list[bool] = []

    def count(goal: Any, tell: Callable[[Mapping[str, Any]], None], cancelled: Callable[[], bool]) -> bool:
        if goal.order == 13:
            raise DeviceError("thirteen is not driven to")
        for number in range(goal.order):
            if cancelled():
                ended.append(True)
                return False
            tell({"sequence": [number]})
            time.sleep(0.02)
        return True

    server.act("count", FIBONACCI, count)
    heard: list[Any] = []

    def result(handle: Any) -> int:
        future = handle.get_result_async()
        assert until(future.done, PATIENCE_S)
        return int(future.result().status)

    # Numbers of action_msgs/msg/GoalStatus: 4 succeeded, 5 canceled, 6 aborted.
    assert result(send(robot, 5, heard.append)) == 4
    assert heard
    handle = send(robot, 10_000, heard.append)
    cancelling = handle.cancel_goal_async()
    assert until(cancelling.done, PATIENCE_S)
    assert result(handle) == 5
    assert ended
    assert result(send(robot, 13, heard.append)) == 6


class Platform:
    """A platform of the simulated floor behind the topics of a real one."""

    def __init__(self, node: RclpyNode, world: FloorWorld) -> None:
        self._node, self._world = node, world
        self._odometry = node.advertise("odom", "nav_msgs/msg/Odometry")
        self._wrench = node.advertise("foam/wrench", "geometry_msgs/msg/WrenchStamped")
        self._lock, self._end = threading.Lock(), threading.Event()
        node.subscribe("cmd_vel", "geometry_msgs/msg/Twist", self._drive)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _drive(self, received: Any) -> None:
        with self._lock:
            self._world.base.drive(received.message.linear.x, received.message.angular.z)

    def _run(self) -> None:
        while not self._end.wait(0.02):
            with self._lock:
                self._world.step(0.02)
                state = self._world.base.state()
            header = messages.header(state.t_s, "map")
            pose = messages.pose(
                Pose.from_rotation_vector([0, 0, state.heading_rad], [state.x_m, state.y_m, 0])
            )
            twist = {
                "linear": {"x": state.speed_m_s, "y": 0.0, "z": 0.0},
                "angular": {"x": 0.0, "y": 0.0, "z": state.turn_rate_rad_s},
            }
            zero = [0.0] * 36
            self._odometry.publish(
                {
                    "header": header,
                    "child_frame_id": "base_link",
                    "pose": {"pose": pose, "covariance": zero},
                    "twist": {"twist": twist, "covariance": zero},
                }
            )
            none = {"x": 0.0, "y": 0.0, "z": 0.0}
            self._wrench.publish({"header": header, "wrench": {"force": none, "torque": none}})

    def close(self) -> None:
        self._end.set()
        self._thread.join()


def navigate_to(x_m: float, y_m: float) -> Any:
    """The goal of ``NavigateToPose``: a PoseStamped in ``pose``, and the behaviour tree that Nav2 would load."""
    position = SimpleNamespace(x=x_m, y=y_m, z=0.0)
    orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    header = SimpleNamespace(frame_id="map")
    pose = SimpleNamespace(header=header, pose=SimpleNamespace(position=position, orientation=orientation))
    return SimpleNamespace(pose=pose, behavior_tree="")


def test_it_drives_to_a_goal_and_stops_when_that_is_taken_back(robot: Robot, tmp_path: Path) -> None:
    """A room of 4 m x 3 m: 0.8 m at 0.3 m/s."""
    save_yaml(tmp_path / "robot.yaml", {"radius_m": 0.17})
    cells = np.zeros((60, 80), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    room = OccupancyMap(cells, 0.05)
    world = FloorWorld(room, [], (0.7, 1.5, 0.0))
    robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED).publish(room.to_message(5.0, "map"))
    platform = Platform(robot, world)
    values = {"robot": str(tmp_path / "robot.yaml"), "pose": "", "max_age_s": 5.0}
    try:
        with running("travel", **values) as process:
            node = process.running.component
            assert until(lambda: node._map is not None, PATIENCE_S)
            assert until(lambda: node._base._publisher.heard, PATIENCE_S)
            told: list[float] = []

            def tell(fields: Any) -> None:
                told.append(fields["distance_remaining"])

            assert node.navigate(navigate_to(1.5, 1.5), tell, lambda: False)
            x, y, _ = world.pose_m()
            assert np.hypot(x - 1.5, y - 1.5) < 0.05
            assert told == sorted(told, reverse=True)
            goals = robot.advertise("goal_pose", "geometry_msgs/msg/PoseStamped")
            goals.wait_until_heard(PATIENCE_S)
            there = messages.pose(Pose.from_rotation_vector([0, 0, 0], [3.3, 1.5, 0]))
            goals.publish({"header": messages.header(5.0, "map"), "pose": there})
            assert until(lambda: world.pose_m()[0] > 1.8, PATIENCE_S)
            with pytest.raises(DeviceError, match="drives to another goal"):
                node.navigate(navigate_to(1.5, 1.5), tell, lambda: False)
            assert robot.trigger("/travel/cancel").success
            assert until(lambda: node.status().reason == "the goal was cancelled", PATIENCE_S)
            assert until(lambda: abs(world.base.state().speed_m_s) < 1e-3, PATIENCE_S)
            assert world.pose_m()[0] < 3.0
    finally:
        platform.close()
