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
from visuohaptic.recognition import HapticClassifier
from visuohaptic.recognition.data import read_squeezed
from visuohaptic.ros.nodes import LifecycleProcess, Running, node_kind
from visuohaptic.ros.transports import RosOptions, open_node
from visuohaptic.ros.wire import LATCHED, Qos
from visuohaptic.simulation.tabletop import DepthCamera, glass_scene
from visuohaptic.tracking.templates import Template

from . import test_nodes
from .conftest import until
from .test_layers_node import TYPES, layer, room
from .test_layers_node import write as write_setting
from .test_nodes import DOMAIN, PATIENCE_S, Robot

robot = test_nodes.robot  #: the fixture
#: Of ``tf2_msgs/msg/TFMessage``.
TF_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def film(camera, image, got):
    """Publish an image again and again, until something has come in."""
    pictures = camera.advertise("image", "sensor_msgs/msg/Image")
    pictures.wait_until_heard(PATIENCE_S)
    stamps = iter(range(10, 10_000))
    assert until(
        lambda: pictures.publish(messages.image(next(stamps) / 10, image, "eye")) or until(lambda: got, 0.3),
        PATIENCE_S,
    )


@contextmanager
def running(name: str, **values: Any) -> Iterator[LifecycleProcess]:
    with LifecycleProcess(name, node_kind(name), values, RosOptions(domain=DOMAIN)) as process:
        process.start()
        yield process


def listen(node: Robot, topic: str, datatype: str, qos: Qos | None = LATCHED) -> list[Any]:
    got: list[Any] = []
    node.subscribe(topic, datatype, lambda received: got.append(received.message), qos)
    return got


def test_a_goal_becomes_a_path(robot: Robot, tmp_path: Path) -> None:
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


def test_a_tag_becomes_a_pose(robot: Robot, tmp_path: Path) -> None:
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
    words = {"templates": str(tmp_path / "tags"), "camera": str(tmp_path / "camera.yaml"), "frame": "eye"}
    with running("template", tf=False, **words):
        film(robot, image, got)
    assert got[0].header.frame_id == "eye"
    distance = 600.0 * tag.pixel_m
    assert got[0].pose.pose.position.z == pytest.approx(distance, rel=0.01)


def test_a_cup_is_grasped_and_squeezed(robot: Robot) -> None:
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


def curve_rows(label: str, name: str, stiffness_N_per_m: float, rng: np.random.Generator) -> list[str]:
    """One squeeze of a linear spring, with the noise of the sensors."""
    deformation_m = np.linspace(0.0, 0.004, 12)
    force_N = stiffness_N_per_m * deformation_m + rng.normal(0, 0.02, 12)
    return [f"{label},{name},8,x+,{f:.4f},{d:.5f}" for f, d in zip(force_N, deformation_m, strict=True)]


def test_squeezes_become_a_class(robot: Robot, tmp_path: Path) -> None:
    """Two kinds of springs, 500 and 3000 N/m with 5 % between objects: one squeeze of 520 N/m tells."""
    rng = np.random.default_rng(2)
    rows = ["label,object,height,side,force_N,deformation_m"]
    for label, stiffness in (("soft", 500.0), ("stiff", 3000.0)):
        for number in range(6):
            rows += curve_rows(label, f"{label}{number}", stiffness * rng.normal(1.0, 0.05), rng)
    (tmp_path / "training.csv").write_text("\n".join(rows) + "\n")
    HapticClassifier().fit(read_squeezed(tmp_path / "training.csv")).save(tmp_path / "tree.json")
    curves = tmp_path / "curves.csv"
    asked = {"tree": str(tmp_path / "tree.json"), "curves": str(curves)}
    with running("classify", **asked):
        answer = robot.trigger("/classify/classify")
        assert not answer.success
        assert "curves.csv" in answer.message
        curves.write_text("\n".join([rows[0], *curve_rows("", "", 520.0, rng)]) + "\n")
        answer = robot.trigger("/classify/classify")
        assert answer.success, answer.message
        found = json.loads(answer.message)
        assert (found["answer"], found["touches"]) == ("soft", 1)
        assert found["probabilities"]["soft"] > 0.9
        # Who comes late hears the same.
        late = listen(robot, "classify/belief", "std_msgs/msg/String")
        assert until(lambda: late, PATIENCE_S)
        assert json.loads(late[-1].data) == found


def depth_image(t_s: float, depth_m: np.ndarray) -> dict[str, Any]:
    rows, columns = depth_m.shape
    layout = {"height": rows, "width": columns, "encoding": "32FC1", "is_bigendian": 0, "step": 4 * columns}
    return {"header": messages.header(t_s, "eye"), **layout, "data": depth_m.astype("<f4").tobytes()}


def test_views_become_transparent_parts(robot: Robot) -> None:
    """Around a table with labelled bottles: a part stands within a radius of each that is found, and one at least is."""
    scene, depth_camera = glass_scene(2, kind="labelled", arc_deg=360, step_m=0.2), DepthCamera.kinect(160)
    rng = np.random.default_rng(2)
    best_effort = Qos(reliable=False, depth=5)
    images = robot.advertise("depth/image", "sensor_msgs/msg/Image", best_effort)
    infos = robot.advertise("depth/camera_info", "sensor_msgs/msg/CameraInfo", best_effort)
    poses = robot.advertise("camera_pose", "geometry_msgs/msg/PoseStamped", best_effort)
    with running("transparency", sensor="kinect", voxel_m=0.008, pause_s=0.5) as process:
        answer = robot.trigger("/transparency/complete")
        assert not answer.success
        assert "0 views with a pose, expected 3 or more" in answer.message
        for publisher in (images, infos, poses):
            publisher.wait_until_heard(PATIENCE_S)

        def views() -> int:
            return int(process.running.component.status().values["views"])

        for number, frame in enumerate(scene.render(depth_camera, rng)):
            header = messages.header(10.0 + number, "world")
            # Best effort, as cameras send: again until it has come.
            assert until(
                lambda header=header, frame=frame, number=number: (
                    infos.publish(messages.camera_info(10.0 + number, depth_camera.camera, "eye"))
                    or poses.publish({"header": header, "pose": messages.pose(frame.T_world_camera)})
                    or images.publish(depth_image(10.0 + number, frame.depth_m))
                    or until(lambda: views() == number + 1, 0.5)
                ),
                PATIENCE_S,
            )
        answer = robot.trigger("/transparency/complete", patience_s=10 * PATIENCE_S)
        assert answer.success, answer.message
        parts = json.loads(answer.message)["parts"]
        clouds = listen(robot, "transparency/points", "sensor_msgs/msg/PointCloud2")
        labels = listen(robot, "transparency/parts", "visualization_msgs/msg/MarkerArray")
        assert until(lambda: clouds and labels, PATIENCE_S)
    bottles = np.array([solid.foot_m[:2] for solid in scene.glass])
    near = [np.hypot(*(bottles - part["centroid_m"][:2]).T).min() for part in parts]
    assert near
    assert min(near) < 0.05
    assert clouds[-1].width > 0
    assert clouds[-1].header.frame_id == "world"
    assert len(labels[-1].markers) == len(parts) + 2  # one that clears the last ones, one for all panes


def test_a_map_becomes_graph_and_masks(robot: Robot, tmp_path: Path) -> None:
    """All four are latched: who joins afterwards gets them from ROS itself, with its own quality of service."""
    maps = robot.advertise("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
    maps.publish(room().to_message(5.0, "map"))
    with running("layers", **write_setting(tmp_path)) as process:
        assert until(lambda: process.running.component.status().reason == "ok", PATIENCE_S)
        with Robot("late", RosOptions(domain=DOMAIN)) as late:
            got = {topic: listen(late, topic, kind) for topic, kind in TYPES.items()}
            assert until(lambda: all(got.values()), PATIENCE_S), {t: len(m) for t, m in got.items()}
    assert (layer(got["felt_obstacles"][0]) == 100).sum() == (layer(got["keepout_mask"][0]) == 100).sum() > 0
    assert json.loads(got["route_graph"][0].data)["type"] == "FeatureCollection"
    assert len(got["route_graph/markers"][0].markers) == 2


def test_frames_of_templates_are_on_tf(tmp_path: Path) -> None:
    """``tf2_msgs`` is in no wheel: the node runs over Cyclone DDS, and ROS itself sees the topic, its type and type hash."""
    pytest.importorskip("cyclonedds")
    tag = Template.from_tag(7, size_m=0.04)
    Camera.simple(640, 480, focal_px=600.0, name="eye").save(tmp_path / "camera.yaml")
    (tmp_path / "tags").mkdir()
    save_yaml(tmp_path / "tags" / "tags.yaml", {"tags": {"box": {"id": 7, "size_m": 0.04}}})
    image = np.full((480, 640), 200, np.uint8)
    rows, columns = tag.image.shape
    image[60 : 60 + rows, 140 : 140 + columns] = tag.image
    values = {"templates": str(tmp_path / "tags"), "camera": str(tmp_path / "camera.yaml"), "frame": "eye"}
    options, got = RosOptions(domain=DOMAIN), []
    with (
        Running(node_kind("template"), lambda: open_node("template", options, "cyclonedds")) as node,
        Robot("other", options) as other,
        open_node("listener", options, "cyclonedds") as listener,
    ):
        node.configure(values)
        node.activate()
        listener.subscribe("/tf", "tf2_msgs/msg/TFMessage", lambda r: got.append(r.message), Qos(depth=100))
        film(other, image, got)
        (told,) = other.inner.get_publishers_info_by_topic("/tf")
    (moved,) = got[0].transforms
    assert (moved.header.frame_id, moved.child_frame_id) == ("eye", "box")
    assert moved.transform.translation.z == pytest.approx(600.0 * tag.pixel_m, rel=0.01)
    assert told.topic_type == "tf2_msgs/msg/TFMessage"
    # As ``ros2 topic info -v /tf`` prints it of tf2_msgs of Iron, Jazzy and later.
    assert str(told.topic_type_hash) == TF_HASH
