"""The floors used as evidence for obstacles, and a slice of their campaign."""

from __future__ import annotations

import numpy as np
import pytest
from tests.worlds import ground

from benchmarks import scene_evidence


@pytest.fixture(scope="module")
def tiles() -> ground.Drive:
    return ground.drive("tiles", 0, frames=4, box=True)


def test_the_floor_moves_as_the_platform_does(tiles: ground.Drive) -> None:
    """The same place of the floor has the same colour in two frames, found by the camera model of the library."""
    world = ground.Drive(tiles.floor, tiles.poses, np.random.default_rng(0))
    view = scene_evidence.floor_view()
    poses = np.array([[0.0, 0.0, 0.0], [0.08, 0.01, 0.1]])
    images = [world.image(pose, 0.0).astype(float) for pose in poses]
    x, y = np.meshgrid(np.linspace(0.28, 0.45, 30), np.linspace(-0.1, 0.1, 30))
    place = np.column_stack([x.ravel(), y.ravel()])
    grey = []
    for (px, py, theta), image in zip(poses, images, strict=True):
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        pixels = view.project((place - [px, py]) @ turn)
        u, v = np.rint(pixels).astype(int).T
        grey.append(image[v, u].mean(axis=1))
    # Joints are a few pixels wide and half a pixel is rounded away: they still agree, and would not when 5 mm off.
    assert np.corrcoef(grey)[0, 1] > 0.8


def test_the_box_stands_where_it_is_said_to(tiles: ground.Drive) -> None:
    assert tiles.box is not None
    free = ground.Drive(tiles.floor, tiles.poses, np.random.default_rng(0))
    changed = (
        np.abs(tiles.image(tiles.poses[0], 0.0).astype(float) - free.image(tiles.poses[0], 0.0)).max(axis=2)
        > 30
    )
    foot = scene_evidence.floor_view().project(tiles.box[:2] - tiles.poses[0, :2])
    middle = changed[:, round(float(foot[0]))]
    # One pixel of rounding and one of blur.
    assert np.flatnonzero(middle).max() == pytest.approx(foot[1], abs=2.0)


def test_a_slice_of_the_campaign_counts_alarms(tmp_path, monkeypatch, tiles: ground.Drive) -> None:
    monkeypatch.setattr(ground, "drive", lambda *_, **__: tiles)
    report = tmp_path / "scene.jsonl"
    rows = scene_evidence.campaign(count=1, only="tiles:box", report=report)
    assert len(rows[0]["frames"]) == 4
    assert scene_evidence.campaign(count=1, only="tiles:box", report=report) == rows
    made = {
        "floor": "grass",
        "kind": "free",
        "frames": [[True, 0.2, 0.01, None], [True, None, None, None]] * 30,
    }
    (line,) = scene_evidence.figures([made])
    assert line["name"] == "grass, free"
    assert line["ours"] == pytest.approx(900.0)  # every second of thirty frames a second


def test_a_plain_box_is_seen_from_30_cm_on_parquet() -> None:
    """Grain along the drive, and a box whose outlines alone are seen: 28.6 cm where each cell stands for itself."""
    drive = scene_evidence.run_drive("parquet", "plain", 0)["frames"]
    said = np.array([(near, sigma, x) for _, near, sigma, x in drive if near is not None])
    error = said[:, 0] - said[:, 2]
    assert said[:, 2].max() > 0.295  # 30.3 cm; a frame is 3 mm of the drive, a comparison up to 8 mm
    assert np.abs(error).max() < scene_evidence.RIGHT_M
    # One column of cells has a likelihood that is flat over 5 cm: 18 mm and 4.9 standard deviations by its curvature. Five
    # comparisons tell the rms to a third.
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.sqrt(np.mean((error / said[:, 1]) ** 2)) < 1.7
