"""Images of any source as topics, and topics as text, between two zenoh sessions."""

from __future__ import annotations

import json
import queue
import threading
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import DeviceError, InputError
from visuohaptic.core.camera import Camera
from visuohaptic.core.files import write_image
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros import RosNode, RosOptions, topics
from visuohaptic.ros.frames import SENSOR_QOS
from visuohaptic.ros.topics import echo, find_topics, plain_message
from visuohaptic.ros.wire import LATCHED

from .conftest import until
from .test_layers_node import running

STRING = "std_msgs/msg/String"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three grey images, 0.1 s apart, and the model of their camera."""
    images = tmp_path / "images"
    images.mkdir()
    for number in range(3):
        write_image(images / f"{number}.png", np.full((12, 16), 40 * number, np.uint8))
    (images / "times.csv").write_text("file,t_s\n" + "".join(f"{n}.png,{5 + 0.1 * n}\n" for n in range(3)))
    Camera.simple(16, 12, 20.0).save(tmp_path / "camera.yaml")
    return tmp_path


@pytest.mark.parametrize("topic", ["/front/image", "/front/image/compressed"])
def test_a_folder_of_images_is_published(folder: Path, robot: RosNode, endpoint: str, topic: str) -> None:
    kind = "sensor_msgs/msg/" + ("CompressedImage" if "compressed" in topic else "Image")
    images: list[Any] = []
    models: list[Any] = []
    robot.subscribe(topic, kind, images.append, SENSOR_QOS)
    robot.subscribe(
        "/front/camera_info", "sensor_msgs/msg/CameraInfo", lambda r: models.append(r.message), SENSOR_QOS
    )
    values = {"source": str(folder / "images"), "camera": str(folder / "camera.yaml"), "image": topic}
    with running("camera", endpoint, values | {"delay_s": 0.5}) as node:
        assert until(lambda: node.component.status().reason == "played", 30.0)
        assert until(lambda: len(images) == len(models) == 3, 30.0)
        assert node.component.status().values == {"images": 3}
        node.deactivate()
        node.activate()
        assert until(lambda: len(images) == 6, 30.0)
    # The intervals are those of the recording, at the present time.
    assert np.diff([image.t_s for image in images[:3]]) == pytest.approx([0.1, 0.1], abs=1e-6)
    assert abs(images[0].t_s - images[0].received_s) < 30.0
    assert models[0].k[0] == pytest.approx(20.0)
    if kind.endswith("/Image"):
        assert [image.message.data[0] for image in images[:3]] == [0, 40, 80]
    else:
        assert {image.message.format for image in images} == {"mono8; jpeg compressed mono8"}


def test_a_source_that_does_not_exist(robot: RosNode, endpoint: str, tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="expected a video, a folder of images"),
        running("camera", endpoint, {"source": str(tmp_path / "none.mp4")}),
    ):
        pass


def test_messages_are_plain_data(robot: RosNode, ours: RosNode) -> None:
    wrench = robot.advertise("/wrench", "geometry_msgs/msg/WrenchStamped", LATCHED)
    sent = {"x": 1.0, "y": float("nan"), "z": 0.0}
    wrench.publish(
        {
            "header": messages.header(2.5, "bumper"),
            "wrench": {"force": sent, "torque": dict.fromkeys("xyz", 0.0)},
        }
    )
    (found,) = islice(echo(ours, "wrench", 60.0), 1)
    assert found["header"] == {"stamp": {"sec": 2, "nanosec": 500_000_000}, "frame_id": "bumper"}
    assert found["wrench"]["force"]["x"] == 1.0
    assert np.isnan(found["wrench"]["force"]["y"])
    assert plain_message(np.arange(3, dtype=np.uint8)) == [0, 1, 2]
    assert plain_message(bytes(128)) == 128 * [0]
    assert plain_message(bytes(129)) == "<129 values>"


def test_what_is_not_published_and_what_is_silent(robot: RosNode, ours: RosNode) -> None:
    robot.advertise("/chatter", STRING)
    assert until(lambda: "/chatter" in find_topics(ours, 1.0), 60.0)
    with pytest.raises(InputError, match="/cup: is not published; found /chatter"):
        next(echo(ours, "/cup", 0.1))
    with pytest.raises(DeviceError, match=r"no message on /chatter \(std_msgs/msg/String\) for 0.1 s"):
        next(echo(ours, "/chatter", 0.1))


def test_a_slow_reader_gets_the_latest_messages(
    robot: RosNode, ours: RosNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    queues: list[queue.Queue[Any]] = []

    def made(size: int) -> queue.Queue[Any]:
        queues.append(queue.Queue(size))
        return queues[-1]

    monkeypatch.setattr(topics, "queue", SimpleNamespace(Queue=made, Empty=queue.Empty, Full=queue.Full))
    texts, last = robot.advertise("/texts", STRING, LATCHED), {"data": "300"}
    texts.publish({"data": "first"})
    reader = echo(ours, "/texts", 60.0)
    assert next(reader) == {"data": "first"}
    for number in range(100, 300):
        texts.publish({"data": str(number)})
    (waiting,) = queues
    assert until(lambda: (waiting.qsize() and waiting.queue[-1].data == "300") or texts.publish(last), 60.0)
    found = [message["data"] for message in islice(reader, 50)]
    assert found == sorted(found)
    # Of more than two hundred messages, the latest hundred have waited.
    assert found[0] > "199"
    reader.close()


def test_the_verb(robot: RosNode, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    chatter = robot.advertise("/chatter", STRING, LATCHED)
    chatter.publish({"data": "Größe"})
    graph = ["--transport", "zenoh", "--connect", endpoint, "--timeout", "60"]
    assert main(["ros", "echo", *graph]) == 0
    assert capsys.readouterr().out == f"/chatter  {STRING}\n"
    assert main(["ros", "echo", "/chatter", "--count", "1", *graph]) == 0
    assert json.loads(capsys.readouterr().out) == {"data": "Größe"}


def test_two_processes_need_no_router(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """``--listen`` of one takes the place of the router for the others."""
    out: list[int] = []
    words = [
        "ros",
        "echo",
        "--transport",
        "zenoh",
        "--connect",
        "none",
        "--listen",
        endpoint,
        "--timeout",
        "60",
    ]
    listener = threading.Thread(target=lambda: out.append(main(words)))
    listener.start()

    def joined() -> RosNode | None:
        try:
            return RosNode("robot", RosOptions(connect=(endpoint,), listen=(), patience_s=1.0))
        except DeviceError:
            return None

    nodes: list[RosNode] = []
    assert until(lambda: nodes or nodes.extend(filter(None, [joined()])), 60.0)
    with nodes[0] as robot:
        robot.advertise("/chatter", STRING)
        listener.join(60.0)
    assert out == [0]
    assert "/chatter" in capsys.readouterr().out


def test_the_domain_of_the_environment(monkeypatch: pytest.MonkeyPatch, endpoint: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with RosNode("a", RosOptions(connect=(), listen=(endpoint,))) as node:
        assert node.options.domain == 7
    with RosNode("a", RosOptions(domain=3, connect=(), listen=(endpoint,))) as node:
        assert node.options.domain == 3
    with RosNode("a", RosOptions(domain=0, connect=(), listen=(endpoint,))) as node:
        assert node.options.domain == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    with pytest.raises(InputError, match="ROS_DOMAIN_ID: found '233', expected a number from 0 to 232"):
        RosNode("a", RosOptions(connect=(), listen=(endpoint,)))
