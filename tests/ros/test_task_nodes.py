"""The nodes that plan, recognise, grasp, track and look through: their services and topics in a live graph."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros.nodes import LifecycleProcess, node_kind
from visuohaptic.ros.transports import RosOptions
from visuohaptic.ros.wire import Qos
from visuohaptic.tracking.templates import Template

from .conftest import until
from .test_nodes import DOMAIN, PATIENCE_S, Robot, robot  # noqa: F401 - a fixture

LATCHED = Qos(latched=True, depth=1)


@contextmanager
def running(name: str, **values: Any) -> Iterator[LifecycleProcess]:
    with LifecycleProcess(name, node_kind(name), values, RosOptions(domain=DOMAIN)) as process:
        process.start()
        yield process


def listen(node: Robot, topic: str, datatype: str, qos: Qos | None = LATCHED) -> list[Any]:
    got: list[Any] = []
    node.subscribe(topic, datatype, lambda received: got.append(received.message), qos)
    return got


def test_a_goal_becomes_a_path(robot: Robot, tmp_path: Path) -> None:  # noqa: F811
    """A room of 4 m x 2 m with a wall that leaves a gap: the path is at least as long as the way through the gap."""
    save_yaml(tmp_path / "robot.yaml", {"radius_m": 0.2})
    walls = np.zeros((40, 80), dtype=bool)
    walls[:, [0, -1]] = walls[[0, -1]] = True
    walls[:28, 40] = True
    grid = OccupancyMap(walls, 0.05)
    maps = robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    poses = robot.advertise("amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", LATCHED)
    goals = robot.advertise("goal_pose", "geometry_msgs/msg/PoseStamped")
    path = listen(robot, "plan", "nav_msgs/msg/Path")
    tasks = listen(robot, "plan/tasks", "std_msgs/msg/String")
    with running("plan", robot=str(tmp_path / "robot.yaml")):
        answer = robot.trigger("/plan/plan")
        assert not answer.success
        assert "nothing on /map, /amcl_pose, /goal_pose yet" in answer.message
        maps.publish(grid.to_message(5.0, "map"))
        here = messages.pose(Pose.from_rotation_vector([0, 0, 0], [0.5, 0.5, 0]))
        poses.publish(
            {"header": messages.header(5.0, "map"), "pose": {"pose": here, "covariance": [0.0] * 36}}
        )
        there = messages.pose(Pose.from_rotation_vector([0, 0, 0], [3.5, 0.5, 0]))
        goals.wait_until_heard(PATIENCE_S)
        assert until(
            lambda: (
                goals.publish({"header": messages.header(5.0, "map"), "pose": there})
                or until(lambda: path, 2.0)
            ),
            PATIENCE_S,
        )
        points = np.array([[p.pose.position.x, p.pose.position.y] for p in path[-1].poses])
        assert path[-1].header.frame_id == "map"
        np.testing.assert_allclose(points[0], [0.5, 0.5], atol=0.05)
        np.testing.assert_allclose(points[-1], [3.5, 0.5], atol=0.05)
        # Round the end of the wall at (2.0, 1.4): no shorter than the two straight lines, and near them.
        length = np.hypot(*np.diff(points, axis=0).T).sum()
        direct = 2 * np.hypot(1.5, 0.9)
        assert direct < length < 1.3 * direct
        assert until(lambda: tasks, PATIENCE_S)
        assert json.loads(tasks[-1].data)["reachable"]
        again = robot.trigger("/plan/plan")
        assert again.success
        assert json.loads(again.message)["reachable"]


def test_a_tag_becomes_a_pose(robot: Robot, tmp_path: Path) -> None:  # noqa: F811
    """Seen from straight ahead, its distance is focal length times size over pixels."""
    tag = Template.from_tag(7, size_m=0.04)
    camera = Camera.simple(640, 480, focal_px=600.0, name="eye")
    camera.save(tmp_path / "camera.yaml")
    (tmp_path / "tags").mkdir()
    save_yaml(tmp_path / "tags" / "tags.yaml", {"tags": {"box": {"id": 7, "size_m": 0.04}}})
    image = np.full((480, 640), 200, np.uint8)
    rows, columns = tag.image.shape
    image[60 : 60 + rows, 140 : 140 + columns] = tag.image
    got = listen(robot, "template/box", "geometry_msgs/msg/PoseWithCovarianceStamped", None)
    pictures = robot.advertise("image", "sensor_msgs/msg/Image")
    words = {"templates": str(tmp_path / "tags"), "camera": str(tmp_path / "camera.yaml"), "frame": "eye"}
    with running("template", tf=False, **words):
        pictures.wait_until_heard(PATIENCE_S)
        stamps = iter(range(10, 10_000))
        assert until(
            lambda: (
                pictures.publish(messages.image(next(stamps) / 10, image, "eye")) or until(lambda: got, 0.3)
            ),
            PATIENCE_S,
        )
    assert got[0].header.frame_id == "eye"
    distance = 600.0 * tag.pixel_m
    assert got[0].pose.pose.position.z == pytest.approx(distance, rel=0.01)


def test_a_cup_is_grasped_and_squeezed(robot: Robot) -> None:  # noqa: F811
    with running("grasp", object="cup", material="PET", thickness_m=0.0005):
        answer = robot.trigger("/grasp/squeeze")
        assert answer.success, answer.message
        found = json.loads(answer.message)
        force = np.array(found["force_N"])
        assert len(force) == len(found["deformation_m"]) > 3
        assert found["stiffness_N_per_m"] > 0
        answer = robot.trigger("/grasp/plan_grasp")
        assert answer.success, answer.message
        assert set(json.loads(answer.message)) == {"grasps", "reason", "notes"}
