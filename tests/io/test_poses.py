"""Poses from text tables and bags: every third-party format, and errors that name the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from visuohaptic.core import InputError
from visuohaptic.io.depth import read_poses

STORE = get_typestore(Stores.ROS2_HUMBLE)
#: Two poses by their rotation and translation.
TURNS = Rotation.from_rotvec([[0.1, -0.2, 0.3], [1.0, 0.5, -0.4]])
PLACES = np.array([[0.1, 0.2, 0.3], [-1.0, 0.5, 0.25]])


def _of_kind(kind: str, number: int) -> Any:
    def make(name: str, *values: Any) -> Any:
        return STORE.types[name](*values)

    stamp = make("builtin_interfaces/msg/Time", 10 + number, 500_000_000)
    header = make("std_msgs/msg/Header", stamp, "map")
    point = make("geometry_msgs/msg/Point", *PLACES[number])
    turn = make("geometry_msgs/msg/Quaternion", *TURNS[number].as_quat())
    pose = make("geometry_msgs/msg/Pose", point, turn)
    uncertain = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    if kind.endswith("/PoseStamped"):
        return make(kind, header, pose)
    if kind.endswith("/PoseWithCovarianceStamped"):
        return make(kind, header, uncertain)
    if kind.endswith("/TransformStamped"):
        motion = make("geometry_msgs/msg/Transform", make("geometry_msgs/msg/Vector3", *PLACES[number]), turn)
        return make(kind, header, "camera", motion)
    still = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    moving = make(
        "geometry_msgs/msg/TwistWithCovariance",
        make("geometry_msgs/msg/Twist", still, still),
        np.zeros(36),
    )
    return make(kind, header, "base", uncertain, moving)


def _bag(folder: Path, kinds: dict[str, str]) -> Path:
    """Two poses on each topic, the later one first."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind in kinds.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number in (1, 0):
                writer.write(
                    connection,
                    (2 - number) * 10**9,
                    STORE.serialize_cdr(_of_kind(kind, number), kind),
                )
    return next(folder.glob("*.mcap"))


@pytest.mark.parametrize(
    "kind",
    [
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TransformStamped",
        "nav_msgs/msg/Odometry",
    ],
)
def test_poses_of_a_bag_come_in_the_order_of_their_stamps(tmp_path: Path, kind: str) -> None:
    found = read_poses(_bag(tmp_path / "bag", {"/camera/pose": kind}))
    assert [one.t_s for one in found] == pytest.approx([10.5, 11.5])
    for one, turn, place in zip(found, TURNS, PLACES, strict=True):
        assert one.pose is not None
        np.testing.assert_allclose(one.pose.rotation, turn.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(one.pose.translation_m, place, atol=1e-12)


def test_a_topic_is_named_where_several_hold_poses(tmp_path: Path) -> None:
    kinds = {"/odom": "nav_msgs/msg/Odometry", "/camera/pose": "geometry_msgs/msg/PoseStamped"}
    path = _bag(tmp_path / "bag", kinds)
    with pytest.raises(InputError, match=r"has poses on /camera/pose, /odom; name one topic"):
        read_poses(path)
    assert len(read_poses(path, "/odom")) == 2
    with pytest.raises(InputError, match="has no poses on /scan"):
        read_poses(path, "/scan")


def test_every_layout_of_a_text_says_the_same(tmp_path: Path) -> None:
    """TUM lines, 3 x 4 and 4 x 4 in one line with and without a number before, and blocks of four lines."""
    x, y, z, w = TURNS[0].as_quat()
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURNS[0].as_matrix(), PLACES[0]

    def line(values: Any) -> str:
        return " ".join(f"{value:.12g}" for value in np.ravel(values))

    texts = {
        "tum": f"# time first\n\n2.5, {line(PLACES[0])} {x} {y} {z} {w}  # a comment\n",
        "three rows": line(matrix[:3]),
        "four rows": line(matrix),
        "numbered": "7 " + line(matrix),
        "block": "12 30 4\n" + "\n".join(line(row) for row in matrix),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        (found,) = read_poses(tmp_path / name)
        assert found.pose is not None
        np.testing.assert_allclose(found.pose.rotation, matrix[:3, :3], atol=1e-9)
        np.testing.assert_allclose(found.pose.translation_m, PLACES[0], atol=1e-9)
        assert found.t_s == (2.5 if name == "tum" else pytest.approx(np.nan, nan_ok=True))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1 0 0 0 0 0 0 2", "line 1 has a quaternion of length 2"),
        ("1 0 nan 0 0 0 0 1", "line 1 is not finite"),
        ("1 0 0 0 0 1 0 0 0 0 1 inf", "line 1 is not finite"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1", "line 1 is not a rigid motion: its last row is not 0 0 0 1"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", "line 1 is not a rigid motion: its rotation is not orthonormal"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "line 1 is not a rigid motion: its rotation is not orthonormal"),
    ],
)
def test_what_is_no_pose_is_left_without_one(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    (found,) = read_poses(tmp_path / "poses.txt")
    assert (found.pose, found.problem) == (None, problem)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# nothing\n", "has no poses, expected lines of t tx ty tz qx qy qz qw"),
        ("1 2 3 4 5\n", "line 1: found 5 numbers, expected 8 .TUM., 4, 12 or 16"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "line 1: has an incomplete 4 x 4 matrix"),
        ("1 0 0 zero 0 0 0 1\n", "line 1: found .* expected numbers"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=said):
        read_poses(tmp_path / "poses.txt")


def test_poses_with_times_in_nanoseconds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text("1764336000000000000 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"time \[s\]: found 1.764336e\+18, expected -1e\+11 to 1e\+11"):
        read_poses(tmp_path / "p.txt")


@pytest.mark.parametrize("header", ["# t tx ty tz qw qx qy qz", "#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z"])
def test_a_header_says_which_number_of_a_quaternion_is_the_first(tmp_path: Path, header: str) -> None:
    x, y, z, w = TURNS[0].as_quat()
    for named, numbers in ((header, (w, x, y, z)), ("# t tx ty tz qx qy qz qw", (x, y, z, w))):
        (tmp_path / "p.txt").write_text(f"{named}\n0 0 0 0 {' '.join(f'{one:.12f}' for one in numbers)}\n")
        pose = read_poses(tmp_path / "p.txt")[0].pose
        assert pose is not None
        np.testing.assert_allclose(pose.rotation, TURNS[0].as_matrix(), atol=1e-9)
