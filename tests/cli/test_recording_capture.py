"""``recording capture``: poses are those of the camera, in the frame of the tag with z up."""

from __future__ import annotations

import json
import os
import signal
from unittest import mock

import numpy as np
import pytest
from tests.cli.capture_camera import SIZE_M, TableCamera, connected

from visuohaptic.cli.main import main
from visuohaptic.io.depth import DepthSequence, write_depth

WORDS = ["recording", "capture", "--source", "realsense:", "--size-m", str(SIZE_M), "--out"]


def test_a_sequence_has_the_true_poses_and_depth(tmp_path, capsys):
    out = tmp_path / "scan"
    with connected(TableCamera(hidden=(3,))) as camera:
        assert main([*WORDS, str(out), "--tag", "7", "--count", "4", "--every", "0.1", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 4
    assert result["skipped"] >= 1
    frames = list(DepthSequence(out))
    for frame in frames:
        truth = camera.poses[round(10 * frame.t_s)]
        # 0.1 px of 0.08 m at 600 px and 0.46 m: 0.3 mrad across, some mrad of tilt over the tag's width.
        np.testing.assert_allclose(frame.T_world_camera.translation_m, truth.translation_m, atol=3e-3)
        np.testing.assert_allclose(frame.T_world_camera.rotation, truth.rotation, atol=8e-3)
    points_m = frames[0].camera.rays(np.array([[320.0, 240.0]])) * frames[0].depth_m[240, 320]
    (point_m,) = frames[0].T_world_camera.apply(points_m)
    assert abs(point_m[2]) < 3e-3  # on the table


def test_a_tag_that_is_not_there_is_named(tmp_path, capsys):
    with connected(TableCamera(tag=3)):
        assert main([*WORDS, str(tmp_path / "scan"), "--tag", "7", "--count", "1"]) == 2
    assert "tag 7: was not detected" in capsys.readouterr().err
    assert not (tmp_path / "scan").exists()


def test_ctrl_c_while_an_image_is_written_ends_the_recording(tmp_path, capsys):
    """The image that is being written is the last one, and the sequence is complete."""

    def write(*words: object) -> None:
        write_depth(*words)
        os.kill(os.getpid(), signal.SIGINT)

    with connected(), mock.patch("visuohaptic.io.depth.depth_sequence_out.write_depth", write):
        assert main([*WORDS, str(tmp_path / "scan"), "--tag", "7", "--every", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 1
    assert len(list(DepthSequence(tmp_path / "scan"))) == 1


@pytest.mark.parametrize("source", ["0", "push.mp4"])
def test_another_source_is_refused(tmp_path, capsys, source):
    words = [
        "recording",
        "capture",
        "--source",
        source,
        "--tag",
        "7",
        "--size-m",
        "0.08",
        "--out",
        str(tmp_path / "scan"),
    ]
    assert main(words) == 2
    assert "is not a depth camera, expected one of realsense:, orbbec:" in capsys.readouterr().err
