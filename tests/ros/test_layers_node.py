"""What a map serves to Nav2 (route graph, masks, felt obstacles), over zenoh; over ROS itself: ``test_task_nodes``."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from visuohaptic.core import DeviceError, Estimate, HapticTag, resources
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.navigation.files import felt_obstacles
from visuohaptic.navigation.problem import MovableObject, RobotModel, objects_from_data
from visuohaptic.ros import RosNode, RosOptions
from visuohaptic.ros.nodes import (
    Running,
    node_kind,
    objects_text,
    plan_node,
)
from visuohaptic.ros.wire import LATCHED

from .conftest import until

TYPES = {
    "route_graph": "std_msgs/msg/String",
    "route_graph/markers": "visualization_msgs/msg/MarkerArray",
    "keepout_mask": "nav_msgs/msg/OccupancyGrid",
    "felt_obstacles": "nav_msgs/msg/OccupancyGrid",
}


def room() -> OccupancyMap:
    """4 m x 2 m, and a wall that leaves a gap at its end."""
    walls = np.zeros((40, 80), dtype=bool)
    walls[:, [0, -1]] = walls[[0, -1]] = True
    walls[:26, 40] = True
    return OccupancyMap(walls, 0.05)


def square(x_m: float, y_m: float, side_m: float = 0.3) -> list[list[float]]:
    return [[x_m + side_m * a, y_m + side_m * b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]


#: A crate that stands fast, a light box that was pushed ten times, and a bin that nobody has touched.
OBJECTS: list[dict[str, Any]] = [
    {"id": "crate", "footprint_m": square(1.0, 1.0), "haptic_tag": {"fixed": True}},
    {"id": "box", "footprint_m": square(3.0, 1.0), "haptic_tag": {"static_friction_N": 4.0, "explored": 10}},
    {"id": "bin", "footprint_m": square(1.0, 0.3)},
]


def write(folder: Path) -> dict[str, str]:
    save_yaml(folder / "robot.yaml", {"radius_m": 0.17, "push_force_max_N": 20.0})
    save_yaml(folder / "objects.yaml", {"objects": OBJECTS})
    return {"robot": str(folder / "robot.yaml"), "objects": str(folder / "objects.yaml")}


@contextmanager
def running(name: str, endpoint: str, values: dict[str, Any]) -> Iterator[Running]:
    options = RosOptions(connect=(endpoint,), listen=())
    with Running(node_kind(name), lambda: RosNode(name, options)) as node:
        node.configure(values)
        node.activate()
        yield node


def hear(node: RosNode) -> dict[str, list[Any]]:
    got: dict[str, list[Any]] = {topic: [] for topic in TYPES}
    for topic, kind in TYPES.items():
        node.subscribe(topic, kind, lambda r, topic=topic: got[topic].append(r.message), LATCHED)
    return got


def layer(message: Any) -> np.ndarray:
    return np.array(message.data, np.int8).reshape(message.info.height, message.info.width)


def inside(cells: np.ndarray, x_m: float, y_m: float) -> int:
    return int(cells[int(y_m / 0.05), int(x_m / 0.05)])


def test_a_map_is_served_to_who_comes_late(tmp_path: Path, robot: RosNode, endpoint: str) -> None:
    grid = room()
    maps = robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    maps.publish(grid.to_message(5.0, "map"))
    with running("layers", endpoint, write(tmp_path)) as node:
        assert until(lambda: node.component.status().reason == "ok"), node.component.status()
        got = hear(robot)
        assert until(lambda: all(got.values())), {topic: len(found) for topic, found in got.items()}
        felt, mask = layer(got["felt_obstacles"][-1]), layer(got["keepout_mask"][-1])
        assert got["felt_obstacles"][-1].header.frame_id == "map"
        assert inside(felt, 1.15, 1.15) == 100  # the crate
        assert 1 <= inside(felt, 3.15, 1.15) < 20  # the box: of ten pushes none has failed
        assert inside(felt, 1.15, 0.45) == 0  # the bin
        assert set(np.unique(mask)) == {0, 100}
        np.testing.assert_array_equal(mask == 100, felt == 100)
        graph = json.loads(got["route_graph"][-1].data)["features"]
        places = {
            f["properties"]["id"]: f["geometry"]["coordinates"]
            for f in graph
            if f["geometry"]["type"] == "Point"
        }
        edges = [f["properties"] for f in graph if "startid" in f["properties"]]
        assert {"crate", "box", "bin"} <= {
            f["properties"].get("metadata", {}).get("object")
            for f in graph
            if f["geometry"]["type"] == "Point"
        }
        assert {(e["endid"], e["startid"]) for e in edges} == {(e["startid"], e["endid"]) for e in edges}
        points, lines = (marker.points for marker in got["route_graph/markers"][-1].markers)
        assert len(points) == len(places)
        assert len(lines) == len(edges)  # two ends of each edge, which the graph has in two directions
        # The box turns out to stand fast: by what was touched since, not by the file.
        told = robot.advertise("objects", "std_msgs/msg/String", LATCHED)
        told.publish({"data": json.dumps({"objects": [OBJECTS[1] | {"haptic_tag": {"fixed": True}}]})})
        assert until(lambda: inside(layer(got["felt_obstacles"][-1]), 3.15, 1.15) == 100)
        assert until(lambda: inside(layer(got["keepout_mask"][-1]), 1.15, 1.15) == 0)


def test_felt_obstacles_cover_what_they_stand_on() -> None:
    """On a map that is turned by 30 degrees: every cell that an object reaches into, and none a cell beyond."""
    grid = OccupancyMap(np.zeros((60, 60), np.int8), 0.1, (-1.0, -2.0, np.pi / 6))
    triangle = np.array([[0.3, 0.4], [1.9, 0.9], [0.8, 2.1]])
    tag = HapticTag(static_friction_N=Estimate(4.0, 0.1), explored=4)
    robot = RobotModel(0.2, push_force_max_N=20.0)
    found = felt_obstacles(grid, [MovableObject("a", triangle, tag)], robot)
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.1
    turn = np.array([[np.cos(np.pi / 6), np.sin(np.pi / 6)], [-np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    for row, column in np.ndindex(60, 60):
        cell = shapely.Polygon((np.array([column, row]) * 0.1 + corner) @ turn + [-1.0, -2.0])
        apart = cell.distance(shapely.Polygon(triangle))
        assert found[row, column] > 0 or apart > 0
        assert found[row, column] == 0 or apart < 0.1
    heavy = HapticTag(static_friction_N=Estimate(40.0, 1.0))
    assert felt_obstacles(grid, [MovableObject("a", triangle, heavy)], robot).max() == 100
    # Where two overlap, the worse one counts.
    both = [MovableObject("b", triangle, heavy), MovableObject("a", triangle, tag)]
    np.testing.assert_array_equal(felt_obstacles(grid, both, robot) == 100, found > 0)


def test_objects_cross_as_they_are() -> None:
    objects = objects_from_data({"objects": OBJECTS})
    again = objects_from_data(json.loads(objects_text(objects)))
    assert [item.id for item in again] == ["crate", "box", "bin"]
    assert [repr(item.tag) for item in again] == [repr(item.tag) for item in objects]
    np.testing.assert_array_equal(again[1].footprint_m, objects[1].footprint_m)


def test_a_search_that_does_not_end_is_not_waited_for(
    tmp_path: Path, robot: RosNode, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Deactivating ends in time, the late plan is dropped, and the node plans again."""
    stuck, let_go, plan = threading.Event(), threading.Event(), plan_node.make_plan

    def endless(problem: Any, **more: Any) -> Any:
        stuck.set()
        assert let_go.wait(60.0)
        return plan(problem, **more)

    monkeypatch.setattr(plan_node, "make_plan", endless)
    monkeypatch.setattr(resources, "WAIT_S", 0.3)
    maps = robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    poses = robot.advertise("amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", LATCHED)
    goals = robot.advertise("goal_pose", "geometry_msgs/msg/PoseStamped")
    paths: list[Any] = []
    robot.subscribe("plan", "nav_msgs/msg/Path", lambda r: paths.append(r.message), LATCHED)
    header = messages.header(5.0, "map")
    here, there = (messages.pose(Pose.from_rotation_vector([0, 0, 0], [x, 1.5, 0])) for x in (0.6, 3.4))
    with running("plan", endpoint, {"robot": write(tmp_path)["robot"]}) as node:
        maps.publish(room().to_message(5.0, "map"))
        poses.publish({"header": header, "pose": {"pose": here, "covariance": [0.0] * 36}})
        assert until(lambda: node.component._map is not None and "pose" in node.component._newest)
        goals.wait_until_heard(60.0)
        goals.publish({"header": header, "pose": there})
        assert stuck.wait(60.0)
        # Who asks by the service has a limit of his own, and is told at once when the node is deactivated.
        monkeypatch.setattr(plan_node, "WAIT_S", -5.9)  # with three budgets of 2 s
        with pytest.raises(DeviceError, match=r"no plan after 0\.1 s"):
            node.component.plan()
        monkeypatch.setattr(plan_node, "WAIT_S", 60.0)
        told: list[str] = []

        def ask() -> None:
            with pytest.raises(DeviceError) as found:
                node.component.plan()
            told.append(str(found.value))

        asking = threading.Thread(target=ask)
        asking.start()
        assert until(lambda: len(node.component._asked) == 2)
        node.deactivate()  # while the search is held: one that is waited for fails, and says so instead of the below
        asking.join(60.0)
        assert told == ["the node plan was deactivated in the meantime"]
        node.activate()
        let_go.set()
        # The first search of a process may still compile its kernels: both limits end a test that hangs.
        assert until(lambda: "deactivated in the meantime" in node.component.status().reason)
        time.sleep(0.5)  # nor is the request of before planned by the new activation
        assert not paths
        goals.publish({"header": header, "pose": there})
        assert until(lambda: paths), node.component.status()


def test_a_plan_without_a_map_says_what_is_missing(tmp_path: Path, robot: RosNode, endpoint: str) -> None:
    with (
        running("plan", endpoint, {"robot": write(tmp_path)["robot"]}) as node,
        pytest.raises(DeviceError, match="nothing on /map, /amcl_pose, /goal_pose yet"),
    ):
        node.component.plan()


@pytest.mark.parametrize("name", ["plan", "travel"])
def test_a_goal_in_another_frame_than_the_map_is_refused(
    tmp_path: Path, robot: RosNode, endpoint: str, name: str
) -> None:
    """RViz sends goals in its fixed frame: numbers of ``odom`` are another place in the map."""
    maps = robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    maps.publish(room().to_message(5.0, "map"))
    poses = robot.advertise("amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", LATCHED)
    here = messages.pose(Pose.from_rotation_vector([0, 0, 0], [0.6, 1.5, 0]))
    poses.publish({"header": messages.header(5.0, "/map"), "pose": {"pose": here, "covariance": [0.0] * 36}})
    goals = robot.advertise("goal_pose", "geometry_msgs/msg/PoseStamped")
    values = {"robot": write(tmp_path)["robot"]} | ({"pose": ""} if name == "travel" else {})
    with running(name, endpoint, values) as node:
        assert until(lambda: node.component._map is not None)
        assert until(lambda: name == "travel" or "pose" in node.component._newest)
        goals.wait_until_heard(60.0)
        goals.publish({"header": messages.header(5.0, "odom"), "pose": here})
        said = "found 'odom', expected 'map', the frame of the map"
        assert until(lambda: said in node.component.status().reason), node.component.status()


def test_views_start_again_with_the_recording(robot: RosNode, endpoint: str) -> None:
    """Played twice, the second pass begins earlier than the last view: it would wait for that time forever."""
    images = robot.advertise("depth/image", "sensor_msgs/msg/Image")
    infos = robot.advertise("depth/camera_info", "sensor_msgs/msg/CameraInfo")
    poses = robot.advertise("camera_pose", "geometry_msgs/msg/PoseStamped")
    camera, pose = Camera.simple(8, 6, 10.0), messages.pose(Pose.identity())
    layout = {"height": 6, "width": 8, "encoding": "32FC1", "is_bigendian": 0, "step": 32}
    with running("transparency", endpoint, {}) as node:
        for publisher in (images, infos, poses):
            publisher.wait_until_heard(60.0)
        infos.publish(messages.camera_info(9.0, camera, "eye"))
        assert until(lambda: node.component._camera is not None)
        for t_s, views in ((10.0, 1), (11.0, 2), (12.0, 3), (10.0, 1), (11.0, 2)):
            header = messages.header(t_s, "world")
            poses.publish({"header": header, "pose": pose})
            assert until(lambda at=t_s: node.component._poses and node.component._poses[-1][0] == at)
            images.publish({"header": header, **layout, "data": np.ones((6, 8), "<f4").tobytes()})
            assert until(lambda count=views: len(node.component._views) == count), (t_s, views)
