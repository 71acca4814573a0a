"""Figures show the names that users give, not the formulas that matplotlib reads in them."""

from __future__ import annotations

import html
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from visuohaptic import report
from visuohaptic.core import ErrorBudget, StiffnessMap
from visuohaptic.core.files import literal, new_figure, save_figure
from visuohaptic.deformation import plot_map
from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.grasping import GraspTask, plan_map
from visuohaptic.grasping.plots import plot_plan as plot_grasps
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.plots import plot_path_plan
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.recognition.data import FeatureSet
from visuohaptic.recognition.trees import plot_correlation, plot_tree, train_tree

#: A formula, a formula that does not parse, one dollar, a backslash before it, and what legends omit.
NAMES = (r"a$b_c$d", r"$\nothing^{$", "5$", r"x\$y\$", "_hidden$_$")


@pytest.fixture(autouse=True)
def _letters():
    """Letters of .svg files remain letters."""
    with mpl.rc_context({"svg.fonttype": "none"}):
        yield


def written(path: Path) -> str:
    """The letters of a figure."""
    return html.unescape(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", NAMES)
def test_charts_show_names_as_they_are(tmp_path, name):
    t_s = np.linspace(0.0, 1.0, 5)
    trace = report.TimeSeries(name, t_s, t_s)
    outline_m = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]])
    figures = (
        report.traces_over_time(t_s, {"x [cm]": [trace], "y": [trace]}, reasons=["ok"] * 5, title=f"title {name}"),
        report.force_over_time(t_s, t_s, t_s, valid=t_s > 0.5, reasons=[f"because {name}"] * 5),
        report.force_against_truth([report.ForceRun(name, t_s, t_s)]),
        report.error_budget({name: ErrorBudget(0.1, 0.1, 0.1, 0.1)}),
        report.floor_map(np.zeros((60, 60), np.int8), 0.05, (0.0, 0.0), objects=[report.MapObject(name, outline_m)]),
    )  # fmt: skip
    for k, figure in enumerate(figures):
        save_figure(tmp_path / f"{k}.svg", figure)
        assert name in written(tmp_path / f"{k}.svg"), k
    assert f"title {name}" in written(tmp_path / "0.svg")
    assert written(tmp_path / "0.svg").count(f"{name}</text>") >= 3  # both legends and the title
    assert f"because {name}" in written(tmp_path / "1.svg")


def test_a_name_that_begins_with_a_line_is_in_the_legend():
    _, (axes,) = new_figure(1, 1, size=(3, 2))
    axes.plot([0, 1], label=literal("_x"))
    axes.plot([0, 1], label="_internal")
    (text,) = axes.legend().get_texts()
    assert text.get_text().removeprefix("\u200b") == "_x"


def test_plans_show_names_of_objects(tmp_path):
    name = NAMES[1]
    box_m = np.array([[1.0, 1.0], [1.3, 1.0], [1.3, 1.3], [1.0, 1.3]])
    problem = PlanningProblem(
        OccupancyMap(np.zeros((40, 60), dtype=bool), 0.05),
        RobotModel(0.15),
        np.array([0.5, 0.5]),
        np.array([2.5, 1.5]),
        (MovableObject(name, box_m),),
    )
    plan = make_plan(problem)
    plot_path_plan(problem, plan, tmp_path / "plan.svg", title=f"plan of {name}")
    assert written(tmp_path / "plan.svg").count(name) == 2


def test_trees_show_names_of_classes(tmp_path):
    names = NAMES[0], NAMES[4]
    stiffness, width = np.full((6, 16, 4), 8e3), np.full((6, 16, 2), 0.06)
    stiffness[:3, 12:] = 5e2
    data = FeatureSet.of_stiffness(stiffness, width, [names[0]] * 3 + [names[1]] * 3)
    plot_tree(tmp_path / "tree.svg", train_tree(data, folds=3), data)
    plot_correlation(tmp_path / "classes.svg", data)
    for name in names:
        assert written(tmp_path / "tree.svg").count(name) == 2  # leaf and legend
        assert written(tmp_path / "classes.svg").count(name) == 2  # both axes


def test_maps_and_grasps_show_their_titles(tmp_path):
    mesh = tube_mesh(0.03, 0.1, 1e-3, around=16, along=8, crossed=False)
    count = len(mesh.vertices_m)
    tube = StiffnessMap(mesh.vertices_m, mesh.faces, np.full(count, 1e3), np.full(count, np.nan))
    plot_map(tmp_path / "map.svg", tube, NAMES[0])
    plot_grasps(tmp_path / "grasp.svg", [(NAMES[0], plan_map(tube, GraspTask(force_N=5.0)))])
    for name in ("map", "grasp"):
        assert NAMES[0] in written(tmp_path / f"{name}.svg")
