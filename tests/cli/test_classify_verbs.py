"""The ``classify`` verbs, from words to files."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

import visuohaptic.viewer
from visuohaptic.cli.main import main
from visuohaptic.recognition.data import FeatureSet, save_feature_set


def _objects(path: Path) -> FeatureSet:
    rng = np.random.default_rng(0)
    place = np.linspace(0, 1, 16)
    features, widths, labels = [], [], []
    for label, top, width in (("soft", 4.0, 0.06), ("rim", 9.0, 0.06), ("flat", 9.0, 0.03)):
        for _ in range(12):
            line = np.exp(np.interp(place, [0, 0.5, 1], [9, 7, top]) + rng.normal(0, 0.1) + place * 0)
            grid = np.repeat(line[:, None], 4, axis=1) * np.exp(rng.normal(0, 0.02, (16, 1)))
            features.append(np.stack([grid, grid, 0 * grid], axis=-1))
            widths.append(np.tile([0.06, width], (16, 1)) * (1 + rng.normal(0, 0.02)))
            labels.append(label)
    data = FeatureSet(
        np.stack(features), np.stack(widths), tuple(labels), tuple(f"{k}" for k in range(len(labels)))
    )
    save_feature_set(path, data)
    return data


def test_train_plan_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    data = _objects(tmp_path / "set.npz")
    tree = str(tmp_path / "tree.json")

    def run(*words: str) -> dict:
        assert main(["classify", *words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    picture = tmp_path / "tree.png"
    trained = run(
        "train", "--objects", str(tmp_path / "set.npz"), "--group", "cup=soft,rim", "--out", tree,
        "--plot", str(picture),
    )  # fmt: skip
    assert trained["classes"] == ["cup", "flat"]
    assert picture.stat().st_size > 10_000
    run("train", "--objects", str(tmp_path / "set.npz"), "--out", tree)
    planned = run("plan", tree)
    assert planned["scaling"] == ["x8", "y8"]
    assert planned["nodes"]
    curves = tmp_path / "curves.csv"
    rng = np.random.default_rng(1)
    with curves.open("w") as handle:
        handle.write("height,side,force_N,deformation_m,width_m\n")
        for height, axis in ((8, "x"), (8, "y"), (15, "x"), (11, "y")):
            column = 0 if axis == "x" else 2
            for k, side in enumerate(f"{axis}+ {axis}-".split()):
                for d in np.arange(1, 19) / 6000:
                    force = data.features[0, height - 1, column + k, 0] * d + rng.normal(0, 0.1)
                    width = data.width_m[0, height - 1, column // 2]
                    handle.write(f"{height},{side},{force},{d + rng.normal(0, 1e-4)},{width}\n")
    found = run("run", tree, str(curves))
    assert found["answer"] == "soft"
    assert found["probabilities"]["soft"] > 0.9
    assert found["touches"] == ["x8", "y8", "x15", "y11"]
    assert sum(found["probabilities"].values()) == pytest.approx(1)
    walked = tmp_path / "walk.json"
    run("run", tree, str(curves), "--steps", str(walked))
    steps = json.loads(walked.read_text())
    assert steps["steps"][0][0] == "touch x8 for the scale"
    assert (steps["result"] or None) == found["tree"]["answer"]
    assert visuohaptic.viewer.open_views([walked])[0].steps == tuple(map(tuple, steps["steps"]))
    monkeypatch.setattr("sys.stdin", io.StringIO("8000 8000 0.06\n" * 10))
    asked = run("run", tree, "--ask", "--max-touches", "2")
    assert 1 <= len(asked["touches"]) <= 2


def test_the_page_walks_with_the_touches(tmp_path: Path, capsys, monkeypatch) -> None:
    pytest.importorskip("viser", reason="the browser page is an extra")
    data = _objects(tmp_path / "set.npz")
    tree = str(tmp_path / "tree.json")
    assert main(["classify", "train", "--objects", str(tmp_path / "set.npz"), "--out", tree]) == 0
    shown = {}
    draw = visuohaptic.viewer.BrowsePage.close

    def closed(page) -> None:
        shown.update({view.title: view for view in page._views.values()})
        draw(page)

    monkeypatch.setattr(visuohaptic.viewer.BrowsePage, "close", closed)
    soft = data.features[0, 7, 0, 0]
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{soft} {soft} 0.06\n" * 10))
    words = ["run", tree, "--ask", "--max-touches", "3", "--view", "--seconds", "0", "--port", "0", "--json"]
    capsys.readouterr()
    assert main(["classify", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(shown) == {"tree", "planner"}
    asked = [question for question, _ in shown["planner"].steps]
    assert asked == [f"touch {touch}" for touch in found["touches"]]
    assert all(answer for _, answer in shown["planner"].steps)
    assert f"It is: {found['answer']}" in shown["planner"].text()


def test_an_afternoon_of_squeezing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two objects at one place each, and then one of them again, without a tree."""
    rows = ["label,at,side,force_N,deformation_m"]
    for label, stiffness in (("sponge", 8e2), ("bottle", 1e4)):
        rows += [f"{label},0.5,x+,{stiffness * d},{d}" for d in np.arange(1, 19) / 6000]
    squeezed, asked = tmp_path / "squeezed.csv", tmp_path / "asked.csv"
    squeezed.write_text("\n".join(rows) + "\n")
    asked.write_text("\n".join(row.partition(",")[2] for row in rows[:19]) + "\n")
    mine = str(tmp_path / "mine.json")
    assert main(["classify", "train", str(squeezed), "--out", mine, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["classes"] == ["sponge", "bottle"]
    assert main(["classify", "run", mine, str(asked), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["answer"] == "sponge"
    assert found["tree"] == {"answer": None, "next_touch": None}
    assert found["doubt"] == ""
    assert main(["classify", "plan", mine]) == 2
    assert "has no tree" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "--objects", "nowhere", "--out", "tree.txt"], "with .json"),
        (["train", "--objects", "nowhere", "--out", "tree.json"], "No such file"),
        (["train", "--objects", "set.npz", "--out", "tree.json", "--group", "cup"], "expected NAME=CLASS"),
        (["train", "--objects", "set.npz", "--out", "tree.json", "--classes", "soft,mug"], "found 'mug'"),
        (["plan", "nowhere.json"], "cannot be read"),
        (["run", "nowhere.json"], "either a file of curves or --ask"),
        (["train", "--states", "mug", "--out", "state.json"], "mug"),
        (["train", "--states", "cup", "--places", "z9", "--out", "state.json"], "found 'z9'"),
        (["train", "--states", "cup", "--fill", "1.5", "--out", "state.json"], "0 to 1"),
        (["train", "--out", "tree.json"], "expected a CSV file of curves, --objects or both, or --states"),
    ],
)
def test_one_line_for_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch, words: list[str], said: str
) -> None:
    _objects(tmp_path / "set.npz")
    monkeypatch.chdir(tmp_path)
    assert main(["classify", *words]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error
    assert "\n" not in error
