from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.recognition.test_contents import felt

from visuohaptic import deformation
from visuohaptic.cli.main import main
from visuohaptic.deformation.maps import GraspCurve, SqueezeResult
from visuohaptic.deformation.shapes import tube_mesh

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


def test_a_place_far_from_the_object_is_refused(tube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Millimetres, or the frame of a scene: the nearest point of the surface would answer something else."""
    assert main(["stiffness", str(tube), "--around", "32", "--at", "35", "0", "100"]) == 2
    assert "m from the object, expected a point at its surface" in capsys.readouterr().err


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
    assert "the wall would intersect itself" in capsys.readouterr().err


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
    assert "face 3 refers to vertex 9, the file has 8" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.yaml"], "does not exist"),
        (["cup", "--out", "map.stl"], ".npz"),
        (["cup", "--material", "mud"], "PET"),
        (["cup", "--thickness", "-1"], "expected more than 0"),
        (["cup", "--poisson", "0.6"], "less than 0.5"),
        (["cup", "--fill", "2"], "expected 0 to 1"),
        (["cup", "--at", "nan", "0", "0"], "found nan, expected a number"),
        (["cup", "--at", "inf", "0", "0"], "expected finite numbers"),
        (["cup", "--unit", "mm"], "not a mesh"),
        (["cup", "--around", "7"], "multiple of 4"),
        (["cup", "--variant", "-1"], "expected 0 to"),
        (["cup", "--thickness", "0.5"], "intersect itself"),
        (["cup", "--base-stiffness", "0"], "expected more than 0"),
        (["cup", "--thickness", "thin"], "expected a number, LOW:HIGH"),
        (["cup", "--thickness", "2e-4:1e-4"], "expected 0 < low < high"),
        (["cup", "--thickness", "none.csv"], "No such file"),
        (["cup", "--remesh", "cast"], "not a mesh"),
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
    assert main(["objects", "build", str(plan), "--out", str(tmp_path / "out"), "--workers", "0"]) == 2
    # Features from curves are another result.
    plan.write_text(
        "around: 16\nband: false\nnonlinear: {around: 16, heights: [8]}\nclasses: [{class: cup, variants: 2}]"
    )
    curved = run(capsys, "objects", "build", str(plan), "--out", str(tmp_path / "out"), "--nonlinear")
    assert curved["computed"] == 2
    assert curved["content_sha256"] != first["content_sha256"]


def test_a_range_of_the_wall_is_a_band(tube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--at", "0.035", "0", "0.1", "--around", "32"]
    found = run(capsys, "stiffness", str(tube), "--thickness", "0.0004:0.0006", *at)
    assert found["thickness_m"] == pytest.approx(5e-4)
    # A uniform distribution: 0.2 mm / sqrt(12).
    assert found["thickness_sigma_m"] == pytest.approx(5.77e-5, rel=1e-3)
    # The stiffness of a pinched tube goes with about the square of its wall.
    place = found["at"][0]
    assert place["sigma_N_per_m"] / place["stiffness_N_per_m"] == pytest.approx(2.07 * 0.1155, rel=0.1)


def test_a_squeeze_says_its_curve(tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "curve.csv"
    words = [
        "--around",
        "32",
        "--at",
        "0.035",
        "0",
        "0.1",
        "--force",
        "10",
        "--points",
        "5",
        "--out",
        str(out),
    ]
    found = run(capsys, "squeeze", str(tube), *words)
    # CalculiX S8R, 3,744 nodes, 0.5 mm of PET: softer than linear by half at 10 N. Cells of 7 mm here: 10 %.
    assert found["force_N"] == pytest.approx([2, 4, 6, 8, 10], rel=1e-3)
    assert found["deformation_m"] == pytest.approx([3.46e-4, 7.66e-4, 1.339e-3, 2.16e-3, 2.965e-3], rel=0.12)
    assert found["linear_to_N"] == pytest.approx(2, rel=1e-3)
    assert len(out.read_text().splitlines()) == 7


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.yaml"], "does not exist"),
        (["cup", "--out", "curve.txt"], "expected .csv"),
        (["cup", "--at", "0", "0", "0", "--height", "0.1"], "expected one of them"),
        (["cup", "--at", "0", "0", "0.1", "--side", "x+"], "--side: found with --at"),
        (["cup", "--force", "-3"], "more than 0"),
        (["cup", "--height", "3"], "expected 0 to"),
        (["cup", "--at", "0", "0", "0"], "the wall is clamped at"),
        (["cup", "--points", "0"], "2 to 100"),
    ],
)
def test_squeezes_that_cannot_be_are_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["squeeze", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_curve_without_any_point_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = "the walls touch before a deformation of 0.2 m, at (0, 0, 0.1) m"
    none, where = np.zeros(0), np.array([0.03, 0.0, 0.1])
    curve = GraspCurve(*[none] * 7, where, -where, False, reason, copies=1, nodes=9, iterations=3)
    found = SqueezeResult(curve, 4e3, 4e2, np.nan, 5e7, np.nan, np.nan, 0.0)
    monkeypatch.setattr(deformation, "squeeze", lambda *_, **__: found)
    assert main(["squeeze", "cup", "--around", "8", "--plot", str(tmp_path / "curve.png")]) == 0
    said = capsys.readouterr().out
    assert f"4000 N/m ± 10 % at rest\nno point of the curve was reached\nends early: {reason}" in said
    assert "elastic" not in said
    assert (tmp_path / "curve.png").stat().st_size > 1000


@pytest.fixture(scope="module")
def squeezes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Firm squeezes by the laws of another test, which share nothing with the model: open, and closed with 0.65 of water."""
    folder, paths = tmp_path_factory.mktemp("squeezes"), {}
    for name, fill, closed in (("open", 0.2, False), ("closed", 0.65, True)):
        _model, curves, mass = felt(fill, closed, np.random.default_rng(0))
        rows = [
            f"{one.height_m},{d},{f}"
            for one in curves
            for d, f in zip(one.deformation_m, one.force_N, strict=True)
        ]
        paths[name] = folder / f"{name}.csv"
        paths[name].write_text("\n".join(["height_m,deformation_m,force_N", *rows]) + "\n")
        paths[f"{name} weighed"] = folder / f"{mass[0]}"
    return paths


def round_tube(radius_m: float, folder: Path, flat: float = 1.0) -> Path:
    mesh = tube_mesh(radius_m, 0.2, 4e-4, around=64, along=40, crossed=False)
    points = mesh.vertices_m * np.array([1.0, flat, 1.0])
    pytest.importorskip("trimesh").Trimesh(points, mesh.faces, process=False).export(folder / "tube.ply")
    return folder / "tube.ply"


@pytest.mark.parametrize(("lid", "fill"), [("open", 0.2), ("closed", 0.65)])
def test_squeezes_of_a_user_tell_lid_and_fill(
    lid: str, fill: float, squeezes: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = round_tube(0.033, tmp_path)
    weighed = ["--mass", squeezes[f"{lid} weighed"].name, "--mass-sigma", "0.003"]
    found = run(capsys, "squeeze", str(mesh), "--measured", str(squeezes[lid]), *weighed)
    assert found["squeezes"] == 2
    assert found["lid"][lid] > 0.98
    assert sum(found["lid"].values()) == pytest.approx(1.0)
    assert sum(found["filling"].values()) == pytest.approx(1.0)
    assert found["filling"]["empty"] < 0.01
    mean, sigma = found["fill"]["mean"], found["fill"]["sigma"]
    assert sigma < 0.15
    assert abs(mean - fill) < min(3.0 * sigma, 0.1)
    # Without its weight, what an open container holds is the prior's: 0.4 of them are empty.
    alone = run(capsys, "squeeze", str(mesh), "--measured", str(squeezes[lid]))
    assert alone["lid"][lid] > 0.98
    assert (alone["filling"]["empty"] > 0.3) == (lid == "open")


def test_an_ellipse_is_round_as_far_as_the_model_knows_its_air(
    squeezes: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half-axes of 33 and 33 s mm differ by 33 (1 - s), less a hundredth for their higher harmonics: .84 mm are 12 % of the area that 7 mm of deformation take."""
    words = ["--measured", str(squeezes["open"])]
    assert run(capsys, "squeeze", str(round_tube(0.033, tmp_path, 0.98)), *words)["lid"]["open"] > 0.9
    assert main(["squeeze", str(round_tube(0.033, tmp_path, 0.97)), *words]) == 2
    said = capsys.readouterr().err
    assert re.search(r"is not round: its half-axes differ by 0\.9[89] mm, expected up to 0\.84 mm", said), (
        said
    )


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        ("height_m,deformation_m,force_N\n", [], "has a header but no rows"),
        ("height_m,deformation_m,force_N\n0.1,-0.001,3\n", [], "line 2: found 0.1 m, -0.001 m and 3 N, expected more than 0"),
        ("height_m,deformation_m,force_N\n0.3,0.001,3\n", [], "a squeeze at 0.3 m, expected less than the height"),
        ("height_m,force_N\n0.1,3\n", [], "deformation_m"),
        ("", ["--points", "3"], "--points: found with --measured"),
        ("", ["--closed"], "--closed: found with --measured"),
    ],
)  # fmt: skip
def test_squeezes_that_cannot_be_read_are_one_line(
    text: str, words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "squeezes.csv"
    path.write_text(text)
    assert main(["squeeze", "bottle", "--measured", str(path), *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--mass", "-1"], "--mass: found -1, expected more than 0"),
        (["--mass", "0.4", "--mass-sigma", "0"], "--mass-sigma: found 0, expected more than 0"),
        (["--mass-sigma", "0.1"], "--mass-sigma: found without --mass"),
    ],
)
def test_a_mass_that_cannot_be_is_refused(
    words: list[str], said: str, squeezes: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["squeeze", "bottle", "--measured", str(squeezes["open"]), *words]) == 2
    assert said in capsys.readouterr().err


def test_a_mass_needs_squeezes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["squeeze", "bottle", "--mass", "0.3"]) == 2
    assert "--mass: found without --measured" in capsys.readouterr().err
