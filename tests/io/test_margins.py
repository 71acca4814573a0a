"""Limits of readers, from both sides: what a recording may be, and what only another unit or place explains."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError, LaserScan, Pose
from visuohaptic.io import OccupancyMap, indices_from_times
from visuohaptic.io.depth.poses import StampedPose, stamped_matrix
from visuohaptic.io.depth.transforms import FrameMotion
from visuohaptic.io.laser_scans import _from_scanner, _joined
from visuohaptic.io.meshes import split_edges
from visuohaptic.io.source import RecordedSource


def test_intervals_are_regular_within_a_fifth_of_a_period() -> None:
    """Every third frame follows after two lost ones; jitter moves it by this fraction of its interval."""
    for jitter, regular in ((0.18, True), (0.22, False)):
        times = np.cumsum([0.0, *[0.1, 0.1, 0.2 * (1.0 + jitter)] * 6])
        found = indices_from_times(times)
        assert found[-1] == (24 if regular else 18)


class ArraySource(RecordedSource):
    """Frames without images."""

    def _images(self, chosen):
        return iter(())


def test_frames_of_a_fast_camera_in_milliseconds_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """A camera of 190 Hz has an interval of 5.3 ms; one image in 4.6 s is a slow recording."""
    for step, told in ((4.6, False), (1000.0 / 190.0, True)):
        caplog.clear()
        ArraySource("run", step * np.arange(5.0))
        assert ("expected times in seconds" in caplog.text) == told


@pytest.mark.parametrize(("off", "kept"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_rotation_that_is_rounded_to_three_digits_is_one(off: float, kept: bool) -> None:
    """A common factor of all entries moves the largest, 1, by the most."""
    matrix = np.hstack([(1.0 + off) * np.eye(3), np.zeros((3, 1))])
    assert (stamped_matrix(matrix, "row 1").pose is not None) == kept


@pytest.mark.parametrize(("gap", "known"), [(1.9, True), (2.1, False)])
def test_a_pose_is_interpolated_over_one_lost_message(gap: float, known: bool) -> None:
    times = [0.0, 0.2, 0.4, 0.4 + 0.2 * gap, 0.6 + 0.2 * gap]
    motion = FrameMotion([StampedPose(t_s, Pose.identity()) for t_s in times]).finish()
    pose, _ = motion.at(0.4 + 0.1 * gap)
    assert (pose is not None) == known


@pytest.mark.parametrize(("degrees", "level"), [(4.6, True), (5.4, False)])
def test_a_scanner_is_level_within_five_degrees(degrees: float, level: bool) -> None:
    scans = [(LaserScan(0.0, np.ones(3), -1.0, 1.0, 0.05, 20.0), (0.0, 0.0, 0.0))]
    tilted = Pose.from_rotation_vector([0.0, math.radians(degrees), 0.0], [0.0, 0.0, 0.0])
    if level:
        assert len(_from_scanner(Path("a.mcap"), scans, tilted)) == 1
        return
    with pytest.raises(InputError, match="expected a horizontal one"):
        _from_scanner(Path("a.mcap"), scans, tilted)


def test_a_scan_a_quarter_of_a_second_beside_the_odometry_has_a_place() -> None:
    """Odometry of 4 Hz has no message for this long; a scan beyond is of another time."""
    scans = [LaserScan(t_s, np.ones(3), -1.0, 1.0, 0.05, 20.0) for t_s in (-0.27, -0.23, 1.23, 1.27)]
    pairs = _joined(Path("a.mcap"), scans, np.array([0.0, 1.0]), np.zeros((2, 3)))
    assert [scan for scan, _ in pairs] == scans[1:3]


def test_cells_wider_than_a_door_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Doors have 0.7 to 0.9 m."""
    OccupancyMap(np.zeros((4, 4), np.int8), 0.05, (0.0, 0.0, 0.0)).save(tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text()
    for resolution, told in (("0.7", False), ("0.9", True)):
        (tmp_path / "map.yaml").write_text(text.replace("resolution: 0.05", f"resolution: {resolution}"))
        caplog.clear()
        OccupancyMap.load(tmp_path / "map.yaml")
        assert ("more than a door" in caplog.text) == told


@pytest.mark.parametrize(("facets", "smooth"), [(6, True), (5, False)])
def test_a_tube_of_six_facets_is_smooth_and_one_of_five_is_not(facets: int, smooth: bool) -> None:
    """The normals of a vertex and its facets differ by half the angle between facets, 30 and 36 degrees: new points of a smooth tube bulge."""
    angle = 2.0 * np.pi * np.arange(facets) / facets
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.vstack([np.column_stack([ring, np.full(facets, z)]) for z in (0.0, 1.0, 2.0)])
    k = np.arange(2 * facets)
    right = k // facets * facets + (k + 1) % facets
    faces = np.vstack(
        [np.column_stack([k, right, right + facets]), np.column_stack([k, right + facets, k + facets])]
    )
    points, _ = split_edges(
        vertices, faces, 0.9 * 2.0 * np.sin(np.pi / facets), np.zeros(len(vertices), bool)
    )[:2]
    x, y = points[len(vertices) :, :2].T
    between = np.abs(np.mod(np.arctan2(y, x) * facets / (2.0 * np.pi), 1.0) - 0.5) < 0.1
    radius = np.hypot(x, y)[between]
    on_chord = np.cos(np.pi / facets)
    assert (radius.max() > on_chord + 0.3 * (1.0 - on_chord)) == smooth
