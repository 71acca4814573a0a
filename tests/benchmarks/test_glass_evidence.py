"""Counting in the campaigns of clear glass, and a slice of one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from tests.worlds.ray_meshes import distance_to_mesh, partly_seen, probe_mesh
from tests.worlds.ray_objects import random_vessel
from tests.worlds.ray_scenes import layout, sequence
from tests.worlds.rays import DepthCamera

from benchmarks import _touch_evidence, glass_evidence
from visuohaptic.io.depth import DepthSequence

SMALL = DepthCamera(96, 72, 83.0)


@pytest.fixture
def scene():
    """Two vessels, and views that nobody looks at."""
    placed = layout("clear", 0)
    small = sequence("opaque", 0, camera=DepthCamera(16, 12, 14.0))
    return replace(
        small, vessels=placed.vessels, depth_m=small.depth_m[:1], T_world_camera=small.T_world_camera[:1]
    )


def _found(monkeypatch, centroids, panes=()):
    regions = [SimpleNamespace(centroid_m=np.array(centroid), body=None) for centroid in centroids]
    result = SimpleNamespace(regions=regions, panes=panes, search=SimpleNamespace(text=""))
    monkeypatch.setattr(glass_evidence, "reconstruct", lambda *_, **__: result)


def test_a_vessel_is_found_by_a_centroid_in_its_grown_box_and_other_regions_are_false(scene, monkeypatch):
    first, second = scene.vessels
    near = np.add(first.bounds_m.mean(axis=0), [0.004, 0.003, 0.0])
    beyond = np.append(second.position_m[:2], second.bounds_m[1, 2] + 0.02)
    _found(monkeypatch, [near, beyond])
    row = glass_evidence.detect(scene)
    assert row["error_m"] == [pytest.approx(0.005), None]
    assert row["false"] == 1
    _found(monkeypatch, [beyond - [0, 0, 0.01]])
    row = glass_evidence.detect(scene)
    assert row["error_m"] == [None, pytest.approx(0.0)]
    assert row["false"] == 0
    _found(monkeypatch, [beyond - [0, 0, 0.01]], panes=("between two vessels",))
    assert glass_evidence.detect(scene)["false"] == 1


def test_one_region_is_not_two_vessels(scene, monkeypatch):
    rng = np.random.default_rng(0)
    close = tuple(random_vessel("glass", rng, (x, 0.0)) for x in (-0.04, 0.04))
    _found(monkeypatch, [[0.001, 0.0, 0.05]])
    row = glass_evidence.detect(replace(scene, vessels=close))
    assert sum(error is not None for error in row["error_m"]) == 1


def test_a_scene_is_a_sequence_folder_for_everybody(scene, tmp_path):
    glass_evidence.save_folder(scene, tmp_path / "scan")
    (frame,) = DepthSequence(tmp_path / "scan")
    assert np.allclose(frame.depth_m, scene.depth_m[0], atol=1e-6, equal_nan=True)
    pose = scene.T_world_camera[0]
    assert frame.T_world_camera.translation_m == pytest.approx(pose[:3, 3], abs=1e-6)
    assert frame.T_world_camera.rotation == pytest.approx(pose[:3, :3], abs=1e-6)


def test_figures_count_every_vessel_and_every_false_region():
    row = {"kind": "pair", "vessels": ["glass", "jar"], "views": 8, "variant": "in order"}
    rows = [row | {"error_m": [0.002, None], "false": 1}, row | {"error_m": [0.004, 0.012], "false": 0}]
    by_name = {figure["name"]: figure["ours"] for figure in glass_evidence.summary("found", rows)}
    assert by_name["found, 8 views in order: vessels found"] == pytest.approx(0.75)
    assert by_name["found, 8 views in order: false regions per scene"] == pytest.approx(0.5)
    assert by_name["found, 8 views in order: position error, p90"] == pytest.approx(10.4)  # of 2, 4 and 12 mm


def test_close_scenes_count_where_all_are_found_and_nothing_twice(scene, monkeypatch):
    rows = []
    for kind, errors, split in (("row", [0.002, 0.009], 0), ("row", [0.002, 0.011], 0), ("stem", [0.003], 1)):
        told = {"kind": kind, "vessels": ["glass"] * len(errors), "views": 8, "variant": "in order"}
        rows.append(told | {"error_m": errors, "false": 0, "split": split})
    by_name = {figure["name"]: figure["ours"] for figure in glass_evidence.summary("close", rows)}
    assert by_name["close, 8 views in order: pairs all found within 10 mm"] == pytest.approx(0.5)
    assert by_name["close, 8 views in order: pairs with a region too many"] == pytest.approx(0.0)
    assert by_name["close, 8 views in order: single vessels all found within 10 mm"] == pytest.approx(1.0)
    assert by_name["close, 8 views in order: single vessels with a region too many"] == pytest.approx(1.0)
    near = scene.vessels[0].bounds_m.mean(axis=0)
    _found(monkeypatch, [near, np.add(near, [0.0, 0.0, 0.01])])
    assert glass_evidence.detect(scene)["split"] == 1


def test_a_declared_rate_is_held_within_chance():
    rows = [
        {"rate": rate, "false": int(abs(rate - 0.1) < 1e-9)}
        for rate in glass_evidence.RATES
        for _ in range(50)
    ]
    notes = [figure["note"] for figure in glass_evidence.declared_figures(rows)]
    assert [note.endswith(", held") for note in notes] == [True, False, True]


def test_a_slice_runs_and_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(
        glass_evidence, "sequence", lambda family, seed, _: sequence(family, seed, camera=SMALL, ring=8)
    )
    options = {"views": (8,), "variants": ("in order",), "journal": tmp_path / "rows.jsonl"}
    rows = glass_evidence.campaign("false", [0], **options)
    assert rows[0]["error_m"] == []
    assert rows[0]["reason"]
    monkeypatch.setattr(glass_evidence, "sequence", lambda *_: pytest.fail("rendered again"))
    assert glass_evidence.campaign("false", [0], **options) == rows


def test_an_object_seen_from_one_side_hides_its_other_side(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    ball.export(tmp_path / "ball.stl")
    seen = partly_seen(tmp_path / "ball.stl", np.random.default_rng(0), noise_m=0.0)
    centre = np.array([0, 0, 0.05])
    assert np.linalg.norm(seen.hidden_m - centre, axis=1) == pytest.approx(0.05, abs=2e-4)
    # Seen is the cap that faces the eye, hidden what does not.
    towards = (seen.vertices_m - centre).mean(axis=0)
    assert ((seen.hidden_m - centre) @ towards < 0.4 * 0.05 * np.linalg.norm(towards)).all()
    ends = partly_seen(tmp_path / "ball.stl", np.random.default_rng(0), "middle")
    assert ((ends.hidden_m[:, 2] > 0.026) & (ends.hidden_m[:, 2] < 0.074)).all()
    contact = probe_mesh(seen.mesh, np.array([0.3, 0.0, 0.05]), centre)
    assert contact == pytest.approx([0.05, 0, 0.05], abs=2e-4)
    assert probe_mesh(seen.mesh, np.array([0.3, 0.0, 0.15]), np.array([0.0, 0.0, 0.15])) is None
    away = distance_to_mesh(
        np.array([[0.3, 0, 0.05]]), np.asarray(seen.mesh.vertices), np.asarray(seen.mesh.faces)
    )
    assert away == pytest.approx([0.25], abs=2e-4)


def test_touches_on_an_object_are_counted_and_measured(tmp_path):
    trimesh.creation.cylinder(0.04, 0.15, sections=64).export(tmp_path / "can.stl")
    row = _touch_evidence.touch_object(partly_seen(tmp_path / "can.stl", np.random.default_rng(1)), 0)
    row["hidden"] = "back"
    assert row["planned"] == _touch_evidence.TOUCHES
    assert row["rms_m"][1] < row["rms_m"][0]
    figures = {figure["name"]: figure["ours"] for figure in _touch_evidence.object_figures([row])}
    assert figures["objects, back hidden: never worse than before"] == 1.0
    assert figures["objects, back hidden: planned touches that meet"] == pytest.approx(
        row["met"] / row["planned"]
    )
