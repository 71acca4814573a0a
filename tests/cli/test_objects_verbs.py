"""The ``objects`` verbs, from the command line to files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from visuohaptic.cli.main import main
from visuohaptic.core import FeatureVector, VisuoHapticObject
from visuohaptic.database import open_database


def test_a_life_of_a_cup(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    db = ["--db", str(tmp_path / "db"), "--json"]

    def run(*words: str) -> dict:
        assert main(["objects", *words, *db]) == 0
        return json.loads(capsys.readouterr().out)

    wall = "material.wall_thickness_m"
    run("add", "cup-1", "--class", "cup", "--state", "lid=open", "--estimate", f"{wall}=1e-3+-2e-4")
    found = run("add", "cup-1", "--estimate", f"{wall}=0.8e-3+-0.02e-3", "--seen", "1", "2", "0")
    assert found["material"]["wall_thickness_m"]["value"] == pytest.approx(0.802e-3, rel=1e-3)
    assert run("show", "cup-1")["state"] == {"lid": "open"}
    run("add", "cup-1", "--seen", "1", "2", "0", "--context", "kitchen,sink")  # as in `objects recognise`
    assert [one["id"] for one in run("list", "--class", "cup")["objects"]] == ["cup-1"]
    with open_database(tmp_path / "db") as database:
        assert database.get("cup-1").seen.context == ("kitchen", "sink")
        for i in range(3):
            features = {"stiffness": FeatureVector(np.full(4, float(i)))}
            database.add(VisuoHapticObject(f"x{i}", features=features))
    assert [one["id"] for one in run("search", "--like", "x2", "--count", "2")["found"]] == ["x2", "x1"]
    np.save(tmp_path / "query.npy", np.zeros(3))
    assert (
        main(["objects", "search", "--features", str(tmp_path / "query.npy"), "--kind", "stifness", *db]) == 2
    )
    assert "--kind: has no object with features 'stifness'" in capsys.readouterr().err
    assert run("export", "--out", str(tmp_path / "out"), "--licence", "CC0-1.0")["exported"] == 4
    assert run("sync", str(tmp_path / "shared"))["sent"] == 4
    db[1] = str(tmp_path / "other")
    assert run("import", str(tmp_path / "out"))["imported"] == 4
    assert len(run("list")["objects"]) == 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["show", "a"], "is not a database"),
        (["add", "a", "--estimate", "material.wall=1"], "expected PLACE=VALUE"),
        (["add", "a", "--estimate", "material.wall=1+-1"], "no such property|not a measured"),
        (["add", "a", "--estimate", "material.wall_thickness_m=1+-0.1"], "expected less than 0.05 m"),
        (["add", "a", "--estimate", "material.youngs_modulus_Pa=0+-1"], "expected more than 0"),
        (["add", "../a"], "found the id"),
        (["add", "a", "--state", "open"], "expected NAME=VALUE"),
        (["add", "a", "--state", "fill=5"], "expected a fill level of 0..1"),
        (["add", "a", "--state", "fill=nan"], "expected a fill level of 0..1"),
        (["import", "nowhere"], "no card.yaml"),
        (["add", "a", "--estimate", "material.wall_thickness_m=1+-0"], "expected more than 0"),
    ],
)
def test_one_line_for_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    import re

    assert main(["objects", *words, "--db", str(tmp_path / "db")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(said, error)


def test_sync_with_neither_database_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here, there = tmp_path / "db", tmp_path / "shared"
    assert main(["objects", "sync", str(there), "--db", str(here)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(there) in error
    assert str(here) in error
    assert not here.exists()
    assert not there.exists()


@pytest.mark.parametrize("other", ["db", "mysql://here/there"])
def test_sync_with_itself_or_another_kind_of_server(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["objects", "add", "cup", "--db", "db"]) == 0
    capsys.readouterr()
    assert main(["objects", "sync", other, "--db", "./db"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert other in error


def test_a_server_is_not_synchronised_with_itself(capsys: pytest.CaptureFixture[str]) -> None:
    """Refused before it is asked, since its own changes would wait for each other; no password is shown."""
    there = "postgresql://robot:secret@127.0.0.1:1/objects"
    assert main(["objects", "sync", there, "--db", there]) == 2
    error = capsys.readouterr().err
    assert error.endswith(
        "postgresql://robot:***@127.0.0.1:1/objects: is the database of --db itself, expected another one\n"
    )


def test_an_empty_file_of_features_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    db = ["--db", str(tmp_path / "db")]
    assert main(["objects", "add", "cup-1", *db]) == 0
    (tmp_path / "empty.npy").touch()
    capsys.readouterr()
    assert main(["objects", "search", "--features", str(tmp_path / "empty.npy"), *db]) == 2
    assert "is not a .npy file of numbers" in capsys.readouterr().err


def test_recognise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("small_gicp")
    import cv2
    from benchmarks._prior_world import containers, label, scene_with, seen_cloud

    from visuohaptic.core import Appearance, Geometry, Sighting

    rng = np.random.default_rng(0)
    meshes = containers(1, classes=("bottle", "cup"))
    with open_database(tmp_path / "db") as database:
        for number, (name, mesh) in enumerate(meshes.items()):
            png = cv2.imencode(".png", label(number))[1].tobytes()
            database.add(
                VisuoHapticObject(
                    name.split("/")[0],
                    geometry=Geometry(mesh.vertices_m, mesh.faces),
                    appearance=Appearance(template_png=png),
                    seen=Sighting((0.0, 0.0, 0.0), 0.1, 1.0, context=("kitchen",)),
                )
            )
    np.save(tmp_path / "cloud.npy", seen_cloud(meshes["cup/0"], rng))
    cv2.imwrite(str(tmp_path / "scene.png"), scene_with(label(0), rng, hardness=0.3))

    def run(*words: str) -> dict:
        assert main(["objects", "recognise", *words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    saved = str(tmp_path / "prior.npz")
    by_cloud = run("--db", str(tmp_path / "db"), "--cloud", str(tmp_path / "cloud.npy"), "--save", saved)
    assert by_cloud["candidates"][0]["id"] == "cup"
    by_image = run("--prior", saved, "--image", str(tmp_path / "scene.png"), "--context", "kitchen")
    assert by_image["candidates"][0]["id"] == "bottle"
    assert sum(by_image["models"].values()) == pytest.approx(1.0, abs=0.03)
    for words, said in (
        (["--prior", saved], "found no input; give --image or --cloud"),
        (["--prior", str(tmp_path / "scene.png"), "--cloud", "x"], "not a visual prior"),
        (["--prior", saved, "--image", str(tmp_path / "cloud.npy")], "is not an image"),
        (["--prior", saved, "--cloud", str(tmp_path / "scene.png")], "not a .npy file"),
    ):
        assert main(["objects", "recognise", *words]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


def test_an_export_with_an_unknown_object_writes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["objects", "add", "cup", "--db", "db"]) == 0
    words = ["objects", "export", "--licence", "CC0-1.0", "--out", "out", "--db", "db", "--json"]
    assert main([*words, "cup", "mug"]) == 2
    assert "there is no object 'mug'" in capsys.readouterr().err
    assert not Path("out").exists()
    assert main([*words, "cup", "cup"]) == 0
    assert json.loads(capsys.readouterr().out)["exported"] == 1
