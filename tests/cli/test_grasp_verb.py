"""``visuohaptic grasp``: all kinds of input, equal results, clear errors."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.cli.main import main
from visuohaptic.io.meshes.ply import PlyMesh, write_ply
from visuohaptic.recognition.touch.refinement import CLASS


def run(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    assert main(["grasp", *words, "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_a_class_gives_ranked_grasps_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plot = tmp_path / "grasps.png"
    words = ["cup-rim", "--around", "32", "--force", "20", "--several", "2", "--plot", str(plot)]
    found = run(capsys, *words)
    grasps = found["grasps"]
    assert isinstance(grasps, list)
    assert grasps[0]["first_m"][2] > 0.09
    assert grasps[0]["deformation_m"] < 0.005
    assert max(found["several"]["deformation_m"]) < grasps[0]["deformation_m"]
    assert plot.stat().st_size > 10_000


def test_a_map_gives_the_grasps_of_its_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "map.npz"
    assert main(["stiffness", "cup", "--around", "32", "--out", str(out)]) == 0
    capsys.readouterr()
    one = run(capsys, str(out), "--force", "4", "--count", "2")
    other = run(capsys, "cup", "--around", "32", "--force", "4", "--count", "2", "--no-confirm")
    for a, b in zip(one["grasps"], other["grasps"], strict=True):
        assert a["score"] == pytest.approx(b["score"])
        assert a["first_m"] == pytest.approx(b["first_m"])


def test_a_map_without_sigma_is_as_uncertain_as_that_of_a_class(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "map.npz"
    assert main(["stiffness", "cup", "--around", "32", "--no-sigma", "--out", str(out)]) == 0
    capsys.readouterr()
    words = [str(out), "--force", "4", "--count", "1", "--mass", "0.1"]
    (grasp,) = run(capsys, *words)["grasps"]
    assert grasp["deformation_m"] > 0
    share = math.hypot(*CLASS[:2])
    assert grasp["deformation_sigma_m"] == pytest.approx(share * grasp["deformation_m"])
    # 5 mm are not exceeded with 95 %.
    limit_N = 0.005 * math.exp(-1.6449 * share) * 4.0 / grasp["deformation_m"]
    assert grasp["deformation_limit_N"] == pytest.approx(limit_N, rel=1e-3)
    assert 0.9 < grasp["success"] < 1.0
    assert main(["grasp", *words]) == 0
    assert "note: the map states no standard deviation" in capsys.readouterr().out


def test_a_sigma_of_the_mass_needs_the_mass_and_is_not_above_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasp", "cup", "--mass-sigma", "0.1"]) == 2
    assert "--mass-sigma: found without --mass" in capsys.readouterr().err
    assert main(["grasp", "cup", "--mass", "0.1", "--mass-sigma", "0.3"]) == 2
    assert "--mass-sigma: found 0.3 kg, expected 0 to the --mass of 0.1 kg" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("--material", "PP"),
        ("--around", "48"),
        ("--state", "closed"),
        ("--fill", "0.5"),
        ("--up", "x"),
        ("--up", "-y"),
    ],
)
def test_a_map_refuses_what_would_change_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, str]
) -> None:
    assert main(["grasp", str(tmp_path / "map.npz"), "--force", "4", *words]) != 0
    assert f"{words[0]}: changes nothing" in capsys.readouterr().err


def test_contents_ask_for_more_force_and_may_spill(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["cleaner", "--around", "32", "--count", "1"]
    empty, full = run(capsys, *words), run(capsys, *words, "--state", "closed", "--fill", "0.9")
    assert full["mass_kg"] > 10 * empty["mass_kg"]
    assert full["grasps"][0]["needed_N"] > 3 * empty["grasps"][0]["needed_N"]


def test_it_says_why_there_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasp", "cup", "--around", "32", "--force", "59"]) == 0
    assert "by the rim, one finger inside: 59.0 N" in capsys.readouterr().out
    assert main(["grasp", "cup", "--around", "32", "--force", "59", "--state", "closed"]) == 0
    assert "no grasp:" in capsys.readouterr().out


def test_a_modulus_without_a_density_names_the_flags(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["cup", "--around", "16", "--count", "1", "--youngs-modulus", "2e9"]
    assert main(["grasp", *words]) == 2
    error = capsys.readouterr().err
    assert "give --mass in kg, or name its --material" in error
    assert "wall_kg_per_m3" not in error
    for more in (["--mass", "0.02"], ["--material", "PP"]):
        assert run(capsys, *words, *more)["mass_kg"] > 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["cup", "--force", "-1"], "force_N: found -1.0, expected more than 0"),
        (["cup", "--fill", "2"], "fill: found 2.0, expected 0 to 1"),
        (["cup", "--plot", "grasps.txt"], "found suffix '.txt'"),
        (["cup", "--force", "5", "--several", "9"], "--several: found 9, expected 2 to 5, the --count"),
        (["cup", "--force", "5", "--several", "0"], "--several: found 0, expected 2 to 5, the --count"),
        (
            ["cup", "--force", "59", "--state", "closed", "--no-confirm", "--several", "2"],
            "--several: found 2, expected at most 0, the number of grasps",
        ),
        (["nothing.xyz"], "found suffix '.xyz'"),
        (["cup", "--friction", "0"], "friction: found 0.0, expected more than 0"),
        (["cup", "--count", "0"], "count: found 0"),
    ],
)
def test_bad_words_are_refused(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["grasp", *words, *(["--around", "16"] if words[0] == "cup" else [])]) == 2
    assert text in capsys.readouterr().err


def test_a_scene_is_an_obstacle_where_the_object_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two walls of two triangles each beside a cup leave ways along them only, or none if there are four."""
    out, scene = tmp_path / "map.npz", tmp_path / "walls.ply"
    assert main(["stiffness", "cup", "--around", "32", "--out", str(out)]) == 0
    capsys.readouterr()
    words = [str(out), "--force", "4", "--count", "1", "--scene", str(scene)]
    square = np.array([[-0.3, 0.06, 0.0], [0.3, 0.06, 0.0], [0.3, 0.06, 0.3], [-0.3, 0.06, 0.3]])
    corners = np.array([[0, 1, 2], [0, 2, 3]])
    turned = [square @ Rotation.from_euler("z", 90 * k, degrees=True).as_matrix().T for k in range(4)]
    place, yaw = np.array([1.5, -0.7, 0.4]), Rotation.from_euler("z", 30, degrees=True).as_matrix()

    def written(walls: list[np.ndarray]) -> None:
        points = np.concatenate(walls) @ yaw.T + place
        write_ply(scene, PlyMesh(points, np.concatenate([corners + 4 * k for k in range(len(walls))])))

    written([turned[0], turned[2]])
    (grasp,) = run(capsys, *words, "--place", "1.5", "-0.7", "0.4", "30")["grasps"]
    approach, fingers = (np.array(grasp["pose"])[:3, k] for k in (2, 0))
    # The palm passes between the walls: it comes from above, or along them.
    assert abs(approach[1]) < 0.5
    assert abs(fingers[1]) < 0.9 or approach[2] < -0.9
    written(turned)
    found = run(capsys, *words, "--place", "1.5", "-0.7", "0.4", "30")
    assert all(abs(one["pose"][2][2]) > 0.8 for one in found["grasps"])  # from above only
    assert main(["grasp", *words]) == 2
    assert "no point is within 0.4 m of the object" in capsys.readouterr().err
    assert main(["grasp", "cup", "--place", "0", "0", "0", "0"]) == 2
    assert "--place: found without --scene" in capsys.readouterr().err
    assert main(["grasp", *words, "--place", "0", "inf", "0", "0"]) == 2
    assert "--place: found NaN or infinity, expected finite numbers" in capsys.readouterr().err
