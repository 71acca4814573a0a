"""The ``classify`` verbs, from the command line to files."""

from __future__ import annotations

import inspect
import io
import json
from pathlib import Path

import numpy as np
import pytest
from tests.explorations import explored_less

import visuohaptic.viewer
from visuohaptic.cli.main import main
from visuohaptic.recognition.data import FeatureSet, save_feature_set
from visuohaptic.recognition.touch import calibrate

CLASSES = {"soft": (4.0, 0.06), "rim": (9.0, 0.06), "flat": (9.0, 0.03)}


def _drawn(label: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Features (16, 4, 3) and widths (16, 2) of one object of a class."""
    top, width = CLASSES[label]
    line = np.exp(np.interp(np.linspace(0, 1, 16), [0, 0.5, 1], [9, 7, top]) + rng.normal(0, 0.1))
    grid = np.repeat(line[:, None], 4, axis=1) * np.exp(rng.normal(0, 0.02, (16, 1)))
    widths = np.tile([0.06, width], (16, 1)) * (1 + rng.normal(0, 0.02))
    return np.stack([grid, grid, 0 * grid], axis=-1), widths


def _objects(path: Path) -> None:
    rng = np.random.default_rng(0)
    labels = tuple(label for label in CLASSES for _ in range(12))
    features, widths = zip(*(_drawn(label, rng) for label in labels), strict=True)
    data = FeatureSet(np.stack(features), np.stack(widths), labels, tuple(f"{k}" for k in range(len(labels))))
    save_feature_set(path, data)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with set.npz, and tree.json as `classify train` made it of the set."""
    folder = tmp_path_factory.mktemp("trained")
    _objects(folder / "set.npz")
    with explored_less():
        assert (
            main(["classify", "train", "--objects", f"{folder}/set.npz", "--out", f"{folder}/tree.json"]) == 0
        )
    return folder


def _run(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    capsys.readouterr()
    assert main(["classify", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_classes_are_grouped_and_the_tree_is_drawn(
    trained: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    monkeypatch.setitem(
        inspect.unwrap(calibrate).__kwdefaults__, "explorations", 400
    )  # neither depends on the probabilities
    picture = tmp_path / "tree.png"
    found = _run(
        capsys, "train", "--objects", f"{trained}/set.npz", "--group", "cup=soft,rim",
        "--out", f"{tmp_path}/tree.json", "--plot", str(picture),
    )  # fmt: skip
    assert found["classes"] == ["cup", "flat"]
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize("label", CLASSES)
def test_touches_of_the_plan_identify_an_object_not_trained_with(
    trained: Path, tmp_path: Path, capsys, label: str
) -> None:
    """The planned touches, whatever they are, until the planner says enough."""
    features, width_m = _drawn(label, np.random.default_rng(2))
    tree = f"{trained}/tree.json"
    planned = _run(capsys, "plan", tree)
    assert planned["scaling"] == ["x8", "y8"]
    assert planned["nodes"]
    curves = tmp_path / "curves.csv"
    curves.write_text("height,side,force_N,deformation_m,width_m\n")
    rng = np.random.default_rng(1)

    def squeeze(place: str) -> None:
        axis, height = place[0], int(place[1:])
        column = "xy".index(axis)
        with curves.open("a") as handle:
            for k, side in enumerate(f"{axis}+ {axis}-".split()):
                for d in np.arange(1, 19) / 6000:
                    force = features[height - 1, 2 * column + k, 0] * d + rng.normal(0, 0.1)
                    width = width_m[height - 1, column]
                    handle.write(f"{height},{side},{force},{d + rng.normal(0, 1e-4)},{width}\n")

    places = list(planned["scaling"])
    for place in places:
        squeeze(place)
    while (found := _run(capsys, "run", tree, str(curves)))["next_touch"]:
        assert not found["confident"]
        places.append(found["next_touch"]["touch"])
        squeeze(places[-1])
    assert found["touches"] == places
    assert len(set(places)) == len(places)
    assert found["answer"] == label
    assert found["confident"]
    assert found["probabilities"][label] >= 0.99  # the default of --confidence
    assert sum(found["probabilities"].values()) == pytest.approx(1)
    walked = tmp_path / "walk.json"
    _run(capsys, "run", tree, str(curves), "--steps", str(walked))
    steps = json.loads(walked.read_text())
    assert steps["steps"][0][0] == "touch x8 for the scale"
    assert (steps["result"] or None) == found["tree"]["answer"]
    assert visuohaptic.viewer.open_views([walked])[0].steps == tuple(map(tuple, steps["steps"]))


def test_asked_touches_end_at_their_maximum(trained: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("8000 8000 0.06\n" * 10))
    asked = _run(capsys, "run", f"{trained}/tree.json", "--ask", "--max-touches", "2")
    assert 1 <= len(asked["touches"]) <= 2


def test_the_page_walks_with_the_touches(trained: Path, capsys, monkeypatch) -> None:
    pytest.importorskip("viser", reason="the browser page is an extra")
    tree = f"{trained}/tree.json"
    shown = {}
    draw = visuohaptic.viewer.BrowsePage.close

    def closed(page) -> None:
        shown.update({view.title: view for view in page._views.values()})
        draw(page)

    monkeypatch.setattr(visuohaptic.viewer.BrowsePage, "close", closed)
    soft = _drawn("soft", np.random.default_rng(2))[0][7, 0, 0]
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
    assert found["contradiction"] == ""
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
