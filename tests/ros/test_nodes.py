"""Nodes in a live graph of ROS 2: processes of their own that real rclpy clients configure, start, ask and stop."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from tests.patience import PATIENCE_S
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.rigs import VirtualSensor
from visuohaptic.ros import Received, TopicNode
from visuohaptic.ros.nodes import LifecycleProcess, declared, node_kind
from visuohaptic.ros.transports import RclpyNode, RosOptions, interface
from visuohaptic.ros.wire import Qos
from visuohaptic.simulation.foam import PressShape, press

from .conftest import until

IMAGE = "/bumper/image/compressed"
#: A domain of this process alone.
DOMAIN = 101 + os.getpid() % 100


class Robot(RclpyNode):
    """The other side: what ``ros2 lifecycle``, ``ros2 param`` and ``ros2 service`` do, with rclpy alone."""

    def call(
        self,
        service: str,
        kind: str,
        fields: Callable[[Any], None] | None = None,
        patience_s: float = PATIENCE_S,
    ) -> Any:
        message = interface(kind)
        client = self.inner.create_client(message, service)
        assert client.wait_for_service(PATIENCE_S), service
        request = message.Request()
        if fields is not None:
            fields(request)
        future = client.call_async(request)
        assert until(future.done, patience_s), service
        self.inner.destroy_client(client)
        return future.result()

    def state(self, node: str) -> str:
        return str(self.call(f"/{node}/get_state", "lifecycle_msgs/srv/GetState").current_state.label)

    def change(self, node: str, transition: str) -> bool:
        def fill(request: Any) -> None:
            request.transition.label = transition

        return bool(self.call(f"/{node}/change_state", "lifecycle_msgs/srv/ChangeState", fill).success)

    def set(self, node: str, name: str, value: Any) -> Any:
        from rclpy.parameter import Parameter

        def fill(request: Any) -> None:
            request.parameters = [Parameter(name, value=value).to_parameter_msg()]

        return self.call(f"/{node}/set_parameters", "rcl_interfaces/srv/SetParameters", fill).results[0]

    def trigger(self, service: str, patience_s: float = PATIENCE_S) -> Any:
        return self.call(service, "std_srvs/srv/Trigger", patience_s=patience_s)


@pytest.fixture
def robot() -> Iterator[Robot]:
    with Robot("robot", RosOptions(domain=DOMAIN)) as node:
        yield node


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[np.ndarray], list[float]]:
    """A calibrated and zeroed sensor in files, pictures of a press, and the true forces."""
    folder = tmp_path_factory.mktemp("foam")
    virtual, rng = VirtualSensor(), np.random.default_rng(4)
    virtual.build(folder, rng, zero_frames=8)
    samples = list(press(PressShape.CYLINDER_12CM, np.linspace(0.0, 0.005, 12), geometry=virtual.geometry))
    renderer = virtual.renderer()
    pictures = [renderer.render(sample.scene, rng=rng) for sample in samples]
    return folder, pictures, [sample.force_N for sample in samples]


class Process:
    """``visuohaptic ros node`` as a user starts it."""

    def __init__(self, *words: str) -> None:
        command = [sys.executable, "-m", "visuohaptic", "ros", "node", *words, "--domain", str(DOMAIN)]
        if "--ros-args" in words:
            place = len(words) - words.index("--ros-args")
            command = [*command[: -2 - place], *command[-2:], *command[-2 - place : -2]]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def end(self, number: int = signal.SIGINT) -> tuple[int, str]:
        self._process.send_signal(number)
        _, said = self._process.communicate(timeout=PATIENCE_S)
        return self._process.returncode, said

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


class Heard:
    """What a foam node publishes."""

    def __init__(self, node: TopicNode) -> None:
        self.wrenches: list[Any] = []
        self.told: list[Any] = []
        self.begin_s = 0  #: stamp of the first picture that is shown
        node.subscribe("/foam/wrench", "geometry_msgs/msg/WrenchStamped", self._wrench, Qos(depth=100))
        node.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._diagnostics)

    def _wrench(self, received: Received) -> None:
        self.wrenches.append(received.message)

    def _diagnostics(self, received: Received) -> None:
        self.told.append(received.message.status[0])

    def measured(self) -> list[Any]:
        """Those of images, which are stamped from 100 s on; stale ones have the time of today."""
        return [w for w in self.wrenches if w.header.stamp.sec < 1000]


def show(robot: TopicNode, pictures: list[np.ndarray], heard: Heard) -> np.ndarray:
    """Publish the pictures, one when the one before is measured; returns the forces [N].

    The first one is sent again until it is measured: what is sent before two nodes have met is lost, and a killed
    one counts as listening until its lease ends.
    """
    camera = robot.advertise(IMAGE, "sensor_msgs/msg/CompressedImage", Qos(depth=5))
    heard.wrenches.clear()
    heard.begin_s += 100

    def measured() -> dict[int, float]:
        stamps = [(w.header.stamp.sec, w.header.stamp.nanosec, w.wrench.force.x) for w in heard.measured()]
        return {round(30 * (sec - heard.begin_s + 1e-9 * nanosec)): force for sec, nanosec, force in stamps}

    for number, picture in enumerate(pictures):
        message = messages.compressed_image(heard.begin_s + number / 30, picture, "bumper", 95)
        end = time.monotonic() + PATIENCE_S
        while number not in measured():
            assert time.monotonic() < end, number
            camera.publish(message)
            until(lambda now=number: now in measured(), 1.0)
    return np.array([measured()[number] for number in range(len(pictures))])


def test_pictures_become_forces(sensor, robot: Robot) -> None:
    """Fifteen lines of a launch file are not needed: one command, and Ctrl-C ends it with exit code 0."""
    folder, pictures, truth = sensor
    heard = Heard(robot)
    with Process(
        "foam", "--param", f"config:={folder / 'sensor.yaml'}", "--param", f"image:={IMAGE}"
    ) as node:
        # Without images it says stale: silence would be taken for no force.
        assert until(lambda: heard.wrenches, PATIENCE_S)
        assert np.isnan(heard.wrenches[0].wrench.force.x)
        assert until(lambda: any(s.message == "stale" for s in heard.told), PATIENCE_S)
        forces = show(robot, pictures, heard)
        assert until(lambda: heard.told[-1].message in ("ok", "stale"), PATIENCE_S)
        assert {value.key for value in heard.told[-1].values} >= {"frames", "lost", "damaged"}
        code, said = node.end()
    assert code == 0, said
    deep = np.array(truth) > 0.3
    # Loading by a cylinder is read within 1 % beyond the first millimetre, and the JPEG loses a little more.
    np.testing.assert_allclose(forces[deep], np.array(truth)[deep], rtol=0.03)
    assert {w.header.frame_id for w in heard.measured()} == {"foam"}


def test_its_states_are_those_of_ros(sensor, robot: Robot) -> None:
    """Unconfigured, inactive, active and back; parameters are fixed while it is configured."""
    folder, pictures, truth = sensor
    heard = Heard(robot)
    with Process("foam", "--managed", "--ros-args", "-p", f"image:={IMAGE}") as node:
        assert robot.state("foam") == "unconfigured"
        assert not robot.change("foam", "configure")  # no config: refused, and it stays
        assert robot.state("foam") == "unconfigured"
        assert robot.set("foam", "config", str(folder / "absent.yaml")).successful
        assert not robot.change("foam", "configure")
        assert robot.set("foam", "config", str(folder / "sensor.yaml")).successful
        refused = robot.set("foam", "stale_s", 100.0)
        assert not refused.successful
        assert "range" in refused.reason
        assert robot.change("foam", "configure")
        assert robot.state("foam") == "inactive"
        refused = robot.set("foam", "queue", 3)
        assert not refused.successful
        assert "clean it up first" in refused.reason
        assert until(lambda: any(s.message == "inactive" for s in heard.told), PATIENCE_S)
        assert not heard.wrenches  # inactive: nothing is measured
        for _ in range(2):  # twice: what was stopped starts again
            assert robot.change("foam", "activate")
            np.testing.assert_allclose(show(robot, pictures, heard)[-3:], truth[-3:], rtol=0.03)
            assert robot.change("foam", "deactivate")
        assert robot.change("foam", "cleanup")
        assert robot.state("foam") == "unconfigured"
        assert robot.set("foam", "queue", 3).successful
        assert node.end(signal.SIGTERM)[0] == 0


def test_parameters_are_described(robot: Robot) -> None:
    with LifecycleProcess("foam", node_kind("foam"), {}, RosOptions(domain=DOMAIN)):

        def fill(request: Any) -> None:
            request.names = ["stale_s", "zero_frames"]

        stale, zero = robot.call(
            "/foam/describe_parameters", "rcl_interfaces/srv/DescribeParameters", fill
        ).descriptors
    assert "[s]" in stale.description
    assert (
        stale.floating_point_range[0].from_value,
        stale.floating_point_range[0].to_value,
    ) == pytest.approx((0.01, 60.0))
    assert zero.integer_range[0].to_value == 10_000


def test_a_mistake_is_one_line_and_exit_code_2(sensor) -> None:
    folder = sensor[0]
    for words, text in (
        (["foam"], "missing config; set it with --param config:=VALUE"),
        (["foam", "--param", "confg:=a"], "did you mean config?"),
        (["foam", "--param", f"config:={folder / 'camera.yaml'}"], "expected foam, beam or scene"),
        (["beam", "--param", f"config:={folder / 'sensor.yaml'}"], "found the sensor foam, expected beam"),
        (["foam", "--ros-args", "-p", "stale_s:=1e9"], "stale_s"),
        (["foam", "--ros-args", "-p", "="], "ROS node: cannot be created"),
    ):
        command = [sys.executable, "-m", "visuohaptic", "ros", "node", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
        lines = [line for line in done.stderr.splitlines() if line.startswith("visuohaptic: error")]
        assert (done.returncode, len(lines)) == (2, 1), (words, done.stderr)
        assert text in lines[0], lines[0]


def test_a_killed_peer_and_a_late_joiner(sensor, robot: Robot) -> None:
    """A node that is killed leaves; another one under its name goes on, and who joins then sees its latched topics."""
    folder, pictures, truth = sensor
    words = ("foam", "--param", f"config:={folder / 'sensor.yaml'}", "--param", f"image:={IMAGE}")
    words += ("--param", "stale_s:=30.0")  # what is stale has no arrows
    heard = Heard(robot)
    with Process(*words) as node:
        show(robot, pictures[-1:], heard)
        node.end(signal.SIGKILL)
    with Process(*words) as node:
        np.testing.assert_allclose(show(robot, pictures, heard)[-3:], truth[-3:], rtol=0.03)
        late: list[Any] = []
        with Robot("late", RosOptions(domain=DOMAIN)) as other:
            kind = "visualization_msgs/msg/MarkerArray"
            other.subscribe(
                "/foam/markers", kind, lambda r: late.append(r.message), Qos(latched=True, depth=1)
            )
            assert until(lambda: late, PATIENCE_S)
        assert any(marker.points for marker in late[0].markers)
        assert node.end()[0] == 0


def test_simulated_time(sensor, robot: Robot) -> None:
    """With ``use_sim_time`` what is stale is stamped by ``/clock``."""
    folder = sensor[0]
    heard = Heard(robot)
    clock = robot.inner.create_publisher(interface("rosgraph_msgs/msg/Clock"), "/clock", 1)
    words = ("-p", f"config:={folder / 'sensor.yaml'}", "-p", f"image:={IMAGE}", "-p", "use_sim_time:=true")
    with Process("foam", "--ros-args", *words):
        message = interface("rosgraph_msgs/msg/Clock")()
        message.clock.sec = 500

        def stamped() -> bool:
            clock.publish(message)
            time.sleep(0.02)
            return any(w.header.stamp.sec == 500 for w in heard.wrenches)

        assert until(stamped, PATIENCE_S)


def test_every_parameter_has_a_default_of_its_type() -> None:
    from visuohaptic.ros.nodes import NODES

    for name in NODES:
        for parameter in declared(node_kind(name).parameter_model):
            assert isinstance(parameter.default, bool | int | float | str | list), (name, parameter)
            assert parameter.description, (name, parameter.name)
            json.dumps(parameter.default)
