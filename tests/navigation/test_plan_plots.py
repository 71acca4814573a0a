"""Plots of plans: zoomed to what the plan needs, with everything that is drawn in the legend."""

from __future__ import annotations

import warnings

import numpy as np
from matplotlib.figure import Figure

from visuohaptic.core import Estimate, HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.plots import plot_path_plan
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel

LIGHT = HapticTag(static_friction_N=Estimate(8.0, 0.0), dynamic_friction_N=Estimate(7.0, 0.0), explored=1)


def test_a_plan_on_a_large_map_is_zoomed_and_explained(tmp_path, monkeypatch):
    cells = np.zeros((400, 600), dtype=bool)
    cells[[0, -1]] = cells[:, [0, -1]] = True
    cells[:, 100] = True
    cells[196:204, 100] = False  # a door of 0.4 m, x 5.0 to 5.05 m
    box = np.array([[5.0, 9.8], [5.3, 9.8], [5.3, 10.2], [5.0, 10.2]])
    chair = MovableObject("chair", box, LIGHT)
    far = MovableObject("far", box + np.array([20.0, 0.0]), LIGHT)
    problem = PlanningProblem(
        OccupancyMap(cells, 0.05),
        RobotModel(0.15),
        np.array([4.0, 10.0]),
        np.array([6.5, 11.0]),
        (chair, far),
    )
    plan = make_plan(problem)
    assert [task.object for task in plan.pushes] == ["chair"]
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: drawn.append(figure) or path.touch())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_path_plan(problem, plan, tmp_path / "plan.png")
    (figure,) = drawn
    (axes,), (legend,) = figure.axes, figure.legends
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert 2.5 < left < 3.1
    assert 7.4 < right < 10.0
    assert 7.0 < low < 9.1
    assert 11.9 < high < 14.0
    words = {text.get_text() for text in legend.get_texts()}
    assert {
        "navigate",
        "push",
        "object, pushed",
        "object, not pushed",
        "after the push",
        "start",
        "goal",
    } <= words
    assert axes.get_title() == plan.summary
    assert plan.summary.startswith(("optimal: ", "within "))


def test_a_flat_plan_with_a_long_title_has_room_for_its_axes(tmp_path):
    """8 m ahead, and a summary as wide as the axes: Matplotlib warns where it draws labels over each other."""
    cells = np.zeros((120, 200), dtype=bool)
    cells[[0, -1]] = cells[:, [0, -1]] = cells[40:, 100] = True
    box = np.array([[-0.2, -2.6], [0.2, -2.6], [0.2, -1.2], [-0.2, -1.2]])
    problem = PlanningProblem(
        OccupancyMap(cells, 0.05, (-5.0, -3.0, 0.0)),
        RobotModel(0.2),
        np.array([-4.0, -2.0]),
        np.array([4.0, -2.0]),
        (MovableObject("box", box),),
    )
    plan = make_plan(problem)
    assert len(plan.summary) > 70
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_path_plan(problem, plan, tmp_path / "plan.png")
