"""``visuohaptic track`` and ``visuohaptic template ...`` on the command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.tracking.templates import Template

CAMERA = Camera.simple(320, 240, 450.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames of a tag that moves, its description, and a camera file."""
    folder = tmp_path_factory.mktemp("track")
    tag = Template.from_tag(9, size_m=0.04)
    (folder / "templates").mkdir()
    (folder / "templates" / "tags.yaml").write_text("tags: {tool: {id: 9, size_m: 0.04}}\n")
    CAMERA.save(folder / "camera.yaml")
    (folder / "frames").mkdir()
    for k in range(5):
        pose = Pose.from_rotation_vector([0.3, -0.2, 0.1 * k], [0.002 * k, 0.0, 0.2])
        corners = CAMERA.project(pose.apply(tag.points_m(tag.esm.corners))).astype(np.float32)
        matrix = cv2.getPerspectiveTransform(tag.esm.corners.astype(np.float32), corners)
        # Four times the size, then averaged: what pixels with an area see.
        fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ matrix
        image = cv2.warpPerspective(tag.image, fine, (1280, 960), borderValue=150, flags=cv2.INTER_LINEAR)
        image = cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA)
        assert cv2.imwrite(str(folder / "frames" / f"{k:03d}.png"), image)
    return folder


def test_track_writes_poses(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["track", "--templates", folder / "templates", "--source", folder / "frames", "--rate-Hz", 30]
    words += ["--camera", folder / "camera.yaml", "--out", folder / "poses.mcap", "--csv", folder / "p.csv"]
    words += ["--plot", folder / "p.svg"]
    assert main(["--json", *map(str, words)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 5
    assert result["seen"] == {"tool": 5}
    with (folder / "p.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 5
    for k, row in enumerate(rows):
        assert row["valid"] == "1"
        assert float(row["x_m"]) == pytest.approx(0.002 * k, abs=2e-5)
        assert float(row["z_m"]) == pytest.approx(0.2, abs=5e-4)
        assert 0 < float(row["z_sigma_m"]) < 1e-3
    drawn = (folder / "p.svg").read_text()  # matplotlib writes each text as a comment beside its outlines
    assert all(f"<!-- {text} -->" in drawn for text in ("tool", "x [cm]", "distance z [cm]"))
    # An independent reader.
    from mcap_ros2.reader import read_ros2_messages

    messages = [
        m for m in read_ros2_messages(str(folder / "poses.mcap")) if m.channel.topic == "/template/tool"
    ]
    assert len(messages) == 5
    last = messages[-1].ros_msg
    assert last.pose.pose.position.z == pytest.approx(float(rows[-1]["z_m"]))
    assert np.array(last.pose.covariance).reshape(6, 6)[2, 2] == pytest.approx(
        float(rows[-1]["z_sigma_m"]) ** 2, rel=1e-6
    )


def test_track_refuses_a_folder_without_templates(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["track", "--templates", folder / "frames" / "none", "--source", folder / "frames"]
    assert main([*map(str, words), "--camera", str(folder / "camera.yaml")]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_template_check_and_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 255, (200, 300), dtype=np.uint8), (0, 0), 2)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    path = tmp_path / "noise.png"
    cv2.imwrite(str(path), image)
    assert main(["template", "check", str(path)]) == 2
    assert "states no resolution" in capsys.readouterr().err
    sheet = tmp_path / "sheet.pdf"
    assert main(["--json", "template", "check", str(path), "--width-m", "0.06", "--sheet", str(sheet)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["width_m"] == pytest.approx(0.06)
    assert result["score"] > 0.5
    assert sheet.read_bytes().startswith(b"%PDF")
    tags = tmp_path / "tags.png"
    assert main(["template", "sheet", "--ids", "0", "1", "--size-m", "0.04", "--out", str(tags)]) == 0
    assert "size_m: 0.04" in capsys.readouterr().out
    assert main(["template", "sheet", "--ids", "0", "--size-m", "9", "--out", str(tags)]) == 2
    assert "does not fit" in capsys.readouterr().err
