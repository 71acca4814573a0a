from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError, MissingExtraError
from visuohaptic.deformation.maps import build, load_plan, plan_jobs

PLAN = """\
seed: 3
around: 16
states: [{closed: false}, {closed: true, fill: 0.5}]
classes:
  - {class: cup, variants: 3}
  - {class: mine.yaml, variants: 2}
"""
MINE = """\
name: mine
base: {shape: ellipse, radius: [30 mm, 40 mm], radius_y: 25 mm}
sections: [{height: [80 mm, 90 mm]}]
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    (tmp_path / "mine.yaml").write_text(MINE)
    (tmp_path / "classes.yaml").write_text(PLAN)
    return tmp_path / "classes.yaml"


def test_a_build_says_what_it_wrote(plan: Path, tmp_path: Path) -> None:
    jobs = plan_jobs(*load_plan(plan))
    seen: list[int] = []
    report = build(jobs, tmp_path / "out", progress=lambda done, total: seen.append(done))
    assert (report.objects, report.computed, report.failed) == (5, 5, ())
    assert seen == [0, 1, 2, 3, 4, 5]
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["content_sha256"] == report.content_sha256
    assert {"visuohaptic", "numpy"} <= set(manifest["versions"])
    with np.load(tmp_path / "out" / manifest["objects"][4]["file"], allow_pickle=False) as data:
        assert data["features"].shape == (2, 16, 4, 3)
        assert data["vertices_m"].shape[0] == data["stiffness_sigma_N_per_m"].shape[0]
        # An ellipse: what is enclosed makes it stiffer.
        assert (data["features"][1, 4:12, 2, 0] > data["features"][0, 4:12, 2, 0]).all()


def test_features_of_curves_on_request(plan: Path, tmp_path: Path) -> None:
    plan.write_text(PLAN.replace("variants: 3", "variants: 1").replace("variants: 2", "variants: 1"))
    linear = build(plan_jobs(*load_plan(plan)), tmp_path / "linear")
    plan.write_text(plan.read_text() + "nonlinear: {around: 16, heights: [4, 9, 14]}\n")
    jobs = plan_jobs(*load_plan(plan, nonlinear=True))
    assert {job.curve_heights for job in jobs} == {(4, 9, 14)}
    curved = build(jobs, tmp_path / "curved")
    assert curved.content_sha256 != linear.content_sha256
    with (
        np.load(tmp_path / "linear" / jobs[1].file, allow_pickle=False) as one,
        np.load(tmp_path / "curved" / jobs[1].file, allow_pickle=False) as two,
    ):
        assert np.isfinite(two["features"]).all()
        assert (one["features"][..., 2] == 0).all()
        assert (two["features"][..., 2] != 0).all()
        # Curves where they were asked for, departures in between.
        assert np.isfinite(two["curve_reached"]).any(axis=(0, 2)).nonzero()[0].tolist() == [3, 8, 13]
        # Enclosed air pushes back against a large pinch of the flat side.
        assert (two["features"][1, 5:12, 2, 1] > two["features"][0, 5:12, 2, 1]).all()


def test_what_is_there_is_kept_and_what_is_damaged_is_made_again(plan: Path, tmp_path: Path) -> None:
    jobs = plan_jobs(*load_plan(plan))
    first = build(jobs, tmp_path / "out")
    files = [tmp_path / "out" / job.file for job in jobs]
    files[0].unlink()
    files[1].write_bytes(files[1].read_bytes()[:1000])
    hurt = bytearray(files[2].read_bytes())
    hurt[len(hurt) // 2] ^= 0xFF
    files[2].write_bytes(hurt)
    (files[3].parent / ".cup-00000.x.part.npz").write_bytes(b"half")
    again = build(jobs, tmp_path / "out")
    assert again.computed == 3
    assert again.content_sha256 == first.content_sha256
    assert not list((tmp_path / "out").glob("*/.*.part.npz"))


def test_another_seed_or_setting_is_another_result(plan: Path, tmp_path: Path) -> None:
    jobs = plan_jobs(*load_plan(plan))
    first = build(jobs, tmp_path / "out")
    plan.write_text(PLAN.replace("seed: 3", "seed: 4"))
    other = build(plan_jobs(*load_plan(plan)), tmp_path / "out")
    assert other.computed == 5
    assert other.content_sha256 != first.content_sha256


def test_kill_9_loses_nothing(plan: Path, tmp_path: Path) -> None:
    whole = build(plan_jobs(*load_plan(plan)), tmp_path / "whole")
    code = (
        "import sys; from visuohaptic.deformation import *;"
        "build(plan_jobs(*load_plan(sys.argv[1])), sys.argv[2])"
    )
    command = [sys.executable, "-c", code, str(plan), str(tmp_path / "killed")]
    for objects in (1, 3):
        process = subprocess.Popen(command, env=os.environ)
        deadline = time.monotonic() + 300  # it ends a test that hangs; a busy machine starts a process late
        while len(list((tmp_path / "killed").glob("*/*.npz"))) < objects and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.wait()
    again = build(plan_jobs(*load_plan(plan)), tmp_path / "killed")
    assert again.content_sha256 == whole.content_sha256
    assert again.computed < 5


def test_processes_give_the_same_as_one(plan: Path, tmp_path: Path) -> None:
    plan.write_text(PLAN.replace("variants: 3", "variants: 1").replace("variants: 2", "variants: 1"))
    jobs = plan_jobs(*load_plan(plan))
    one, two = build(jobs, tmp_path / "one"), build(jobs, tmp_path / "two", workers=2)
    assert one.content_sha256 == two.content_sha256


def test_a_second_build_in_the_folder_is_refused(plan: Path, tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    (tmp_path / "out").mkdir()
    with (tmp_path / "out" / ".lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another build"):
            build(plan_jobs(*load_plan(plan)), tmp_path / "out")


def test_a_cluster_needs_its_extra(plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match="cluster"):
        build(plan_jobs(*load_plan(plan)), tmp_path / "out", workers="tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("classes: []", "classes"),
        ("classes: [{class: nope}]", "expected a YAML file or one of"),
        ("classes: [{class: cup}, {class: cup}]", "twice"),
        ("classes: [{class: cup, variants: 0}]", "variants"),
        ("classes: [{class: cup}]\naround: 17", "around"),
        ("classes: [{class: cup}]\nseeds: 17", "seeds"),
        ("classes: [{class: cup}]\nnonlinear: {heights: [0]}", "nonlinear.heights"),
    ],
)
def test_bad_plans_are_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_plan(path)


@pytest.mark.parametrize("source", ["/dev/zero", "../cup", "teapot", ""])
def test_a_plan_that_names_no_class_is_told_by_its_own_name(tmp_path, source):
    """A name without a suffix is a shipped class, not a file somewhere."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(f"classes: [{{class: '{source}', variants: 2}}]\n")
    with pytest.raises(InputError, match=r"plan\.yaml.*expected a YAML file or one of: .*cup"):
        load_plan(plan)
