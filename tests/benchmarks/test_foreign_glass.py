"""A slice of the campaign on glass of another renderer, and its counting."""

import numpy as np
import pytest

pytest.importorskip("mujoco")
from tests.worlds.mujoco_glass import ray_scene

from benchmarks import foreign_glass
from visuohaptic.reconstruction.fusion import SpaceGrid

SMALL = SpaceGrid.around((-0.12, -0.12, -0.02), (0.12, 0.12, 0.2), 0.005)


def test_a_jar_is_found_from_six_views_of_another_renderer():
    (row,) = foreign_glass.campaign([2], (6,), space=SMALL, scale=0.5)
    assert row["kind"] == "jar"
    assert row["error_m"][0] < 0.01
    assert row["false"] == 0


def test_the_rays_of_an_empty_part_of_the_table_read_the_table():
    scene = ray_scene(8, views=1, scale=0.25)
    pose, matrix = scene.T_world_camera[0], scene.camera.matrix
    rows, columns = np.nonzero(~np.isnan(scene.depth_m[0]))
    rays = np.column_stack([columns, rows, np.ones_like(rows)]) @ np.linalg.inv(matrix).T
    points = scene.depth_m[0, rows, columns, None] * rays @ pose[:3, :3].T + pose[:3, 3]
    table = points[(abs(points[:, 0]) < 0.2) & (abs(points[:, 1]) < 0.2), 2]
    assert np.median(table) == pytest.approx(0.0, abs=0.005)


def test_figures_count_every_vessel_and_every_false_region():
    row = {"kind": "two", "vessels": ["tumbler", "tumbler"], "views": 8, "false": 1, "error_m": [0.002, None], "deviates": [0.5]}  # fmt: skip
    rows = [row, row | {"kind": "dark", "vessels": [], "false": 2, "error_m": [], "deviates": []}]
    by_name = {figure["name"]: figure for figure in foreign_glass.summary(rows)}
    assert by_name["other renderer, 8 views: vessels found"]["ours"] == pytest.approx(0.5)
    assert "missed: two" in by_name["other renderer, 8 views: vessels found"]["note"]
    assert by_name["other renderer, 8 views: false regions per scene"]["ours"] == pytest.approx(1.5)
    assert by_name["other renderer, 8 views: axis error / declared, rms"]["ours"] == pytest.approx(0.5)
