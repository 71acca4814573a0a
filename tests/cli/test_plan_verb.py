"""``visuohaptic plan``: JSON output, plot, and one-line errors."""

from __future__ import annotations

import json

import pytest
import yaml
from tests.navigation.plan_scenes import office

from visuohaptic.cli.main import main

ROBOT = "{radius_m: 0.17, v_max_m_s: 0.3, v_min_m_s: 0.05, v_push_m_s: 0.05, push_force_max_N: 20.0, setup_time_s: 4.0}"


@pytest.fixture
def files(tmp_path):
    problem = office()
    problem.map.save(tmp_path / "map.yaml")
    objects = []
    for item in problem.objects:
        tag = {}
        for name in ("static_friction_N", "dynamic_friction_N", "drift", "fixed", "explored"):
            value = getattr(item.tag, name)
            tag[name] = getattr(value, "value", value)
        objects.append({"id": item.id, "footprint_m": item.footprint_m.tolist(), "haptic_tag": tag})
    (tmp_path / "objects.yaml").write_text(yaml.safe_dump({"objects": objects}))
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path


def run(folder, *more, start=("1.5", "0.9"), goal=("2.45", "1.5")):
    return main(
        ["plan", str(folder / "map.yaml"), "--objects", str(folder / "objects.yaml"), "--robot",
         str(folder / "robot.yaml"), "--start", *start, "--goal", *goal, *more]
    )  # fmt: skip


def test_json_is_the_contract(files, capsys):
    assert run(files, "--json", "--compare", "--plot", str(files / "plan.png")) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["reachable"] is True
    assert data["cost_s"] == pytest.approx(sum(task["cost_s"] for task in data["tasks"]), abs=1e-4)
    # With turns on the spot and retries, and without the setup time of a push.
    assert 0.9 * data["cost_s"] < data["expected_duration_s"] < 2.0 * data["cost_s"]
    first, push, last = data["tasks"]
    assert (first["kind"], push["kind"], last["kind"]) == ("navigate", "push", "navigate")
    assert first["path_m"][0] == pytest.approx([1.5, 0.9])
    assert last["path_m"][-1] == pytest.approx([2.45, 1.5])
    assert push["object"] == "stool"
    assert set(push) >= {"contact_m", "goal_m", "cost_s", "failure_probability"}
    assert data["compare"]["no pushing"]["length_m"] > data["length_m"] / 0.35
    assert (files / "plan.png").stat().st_size > 5000


def test_text_says_what_to_do(files, capsys):
    assert run(files) == 0
    out = capsys.readouterr().out
    assert "push stool" in out
    assert "tower is not pushed: fixed" in out


def test_a_tour_explores_what_is_unknown(files, capsys):
    data = yaml.safe_load((files / "objects.yaml").read_text())
    for item in data["objects"]:
        item.pop("haptic_tag")
    (files / "objects.yaml").write_text(yaml.safe_dump(data))
    plan = ["plan", str(files / "map.yaml"), "--objects", str(files / "objects.yaml")]
    plan += ["--robot", str(files / "robot.yaml"), "--start", "1.5", "0.9"]
    assert main([*plan, "--explore", "600", "--json", "--plot", str(files / "tour.png")]) == 0
    tour = json.loads(capsys.readouterr().out)
    steps = [step["object"] for step in tour["steps"]]
    assert steps == [task["object"] for task in tour["tasks"] if task["kind"] == "explore"]
    assert {*steps, *tour["left_out"]} == {item["id"] for item in data["objects"]}
    assert tour["time_s"] == pytest.approx(sum(step["time_s"] for step in tour["steps"]), abs=1e-5)
    assert tour["time_s"] <= tour["budget_s"] == 600.0
    assert (files / "tour.png").stat().st_size > 5000
    assert main([*plan, "--explore", "1"]) == 3
    assert "by itself" in capsys.readouterr().out
    for wrong in ([], ["--explore", "60", "--prove"]):
        assert main([*plan, *wrong]) == 2
    assert main([*plan, "--explore", "-1"]) == 2


def test_no_plan_is_an_answer(files, capsys):
    (files / "objects.yaml").write_text("objects: []")
    assert run(files, "--json", goal=("5.3", "3.6")) == 3
    data = json.loads(capsys.readouterr().out)
    assert data["reachable"] is False
    assert data["proved"] is True
    assert data["answer"] == "no plan (proved)"
    assert (
        data["reason"] == "walls separate start and goal"
    )  # no word of pushing where nothing is there to push
    assert data["tasks"] == []


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("objects.yaml", "objects: [{id: a}]", "objects[0].footprint_m: is missing"),
        ("robot.yaml", "{radius_m: -1}", "radius_m: found -1.0"),
    ],
)
def test_bad_files_are_one_line_and_exit_code_2(files, capsys, name, text, said):
    (files / name).write_text(text)
    assert run(files) == 2
    error = capsys.readouterr().err
    assert said in error
    assert name in error
    assert error.count("\n") == 1


def test_start_off_the_map_is_an_error(files, capsys):
    assert run(files, start=("-50", "0")) == 2
    assert "off the map" in capsys.readouterr().err


def test_a_footprint_its_heading_and_areas_are_read(files, capsys):
    corners = [[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]]
    (files / "robot.yaml").write_text(yaml.safe_dump({"footprint": str(corners)}))
    data = yaml.safe_load((files / "objects.yaml").read_text())
    area = {"id": "all", "type": "avoid", "cost_s": 0.5, "footprint_m": [[0, 0], [9, 0], [9, 9], [0, 9]]}
    (files / "objects.yaml").write_text(yaml.safe_dump({"objects": [*data["objects"], area]}))
    assert run(files, "--yaw", "0.0", "--keep-routes", "0.25", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    ends = [note for note in plan["notes"] if "place to avoid" in note]
    assert len(ends) == len({task["object"] for task in plan["tasks"] if task["kind"] == "push"}) > 0
    assert run(files, "--compare") == 2
    assert "alternatives are planned for a disc only" in capsys.readouterr().err
    (files / "robot.yaml").write_text(ROBOT)
    assert run(files, "--yaw", "0.0") == 2
    assert "--yaw: does not apply to a disc" in capsys.readouterr().err
