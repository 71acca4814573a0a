"""The ``objects`` verbs, from words to files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from visuohaptic.cli.main import main
from visuohaptic.objects import FeatureVector, VisuoHapticObject
from visuohaptic.objects.database import open_database


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
    assert [one["id"] for one in run("list", "--class", "cup")["objects"]] == ["cup-1"]
    with open_database(tmp_path / "db") as database:
        for i in range(3):
            features = {"stiffness": FeatureVector(np.full(4, float(i)))}
            database.add(VisuoHapticObject(f"x{i}", features=features))
    assert [one["id"] for one in run("search", "--like", "x2", "--count", "2")["found"]] == ["x2", "x1"]
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
        (["add", "../a"], "found the id"),
        (["add", "a", "--state", "open"], "expected NAME=VALUE"),
        (["import", "nowhere"], "no card.yaml"),
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
