from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli.main import main

TUBE = """\
name: tube
base: {radius: 35 mm}
sections: [{height: 200 mm}]
wall: 0.5 mm
youngs_modulus: 2.5 GPa
"""


@pytest.fixture
def tube(tmp_path: Path) -> Path:
    path = tmp_path / "tube.yaml"
    path.write_text(TUBE)
    return path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    assert main([*words, "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_a_description_becomes_a_map(tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, plot = tmp_path / "map.npz", tmp_path / "map.png"
    found = run(
        capsys, "stiffness", str(tube), "--out", str(out), "--plot", str(plot), "--at", "0.035", "0", "0.1"
    )
    # Fourier series of the Koiter shell at half height.
    assert found["at"][0]["stiffness_N_per_m"] == pytest.approx(6164, rel=0.015)
    assert plot.stat().st_size > 1000
    with np.load(out) as data:
        count = len(data["vertices_m"])
        assert data["stiffness_N_per_m"].shape == data["stiffness_sigma_N_per_m"].shape == (count,)
        assert data["faces"].max() < count
    assert found["vertices"] == count


def test_it_says_how_far_the_surface_is(tube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run(
        capsys, "stiffness", str(tube), "--around", "48", "--no-sigma", "--at", "0.037", "0", "0.0987"
    )
    at = found["at"][0]
    # A vertex's column is at this angle, and between two rings the wall is straight.
    assert at["distance_m"] == pytest.approx(0.002, abs=1e-6)
    assert at["point_m"] == pytest.approx([0.035, 0, 0.0987], abs=1e-6)


def test_what_was_not_asked_for_is_not_reported(tube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stiffness", str(tube), "--around", "16", "--no-sigma"]) == 0
    said = capsys.readouterr().out
    assert "out:" not in said
    assert "plot:" not in said


def test_a_wall_of_a_metre_is_refused(tube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stiffness", str(tube), "--thickness", "1"]) == 2
    assert "the wall would cut itself" in capsys.readouterr().err


def test_a_mesh_gives_nearly_the_same(tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh = pytest.importorskip("trimesh")
    from visuohaptic.deformation.shapes import tube_mesh

    mesh = tube_mesh(0.035, 0.2, 0.0005, around=72, along=60, crossed=False)
    path = tmp_path / "tube.stl"
    trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(path)
    words = ["--youngs-modulus", "2.5e9", "--poisson", "0.38", "--thickness", "0.0005", "--open-top"]
    found = run(capsys, "stiffness", str(path), *words, "--at", "0.035", "0", "0.1", "--no-sigma")
    assert found["at"][0]["stiffness_N_per_m"] == pytest.approx(6164, rel=0.02)
    assert found["relative_sigma_median"] is None


def test_the_state_changes_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--at", "0", "0.03", "0.07", "--no-sigma", "--around", "32"]
    found = [
        run(capsys, "stiffness", "elliptic", *more, *at)["at"][0]["stiffness_N_per_m"]
        for more in (["--open-top"], [], ["--closed"], ["--fill", "0.95"])
    ]
    assert found == sorted(found)


def test_an_elastic_base_softens_what_is_near_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stiffness", "elliptic", "--at", "0", "0.03", "0.02", "--no-sigma", "--around", "32"]
    soft, clamped = (
        run(capsys, *words, *more)["at"][0]["stiffness_N_per_m"] for more in (["--base-stiffness", "1e4"], [])
    )
    assert soft < 0.9 * clamped


def test_a_face_that_names_no_vertex_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.obj"
    corners = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    bad.write_text("\n".join([*corners, "f 1 2 3", "f 1 2 4", "f 2 3 9"]))
    assert main(["stiffness", str(bad)]) == 2
    assert "face 3 names vertex 9, the file has 8" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.yaml"], "no such file"),
        (["cup", "--out", "map.stl"], ".npz"),
        (["cup", "--material", "mud"], "PET"),
        (["cup", "--thickness", "-1"], "expected more than 0"),
        (["cup", "--poisson", "0.6"], "less than 0.5"),
        (["cup", "--fill", "2"], "expected 0 to 1"),
        (["cup", "--at", "nan", "0", "0"], "finite"),
        (["cup", "--unit", "mm"], "not a mesh"),
        (["cup", "--around", "7"], "multiple of 4"),
        (["cup", "--variant", "-1"], "expected 0 to"),
        (["cup", "--thickness", "0.5"], "cut itself"),
        (["cup", "--base-stiffness", "0"], "expected > 0"),
    ],
)
def test_bad_input_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stiffness", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_plan_becomes_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("around: 16\nband: false\nclasses: [{class: cup, variants: 2}]")
    first = run(capsys, "objects", "build", str(plan), "--out", str(tmp_path / "out"))
    assert (first["objects"], first["computed"]) == (2, 2)
    again = run(capsys, "objects", "build", str(plan), "--out", str(tmp_path / "out"))
    assert (again["computed"], again["content_sha256"]) == (0, first["content_sha256"])
    assert main(["objects", "build", str(plan), "--out", str(tmp_path / "out"), "--jobs", "0"]) == 2
    # Features from curves are another result.
    plan.write_text(
        "around: 16\nband: false\nnonlinear: {around: 16, heights: [8]}\nclasses: [{class: cup, variants: 2}]"
    )
    curved = run(capsys, "objects", "build", str(plan), "--out", str(tmp_path / "out"), "--nonlinear")
    assert curved["computed"] == 2
    assert curved["content_sha256"] != first["content_sha256"]
