"""From a folder to a completed surface with its sigma and plots, through the public interface."""

from __future__ import annotations

import doctest
import logging
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame, write_sequence
from visuohaptic.reconstruction import (
    SurfaceMesh,
    pipeline,
    plot_completion,
    plot_reconstruction,
    plots,
    reconstruct,
)
from visuohaptic.reconstruction.completion import Touch
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.transparency import find_regions
from visuohaptic.reconstruction.transparency.panes import Pane

from .test_completion import bellied, scene

GRID = SpaceGrid.around([-0.1, -0.1, 0.7], [0.1, 0.1, 0.9], 0.01)
WALL_M = 0.8


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """A folder with six views of a wall across the optical axis, and the views."""
    camera = Camera.simple(64, 48, 60.0)
    depth_m = np.full((48, 64), WALL_M, np.float32)
    frames = [
        DepthFrame(0.1 * k, depth_m, None, Pose(np.eye(3), np.array([x_m, 0.0, 0.0])), camera, k)
        for k, x_m in enumerate(np.linspace(-0.1, 0.1, 6))
    ]
    folder = tmp_path_factory.mktemp("wall")
    write_sequence(folder / "scan", iter(frames), sensor="home-made")
    return folder / "scan", frames


@pytest.fixture(scope="module")
def bottle(wall):
    """A bottle whose belly was not seen, as the pipeline would hand it over."""
    visible, hole, _ = scene(bellied())
    low_m, high_m = hole.hull_m.min(axis=0), hole.hull_m.max(axis=0)
    grid = SpaceGrid.around(low_m, high_m, 0.005)
    inside = hole.within(grid.all_centres_m).reshape(grid.shape)
    regions = find_regions(inside.astype(float), inside, grid)
    return replace(reconstruct(wall[1], grid=GRID), surface=visible, regions=regions)


def test_a_folder_gives_the_surface_of_its_views(wall, caplog):
    folder, frames = wall
    with caplog.at_level(logging.INFO):
        found = reconstruct(str(folder), grid=GRID)
    assert "noise of the sensor 'home-made', measured" in caplog.text
    # Depths are stored in whole millimetres; the plane is interpolated exactly.
    assert np.abs(found.surface.vertices_m[:, 2] - WALL_M).max() < 0.0005
    assert len(found.surface.faces) == len(reconstruct(frames, grid=GRID).surface.faces)
    assert found.regions == ()


def test_a_sparse_surface_goes_beyond_the_space_of_interest(wall):
    folder, _ = wall
    dense, sparse = (reconstruct(folder, grid=GRID, sparse=way).surface for way in (False, True))
    assert np.abs(sparse.vertices_m[:, 2] - WALL_M).max() < 0.0005
    # The space is 0.2 m wide; the image of 64 px at 60 px covers 0.85 m, and the camera moves by 0.2 m.
    assert np.ptp(dense.vertices_m[:, 0]) <= 0.2 + 0.01
    assert np.ptp(sparse.vertices_m[:, 0]) == pytest.approx(0.85 + 0.2, abs=0.03)


def test_a_part_is_completed_and_known_best_where_it_was_touched(bottle):
    completion = bottle.completion()
    plan = completion.next_touch()
    wall_m = float(bellied().radius_m(np.arctan2(*plan.start_m[1::-1]), plan.target_m[2]))
    contact_m = [*(-wall_m * plan.direction[:2]), plan.target_m[2]]  # the axis is that of z
    assert abs(completion.implicit(np.array(contact_m))) > 0.004  # the extension misses the belly of 12 mm
    completion.add(Touch(contact_m, plan.start_m, plan.end_m, 0.0003))
    surface = completion.completed()
    sigma_m = completion.sigma_m(surface.vertices_m)
    assert sigma_m.shape == (len(surface.vertices_m),)
    assert sigma_m.min() > 0
    near = np.linalg.norm(surface.vertices_m - contact_m, axis=1).argmin()
    assert np.linalg.norm(surface.vertices_m[near] - contact_m) < 0.004  # a step of the grid: 1/63 of 0.2 m
    assert sigma_m[near] < np.median(sigma_m[sigma_m > completion.settings.visual_sigma_m])


def test_a_part_that_is_not_there_is_refused(bottle):
    with pytest.raises(InputError, match="found part 3, expected one of 1 transparent parts"):
        bottle.completion(3)
    with pytest.raises(InputError, match="expected one of 0 transparent parts; 6 of 6 views compared"):
        replace(bottle, regions=()).completion()


def test_figures_are_written_and_show_both_kinds_of_surface(bottle, tmp_path):
    completion = bottle.completion()
    plot_completion(completion, tmp_path / "completed.png")
    image = cv2.imread(str(tmp_path / "completed.png"))
    saturation = np.ptp(image.astype(int), axis=2)
    dark = image.max(axis=2) < 235
    # The hidden belly is coloured, the bands are grey: both cover a fiftieth of the figure at least.
    assert (saturation > 40).mean() > 0.02
    assert ((saturation < 10) & dark).mean() > 0.02
    plot_reconstruction(bottle, tmp_path / "scene.svg")
    assert (tmp_path / "scene.svg").stat().st_size > 10_000
    with pytest.raises(InputError, match=r"found suffix '.xyz', expected .png, .pdf or .svg"):
        plot_completion(completion, tmp_path / "completed.xyz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["completed.png", "scene.svg"]


def test_no_label_of_a_flat_scene_covers_another(bottle, tmp_path, monkeypatch):
    """A table is wide and low: its labels of height are the ones that find no room. The title counts panes."""
    corners_m = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.08, 0.1)])
    table = SurfaceMesh(corners_m, np.array([[0, 2, 6], [1, 3, 7]]))
    drawn = []
    monkeypatch.setattr(plots, "save_figure", lambda path, figure: drawn.append(figure))
    pane = Pane(corners_m[[0, 2, 6, 4]], 0.001, 20.0)
    plot_reconstruction(replace(bottle, surface=table, panes=(pane,)), tmp_path / "table.png")
    (figure,) = drawn
    assert "parts, 1 flat pane in " in figure.get_suptitle()
    FigureCanvasAgg(figure).draw()
    boxes = []
    for axis in (getattr(axes, f"{name}axis") for axes in figure.axes[:2] for name in "xyz"):
        shown = [tick.label1 for tick in axis.get_major_ticks() if tick.label1.get_text()]
        boxes += [text.get_window_extent() for text in (axis.label, *shown)]
    assert len(boxes) > 18
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_the_example_of_the_docstring_runs():
    found = doctest.testmod(pipeline)
    assert found.attempted > 5
    assert found.failed == 0
