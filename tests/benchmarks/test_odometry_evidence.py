"""Counting in the campaign of sequences without poses."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.worlds.ray_scenes import FAMILIES, layout

from benchmarks import odometry_evidence
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.reconstruction.fusion import sensor_noise


def test_errors_are_those_of_camera_centres_relative_to_the_first_view(monkeypatch):
    """Views that all turn and shift together have no error; the last one is 3 mm off, and one has no pose."""
    true = np.array([Camera.pose_of_view([0.1 * k, -0.5, 0.4], [0.0, 0.0, 0.0]).matrix for k in range(4)])
    common = Camera.pose_of_view([1.0, 2.0, 0.5], [0.0, 0.0, 0.0]).matrix
    found = [SimpleNamespace(pose=Pose.from_matrix(common @ pose), sigma_m=0.001) for pose in true]
    found[1].pose = None
    found[3].pose = Pose(found[3].pose.rotation, np.add(found[3].pose.translation_m, [0.0, 0.003, 0.0]))
    monkeypatch.setattr(odometry_evidence, "estimate_poses", lambda *_: SimpleNamespace(poses=found, text=""))
    row = odometry_evidence.compared([], true, Camera.simple(16, 12, 14.0), sensor_noise("kinect"))
    assert row["posed"] == pytest.approx(0.75)
    assert row["error_m"] == pytest.approx([0.0, 0.003], abs=1e-9)
    assert row["turn_rad"] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_figures_tell_refused_sequences_from_wrong_ones():
    rows = [
        {"kind": "objects", "error_m": error_m, "sigma_m": [0.001] * len(error_m)}
        for error_m in ([0.003, 0.004], [0.001, 0.02], [], [0.001])
    ]
    by_name = {figure["name"]: figure["ours"] for figure in odometry_evidence.figures(rows)}
    assert by_name["objects: sequences with poses"] == pytest.approx(0.75)
    assert by_name["objects: sequences with wrong poses"] == pytest.approx(0.25)
    assert by_name["objects: rms error"] == pytest.approx(1e3 * np.sqrt(12.5e-6))
    assert by_name["objects: rms error / declared"] == pytest.approx(np.sqrt(12.5 / 3))


def test_a_walk_has_24_to_60_views_of_its_kind_of_table():
    plans = [layout("walk", seed) for seed in range(0, 64, 2)]
    assert {len(plan.T_world_camera) for plan in plans} == {24, 36, 48, 60}
    for plan in plans:
        objects = len(plan.objects) + len(plan.boxes) - 2  # table and floor
        assert len(plan.vessels) == (plan.kind == "glass")
        low, high = {"objects": (3, 6), "glass": (4, 4), "can": (1, 1), "bare": (0, 0)}[plan.kind]
        assert low <= objects <= high
    assert {plan.kind for plan in plans} == set(FAMILIES["walk"])
