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
    assert found["at"][0]["stiffness_N_per_m"] == pytest.approx(6164, rel=0.015)  # type: ignore[index]
    assert plot.stat().st_size > 1000
    with np.load(out) as data:
        count = len(data["vertices_m"])
        assert data["stiffness_N_per_m"].shape == data["stiffness_sigma_N_per_m"].shape == (count,)
        assert data["faces"].max() < count
    assert found["vertices"] == count


def test_a_mesh_gives_nearly_the_same(tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh = pytest.importorskip("trimesh")
    from visuohaptic.deformation import tube_mesh

    mesh = tube_mesh(0.035, 0.2, 0.0005, around=72, along=60, crossed=False)
    path = tmp_path / "tube.stl"
    trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(path)
    words = ["--youngs-modulus", "2.5e9", "--poisson", "0.38", "--thickness", "0.0005", "--open-top"]
    found = run(capsys, "stiffness", str(path), *words, "--at", "0.035", "0", "0.1", "--no-sigma")
    assert found["at"][0]["stiffness_N_per_m"] == pytest.approx(6164, rel=0.02)  # type: ignore[index]
    assert found["relative_sigma_median"] is None


def test_the_state_changes_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--at", "0", "0.03", "0.07", "--no-sigma", "--around", "32"]
    found = [
        run(capsys, "stiffness", "elliptic", *more, *at)["at"][0]["stiffness_N_per_m"]  # type: ignore[index]
        for more in (["--open-top"], [], ["--closed"], ["--fill", "0.95"])
    ]
    assert found == sorted(found)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.yaml"], "no such file"),
        (["cup", "--out", "map.stl"], ".npz"),
        (["cup", "--material", "mud"], "PET"),
        (["cup", "--thickness", "-1"], "expected > 0"),
        (["cup", "--poisson", "0.6"], "less than 0.5"),
        (["cup", "--fill", "2"], "expected 0 to 1"),
        (["cup", "--at", "nan", "0", "0"], "finite"),
        (["cup", "--unit", "mm"], "no mesh"),
        (["cup", "--around", "7"], "multiple of 4"),
        (["cup", "--variant", "-1"], "expected 0 to"),
        (["cup", "--thickness", "0.5"], "cut itself"),
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
