"""``sense scene`` end to end, on rendered images in a recording."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from tests.sensing import scenes

from visuohaptic.cli.main import main
from visuohaptic.core.camera import Frame
from visuohaptic.core.files import save_yaml
from visuohaptic.io.sinks import MeasurementWriter

pytest.importorskip("mcap_ros2")


STEP_M, FRAMES = 0.009, 14


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of a drive of 12 cm towards a box, and of its wheels."""
    folder = tmp_path_factory.mktemp("scene")
    rig, rng = scenes.RIG, np.random.default_rng(0)
    rig.camera.save(folder / "camera.yaml")
    described = rig.T_camera_foam.fields
    save_yaml(folder / "scene.yaml", {"kind": "scene", "camera": "camera.yaml", "T_camera_foam": described})
    render = scenes.renderer(rig)
    with MeasurementWriter(folder / "frames.mcap") as writer:
        for i in range(FRAMES):
            box = scenes.box(0.30 - STEP_M * i, 0.0, grey=180.0)
            image = render.render(scenes.scene(i / 30, scenes.planar(STEP_M * i, 0, 0), [box]), rng=rng)
            writer.write_frame(Frame(image, i / 30, i))
    with (folder / "wheels.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["t_s", "speed_m_s", "turn_rate_rad_s", "battery_V"])
        rows.writerows([[i / 10, 30 * STEP_M, 0.0, 12.0] for i in range(6)])
    return folder


def words(folder, *more):
    return [
        "sense", "scene", "--config", str(folder / "scene.yaml"), "--source", str(folder / "frames.mcap"),
        *map(str, more),
    ]  # fmt: skip


@pytest.mark.parametrize("wheels", [False, True])
def test_a_drive_towards_a_box(folder, capsys, wheels) -> None:
    from mcap_ros2.reader import read_ros2_messages

    more = ["--odometry", folder / "wheels.csv"] if wheels else []
    out = ["--out", folder / "run.mcap", "--csv", folder / "run.csv", "--mask", "--json"]
    out += ["--plot", folder / "run.svg"]
    assert main(words(folder, *out, *more)) == 0
    result = json.loads(capsys.readouterr().out)
    way = STEP_M * (FRAMES - 1)
    assert result["frames"] == FRAMES
    assert result["reasons"] == {"not_zeroed": 1, "ok": FRAMES - 1}
    # One per cent of the way, and three declared sigmas.
    assert result["pose"]["x_m"] == pytest.approx(way, abs=0.01 * way)
    assert abs(result["pose"]["x_m"] - way) < 3 * result["pose_sigma"]["x_m"] + 1e-4
    # 16 cm ahead of the foam, by its parallax: three declared sigmas of 2 mm.
    assert result["nearest_m"] == pytest.approx(0.30 - way - scenes.FRONT_M, abs=0.006)
    with (folder / "run.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == FRAMES
    assert rows[0]["valid"] == "false"
    assert rows[0]["obstacle_valid"] == "false"
    assert math.isnan(float(rows[0]["proximity_m"]))
    assert float(rows[-1]["x_m"]) == pytest.approx(result["pose"]["x_m"])
    assert rows[-1]["object_reason"] == "not_zeroed"
    drawn = (folder / "run.svg").read_text()  # matplotlib writes each text as a comment beside its outlines
    for text in ("position [cm]", "heading [deg]", "obstacle ahead [cm]", "invalid: not_zeroed"):
        assert f"<!-- {text} -->" in drawn
    assert "object [deg]" not in drawn  # nothing touches
    told = [m.ros_msg for m in read_ros2_messages(str(folder / "run.mcap"), topics=["/scene/pose"])]
    assert len(told) == FRAMES
    assert told[-1].pose.pose.position.x == pytest.approx(result["pose"]["x_m"])
    assert math.sqrt(told[-1].pose.covariance[0]) == pytest.approx(result["pose_sigma"]["x_m"])
    assert told[-1].pose.covariance[35] > 0
    masks = list(read_ros2_messages(str(folder / "run.mcap"), topics=["/scene_obstacles/image/compressed"]))
    assert len(masks) == FRAMES


def test_help_has_an_example(capsys) -> None:
    assert main(["sense", "scene", "--help"]) == 0
    assert "visuohaptic sense scene --config scene.yaml --source" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "more", "text"),
    [
        ({"camera": None}, [], "expected either sensor, or camera and T_camera_foam"),
        ({"floor_below_m": -1}, [], "floor_below_m"),
        ({"camera": "absent.yaml"}, [], "absent.yaml"),
        ({"sensor": "sensor.yaml", "camera": None, "T_camera_foam": None}, [], "sensor.yaml"),
        ({}, ["--zero-frames", 3], "names no sensor"),
        ({}, ["--start", 99], "no frame"),
        ({}, ["--csv", "table.txt"], "expected .csv"),
        ({}, ["--plot", "scene.txt"], "expected .png, .pdf or .svg"),
    ],
)
def test_bad_input_is_one_line(folder, capsys, change, more, text) -> None:
    import yaml

    fields = yaml.safe_load((folder / "scene.yaml").read_text()) | change
    save_yaml(folder / "bad.yaml", {k: v for k, v in fields.items() if v is not None})
    line = words(folder, *more)
    line[3] = str(folder / "bad.yaml")
    assert main(line) == 2
    error = capsys.readouterr().err
    assert text in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ("t_s,speed_m_s\n0,1\n", "missing: turn_rate_rad_s"),
        ("t_s,speed_m_s,turn_rate_rad_s\n0,1,x\n", "line 2, turn_rate_rad_s"),
        ("t_s,speed_m_s,turn_rate_rad_s\n0,1,0\n0,1,0\n", "line 3, t_s"),
        ("t_s,speed_m_s,turn_rate_rad_s\n", "no rows"),
    ],
)
def test_bad_odometry_is_one_line(folder, capsys, table, text) -> None:
    (folder / "bad.csv").write_text(table)
    assert main(words(folder, "--odometry", folder / "bad.csv")) == 2
    assert text in capsys.readouterr().err
