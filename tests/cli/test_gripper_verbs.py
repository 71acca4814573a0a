"""``calibrate stripe`` and ``sense foam`` with a finger, on images in a folder."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.io.sinks import MeasurementWriter
from visuohaptic.rigs import GripperSensor

pytest.importorskip("sklearn")
pytest.importorskip("mcap_ros2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, world):
    """Sensor files, a picture at rest, and a recording of the finger closing by 4 mm."""
    folder = tmp_path_factory.mktemp("gripper")
    world.copy("calibrate stripe", folder)  # the sensor files and the picture of the help's example
    gripper = GripperSensor().gripper(rng=np.random.default_rng(2))
    cv2.imwrite(str(folder / "grey.png"), gripper.frame().grey)
    gripper.move(0.092, 0.05)
    with MeasurementWriter(folder / "frames.mcap") as writer:
        for _ in range(6):
            writer.write_frame(gripper.frame())
    return folder


def test_learn_a_stripe(folder, capsys) -> None:
    words = [
        "calibrate",
        "stripe",
        str(folder / "rest.png"),
        "--config",
        str(folder / "sensor.yaml"),
        "--json",
    ]
    out = [f"--out={folder / 'again.npz'}", f"--mask={folder / 'mask.png'}"]
    assert main(words + out) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["mean_probability_on_stripe"] > 0.9
    assert result["mean_probability_elsewhere"] < 0.05
    assert (folder / "again.npz").exists()
    assert (folder / "mask.png").exists()


@pytest.mark.parametrize(
    ("image", "text"),
    [("absent.png", "No such file"), ("sensor.yaml", "sensor.yaml"), ("broken.png", "image")],
)
def test_bad_pictures(folder, capsys, image, text) -> None:
    (folder / "broken.png").write_bytes(b"not a picture")
    words = ["calibrate", "stripe", str(folder / image), "--config", str(folder / "sensor.yaml")]
    assert main([*words, "--out", str(folder / "no.npz")]) == 2
    assert text in capsys.readouterr().err
    assert not (folder / "no.npz").exists()


def test_sense_with_a_finger(folder, capsys) -> None:
    from mcap_ros2.reader import read_ros2_messages

    words = [
        "sense",
        "foam",
        "--config",
        str(folder / "sensor.yaml"),
        "--source",
        str(folder / "frames.mcap"),
    ]
    assert main([*words, "--out", str(folder / "run.mcap"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["reasons"] == {"ok": 6}
    assert result["finger"]["frames"] == 6
    assert result["finger"]["last_m"] > result["finger"]["first_m"] + 1e-3
    poses = [message.ros_msg for message in read_ros2_messages(folder / "run.mcap", topics=["/finger/pose"])]
    assert len(poses) == 6
    assert poses[-1].pose.pose.position.x == pytest.approx(result["finger"]["last_m"], abs=1e-9)
    assert 0 < poses[-1].pose.covariance[0] < 1e-9
