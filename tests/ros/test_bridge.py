"""The bridge end to end: rendered images over topics in, forces over topics out."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera
from visuohaptic.core.files import save_yaml
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.rigs import VirtualSensor
from visuohaptic.ros import Bridge, BridgeConfig, RosNode, RosOptions, SensorChannel
from visuohaptic.ros.bridge_config import NodeSection, SensorSection
from visuohaptic.ros.wire import message_type
from visuohaptic.simulation.foam import PressShape, SensorRig, press

from .conftest import until

IMAGE = "/bumper/image/compressed"


@pytest.fixture(scope="module")
def sensor(tmp_path_factory):
    """A calibrated and zeroed sensor in files, pictures of a press, and the true forces."""
    folder = tmp_path_factory.mktemp("bridge")
    virtual, rng = VirtualSensor(rig=SensorRig().half_size()), np.random.default_rng(3)
    virtual.build(folder, rng, zero_frames=8)
    depths = np.linspace(0.0, 0.005, 12)
    samples = list(press(PressShape.CYLINDER_12CM, depths, geometry=virtual.geometry))
    renderer = virtual.renderer()
    pictures = [renderer.render(sample.scene, rng=rng) for sample in samples]
    return folder, pictures, [sample.force_N for sample in samples]


def write(folder: Path, endpoint: str, **more) -> Path:
    section = {"name": "foam", "config": "sensor.yaml", "image": IMAGE, "queue": 20} | more.pop("sensor", {})
    node = {"connect": [endpoint], "listen": [], "patience_s": PATIENCE_S}
    path = folder / "bridge.yaml"
    save_yaml(path, {"node": node, "sensors": [section], "stale_s": 0.3} | more)
    return path


# The camera waits (wait=True): twelve pictures at once would overrun the queue of a busy machine.
def test_pictures_become_forces(sensor, robot: RosNode, endpoint: str) -> None:
    folder, pictures, truth = sensor
    wrenches, told = [], []
    robot.subscribe("/foam/wrench", "geometry_msgs/msg/WrenchStamped", lambda r: wrenches.append(r.message))
    robot.subscribe(
        "/foam/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", lambda r: told.append(r.message)
    )
    others = {"contact": "sensor_msgs/msg/PointCloud2", "profile": "sensor_msgs/msg/PointCloud2",
              "event": "std_msgs/msg/String", "markers": "visualization_msgs/msg/MarkerArray"}  # fmt: skip
    seen: dict[str, list] = {name: [] for name in others}
    for name, datatype in others.items():
        robot.subscribe(f"/foam/{name}", datatype, lambda r, name=name: seen[name].append(r.message))
    camera = robot.advertise(IMAGE, "sensor_msgs/msg/CompressedImage", wait=True)
    with Bridge.load(write(folder, endpoint)) as bridge:
        camera.wait_until_heard()
        # Without images it says stale: silence would be taken for no force.
        assert until(lambda: told and wrenches)
        assert told[0].status[0].message == "stale"
        assert np.isnan(wrenches[0].wrench.force.x)
        for number, picture in enumerate(pictures):
            camera.publish(messages.compressed_image(10.0 + number / 30, picture, "bumper", 95))
        assert until(lambda: bridge.frames == len(pictures)), bridge.frames
        assert until(lambda: sum(w.header.stamp.sec < 1000 for w in wrenches) == len(pictures))
        topics = {e.topic for e in robot.graph() if e.node == "visuohaptic"}
    assert {"/foam/wrench", "/foam/diagnostics", IMAGE} <= topics
    measured = [w for w in wrenches if w.header.stamp.sec < 1000]
    stamps = [w.header.stamp.sec + 1e-9 * w.header.stamp.nanosec for w in measured]
    assert stamps == pytest.approx([10.0 + number / 30 for number in range(len(pictures))], abs=1e-6)
    assert {w.header.frame_id for w in measured} == {"foam"}
    # Loading by a cylinder is read within 1 % beyond the first millimetre, and the JPEG loses a little more.
    forces = np.array([w.wrench.force.x for w in measured])
    truth = np.array(truth)
    deep = truth > 0.3
    assert deep.sum() >= 5
    np.testing.assert_allclose(forces[deep], truth[deep], rtol=0.03)
    assert json.loads(seen["event"][0].data)["kind"] == "contact"
    assert len(seen["profile"]) >= len(pictures)
    assert seen["contact"]
    shown = [m for array in seen["markers"] for m in array.markers if m.points]
    assert shown
    assert shown[-1].points[0].x > shown[-1].points[1].x  # against x, as the force on the sensor
    (report,) = bridge.reports
    assert (report.frames, report.lost, report.damaged) == (len(pictures), 0, 0)
    assert report.reasons["ok"] >= deep.sum()
    assert report.stale >= 1


def test_it_can_zero_by_itself(sensor, robot: RosNode, endpoint: str, tmp_path: Path) -> None:
    folder, pictures, _ = sensor
    for name in ("sensor.yaml", "camera.yaml", "foam.yaml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(InputError, match=r"no zero reference.*zero_frames"):
        Bridge.load(write(tmp_path, endpoint))
    virtual = VirtualSensor(rig=SensorRig().half_size())
    rest = [frame.image for frame in virtual.rest_frames(np.random.default_rng(1), 5)]
    wrenches: list = []
    robot.subscribe("/foam/wrench", "geometry_msgs/msg/WrenchStamped", lambda r: wrenches.append(r.message))
    camera = robot.advertise(IMAGE, "sensor_msgs/msg/CompressedImage", wait=True)
    with Bridge.load(write(tmp_path, endpoint, sensor={"zero_frames": 5})) as bridge:
        camera.wait_until_heard()
        for number, picture in enumerate([*rest, *pictures[-1:]]):
            camera.publish(messages.compressed_image(10.0 + number, picture, "bumper", 95))
        assert until(lambda: bridge.frames == 1)
    assert not (tmp_path / "zero.yaml").exists()


def test_a_picture_of_another_size_ends_it(sensor, robot: RosNode, endpoint: str) -> None:
    folder, pictures, _ = sensor
    camera = robot.advertise(IMAGE, "sensor_msgs/msg/CompressedImage", wait=True)
    with Bridge.load(write(folder, endpoint)) as bridge:
        camera.wait_until_heard()
        camera.publish(messages.compressed_image(10.0, pictures[0][:100], "bumper", 95))
        with pytest.raises(InputError, match="found images of 800 x 100"):
            bridge.wait(60.0)


GOOD = {"name": "foam", "config": "sensor.yaml", "image": IMAGE}


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "sensors: is missing"),
        ({"sensors": []}, "at least 1 entries"),
        ({"sensors": [GOOD], "nodes": 1}, "nodes: unknown field"),
        ({"sensors": [GOOD | {"image": "a b"}]}, "expected words of letters"),
        ({"sensors": [GOOD | {"name": "fo/am"}]}, "sensors.0.name"),
        ({"sensors": [GOOD, GOOD]}, "foam occurs twice"),
        ({"sensors": [GOOD], "node": {"name": "a b"}}, "node name: found 'a b'"),
        ({"sensors": [GOOD], "node": {"domain": 999}}, "node.domain"),
        ({"sensors": [GOOD | {"config": "camera.yaml"}]}, "expected foam, beam or scene"),
        ({"sensors": [GOOD | {"config": "absent.yaml"}]}, "absent.yaml: cannot be read"),
        ({"sensors": [GOOD], "node": {"connect": ["tcp/127.0.0.1:1"], "patience_s": 0.1}}, "no connection"),
    ],
)
def test_a_bad_file_is_one_line_and_exit_code_2(sensor, capsys, fields: dict, words: str) -> None:
    path = sensor[0] / "bad.yaml"
    save_yaml(path, fields)
    assert main(["ros", "bridge", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error


def test_the_verb_ends_by_itself(sensor, robot: RosNode, endpoint: str, capsys) -> None:
    words = ["ros", "bridge", str(write(sensor[0], endpoint)), "--duration", "2.0", "--json"]
    assert main(words) == 0
    (found,) = json.loads(capsys.readouterr().out)["sensors"]
    assert (found["name"], found["frames"]) == ("foam", 0)
    assert found["stale"] >= 1


def catches(pid: int, number: int) -> bool:
    """Whether a process has a handler of a signal."""
    (mask,) = re.findall(r"SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
    return bool(int(mask, 16) >> (number - 1) & 1)


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="handlers of signals are read from /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(sensor, robot: RosNode, endpoint: str, number: int) -> None:
    path = write(sensor[0], endpoint)
    command = [sys.executable, "-m", "visuohaptic.cli.main", "ros", "bridge", str(path), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert until(lambda: any(e.node == "visuohaptic" for e in robot.graph(0.2)))
    assert until(lambda: catches(process.pid, signal.SIGTERM))
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert json.loads(out)["sensors"][0]["frames"] == 0
    assert until(lambda: not any(e.node == "visuohaptic" for e in robot.graph(0.2)))


def test_a_file_without_a_connection_has_that_of_every_node() -> None:
    assert NodeSection().options(Path("folder")) == RosOptions()


def test_the_file_of_the_documentation_is_one() -> None:
    text = (Path(__file__).parents[2] / "docs" / "ros.md").read_text()
    import yaml

    block = text.partition("```yaml\n")[2].partition("```")[0]
    config = BridgeConfig.model_validate(yaml.safe_load(block))
    assert config.sensors[0].name == "foam"
    assert message_type("geometry_msgs/msg/WrenchStamped").type_hash() in text


class _HeldReader:
    """A sensor that does not return from its first image until it is let go."""

    def __init__(self) -> None:
        self.topics: dict[str, str] = {}
        self.camera = Camera.simple(8, 8, 70.0)
        self.reads, self.go, self.closed = threading.Event(), threading.Event(), False

    def blank(self, *_: object) -> None:
        self.reads.set()
        self.go.wait(PATIENCE_S)

    def close(self) -> None:
        self.closed = True


def test_a_sensor_that_does_not_answer_does_not_hold_up_the_end(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The node is not kept from ending, says so, and leaves the reader to the thread that uses it, which closes it."""
    monkeypatch.setattr("visuohaptic.core.resources.WAIT_S", 0.05)
    quiet = SimpleNamespace(close=lambda: None)
    node = SimpleNamespace(resolve=lambda name: name, subscribe=lambda *_: quiet, now_s=lambda: 0.0)
    reader, stop = _HeldReader(), threading.Event()
    section = SensorSection(name="foam", config="sensor.yaml", image=IMAGE)
    channel = SensorChannel(node, section, reader, 0.001, stop, pytest.fail)
    channel.start()
    assert reader.reads.wait(PATIENCE_S)
    stop.set()
    assert not channel.join()
    channel.close()
    assert not reader.closed
    assert [record.message for record in caplog.records] == 2 * [
        "sensor foam: still computing after 0.05 s; its result is dropped"
    ]
    reader.go.set()
    assert until(lambda: reader.closed)
