"""Frames written as a sequence folder are read back unchanged."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame, DepthSequence, write_sequence

CAMERA = Camera.simple(20, 16, 30.0)


def frames(count=3):
    rng = np.random.default_rng(0)
    for k in range(count):
        depth_m = rng.uniform(0.5, 3.0, (16, 20)).astype(np.float32)
        depth_m[0, k] = np.nan
        color = rng.integers(0, 255, (16, 20, 3), dtype=np.uint8)
        yield DepthFrame(
            0.1 * k, depth_m, color, Pose.from_rotation_vector([0, 0, 0.1 * k], [0.01 * k, 0, 0]), CAMERA
        )


def test_what_is_written_is_read(tmp_path):
    assert write_sequence(tmp_path / "scan", frames(), sensor="kinect") == 3
    sequence = DepthSequence(tmp_path / "scan")
    assert sequence.sensor == "kinect"
    for told, found in zip(frames(), sequence, strict=True):
        # Units of 0.1 mm round by half of one.
        np.testing.assert_allclose(found.depth_m, told.depth_m, atol=0.51e-4)
        np.testing.assert_array_equal(found.color, told.color)
        np.testing.assert_allclose(found.T_world_camera.matrix, told.T_world_camera.matrix, atol=1e-6)
        assert found.t_s == pytest.approx(told.t_s)


def test_nothing_to_write_and_a_folder_in_use_are_refused(tmp_path):
    with pytest.raises(InputError, match="no frames"):
        write_sequence(tmp_path / "none", [])
    write_sequence(tmp_path / "scan", frames())
    with pytest.raises(InputError, match="not empty"):
        write_sequence(tmp_path / "scan", frames())


def test_depths_beyond_the_largest_unit_are_told(tmp_path, caplog):
    """Units of 0.1 mm end at 6.5534 m: the one pixel of 320 that is farther is not measured, and that is told."""
    wall_m = np.full((16, 20), 6.5, np.float32)
    wall_m[3, 4] = 6.6
    write_sequence(tmp_path / "scan", [DepthFrame(0.0, wall_m, None, Pose.identity(), CAMERA)])
    (found,) = DepthSequence(tmp_path / "scan")
    assert np.argwhere(np.isnan(found.depth_m)).tolist() == [[3, 4]]
    assert "0.312 % of the pixels are farther than 6.55 m" in caplog.text
    caplog.clear()
    write_sequence(tmp_path / "near", [DepthFrame(0.0, 0.9 * wall_m, None, Pose.identity(), CAMERA)])
    assert not caplog.text
