"""Pictures of plans, and refusals of grasps to confirm."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import ramp_colours
from visuohaptic.deformation.shapes import load_object
from visuohaptic.grasping import GraspTask, confirm_grasp, plan_map
from visuohaptic.grasping.confirm import pinch_at
from visuohaptic.grasping.plots import plot_plan

from .objects import tube_map


def test_a_ramp_is_viridis_between_its_colours() -> None:
    fraction = np.array([0.0, 1.0, 0.5, 0.125, np.nan, -1.0, 2.0])
    viridis = matplotlib.colormaps["viridis"](np.nan_to_num(fraction).clip(0, 1), bytes=True)[:, :3]
    found = ramp_colours(fraction)
    np.testing.assert_allclose(found, viridis, atol=10)
    assert found[[0, 4, 5]].tolist() == [[68, 1, 84]] * 3
    assert ramp_colours(np.array([0.25]), np.array([[0.0, 0, 0], [0, 200, 8]])).tolist() == [[0, 50, 2]]


def test_a_picture_has_a_column_for_each_plan(tmp_path: Path) -> None:
    tube = tube_map(0.03, 0.1, 4000.0, around=16)
    plans = [("firm", plan_map(tube, GraspTask(force_N=10.0))), ("soft", plan_map(tube, GraspTask(force_N=21.0)))]  # fmt: skip
    assert plans[0][1].grasps
    plot_plan(tmp_path / "plan.svg", plans)
    drawn = (tmp_path / "plan.svg").read_text(encoding="utf-8")
    # Letters are drawn as curves; each text is in a comment.
    for text in ("firm", f"best score {plans[0][1].grasps[0].score:.2f}", "soft", "no grasp"):
        assert f"<!-- {text}" in drawn or f"\n{text}" in drawn, text
    assert drawn.count("<!-- grasp score -->") >= 2
    assert drawn.count("<!-- height [mm] -->") == 1
    with pytest.raises(InputError, match=r"plan\.txt"):
        plot_plan(tmp_path / "plan.txt", plans)
    assert [path.name for path in tmp_path.iterdir()] == ["plan.svg"]


def test_what_cannot_be_confirmed_is_refused() -> None:
    cup = load_object("cup", around=16)
    count = len(cup.mesh.vertices_m)
    for vertex in (-1, count):
        with pytest.raises(InputError, match=f"vertex: found {vertex}, expected 0 to {count - 1}"):
            pinch_at(cup, vertex)
    for force_N in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match=f"force_N: found {force_N}, expected more than 0"):
            confirm_grasp(cup, 0, force_N)
