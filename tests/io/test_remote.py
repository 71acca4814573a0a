"""World and robot in two processes: tasks run over the connection, and only protocol members are accessible."""

from __future__ import annotations

import json
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from visuohaptic.core import DeviceError, InputError, MapPose
from visuohaptic.core.camera import Camera, Frame, Pose
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.remote import RemoteRobot, start_robot
from visuohaptic.io.remote.server import serve_robot
from visuohaptic.io.remote.wire import pack, unpack
from visuohaptic.navigation.mapping import OccupancyMapper
from visuohaptic.simulation.floor import FloorObject
from visuohaptic.tasks.manipulation import Hand, Place, SqueezeSettings, squeeze

KITCHEN = "visuohaptic.simulation.served:kitchen"

#: The robot's mind: it may import nothing of the world, and prints what it has done.
MIND = """
import json, sys
import numpy as np
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.remote import start_robot
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.tasks.mobile.travel import travel

folder, world = sys.argv[1], json.loads(sys.argv[2])
box = np.array(world["objects"][0]["footprint_m"])
grid = OccupancyMap.load(world["map"])
cells = grid.cells.copy()
u, v = np.meshgrid(*(0.05 * (np.arange(n) + 0.5) for n in cells.shape[::-1]))
cells[(u > box[:, 0].min()) & (u < box[:, 0].max()) & (v > box[:, 1].min()) & (v < box[:, 1].max())] = 100
robot_model = RobotModel(0.17, push_force_max_N=20.0)
problem = PlanningProblem(
    OccupancyMap(cells, 0.05), robot_model, np.array([1.2, 1.4]), np.array([2.7, 1.4]),
    (MovableObject("stool", box),),
)
with start_robot("visuohaptic.simulation.served:floor", world) as robot:
    done = travel(problem, robot.base, robot.senses, robot.wait)
    x, y, _ = robot.senses.pose()
worlds = [n for n in sys.modules if n.startswith(("visuohaptic.simulation", "visuohaptic.rigs", "mujoco"))]
print(json.dumps({"outcome": done.outcome, "why": done.reason, "pushes": done.pushes, "at": [x, y], "worlds": worlds}))
"""


def test_a_mind_that_has_never_seen_the_world_drives_in_it(tmp_path: Path) -> None:
    """A stool of 8 N in a door, unknown: it is explored, pushed aside, and the goal is reached."""
    pytest.importorskip("mujoco")
    cells = np.zeros((60, 80), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:20, 38:40] = cells[38:, 38:40] = 100
    OccupancyMap(cells, 0.05).save(tmp_path / "room.yaml")
    box = [[1.775, 1.275], [2.125, 1.275], [2.125, 1.625], [1.775, 1.625]]
    stool = {"id": "stool", "footprint_m": box, "mass_kg": 2.7, "floor_friction": 0.3}
    world = {"map": str(tmp_path / "room.yaml"), "start_m": [1.2, 1.4, 0.3], "objects": [stool], "seed": 2}
    done = subprocess.run(
        [sys.executable, "-c", MIND, str(tmp_path), json.dumps(world)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["worlds"] == []
    assert found["outcome"] == "arrived", found
    assert found["pushes"] >= 1
    # Localisation errs by 6 mm, the follower ends within 5 cm.
    assert np.hypot(found["at"][0] - 2.7, found["at"][1] - 1.4) < 0.08


@pytest.fixture(scope="module")
def table():
    with start_robot(KITCHEN, {"stiffness_N_per_m": 2500.0, "seed": 4}) as robot:
        yield robot


def test_a_hand_squeezes_through_the_wire(table: RemoteRobot) -> None:
    hand = Hand(table.arm, table.gripper, table.camera, table.feel, table.weigh)
    found = squeeze(hand, [Place(0.1)], SqueezeSettings(forces_N=(1.0, 2.0, 4.0, 8.0)))
    assert found.ending.success, found.ending
    # As in one process: 0.08 N and 40 um by the median of six frames.
    assert found.curves[0].stiffness_N_per_m == pytest.approx(2500.0, rel=0.08)


def test_nothing_but_members_of_the_protocols_crosses(table: RemoteRobot) -> None:
    assert set(table.parts) == {"arm", "gripper", "camera", "feel", "weigh", "wait"}
    for part, member in (
        ("gripper", "container"), ("gripper", "force_N"), ("arm", "true_pose"), ("camera", "_balance"),
        ("gripper", "__class__"), ("world", "state"), ("base", "state"),
    ):  # fmt: skip
        with pytest.raises(
            InputError, match=rf"found {part}\.{member}, which is not a member of a served part"
        ):
            table.call(part, member)
    with pytest.raises(InputError, match="found -1"):
        table.gripper.move(-1.0, 0.01)
    with pytest.raises(DeviceError, match="out of reach"):
        table.arm.move_linear(Pose(np.eye(3), np.array([9.0, 0.0, 0.0])), 0.1)
    assert table.gripper.state().opening_m > 0.0  # it goes on after a refusal


def test_a_stranger_without_the_key_is_refused(table: RemoteRobot) -> None:
    with pytest.raises(DeviceError, match="does not answer"):
        RemoteRobot(("127.0.0.1", 9), b"x")
    with pytest.raises(DeviceError, match="did not serve a robot"):
        start_robot("visuohaptic.simulation.served:nowhere")


def test_what_a_robot_prints_is_not_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "noisy.py").write_text(
        "import os\nprint('a greeting')\nos.write(1, b'of a library\\n')\n"
        "def robot():\n    print('ready')\n    return {'wait': print}\n"
    )
    monkeypatch.chdir(tmp_path)
    with start_robot("noisy:robot") as robot:
        assert robot.wait(0.25) is None
    said = capfd.readouterr().err
    assert all(text in said for text in ("a greeting", "of a library", "ready", "0.25"))


def test_values_cross_as_they_are_and_truth_does_not() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(4, 6)
    frame = unpack(pack(Frame(image, 1.5, 7)))
    np.testing.assert_array_equal(frame.image, image)
    assert (frame.t_s, frame.index) == pytest.approx((1.5, 7))
    pose = Pose.from_rotation_vector([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(unpack(pack((2.0, pose)))[1].matrix, pose.matrix)
    assert unpack(pack(MapPose(1.0, 2.0, 3.0, np.nan))).t_s == 1.0
    assert np.isnan(unpack(pack({"force": float("nan")}))["force"])
    np.testing.assert_array_equal(
        unpack(pack(Camera.simple(6, 4, focal_px=5.0))).matrix, Camera.simple(6, 4, focal_px=5.0).matrix
    )
    stool = FloorObject("stool", np.eye(3, 2), 1.0, 0.3)
    for truth in (stool, object(), {"a": stool}, np.array([stool]), lambda: None):
        with pytest.raises(InputError, match="which cannot be transmitted"):
            pack(truth)


@pytest.mark.parametrize(
    "message",
    [
        b"", b"{}", b"[1, 2]\n", b'{"value": {"kind": "Popen", "fields": "{}", "apart": {"items": {}}}, "arrays": []}\n',
        b'{"value": {"array": 0}, "arrays": [["<f8", [1000000000]]]}\n1', b'{"value": {"array": 0}, "arrays": [["O", [1]]]}\n12345678',
        b'{"value": {"array": 0}, "arrays": [["<f8", [-1]]]}\n', b"\xff\xfe\n", b'{"value": {"array": 3}, "arrays": []}\n',
        # NumPy parses the names of types as Python; a number beyond all floats is infinite.
        b'{"value": {"array": 0}, "arrays": [[",f8", [1]]]}\n', b'{"value": {"array": 0}, "arrays": [["<f8", [1e999]]]}\n',
        b'{"value": {"array": 0}, "arrays": [["<f8", [1180591620717411303424]]]}\n',  # 2^70
    ],
)  # fmt: skip
def test_what_is_no_message_is_refused(message: bytes) -> None:
    with pytest.raises(DeviceError, match="that are not a message"):
        unpack(message)


@contextmanager
def served(
    parts: dict[str, Any], strangers: Callable[[tuple[str, int]], None] | None = None
) -> Iterator[RemoteRobot]:
    """A robot of these parts in a thread, and who commands it; strangers come first."""
    key, found = b"k" * 32, queue.Queue[tuple[str, int]]()
    serving = threading.Thread(target=serve_robot, args=(parts,), kwargs={"key": key, "ready": found.put})
    serving.start()
    address = found.get(timeout=PATIENCE_S)
    if strangers is not None:
        strangers(address)
    robot = RemoteRobot(address, key)
    try:
        yield robot
    finally:
        robot.close()
        serving.join(PATIENCE_S)


def test_strangers_do_not_end_the_service() -> None:
    """A port is open to every process of the machine: the robot waits for the one that has the key."""

    def strangers(address: tuple[str, int]) -> None:
        with pytest.raises(DeviceError, match="does not answer"):
            RemoteRobot(address, b"another key")
        for message in (b"", b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 64):
            with socket.create_connection(address, PATIENCE_S) as line:
                line.sendall(message)

    with served({"weigh": lambda frame: 2.5}, strangers) as robot:
        assert robot.weigh(Frame(np.zeros((2, 2), np.uint8), 0.0, 0)) == pytest.approx(2.5)


def test_a_silent_client_does_not_hold_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    """It connects first and says nothing, or a byte now and then; the one with the key is served while both wait."""
    monkeypatch.setattr("visuohaptic.io.remote.server.HANDSHAKE_S", 0.2)
    lines: list[socket.socket] = []

    def strangers(address: tuple[str, int]) -> None:
        lines.extend(socket.create_connection(address, PATIENCE_S) for _ in range(2))
        lines[1].sendall(b"\0")

    with served({"weigh": lambda frame: 2.5}, strangers) as robot:
        assert robot.weigh(Frame(np.zeros((2, 2), np.uint8), 0.0, 0)) == pytest.approx(2.5)
    for line in lines:
        line.close()


@pytest.mark.parametrize("greeting", [b"", b"\0", b"\0\0\0\x04helo", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_a_server_that_is_no_robot_is_told(greeting: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is silent, stops in the middle, or speaks another protocol."""
    monkeypatch.setattr("visuohaptic.io.remote.client.PATIENCE_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()[:2]
        queued: list[socket.socket] = []
        accepting = threading.Thread(
            target=lambda: queued.append(server.accept()[0]) or queued[0].sendall(greeting)
        )
        accepting.start()
        with pytest.raises(DeviceError, match=f"the robot at 127.0.0.1:{address[1]} does not answer"):
            RemoteRobot(address, b"k" * 32)
        accepting.join(PATIENCE_S)
        queued[0].close()


def test_a_robot_that_stops_taking_bytes_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hung process leaves a picture that is larger than all buffers half sent."""
    monkeypatch.setattr("visuohaptic.io.remote.client.PATIENCE_S", 1.0)
    hung = threading.Event()
    with served(
        {"wait": lambda duration_s: hung.wait(PATIENCE_S) and None, "weigh": lambda frame: 2.5}
    ) as robot:
        robot._connection.send_bytes(pack({"part": "wait", "member": "wait", "arguments": (0.0,)}))
        with pytest.raises(DeviceError, match="lost the connection"):
            robot.weigh(Frame(np.zeros((6000, 6000), np.uint8), 0.0, 0))
        hung.set()


def test_replies_of_another_kind_are_an_error_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = [(1.0, 2.0), None]
    laser = SimpleNamespace(scan=lambda: answers.pop())
    with served({"laser": laser}) as robot:
        for kind in ("NoneType", "tuple"):
            with pytest.raises(DeviceError, match=f"found {kind}, expected LaserScan"):
                robot.scan()
        monkeypatch.setattr("visuohaptic.io.remote.client.unpack", lambda message: 7)
        with pytest.raises(DeviceError, match="found int, expected the reply of a robot"):
            robot.scan()
        assert robot._connection.closed, "what else it sends would be taken for another reply"


@pytest.mark.parametrize(
    "failure", [OSError(5, "Input/output error"), EOFError("cable"), KeyError("joint_3")]
)
def test_a_driver_that_fails_is_an_error_of_the_device_and_the_rest_goes_on(failure: Exception) -> None:
    """Also with the errors that a connection which is gone raises: they are the driver's own here."""
    stops: list[None] = []

    class Base:
        def state(self) -> None:
            raise failure

        def stop(self) -> None:
            stops.append(None)

    with served({"base": Base(), "weigh": lambda frame: 2.5}) as robot:
        with pytest.raises(DeviceError, match=f"{type(failure).__name__}: .*{failure.args[-1]}"):
            robot.base.state()
        assert robot.weigh(Frame(np.zeros((2, 2), np.uint8), 0.0, 0)) == pytest.approx(2.5)
        robot.base.stop()
        assert len(stops) == 1


def test_after_an_answer_that_does_not_come_nothing_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reply that comes late must not be taken for that of the next call."""
    with served({"wait": lambda duration_s: time.sleep(duration_s) or duration_s}) as robot:
        monkeypatch.setattr("visuohaptic.io.remote.client.PATIENCE_S", 0.1)
        with pytest.raises(DeviceError, match="not answered"):
            robot.call("wait", "wait", 0.6)
        time.sleep(0.8)
        with pytest.raises(DeviceError, match="lost the connection"):
            robot.call("wait", "wait", 0.0)


def test_a_mind_maps_a_room_that_it_scans_in_another_process(tmp_path: Path) -> None:
    """Driven by its laser alone: the map of an L of walls and a box, and the pose in it, from served scans and odometry."""
    pytest.importorskip("mujoco")
    cells = np.zeros((60, 80), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:20, 38:40] = 100
    walls = OccupancyMap(cells, 0.05)
    walls.save(tmp_path / "room.yaml")
    box = [[2.6, 2.0], [3.0, 2.0], [3.0, 2.4], [2.6, 2.4]]
    crate = {"id": "crate", "footprint_m": box, "mass_kg": 3.0, "floor_friction": 0.4}
    world = {"map": str(tmp_path / "room.yaml"), "start_m": [0.8, 1.8, 0.0], "objects": [crate], "seed": 4}
    mapper = OccupancyMapper()
    with start_robot("visuohaptic.simulation.served:floor", world) as robot:
        assert "laser" in robot.parts
        with pytest.raises(AttributeError, match="base has no pose_m"):
            robot.base.pose_m  # type: ignore[attr-defined]  # noqa: B018 - the truth of the world
        for speed_m_s, turn_rad_s, steps in ((0.3, 0.0, 8), (0.0, 0.6, 4), (0.3, 0.0, 3)):
            for _ in range(steps):
                robot.base.drive(speed_m_s, turn_rad_s)
                robot.wait(0.35)
                robot.base.stop()
                scan, state = robot.scan(), robot.base.state()
                mapper.add(scan, (state.x_m, state.y_m, state.heading_rad))
    seen = scan.points_m
    assert scan.t_s == pytest.approx(state.t_s)
    # The mapper's frame is that of the odometry: scans err by 1 cm, cells have 5 cm.
    assert np.hypot(mapper.pose[0] - state.x_m, mapper.pose[1] - state.y_m) < 0.04
    found, (turn, x, y) = mapper.map(), (state.heading_rad, state.x_m, state.y_m)
    points = seen @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + (x, y)
    near = np.abs(points[:, None] - np.array(box)).max(axis=2).min(axis=1) < 0.45
    assert np.count_nonzero(near) > 5, "the crate is scanned"
    inside = found.cell_from_world(points).astype(int)
    assert np.mean(found.cells[inside[:, 0], inside[:, 1]] >= 50) > 0.8
