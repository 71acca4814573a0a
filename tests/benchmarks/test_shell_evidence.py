"""Counting in the campaigns of shells, and a slice of each."""

import numpy as np
import pytest
from benchmarks._shell_bound import _alone_scores
from scipy.spatial.transform import Rotation
from tests.explorations import explored_less
from tests.worlds.shell_bodies import CLASSES, OTHERS, draw, wall_of
from tests.worlds.shell_touches import (
    CONDITIONS,
    KINDS,
    TouchedObject,
    felt,
    known_object,
    squeezed_objects,
    unknown_object,
)

from benchmarks import _shell_readings, shell_evidence
from visuohaptic.deformation import RevolutionShell, pinch_stiffness
from visuohaptic.deformation.shapes import ContainerDescription, mesh_container
from visuohaptic.deformation.shells import IsotropicMaterial


@pytest.fixture(scope="module")
def classifier(tmp_path_factory):
    """Of two classes, three objects each."""
    with pytest.MonkeyPatch.context() as patch, explored_less():
        patch.setattr(_shell_readings, "CLASSES", {name: CLASSES[name] for name in ("pot", "milk")})
        return _shell_readings.train(tmp_path_factory.mktemp("shells"), 3)


def exact(name: str, stiffness: np.ndarray) -> TouchedObject:
    """An object under a perfect gripper."""
    return TouchedObject(
        name, stiffness, 0 * stiffness, np.full((16, 2), 0.06), 0.1, CONDITIONS["in range"], 1.0, 0.0, 0.0
    )


@pytest.mark.parametrize("name", [*CLASSES, *OTHERS])
def test_every_kind_is_a_container_that_the_library_reads(name):
    description = (CLASSES | OTHERS)[name]
    for seed in range(0, 60, 2):
        body = wall_of(draw(description, np.random.default_rng(seed), outside=0.3))
        assert (body.meridian_m[:, 0] > 0).all()
        assert (np.diff(body.meridian_m[:, 1]) >= 0).all()
    ours = wall_of(draw(description, np.random.default_rng(4)))
    member = draw(description, np.random.default_rng(4))
    found = mesh_container(ContainerDescription.model_validate({"name": "one", **member}), around=64)
    assert found.height_m == pytest.approx(ours.meridian_m[:, 1].max(), rel=1e-9)
    # Rings stand as far apart as corners: a tenth of the radius, a bulge is lower between them by (1/10)^2 / 2.
    ring = np.hypot(*found.mesh.vertices_m[:, :2].T).max()
    assert ring == pytest.approx(ours.meridian_m[:, 0].max(), rel=0.01)


def test_the_world_and_the_series_of_the_library_are_one_physics():
    body = wall_of(draw(CLASSES["beaker"], np.random.default_rng(0)))
    wall = np.full(len(body.meridian_m), body.wall_m[0])
    plastic = IsotropicMaterial(body.youngs_modulus_Pa, body.poisson_ratio)
    series = pinch_stiffness(RevolutionShell(*body.meridian_m.T, wall), plastic)
    some = np.arange(5, len(series), 12)
    assert body.pinch_stiffness(body.meridian_m[some, 1]) == pytest.approx(series[some], rel=0.01)


def test_a_gripper_that_is_right_feels_the_pinch_and_a_wrong_one_feels_another_height():
    body = wall_of(draw(CLASSES["pot"], np.random.default_rng(0)))
    touches = [(6, 0), (9, 1)]
    stiffness, width = felt(body, np.zeros(3), np.eye(3), touches)
    heights = (np.array([6, 9]) + 0.5) / 16 * body.meridian_m[-1, 1]
    expected = body.pinch_stiffness(heights, harmonics=32)
    # Of the other tip's alternating series half the last term is missing: 1 / 32^3 of what begins at 1 / 2^3.
    assert stiffness[6, :2] == pytest.approx([expected[0]] * 2, rel=1e-3)
    assert stiffness[9, 2:] == pytest.approx([expected[1]] * 2, rel=1e-3)
    assert np.isnan(stiffness[6, 2:]).all()
    assert width[6, 0] == pytest.approx(2 * body.radius_m(heights[0]))
    raised, _ = felt(body, np.array([0, 0, 0.005]), np.eye(3), touches)
    assert raised[6, 0] == pytest.approx(body.pinch_stiffness(heights[:1] + 0.005, harmonics=32)[0], rel=1e-3)
    # Off the axis the tips press on a shorter chord; turned about the axis nothing changes.
    aside, chord = felt(body, np.array([0, 0.01, 0]), np.eye(3), touches)
    assert chord[6, 0] == pytest.approx(2 * np.sqrt(body.radius_m(heights[0]) ** 2 - 0.01**2), rel=1e-6)
    assert aside[6, 0] != pytest.approx(stiffness[6, 0], rel=0.01)
    turned, _ = felt(body, np.zeros(3), Rotation.from_euler("z", 0.3).as_matrix(), touches)
    assert turned == pytest.approx(stiffness, rel=1e-6, nan_ok=True)


def test_readings_are_the_truth_with_the_errors_of_the_condition():
    thing = exact("pot", np.full((16, 4), 2000.0))
    curves = [thing.curve(3, 1, np.random.default_rng(k)) for k in range(40)]
    depth, force = (np.concatenate([curve[k] for curve in curves]) for k in range(2))
    slope = (depth @ force) / (depth @ depth)
    assert slope == pytest.approx(2000, rel=0.02)
    assert np.std(force - 2000 * depth) == pytest.approx(np.hypot(0.1, 0.2), rel=0.1)  # 2000 N/m times 0.1 mm
    gains = [unknown_object(seed, "nuisances").gain for seed in (28, 30, 32, 34, 36, 38)]
    assert np.abs(np.array(gains) - 1) == pytest.approx(0.05)
    assert min(gains) < 1 < max(gains)
    assert known_object(26).name == "beaker"
    assert len(KINDS) == 20


def test_a_range_is_left_by_no_more_than_was_asked_for():
    rng = np.random.default_rng(0)
    walls = np.array([draw(CLASSES["milk"], rng, outside=0.3)["wall"][0] for _ in range(300)])
    low, high = CLASSES["milk"]["wall"]
    assert walls.min() >= low - 0.3 * (high - low) - 1e-12
    assert walls.max() <= high + 0.3 * (high - low) + 1e-12
    out = (walls < low) | (walls > high)
    # Half of 300, three standard deviations of a coin.
    assert 0.41 < out.mean() < 0.59


def test_a_slice_of_readings_and_of_unknown_objects(classifier, monkeypatch, tmp_path):
    monkeypatch.setattr(shell_evidence, "train", lambda *_: classifier)
    first, again = (
        shell_evidence.recognition(
            "readings", [0], tmp_path, journal=tmp_path / "rows.jsonl",
            conditions=("in range",), widths=(True,),
        )
        for _ in range(2)
    )  # fmt: skip
    assert first == again
    (row,) = first
    assert row["class"] == "pot"
    assert row["tree"] in {"pot", "milk"}
    assert row["answer"] in {"pot", "milk", "unknown"}
    assert 1 <= row["touches"] <= 10
    assert set(row["peers"]) == {"RF", "GNB", "kNN", "LDA", "GP"}
    # A milk bottle is wider than a pot on all of its body and narrower at its neck.
    assert row["peers"]["LDA"] == "pot"
    (strange,) = shell_evidence.recognition(
        "unknown", [26], tmp_path, conditions=("in range",), widths=(False,)
    )
    assert strange["kind"] == "wooden block"
    assert strange["answer"] in {"pot", "milk", "unknown"}


def test_figures_of_readings():
    row = {"class": "pot", "answer": "pot", "confidence": 0.9, "touches": 3, "random": "pot", "random_touches": 6,
           "tree": "milk", "tree_touches": 2, "path": [("milk", 0.3), ("pot", 0.6), ("pot", 0.9)], "peers": {"LDA": "pot", "RF": "milk"}}  # fmt: skip
    rows = [row | {"condition": "in range", "width": True}] * 3
    wrong = [("milk", 0.3), ("unknown", 0.5), ("unknown", 0.6)]
    rows.append(rows[0] | {"answer": "unknown", "confidence": 0.6, "path": wrong})
    by_name = {figure["name"]: figure for figure in shell_evidence.summary("readings", rows)}
    label = "in range, with widths"
    assert by_name[f"{label}: right"]["ours"] == pytest.approx(0.75)
    assert by_name[f"{label}: right"]["peer"] == pytest.approx(1.0)
    assert by_name[f"{label}: false unknown"]["ours"] == pytest.approx(0.25)
    assert by_name[f"{label}: touches by random order"]["ours"] == pytest.approx(0.5)
    # The tree is never right: one touch is enough for that. Three of four are right after two, all of them never.
    assert by_name[f"{label}: touches by the tree, as often right"]["ours"] == pytest.approx(0.5)
    assert _shell_readings.touches_at_accuracy(rows, 0.75) == pytest.approx(2)
    assert _shell_readings.touches_at_accuracy(rows, 1.0) == pytest.approx(3)
    # Three of 0.9 that are right, one of 0.6 that is wrong.
    assert by_name[f"{label}: expected calibration error"]["ours"] == pytest.approx(0.75 * 0.1 + 0.25 * 0.6)
    strange = [
        {"kind": "can", "answer": "unknown", "confidence": 1.0, "condition": "in range", "width": False}
    ]
    (figure,) = shell_evidence.summary("unknown", strange)
    assert figure["ours"] == pytest.approx(1.0)


def test_a_few_curves_are_learned_and_asked_for(tmp_path):
    squeezed = squeezed_objects(0, 2, 3, tmp_path)
    names = [thing.name for thing, _places in squeezed]
    assert names[:2] == names[2:]
    for thing, places in squeezed:
        assert all(thing.stiffness_N_per_m[height - 1, side] > 0 for height, side in places)
    again = squeezed_objects(0, 2, 3, tmp_path)
    assert again[3][0].stiffness_N_per_m == pytest.approx(squeezed[3][0].stiffness_N_per_m, nan_ok=True)
    half = {"answers": ["a", "unknown"], "peers": {"kNN": ["a", "b"]}}
    failed = {"answers": None, "peers": {"kNN": ["a", "a"]}, "reason": "InputError: no"}
    rows = [{"objects": ["a", "b"], "machine": part, "by hand": half} for part in (half, failed)]
    machine, by_hand = shell_evidence.summary("few_curves", rows)
    assert machine["ours"] == pytest.approx(0.25)
    assert machine["peer"] == pytest.approx(0.75)
    assert by_hand["ours"] == pytest.approx(0.5)
    assert "called unknown 0.50" in by_hand["note"]


def test_a_mesh_is_read_mapped_and_asked():
    (row,) = shell_evidence.meshes([0], ["2,000 triangles"])
    assert row["faces"] > 1500
    # A coarse mesh of a wall: a few percent, for the order of magnitude alone.
    assert row["ratio"] == pytest.approx([1.0] * 6, rel=0.1)


def test_figures_of_meshes():
    rows = [
        {"kind": "grooves", "faces": 9, "truth": [1.0] * 4, "ratio": [1.0, 0.985, 1.05, 1.0], "notes": [], "cpu_s": 1.0},
        {"kind": "decimated", "faces": 9, "truth": [1.0] * 4, "refused": "a hole", "cpu_s": 3.0},
        {"kind": "drill", "refused": "no wall"},
        {"kind": "bulb", "notes": []},
        {"kind": "scanned", "faces": 200_000, "truth": [], "ratio": [], "notes": [], "cpu_s": 2.0},
    ]  # fmt: skip
    by_name = {figure["name"]: figure["ours"] for figure in shell_evidence.summary("meshes", rows)}
    assert by_name["meshes: heights within 2 %"] == pytest.approx(3 / 8)
    assert by_name["meshes: heights within 1 %"] == pytest.approx(2 / 8)
    assert by_name["meshes: worst"] == pytest.approx(5.0)
    assert by_name["meshes: taken as they are"] == pytest.approx(2 / 3)
    assert by_name["meshes: import to map, slowest"] == pytest.approx(3.0)
    assert by_name["meshes: import of 200,000 triangles or more to map, slowest"] == pytest.approx(2.0)
    assert by_name["no containers: refused"] == pytest.approx(0.5)


def test_the_room_of_orders_is_of_all_objects_together():
    """Three touches of six by chance: not the mean of 2 / 5 and 1 / 1."""
    rows = [
        {"fewest": 2, "random": 5.0, "tree": 4, "tree_right": True},
        {"fewest": 1, "random": 1.0, "tree": 2, "tree_right": False},
    ]
    chance, tree = shell_evidence.order_figures(rows, "in range")
    assert (chance["ours"], tree["ours"]) == (pytest.approx(0.5), pytest.approx(0.5))
    assert "right 0.50" in tree["note"]


def test_classes_alone_reject_what_is_far_from_all_of_them() -> None:
    """Members of all classes of the library's world as unit Gaussians far apart: an object 8 sigma off fits worse than all members."""
    rng, names = np.random.default_rng(0), list(CLASSES)
    members = np.concatenate([20 * k + rng.standard_normal((60, 4)) for k in range(len(names))])
    inside, outside = rng.standard_normal((50, 4)) * 0.5, np.array([[8.0, 0, 0, 0], [10.0, 10, 10, 10]])
    table = np.concatenate([members, inside, outside])
    label = np.concatenate([np.repeat(names, 60), ["can"] * 52])
    score = _alone_scores(table, label, np.tile(np.arange(60), 8)[: len(table)])
    limit = np.quantile(score[:360], 0.95)
    assert (score[360:410] < limit).all()
    assert (score[410:] > score[:360].max()).all()
