"""Odometry in scenes of boxes that are cast here: true poses, standard deviations, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame, DepthSequence, write_sequence
from visuohaptic.reconstruction.fusion import sensor_noise
from visuohaptic.reconstruction.odometry import estimate_poses

pytest.importorskip("small_gicp")

CAMERA = Camera.simple(160, 120, 140.0)
#: Corners of boxes on a floor: a corner of a room with furniture.
ROOM = [
    ([-3, -3, -0.1], [3, 3, 0]),
    ([0.5, -3, 0], [0.6, 3, 2]),
    ([-3, 0.6, 0], [3, 0.7, 2]),
    ([0.0, 0.0, 0], [0.2, 0.15, 0.25]),
    ([-0.3, 0.2, 0], [-0.1, 0.4, 0.15]),
    ([0.2, -0.35, 0], [0.4, -0.2, 0.35]),
]
FLOOR = ROOM[:1]


def cast(boxes: list, pose: Pose, rng: np.random.Generator) -> np.ndarray:
    """Depth image of boxes by their slabs, with the noise of a stereo camera."""
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    fx, fy, cx, cy = CAMERA.matrix[0, 0], CAMERA.matrix[1, 1], CAMERA.matrix[0, 2], CAMERA.matrix[1, 2]
    rays = (
        np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(columns.shape)], axis=-1) @ pose.rotation.T
    )
    nearest = np.full(columns.shape, np.inf)
    with np.errstate(divide="ignore"):
        for low, high in boxes:
            ends = (np.array([low, high])[:, None, None] - pose.translation_m) / rays
            enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    nearest = np.where(
        nearest < 3.0, nearest + 0.002 * nearest**2 * rng.standard_normal(nearest.shape), np.nan
    )
    return nearest.astype(np.float32)


def path(count: int) -> list[Pose]:
    """An arc around the furniture, up and down."""
    turn = np.radians(215 + 8.0 * np.arange(count))
    eyes = np.stack([0.9 * np.cos(turn), 0.9 * np.sin(turn), 0.7 + 0.05 * np.sin(2 * turn)], axis=1)
    return [Camera.pose_of_view(eye, [0.05, 0.05, 0.1]) for eye in eyes]


def test_a_camera_in_a_room_finds_its_way_and_says_how_well() -> None:
    rng, true = np.random.default_rng(3), path(3)
    depths = [cast(ROOM, pose, rng) for pose in true]
    depths.insert(1, np.full((CAMERA.height, CAMERA.width), np.nan, np.float32))
    found = estimate_poses(depths, CAMERA, sensor_noise("realsense_d435"))
    assert found.poses.pop(1).problem == "not one depth is valid"
    errors, sigmas = [], []
    for pose, one in zip(true, found.poses, strict=True):
        assert one.pose is not None, one.problem
        away = (true[0].inverse() @ pose).inverse() @ one.pose
        errors.append(away.translation_m)
        sigmas.append(one.sigma_m)
    assert sigmas[0] == 0.0
    rms, said = np.sqrt(np.mean(np.square(errors[1:]))), np.sqrt(np.mean(np.square(sigmas[1:])))
    assert rms < 0.002
    assert 0.3 < rms / said < 3.0


def test_a_floor_alone_gives_no_pose(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its images fit wherever the camera is: no pose is better than any of them."""
    rng = np.random.default_rng(4)
    true = [Camera.pose_of_view([0.04 * k, 0.0, 0.8], [0.04 * k, 0.3, 0.0]) for k in range(2)]
    frames = [DepthFrame(k / 30, cast(FLOOR, pose, rng), None, pose, CAMERA) for k, pose in enumerate(true)]
    write_sequence(tmp_path / "true", frames, sensor="realsense_d435")
    words = [
        "recording",
        "import",
        str(tmp_path / "true"),
        "--poses",
        "odometry",
        "--out",
        str(tmp_path / "scan"),
    ]
    assert main(words) == 0
    assert "image 1 has no pose, the surfaces do not determine it" in capsys.readouterr().out
    sequence = DepthSequence(tmp_path / "scan")
    assert [stamped.pose is not None for stamped in sequence.stamped] == [True, False]
    assert sequence.poses_source.startswith("odometry: 1 of 2 poses")
    assert np.isnan(sequence.pose_sigma[1:]).all()
    assert main(["recording", "info", str(tmp_path / "scan"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["without_pose"], said["poses"]) == (1, sequence.poses_source)


def test_less_than_two_images_are_refused() -> None:
    empty = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    with pytest.raises(InputError, match="found 0 images with depths, expected at least two"):
        estimate_poses([empty, None], CAMERA)
