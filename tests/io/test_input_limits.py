"""Where input is refused, warned of or left out: just inside and just outside of each limit that decides it."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from visuohaptic.core import Camera, InputError, LaserScan, Pose
from visuohaptic.io import indices_from_times
from visuohaptic.io.depth import DepthFrame, DepthSequence, StampedPose, _conventions, write_sequence
from visuohaptic.io.depth.poses import stamped_matrix
from visuohaptic.io.depth.transforms import FrameMotion
from visuohaptic.io.laser_scans import _joined
from visuohaptic.io.maps import FREE, OccupancyMap
from visuohaptic.io.source import RecordedSource

CAMERA = Camera.simple(40, 30, 35.0)


def judged(monkeypatch: pytest.MonkeyPatch, read: float, other: float, pairs: int = 3) -> None:
    """Pairs of views that disagree by ``read``, and by ``other`` with inverted poses (fractions of the depth)."""

    def misfit(camera: object, one: object, two: object, meant: object, factor: object) -> float:
        return other if meant is Pose.inverse else read if meant is _conventions._same else 1.0

    monkeypatch.setattr(_conventions, "_misfit", misfit)
    view = (np.zeros((30, 40), np.float32), Pose.identity())
    _conventions.check_conventions(Path("s"), CAMERA, [[view] * (pairs + 1)])


def test_another_convention_is_named_if_three_pairs_fit_it_clearly(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="the poses are world to camera, but differ by 6"):
        judged(monkeypatch, 0.06, 0.0185)
    judged(monkeypatch, 0.09, 0.0215)  # no better than a bad camera
    judged(monkeypatch, 0.0515, 0.0185)  # 2.8 times: not clearly
    judged(monkeypatch, 0.06, 0.0185, pairs=2)


def test_views_are_compared_beside_each_other_along_the_whole_sequence() -> None:
    assert _conventions.compared(19) == [[0, 1, 3, 9], [4, 5, 7, 13], [9, 10, 12, 18]]
    assert _conventions.compared(4) == [[0, 1], [1, 2], [2, 3]]


@pytest.mark.parametrize(("step_m", "refused"), [(3.7, False), (4.3, True)])
def test_a_camera_does_not_move_by_four_depths_between_frames(
    tmp_path: Path, step_m: float, refused: bool
) -> None:
    depth = np.full((30, 40), 1.0, np.float32)
    poses = (Pose(np.eye(3), np.array([k * step_m, 0.0, 0.0])) for k in range(3))
    write_sequence(tmp_path / "s", (DepthFrame(0.1 * k, depth, None, p, CAMERA) for k, p in enumerate(poses)))
    if refused:
        with pytest.raises(InputError, match="check that poses are in metres"):
            DepthSequence(tmp_path / "s")
    else:
        assert len(DepthSequence(tmp_path / "s")) == 3


def test_a_matrix_may_be_rounded_to_a_thousandth() -> None:
    for off, usable in ((0.9e-3, True), (1.1e-3, False)):
        # Stretched along x: the nearest rotation is the identity.
        found = stamped_matrix(np.diag([1.0 + off, 1.0, 1.0, 1.0]), "line 1")
        assert (found.pose is not None) is usable


def test_transforms_are_interpolated_where_none_is_lost() -> None:
    for gap_s, known in ((0.37, True), (0.43, False)):  # at 5 Hz; two intervals
        times_s = np.concatenate([0.2 * np.arange(8), 1.4 + gap_s + 0.2 * np.arange(8)])
        motion = FrameMotion([StampedPose(t_s, Pose.identity()) for t_s in times_s]).finish()
        assert (motion.at(1.4 + gap_s / 2)[0] is not None) is known


def test_scans_before_the_odometry_are_kept_for_a_quarter_of_a_second() -> None:
    scans = [LaserScan(t_s, np.ones(3), 0.0, 0.1) for t_s in (4.73, 4.77, 5.5, 6.23, 6.27)]
    kept = _joined(Path("r.mcap"), scans, np.array([5.0, 6.0]), np.zeros((2, 3)))
    assert [scan.t_s for scan, _ in kept] == pytest.approx([4.77, 5.5, 6.23])


def test_cells_wider_than_a_door_are_warned_about(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name, size_m, warns in (("a", 0.77, False), ("b", 0.83, True)):
        caplog.clear()
        OccupancyMap(np.full((3, 3), FREE, np.int8), size_m).save(tmp_path / f"{name}.yaml")
        OccupancyMap.load(tmp_path / f"{name}.yaml")
        assert ("more than a door" in caplog.text) is warns


def test_a_lens_wider_than_137_degrees_is_warned_about(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for focal_px, warns in ((8.3, False), (7.7, True)):  # of 40 px
        caplog.clear()
        Camera.simple(40, 30, focal_px).save(tmp_path / "camera.yaml")
        Camera.load(tmp_path / "camera.yaml")
        assert ("is it in millimetres?" in caplog.text) is warns


def test_frames_count_as_regular_within_a_fifth_of_the_period() -> None:
    for jitter, gaps in ((0.18, True), (0.22, False)):
        # Every fourth interval is longer, the next one as much shorter; a frame is lost in the middle.
        steps = np.tile([1.0, 1.0, 1.0 + jitter, 1.0 - jitter], 10)
        steps[20] = 2.0
        indices = indices_from_times(np.concatenate([[0.0], 0.1 * np.cumsum(steps)]))
        assert indices[-1] == (41 if gaps else 40)


def test_frames_more_than_five_seconds_apart_are_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    class Frames(RecordedSource):
        def _images(self, chosen: object) -> SimpleNamespace:
            pytest.fail("no image is read")

    for step_s, warns in ((4.8, False), (5.2, True)):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            Frames("frames", step_s * np.arange(4), camera=None, start_s=0.0, stop_s=float("inf"))
        assert ("expected times in seconds" in caplog.text) is warns
