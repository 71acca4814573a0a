"""Third-party scenes, and the outlines of SVG paths."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.peers.scenes import load_namosim, load_svg_mppi
from benchmarks.peers.svg_path import outline_from_svg_path
from shapely import Polygon

from visuohaptic.core import InputError
from visuohaptic.navigation.planning import make_plan

from .plan_check import faults

SVG = """<svg viewBox="0 0 400 200" xmlns:sodipodi="http://example.org/s">
  <namo_config cell_size_cm="5"><agent agent_id="r"><goal goal_id="g"/></agent></namo_config>
  <path id="w" type="wall" d="M 190 0 h 20 v 60 h -20 z"/>
  <path id="v" type="wall" d="M 190 140 h 20 v 60 h -20 z"/>
  <path id="b" type="movable" d="m 185,75 h 30 v 30 h -30 z"/>
  <path id="r" sodipodi:type="arc" d="m 120,90 a 20,20 0 0 1 -20,20 20,20 0 0 1 -20,-20 20,20 0 0 1 40,0 z"/>
  <path id="g" d="M 330 90 L 310 110 L 290 90 L 310 70 Z"/>
</svg>"""


def test_a_namosim_scene_is_in_centimetres_with_y_down(tmp_path):
    (tmp_path / "a.svg").write_text(SVG)
    scene = load_namosim(tmp_path / "a.svg")
    (problem,) = scene.problems
    assert problem.start_m == pytest.approx([1.0, 1.1], abs=0.01)
    assert problem.goal_m == pytest.approx([3.1, 1.1], abs=1e-6)
    assert problem.robot.radius_m == pytest.approx(0.2, rel=0.02)
    (box,) = problem.objects
    assert box.centre_m == pytest.approx([2.0, 1.1])
    assert problem.map.value_at(np.array([2.0, 1.7])) == 100
    assert problem.map.value_at(np.array([2.0, 1.1])) == 0
    plan = make_plan(problem)
    assert plan.reachable
    assert faults(problem, plan) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("viewBox", "box"), "viewBox: expected four numbers"),
        (("cell_size_cm", "cells"), "cell_size_cm: expected a number"),
        (('goal_id="g"', 'goal_id="h"'), "h: has no path with that id"),
        (('agent_id="r"', 'agent_id="q"'), "agent_id: has no robot"),
        (("M 190 0 h 20", "M 190 0 h"), "d: "),
        (("<svg", "<!DOCTYPE x [<!ENTITY a 'b'>]><svg"), "has a document type"),
        (("</svg>", ""), "is not XML"),
        (("namo_config", "other"), "namo_config: is missing"),
    ],
)
def test_scenes_that_are_none(tmp_path, change, said):
    (tmp_path / "a.svg").write_text(SVG.replace(*change))
    with pytest.raises(InputError) as error:
        load_namosim(tmp_path / "a.svg")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_svg_paths_of_all_commands():
    square = [[0, 0], [10, 0], [10, 10], [0, 10]]
    for text in ("M0 0 H10 V10 H0 Z", "m 0,0 10,0 0,10 -10,0 z", "M0,0L10,0 10,10 0,10", "m0 0h10v10h-10z"):
        assert outline_from_svg_path(text).tolist() == square
    circle = outline_from_svg_path("M 10 0 A 10 10 0 0 1 -10 0 A 10 10 0 0 1 10 0 Z")
    assert np.allclose(np.hypot(*circle.T), 10.0)
    assert abs(Polygon(circle).area) == pytest.approx(16 / 2 * 100 * np.sin(2 * np.pi / 16))
    curve = outline_from_svg_path("M 0 0 C 0 10 10 10 10 0 S 20 -10 20 0 Q 10 -30 0 0")
    assert np.isfinite(curve).all()
    with pytest.raises(InputError, match="begins with M"):
        outline_from_svg_path("10 10 20 20")
    with pytest.raises(InputError, match="found 0 distinct corners"):
        outline_from_svg_path("")


@pytest.mark.data
def test_namosim_scenes_are_solved(data):
    folder = data / "navigation" / "dev" / "namo" / "namosim"
    for path in [*sorted(folder.glob("*.svg")), folder / "citi_ing_push_only" / "namo.yaml"]:
        for problem in load_namosim(path).problems:
            plan = make_plan(problem)
            assert plan.reachable, path.name
            assert faults(problem, plan) == [], path.name


@pytest.mark.data
def test_svg_mppi_worlds_are_read(data):
    for path in sorted((data / "navigation" / "dev" / "namo" / "svg_mppi").glob("*.yaml")):
        (problem,) = load_svg_mppi(path).problems
        assert problem.objects
        assert all(item.tag is not None for item in problem.objects)
