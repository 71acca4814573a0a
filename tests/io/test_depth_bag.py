"""Depth topics of bags, written by the rosbags library: topics, registered colour, camera, and poses of every kind."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Pose
from visuohaptic.io.depth import BagImages, DepthSequence, import_bag, write_poses

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
pytest.importorskip("mcap_ros2")

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
WIDTH, HEIGHT = 16, 12
K = np.array([20.0, 0, 7.5, 0, 20.0, 5.5, 0, 0, 1.0])
OPTICAL = "camera_color_optical_frame"
DEPTH, COLOUR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"
#: The base turns about z and moves along x; the camera is mounted with a turn on it.
MOUNT = Rotation.from_euler("xyz", [-1.8, 0.2, -1.5])
MOUNT_M = np.array([0.1, 0.02, 0.4])


def make(name: str, *values: Any) -> Any:
    return STORE.types[name](*values)


def header(t_s: float, frame: str) -> Any:
    ns = round(1e9 * t_s)
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9), frame)


def depth_mm(number: int) -> np.ndarray:
    return (500 + 10 * number + np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)).astype(np.uint16)


def image(t_s: float, values: np.ndarray, encoding: str, frame: str = OPTICAL) -> Any:
    raw = np.ascontiguousarray(values)
    step = raw.nbytes // raw.shape[0]
    data = np.frombuffer(raw.tobytes(), np.uint8)
    return make("sensor_msgs/msg/Image", header(t_s, frame), *raw.shape[:2], encoding, 0, step, data)


def info(frame: str = OPTICAL) -> Any:
    roi = make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    whole = np.zeros(12)
    whole[[0, 2, 5, 6, 10]] = 20.0, 7.5, 20.0, 5.5, 1.0
    return make(
        "sensor_msgs/msg/CameraInfo", header(1.0, frame), HEIGHT, WIDTH, "plumb_bob", np.zeros(5), K,
        np.eye(3).ravel(), whole, 0, 0, roi,
    )  # fmt: skip


def transform(t_s: float, parent: str, child: str, turn: Rotation, place: np.ndarray) -> Any:
    motion = make("geometry_msgs/msg/Transform", make("geometry_msgs/msg/Vector3", *place), quaternion(turn))
    stamped = make("geometry_msgs/msg/TransformStamped", header(t_s, parent), child, motion)
    return make("tf2_msgs/msg/TFMessage", [stamped])


def quaternion(turn: Rotation) -> Any:
    return make("geometry_msgs/msg/Quaternion", *turn.as_quat())


def base(t_s: float) -> tuple[Rotation, np.ndarray]:
    """True pose of the base at a time."""
    return Rotation.from_euler("z", 0.3 * (t_s - 100)), np.array([0.2 * (t_s - 100), 0.0, 0.0])


def camera_truth(t_s: float) -> tuple[np.ndarray, np.ndarray]:
    turn, place = base(t_s)
    return (turn * MOUNT).as_matrix(), turn.apply(MOUNT_M) + place


def odometry(t_s: float, child: str) -> Any:
    turn, place = base(t_s)
    still = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", *place), quaternion(turn))
    uncertain = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    twist = make(
        "geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", still, still), np.zeros(36)
    )
    return make("nav_msgs/msg/Odometry", header(t_s, "odom"), child, uncertain, twist)


def bag(folder: Path, messages: list[tuple[str, float, Any]], storage: Any = None) -> Path:
    """A bag of (topic, recording time, message)."""
    with rosbag2.Writer(folder, version=9, storage_plugin=storage or rosbag2.StoragePlugin.SQLITE3) as writer:
        known: dict[str, Any] = {}
        for topic, t_s, message in messages:
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], round(1e9 * t_s), STORE.serialize_cdr(message, kind))
    return folder


def images(count: int = 3) -> list[tuple[str, float, Any]]:
    found: list[tuple[str, float, Any]] = [("/camera/aligned_depth_to_color/camera_info", 99.0, info())]
    for number in range(count):
        t_s = 100.0 + 0.1 * number
        colour = np.full((HEIGHT, WIDTH, 3), (10, 20, 30 + number), np.uint8)
        # Colour arrives after the depth of the next frame.
        found += [(DEPTH, t_s, image(t_s, depth_mm(number), "16UC1"))]
        found += [(COLOUR, t_s + 0.12, image(t_s + 0.001, colour, "rgb8"))]
    return sorted(found, key=lambda one: one[1])


def tf(rate_s: float = 0.05) -> list[tuple[str, float, Any]]:
    found = [("/tf_static", 99.0, transform(0.0, "base_link", f"/{OPTICAL}", MOUNT, MOUNT_M))]
    times = 99.9 + rate_s * np.arange(round(1.0 / rate_s))
    return found + [("/tf", t, transform(t, "odom", "base_link", *base(t))) for t in times]


def read(folder: Path) -> list[Any]:
    return list(DepthSequence(folder))


def check_poses(frames: list[Any], *, atol: float = 1e-4) -> None:
    for frame in frames:
        turn, place = camera_truth(frame.t_s)
        np.testing.assert_allclose(frame.T_world_camera.rotation, turn, atol=atol)
        np.testing.assert_allclose(frame.T_world_camera.translation_m, place, atol=atol)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_depth_colour_camera_and_tf_arrive(tmp_path: Path, storage: str, capsys: Any) -> None:
    source = bag(tmp_path / "bag", images() + tf(), getattr(rosbag2.StoragePlugin, storage))
    assert main(["recording", "import", str(source), "--out", str(tmp_path / "scan")]) == 0
    said = capsys.readouterr().out
    for words in (f"depth: {DEPTH}", f"colour: {COLOUR}", f"poses: tf, {OPTICAL} in odom"):
        assert words in said
    frames = read(tmp_path / "scan")
    assert [frame.t_s for frame in frames] == pytest.approx([100.0, 100.1, 100.2])
    check_poses(frames)
    for number, frame in enumerate(frames):
        np.testing.assert_allclose(frame.depth_m, depth_mm(number) * 1e-3, atol=1e-6)
        np.testing.assert_array_equal(frame.color[0, 0], [30 + number, 20, 10])
        np.testing.assert_allclose(frame.camera.matrix.ravel(), K)


def test_transforms_of_two_robots_are_kept_apart(tmp_path: Path) -> None:
    """Two robots with the same names of frames, each in its namespace: the other one stands elsewhere."""
    mine = [(f"/r1{topic}", t_s, message) for topic, t_s, message in tf()]
    away = Rotation.from_euler("z", 1.0)
    other = [
        ("/r2/tf", t_s, transform(t_s, "odom", "base_link", away, np.array([5.0, 5.0, 0.0])))
        for _, t_s, _ in tf()[1:]
    ]
    own = [(f"/r1{topic}", t_s, message) for topic, t_s, message in images()]
    both = sorted([*own, *mine, *other], key=lambda one: one[1])
    import_bag(BagImages(bag(tmp_path / "bag", both)), tmp_path / "scan")
    check_poses(read(tmp_path / "scan"))
    nobodys = sorted([*images(), *mine, *other], key=lambda one: one[1])
    with pytest.raises(InputError, match="has the same frames on /r1/tf, /r2/tf, none in the namespace of"):
        BagImages(bag(tmp_path / "nobody", nobodys))


def test_options_of_folders_are_refused_for_a_recording(tmp_path: Path, capsys: Any) -> None:
    source = bag(tmp_path / "bag", images() + tf())
    for option in ("--layout arm", "--kind opaque", "--bit-rotation 3"):
        words = ["recording", "import", str(source), "--out", str(tmp_path / "scan"), *option.split()]
        assert main(words) == 2
        assert f"{option.split()[0]}: does not apply to {source}, a recording" in capsys.readouterr().err


def test_poses_of_a_base_are_carried_to_the_camera(tmp_path: Path) -> None:
    moving = [("/odom", t, odometry(t, "base_link")) for t in (99.95, 100.0, 100.05, 100.1, 100.15)]
    found = import_bag(BagImages(bag(tmp_path / "bag", images() + moving + tf()[:1])), tmp_path / "scan")
    assert (found.frames, len(found.skipped)) == (2, 1)
    assert "no pose within 0.1 s of 100.200 s" in found.skipped[0]
    check_poses(read(tmp_path / "scan"))
    unknown = bag(tmp_path / "other", [*images(), ("/odom", 100.0, odometry(100.0, "base_link"))])
    with pytest.raises(
        InputError, match=f"poses of base_link on /odom, and no transform from it to {OPTICAL}"
    ):
        BagImages(unknown)


def test_poses_of_a_file_a_missing_topic_and_none(tmp_path: Path, capsys: Any) -> None:
    source = bag(tmp_path / "bag", images())
    with pytest.raises(InputError, match="has no camera poses; choose poses: a topic, a file"):
        BagImages(source)
    with pytest.raises(InputError, match="has no poses on /pose; topics of poses: none"):
        BagImages(source, poses="/pose")
    with pytest.raises(InputError, match="has no transforms that move 'camera_color"):
        BagImages(source, poses="tf")
    stamped = [(t, Pose(*camera_truth(t))) for t in (100.0, 100.1, 100.2)]
    write_poses(tmp_path / "poses.txt", stamped)
    import_bag(BagImages(source, poses=str(tmp_path / "poses.txt")), tmp_path / "scan")
    check_poses(read(tmp_path / "scan"))
    import_bag(BagImages(source, poses="none"), tmp_path / "bare")
    assert main(["recording", "info", str(tmp_path / "bare"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["frames"], said["without_pose"], said["poses"]) == (3, 3, "none")
    sequence = DepthSequence(tmp_path / "bare")
    assert sequence.poses_source == "none"
    assert len(list(sequence.depth_images())) == 3
    np.testing.assert_allclose(sequence.times_s, [100.0, 100.1, 100.2])
    with pytest.raises(InputError, match=r"none of 3 frames can be used; .* has no poses"):
        next(iter(sequence))


def test_topics_are_named_where_there_is_a_choice(tmp_path: Path) -> None:
    left = [("/left/depth/image_rect", 100.0, image(100.0, depth_mm(0), "16UC1", "left"))]
    right = [("/right/depth/image_rect", 100.0, image(100.0, depth_mm(0), "16UC1", "right"))]
    source = bag(tmp_path / "bag", left + right + [("/right/depth/camera_info", 99.0, info("right"))])
    with pytest.raises(
        InputError, match="has depth on /left/depth/image_rect, /right/depth/image_rect; name one"
    ):
        BagImages(source, poses="none")
    with pytest.raises(InputError, match="has no depth on /nowhere; depth topics: /left"):
        BagImages(source, "/nowhere", poses="none")
    with pytest.raises(
        InputError, match=r"has no /left/depth/camera_info of /left/depth/image_rect; camera_info topics"
    ):
        BagImages(source, "/left/depth/image_rect", poses="none")
    assert (
        import_bag(BagImages(source, "/right/depth/image_rect", poses="none"), tmp_path / "out").frames == 1
    )
    with pytest.raises(InputError, match="has no depth images; image topics: none"):
        BagImages(bag(tmp_path / "empty", tf()), poses="none")


def test_metres_compressed_depth_and_other_colour(tmp_path: Path) -> None:
    """32FC1, both encodings of compressed_depth_image_transport, and colour of another camera, which is left out."""
    true_m = depth_mm(0).astype(np.float32) * np.float32(1e-3)
    true_m[0, 0] = np.nan
    other = ("/other/image_raw", 100.0, image(100.0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), "bgr8", "other"))
    inverse = np.rint(np.where(np.isnan(true_m), 0, 1000.0 / true_m + 7)).astype(np.uint16)
    packed = {
        "16UC1": bytes(12)
        + cv2.imencode(".png", np.rint(np.nan_to_num(true_m) * 1000).astype(np.uint16))[1].tobytes(),
        "32FC1": struct.pack("<i2f", 0, 1000.0, 7.0) + cv2.imencode(".png", inverse)[1].tobytes(),
    }
    topics: dict[str, Any] = {"/camera/depth/image_raw": image(100.0, true_m, "32FC1", "camera")}
    for kind, data in packed.items():
        topics[f"/camera/depth_{kind}/image_raw/compressedDepth"] = make(
            "sensor_msgs/msg/CompressedImage", header(100.0, "camera"), f"{kind}; compressedDepth png",
            np.frombuffer(data, np.uint8),
        )  # fmt: skip
    for number, (topic, message) in enumerate(topics.items()):
        source = bag(
            tmp_path / f"bag{number}", [("/info", 99.0, info("camera")), (topic, 100.0, message), other]
        )
        found = import_bag(BagImages(source, poses="none"), tmp_path / f"scan{number}")
        assert found.notes[1] == "colour: none registered to the depth"
        (depth_m,) = DepthSequence(found.folder).depth_images()
        # Steps of 0.1 mm, 1 mm, and of the quantised inverse depth.
        np.testing.assert_allclose(depth_m, true_m, atol=6e-4)


def test_far_depths_in_metres_are_kept_in_a_given_unit(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """12 m are beyond 16 bit of 0.1 mm, which is told, and within those of 0.5 mm."""
    true_m = np.full((HEIGHT, WIDTH), 12.0, np.float32)
    message = ("/camera/depth/image_raw", 100.0, image(100.0, true_m, "32FC1", "camera"))
    source = bag(tmp_path / "bag", [("/info", 99.0, info("camera")), message])
    import_bag(BagImages(source, poses="none"), tmp_path / "near")
    assert "100 % of the pixels are farther than 6.55 m" in caplog.text
    found = import_bag(BagImages(source, poses="none", depth_scale_m=5e-4), tmp_path / "far")
    (depth_m,) = DepthSequence(found.folder).depth_images()
    np.testing.assert_allclose(depth_m, true_m, atol=2.6e-4)


def test_a_bag_of_ros_1_is_converted_first(tmp_path: Path) -> None:
    """As recorded by Intel's tools: depth in ``mono16`` with the unit as an option; the line of the remedy is run."""
    from rosbags.rosbag1 import Writer

    old = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    path, base_name = tmp_path / "d435.bag", "/device_0/sensor_0"
    ns = 100 * 10**9
    stamp = old.types["builtin_interfaces/msg/Time"](100, 0)
    head = old.types["std_msgs/msg/Header"](0, stamp, "0")
    raw = np.frombuffer(depth_mm(0).tobytes(), np.uint8)
    roi = old.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    camera = old.types["sensor_msgs/msg/CameraInfo"](
        head, HEIGHT, WIDTH, "", np.zeros(0), K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi
    )
    messages = {
        f"{base_name}/Depth_0/info/camera_info": camera,
        f"{base_name}/option/Depth_Units/value": old.types["std_msgs/msg/Float32"](2e-4),
        f"{base_name}/Depth_0/image/data": old.types["sensor_msgs/msg/Image"](
            head, HEIGHT, WIDTH, "mono16", 0, 2 * WIDTH, raw
        ),
    }
    with Writer(path) as writer:
        for topic, message in messages.items():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=old)
            writer.write(connection, ns, old.serialize_ros1(message, message.__msgtype__))
    with pytest.raises(
        InputError, match=r"is a bag of ROS 1; convert it: .*rosbags-convert --dst-typestore"
    ) as error:
        BagImages(path, poses="none")
    from rosbags.convert.cli import main as convert

    words = error.value.remedy.partition("rosbags-convert ")[2].split()
    words[-1] = str(tmp_path / "converted")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["rosbags-convert", *words])
        with pytest.raises(SystemExit) as done:
            convert()
    assert done.value.code == 0
    found = import_bag(BagImages(tmp_path / "converted", poses="none"), tmp_path / "scan")
    assert found.frames == 1
    (depth_m,) = DepthSequence(tmp_path / "scan").depth_images()
    np.testing.assert_allclose(depth_m, depth_mm(0) * 2e-4, atol=1e-6)
