"""objects.yaml and robot.yaml: valid files, and one-line errors."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from visuohaptic.core import InputError
from visuohaptic.navigation.problem import load_objects, load_robot, objects_from_data, robot_from_data

CONTRACT = """
objects:
  - id: stool
    footprint_m: [[1, 1], [1.4, 1], [1.4, 1.4], [1, 1.4]]
    haptic_tag: {static_friction_N: 8.1, dynamic_friction_N: 7.5, drift: 0.03, rotation_rad_per_m: 0.0,
                 deformability: 0.08, deceleration_s: null, fixed: false, falls: false, explored: 1, failed: 0}
  - id: thing
    footprint_m: [[2, 1], [2.2, 1], [2.1, 1.2], [2, 1]]
"""
ROBOT = """
{radius_m: 0.17, v_max_m_s: 0.3, v_min_m_s: 5e-2, v_push_m_s: 0.05, push_force_max_N: 20.0, setup_time_s: 4.0}
"""
SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


def test_the_contract_is_read(tmp_path):
    (tmp_path / "o.yaml").write_text(CONTRACT)
    (tmp_path / "r.yaml").write_text(ROBOT)
    stool, thing = load_objects(tmp_path / "o.yaml")
    assert stool.tag is not None
    assert stool.tag.static_friction_N is not None
    assert stool.tag.static_friction_N.value == pytest.approx(8.1)
    assert stool.tag.deceleration_s is None
    assert stool.tag.fixed is False
    assert np.allclose(stool.centre_m, [1.2, 1.2])
    assert thing.tag is None
    assert len(thing.footprint_m) == 3  # the repeated corner closes the outline
    robot = load_robot(tmp_path / "r.yaml")
    assert robot.v_min_m_s == pytest.approx(0.05)  # YAML 1.1 reads 5e-2 as a text
    assert robot.push_force_max_N == 20.0


def test_a_partial_tag_keeps_what_was_not_observed_apart_from_zero():
    (item,) = objects_from_data(
        {"objects": [{"id": 7, "footprint_m": SQUARE, "haptic_tag": {"drift": None, "explored": None}}]}
    )
    assert item.id == "7"
    assert item.tag is not None
    assert item.tag.drift is None
    assert item.tag.fixed is None
    assert item.tag.explored == 0


def test_no_objects_are_no_error():
    assert objects_from_data({"objects": []}) == ()
    assert objects_from_data({"objects": None}) == ()


def thing(**changes):
    return {"objects": [{"id": "a", "footprint_m": SQUARE, **changes}]}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ([], "found [], expected a mapping of fields"),
        ({}, "objects: is missing"),
        ({"objects": {}}, "objects: found {}, expected a list of entries"),
        ({"objects": [], "robots": 1}, "robots: is unknown"),
        (thing(colour="red"), "objects[0].colour: is unknown"),
        (thing(id=None), "objects[0].id: is missing"),
        (thing(id=""), "objects[0].id: found ''"),
        (thing(footprint_m=None), "objects[0].footprint_m: is missing"),
        (thing(footprint_m=[[0, 0], [1, 1]]), "objects[0].footprint_m: found 2 distinct corners"),
        (
            thing(footprint_m=[[0, 0], [1, 1], [2, 2]]),
            "objects[0].footprint_m: found an outline without area",
        ),
        (thing(footprint_m=[[0, 0], [1, 1], [1, 0], [0, 1]]), "objects[0].footprint_m: found an outline"),
        (
            thing(footprint_m=[[0, 0, 1], [1, 1], [1, 0]]),
            "objects[0].footprint_m: found [[0, 0, 1], [1, 1], [1, 0]], expected an array of numbers",
        ),
        (thing(footprint_m=[[0, float("nan")], [1, 1], [1, 0]]), "objects[0].footprint_m: found nan"),
        (thing(footprint_m=[[0, "x"], [1, 1], [1, 0]]), "objects[0].footprint_m: found 'x'"),
        (
            thing(footprint_m=[[0, 0], [1e300, 0], [0, 1e300]]),
            "expected finite [x, y] corners within 1e+09 m",
        ),
        (thing(haptic_tag=3), "objects[0].haptic_tag: found 3, expected a mapping of fields"),
        (thing(haptic_tag={"friction": 3}), "objects[0].haptic_tag.friction: is unknown"),
        (thing(haptic_tag={"fixed": "yes"}), "objects[0].haptic_tag.fixed: found 'yes'"),
        (thing(haptic_tag={"explored": -1}), "objects[0].haptic_tag.explored: found -1"),
        (thing(haptic_tag={"failed": True}), "objects[0].haptic_tag.failed: found True"),
        (thing(haptic_tag={"drift": "inf"}), "objects[0].haptic_tag.drift: found value inf"),
        (thing(pose_sigma=[0.01, 3]), "objects[0].pose_sigma[1]: found 3.0, expected 0 to 1.8138"),
        (thing(pose_sigma=[-0.01, 0.1]), "objects[0].pose_sigma: found (-0.01, 0.1), expected at least 0"),
        (thing(open_s=3), "objects[0].open_s: has no meaning for the type object"),
        (thing(type="glass", cost_s=3), "objects[0].cost_s: has no meaning for the type glass"),
        (thing(type="elevator", cost_s=3), "objects[0].cost_s: has no meaning for the type elevator"),
        (
            thing(type="avoid", cost_s=3, haptic_tag={"static_friction_N": 3}),
            "objects[0].haptic_tag: has no meaning for the type avoid",
        ),
        (thing(haptic_tag={"static_friction_N": -1}), "objects[0].haptic_tag.static_friction_N: found -1"),
        (thing(haptic_tag={"drift": {"sigma": 1}}), "objects[0].haptic_tag.drift.value: is missing"),
        (
            {"objects": [{"id": "a", "footprint_m": SQUARE}, {"id": "a", "footprint_m": SQUARE}]},
            "objects[1].id: found 'a', which objects[0] has already",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_line(data, said):
    with pytest.raises(InputError) as error:
        objects_from_data(data, where="objects.yaml")
    assert str(error.value).startswith("objects.yaml: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({}, "radius_m: is missing"),
        ({"radius_m": 0}, "radius_m: found 0.0, expected more than 0"),
        ({"radius_m": "big"}, "radius_m: found 'big'"),
        ({"radius_m": 0.2, "v_min_m_s": 1.0}, "v_min_m_s: found 1.0, expected at most v_max_m_s"),
        ({"radius_m": 0.2, "v_min_m_s": 1e-12}, "v_min_m_s: found 1e-12, expected at least v_max_m_s / 1000"),
        ({"radius_m": 0.2, "v_max_m_s": 1e308}, "v_min_m_s: found 0.05, expected at least v_max_m_s / 1000"),
        ({"radius_m": 0.2, "wheels": 2}, "wheels: is unknown"),
        ({"radius_m": 0.2, "setup_time_s": -1}, "setup_time_s: found -1.0"),
    ],
)
def test_robots_that_cannot_be(data, said):
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        robot_from_data(data, where="robot.yaml")


def test_objects_survive_a_round_trip_through_yaml(tmp_path):
    text = yaml.safe_dump(yaml.safe_load(CONTRACT))
    (tmp_path / "o.yaml").write_text(text)
    assert [item.id for item in load_objects(tmp_path / "o.yaml")] == ["stool", "thing"]
