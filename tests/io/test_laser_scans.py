"""Scans from MCAP (written by rosbags' definitions) and CSV, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import InputError, LaserScan, Pose
from visuohaptic.io import read_scans, write_scans
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros import header
from visuohaptic.io.sinks import MeasurementWriter


def room_scan(t_s: float, x: float) -> LaserScan:
    """In a room of 6 m x 4 m, at (x, 0), exact."""
    angles = -np.pi + np.pi / 180 * np.arange(360)
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(np.where(c > 0, (3 - x) / c, (-3 - x) / c), np.abs(2 / s))
    ranges[7], ranges[9] = math.nan, math.inf
    return LaserScan(t_s, ranges, -np.pi, np.pi / 180, 0.05, 20.0)


def scan_message(scan: LaserScan) -> dict[str, object]:
    return {
        "header": header(scan.t_s, "laser"),
        "angle_min": scan.angle_min_rad,
        "angle_max": -scan.angle_min_rad,
        "angle_increment": scan.angle_step_rad,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": scan.range_min_m,
        "range_max": scan.range_max_m,
        "ranges": [float(r) for r in scan.ranges_m],
        "intensities": [],
    }


def odometry_message(t_s: float, x: float, yaw: float) -> dict[str, object]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {
        "header": header(t_s, "odom"),
        "child_frame_id": "base",
        "pose": {"pose": {"position": {**zero, "x": x}, "orientation": turn}, "covariance": [0.0] * 36},
        "twist": {"twist": {"linear": zero, "angular": zero}, "covariance": [0.0] * 36},
    }


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    with MeasurementWriter(path) as writer:
        for number in range(12):
            t_s = 5.0 + 0.1 * number
            scan = room_scan(t_s, 0.05 * number)
            writer.write("/scan", "sensor_msgs/msg/LaserScan", t_s, scan_message(scan))
            # Odometry at other times than the scans, and across the jump of the angle.
            writer.write(
                "/odom",
                "nav_msgs/msg/Odometry",
                t_s + 0.05,
                odometry_message(t_s + 0.05, 0.05 * number + 0.025, 0.0),
            )
    return path


def test_mcap_with_interpolated_odometry(recording: Path) -> None:
    scans = read_scans(recording)
    assert len(scans) == 12
    for number, (scan, odometry) in enumerate(scans[1:], start=1):
        np.testing.assert_allclose(scan.ranges_m, room_scan(0.0, 0.05 * number).ranges_m, rtol=1e-6)
        assert odometry == pytest.approx((0.05 * number, 0.0, 0.0), abs=1e-6)
    with pytest.raises(InputError, match="has no sensor_msgs/msg/LaserScan on /other"):
        read_scans(recording, scan_topic="/other")


def transform_message(t_s: float, *frames: tuple[str, str, Pose]) -> dict[str, object]:
    """Child, parent, and the pose of the child in it."""
    names = "xyzw"
    return {
        "transforms": [
            {
                "header": header(t_s, parent),
                "child_frame_id": child,
                "transform": {
                    "translation": dict(zip(names, map(float, pose.translation_m), strict=False)),
                    "rotation": dict(zip(names, map(float, pose.quaternion_xyzw), strict=True)),
                },
            }
            for child, parent, pose in frames
        ]
    }


def _points(scan: LaserScan, pose: tuple[float, float, float]) -> np.ndarray:
    """Hits in the frame of the odometry."""
    x, y, yaw = pose
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    return scan.points_m @ turn.T + [x, y]


@pytest.mark.parametrize("turn", [[0.0, 0.0, math.pi], [math.pi, 0.0, 0.0], [0.0, 0.0, 0.4]])
def test_the_scanner_stands_on_the_robot_where_the_recording_says(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, turn: list[float]
) -> None:
    """Mounted backwards, upside down or aslant, 0.1 m ahead of the foot: the walls of the room stay where they are."""
    path = tmp_path / "run.mcap"
    mounted = Pose.from_rotation_vector(turn, [0.1, 0.0, 0.2])
    side = mounted.rotation[2, 2]  # -1: the beams run clockwise
    yaw = math.atan2(mounted.rotation[1, 0], mounted.rotation[0, 0])
    with MeasurementWriter(path) as writer:
        writer.write(
            "/tf_static",
            "tf2_msgs/msg/TFMessage",
            0.0,
            transform_message(
                0.0,
                ("link", "base", Pose(np.eye(3), np.array([0.0, 0.0, 0.1]))),
                ("laser", "/link", mounted),
            ),
        )
        for number in range(3):
            angles = yaw + side * (-np.pi + np.pi / 180 * np.arange(360))
            c, s, x = np.cos(angles), np.sin(angles), 0.05 * number + 0.1
            with np.errstate(divide="ignore"):
                ranges = np.minimum(np.where(c > 0, (3 - x) / c, (-3 - x) / c), np.abs(2 / s))
            scan = LaserScan(0.1 * number, ranges, -np.pi, np.pi / 180, 0.05, 20.0)
            writer.write("/scan", "sensor_msgs/msg/LaserScan", scan.t_s, scan_message(scan))
            told = odometry_message(scan.t_s, 0.05 * number, 0.0)
            writer.write("/odom", "nav_msgs/msg/Odometry", scan.t_s, told)
    for scan, pose in read_scans(path):
        points = _points(scan, pose)
        off = np.minimum(np.abs(np.abs(points[:, 0]) - 3), np.abs(np.abs(points[:, 1]) - 2))
        assert off.max() < 1e-5
        assert pose[0] == pytest.approx(10 * 0.05 * scan.t_s + 0.1)
    assert "not recorded" not in caplog.text


def test_a_scanner_on_its_side_is_refused_and_one_without_a_place_is_told(
    recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert len(read_scans(recording)) == 12
    assert "where 'laser' is on 'base' is not recorded (/tf_static)" in caplog.text
    path = tmp_path / "tilted.mcap"
    tilted = Pose.from_rotation_vector([0.0, 0.5, 0.0], [0.0, 0.0, 0.0])
    with MeasurementWriter(path) as writer:
        told = transform_message(0.0, ("laser", "base", tilted))
        writer.write("/tf_static", "tf2_msgs/msg/TFMessage", 0.0, told)
        writer.write("/scan", "sensor_msgs/msg/LaserScan", 0.0, scan_message(room_scan(0.0, 0.0)))
        writer.write("/odom", "nav_msgs/msg/Odometry", 0.0, odometry_message(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="its scanner is tilted by 29 degrees, expected a horizontal one"):
        read_scans(path)


def test_csv_comes_back(tmp_path: Path) -> None:
    scans = [(room_scan(0.1 * n, 0.1 * n), (0.1 * n, 0.2, 3.0)) for n in range(4)]
    write_scans(tmp_path / "s.csv", scans)
    for (scan, pose), (back, back_pose) in zip(scans, read_scans(tmp_path / "s.csv"), strict=True):
        np.testing.assert_array_equal(scan.ranges_m, back.ranges_m)
        assert (pose, scan.t_s, scan.angle_step_rad) == (back_pose, back.t_s, back.angle_step_rad)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda t: t.replace("angle_min_rad", "angle"), "missing: angle_min_rad"),
        (lambda t: t.replace("0.2,3.0", "0.2,nan", 1), "line 2, yaw_rad: found 'nan', expected a finite"),
        (lambda t: t.replace("0.2,3.0", "0.2,x", 1), "line 2, yaw_rad: found 'x', expected a number"),
        (
            lambda t: t.replace(repr(np.pi / 180), "1.0"),
            "line 2: found 360 beams over 57.1 turns, expected at most 2",
        ),
        (lambda t: "\n".join(t.splitlines()[:1]), "has a header but no rows"),
        (lambda t: t[:-200], "fields, expected"),
    ],
)
def test_bad_csv(tmp_path: Path, change: object, problem: str) -> None:
    write_scans(tmp_path / "s.csv", [(room_scan(0.0, 0.0), (0.1, 0.2, 3.0))])
    path = tmp_path / "bad.csv"
    path.write_text(change((tmp_path / "s.csv").read_text()))
    with pytest.raises(InputError, match=problem):
        read_scans(path)
    with pytest.raises(InputError, match=r"expected \.mcap, \.db3 or \.csv"):
        read_scans(tmp_path / "s.txt")


def test_topics_are_named_where_there_are_several(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    kind = "sensor_msgs/msg/LaserScan"
    with MeasurementWriter(path) as writer:
        for topic, shift_m in (("/front", 0.0), ("/back", 0.3)):
            writer.write(topic, kind, 5.0, scan_message(room_scan(5.0, shift_m)))
        writer.write("/odom", "nav_msgs/msg/Odometry", 5.0, odometry_message(5.0, 0.5, 0.1))
    with pytest.raises(InputError, match=r"has sensor_msgs/msg/LaserScan on /back, /front; name one topic"):
        read_scans(path)
    ((scan, pose),) = read_scans(path, scan_topic="/back")
    # As the message holds them, in 32 bit.
    np.testing.assert_allclose(scan.ranges_m, room_scan(5.0, 0.3).ranges_m, rtol=1e-6)
    assert pose == pytest.approx((0.5, 0.0, 0.1))
    with pytest.raises(InputError, match="has no nav_msgs/msg/Odometry on /wheels"):
        read_scans(path, scan_topic="/back", odometry_topic="/wheels")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ranges": []}, "ranges: found 0 beams, expected 1 to"),
        ({"angle_increment": 0.0}, "expected a non-zero step"),
    ],
)
def test_a_message_that_is_no_scan_is_told_with_its_topic(tmp_path: Path, change: dict, said: str) -> None:
    path = tmp_path / "run.mcap"
    with MeasurementWriter(path) as writer:
        writer.write("/scan", "sensor_msgs/msg/LaserScan", 5.0, scan_message(room_scan(5.0, 0.0)) | change)
        writer.write("/odom", "nav_msgs/msg/Odometry", 5.0, odometry_message(5.0, 0.0, 0.0))
    with pytest.raises(InputError, match=f"run.mcap:/scan.*{said}"):
        read_scans(path)


def test_a_pose_that_is_not_finite_and_scans_long_after_are_refused(tmp_path: Path) -> None:
    for name, at_s, x_m, said in (
        ("a", 5.0, math.nan, "expected finite x, y and yaw"),
        ("b", 60.0, 0.0, "b.mcap"),
    ):
        with MeasurementWriter(tmp_path / f"{name}.mcap") as writer:
            scan = scan_message(room_scan(at_s, 0.0))
            writer.write("/scan", "sensor_msgs/msg/LaserScan", at_s, scan)
            writer.write("/odom", "nav_msgs/msg/Odometry", 5.0, odometry_message(5.0, x_m, 0.0))
        with pytest.raises(InputError, match=said):
            read_scans(tmp_path / f"{name}.mcap")


@pytest.mark.parametrize("length", [0.0, 0.5, 3.0])
def test_orientations_of_any_length_are_turned_and_zero_is_refused(tmp_path: Path, length: float) -> None:
    """A quaternion of another length gave another angle (14 degrees for 60 at a half), and zero was "straight ahead"."""
    message: dict[str, Any] = odometry_message(5.0, 0.5, math.pi / 3)
    pose = message["pose"]["pose"]
    pose["orientation"] = {name: length * value for name, value in pose["orientation"].items()}
    with MeasurementWriter(tmp_path / "run.mcap") as writer:
        writer.write("/scan", "sensor_msgs/msg/LaserScan", 5.0, scan_message(room_scan(5.0, 0.0)))
        writer.write("/odom", "nav_msgs/msg/Odometry", 5.0, message)
    if not length:
        with pytest.raises(InputError, match=r"run\.mcap:/odom: pose: .*not all 0"):
            read_scans(tmp_path / "run.mcap")
        return
    ((_, place),) = read_scans(tmp_path / "run.mcap")
    assert place == pytest.approx((0.5, 0.0, math.pi / 3))


def test_the_verb_builds_a_map(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    verbs = {"map build": ("visuohaptic.cli.verbs.planning.map_build", "build a map from laser scans")}
    assert main(["map", "build", str(recording), "--out", str(tmp_path / "m.yaml"), "--json"], verbs) == 0
    assert '"refused": 0' in capsys.readouterr().out
    grid = OccupancyMap.load(tmp_path / "m.yaml")
    # The room is 6 m x 4 m about the first pose; walls are one or two cells.
    assert grid.value_at(np.array([[0.0, 0.3], [2.9, 0.3], [-2.9, 0.3]])).tolist() == [0, 0, 0]
    assert grid.value_at(np.array([[3.01, 0.1], [2.99, 0.1]])).max() == 100
    walls = grid.world_from_cell(np.argwhere(grid.occupied))
    np.testing.assert_allclose([walls.min(axis=0), walls.max(axis=0)], [[-3, -2], [3, 2]], atol=0.06)


@pytest.mark.parametrize("ranges", ["r1,r0", "r0,intensity", "r0,r2"])
def test_columns_that_are_not_ranges_in_their_order_are_refused(tmp_path, ranges):
    path = tmp_path / "scans.csv"
    head = "t_s,x_m,y_m,yaw_rad,angle_min_rad,angle_step_rad,range_min_m,range_max_m"
    path.write_text(f"{head},{ranges}\n0,0,0,0,0,0.1,0.05,30,1,2\n")
    with pytest.raises(InputError, match=r"header: expected the ranges as columns r0, r1"):
        read_scans(path)


def _one_scan(path: Path, ranges: str, t_s: str = "0") -> Path:
    header = "t_s,x_m,y_m,yaw_rad,angle_min_rad,angle_step_rad,range_min_m,range_max_m,r0,r1,r2"
    path.write_text(f"{header}\n{t_s},0,0,0,-1,1,0.05,30,{ranges}\n")
    return path


def test_ranges_in_millimetres_are_not_free_space(tmp_path: Path) -> None:
    """Each would be beyond the range of the scanner, and everything up to there free."""
    with pytest.raises(InputError, match="ranges of 1500 to 3000 m are all outside of the scanner's limits"):
        read_scans(_one_scan(tmp_path / "s.csv", "2000,3000,1500"))
    assert len(read_scans(_one_scan(tmp_path / "s.csv", "2000,3000,1.5"))) == 1
    assert len(read_scans(_one_scan(tmp_path / "s.csv", "inf,inf,"))) == 1


@pytest.mark.parametrize("t_s", ["1764336000000", "1764336000000000000"])
def test_a_time_since_1970_that_is_not_in_seconds_is_refused(tmp_path: Path, t_s: str) -> None:
    with pytest.raises(InputError, match=r"line 2: t_s: found 1\S+, expected -1e\+11 to 1e\+11"):
        read_scans(_one_scan(tmp_path / "s.csv", "1,2,3", t_s))
    assert read_scans(_one_scan(tmp_path / "s.csv", "1,2,3", "1764336000.5"))[0][0].t_s == pytest.approx(
        1764336000.5, abs=1e-6
    )


def _recorded(path: Path, odometry_s: list[float], scans_s: list[float], *, stamped: bool = True) -> Path:
    """A robot at 0.5 m/s; without stamps, the recorder alone knows the times."""
    with MeasurementWriter(path) as writer:
        for t_s in odometry_s:
            message = odometry_message(t_s if stamped else 0.0, 0.5 * (t_s - 5.0), 0.0)
            writer.write("/odom", "nav_msgs/msg/Odometry", t_s, message)
        for t_s in scans_s:
            scan = room_scan(t_s if stamped else 0.0, 0.5 * (t_s - 5.0))
            writer.write("/scan", "sensor_msgs/msg/LaserScan", t_s, scan_message(scan))
    return path


def test_messages_without_stamps_have_the_time_of_the_recorder(tmp_path: Path) -> None:
    times = [5.0, 5.1, 5.2, 5.3]
    found = read_scans(_recorded(tmp_path / "run.mcap", times, [5.05, 5.25], stamped=False))
    assert [scan.t_s for scan, _ in found] == pytest.approx([5.05, 5.25])
    assert [pose[0] for _, pose in found] == pytest.approx([0.025, 0.125])


def test_scans_where_odometry_is_lost_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Two seconds without odometry: the robot may have turned there and back. Slow odometry is no loss."""
    fast = [5.0, 5.1, 5.2, 7.2, 7.3, 7.4]
    found = read_scans(_recorded(tmp_path / "run.mcap", fast, [5.15, 5.4, 6.2, 7.0, 7.25]))
    assert [scan.t_s for scan, _ in found] == pytest.approx([5.15, 5.4, 7.0, 7.25])
    assert "1 of 5 scans have no odometry and are left out" in caplog.text
    slow = read_scans(_recorded(tmp_path / "slow.mcap", [5.0, 6.0, 7.0], [5.5, 6.4]))
    assert [pose[0] for _, pose in slow] == pytest.approx([0.25, 0.7])
