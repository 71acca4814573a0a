"""What plots contain, read from Matplotlib: places, outlines, headings and limits, by shapes that are computed here."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import shapely
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from tests.navigation.random_maps import random_map
from visuohaptic.core import Estimate, HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.plots import plot_navigation, plot_path_plan
from visuohaptic.navigation.plots.plan_plots import _poses
from visuohaptic.navigation.problem import (
    MovableObject,
    Passage,
    PassageKind,
    Plan,
    PlanningProblem,
    RobotModel,
    Task,
)

LIGHT = HapticTag(static_friction_N=Estimate(8.0, 0.0), explored=1)
BOX_M = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.2], [0.0, 0.2]])
FOOT_M = np.array([[0.3, -0.2], [0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2]])


def drawn(problem, plan, monkeypatch, tmp_path, **options):
    """The figure that is saved."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: figures.append(figure) or path.touch())
    plot_path_plan(problem, plan, tmp_path / "plan.png", **options)
    return figures[0]


@pytest.fixture
def scene():
    """A map of 20 m by 10 m, turned by 0.4 rad; a plan that explores, pushes and turns a box and waits at a door."""
    cells = np.zeros((100, 200), np.int8)
    cells[10:20, 30:40] = 100
    cells[50:60, 0:10] = -1
    grid = OccupancyMap(cells, 0.1, (2.0, -1.0, 0.4))
    place = [
        grid.world_from_cell(np.array([row, column]) - 0.5) for row, column in ((20, 20), (40, 100), (42, 60))
    ]
    start, goal, at = place
    things = (
        MovableObject("pushed", BOX_M + at, LIGHT),
        MovableObject("fixed", BOX_M + at + [0.0, 1.0], HapticTag(fixed=True)),
        MovableObject("left", BOX_M + at + [1.0, 1.0], LIGHT),
    )
    door = Passage("door", BOX_M + at + [2.0, 0.0], PassageKind.DOOR_PUSH)
    problem = PlanningProblem(grid, RobotModel.of_footprint(FOOT_M), start, goal, things, passages=(door,))
    end = things[0].centre_m + np.array([0.5, 0.3])
    way = tuple(map(tuple, (at + np.array([[-1.0, 0.1], [-0.5, 0.1], [-0.8, 0.1]])).tolist()))
    plan = Plan(
        True,
        (
            Task("navigate", 5.0, 2.0, (tuple(start), way[0])),
            Task("explore", 8.0, object="pushed", contact_m=tuple(at)),
            Task("push", 7.0, 0.8, way, "pushed", tuple(at), tuple(end), (0.5, 0.3), 0.6),
            Task("sideward", 7.0, 0.8, way[:2], "pushed", tuple(at), tuple(end), (0.5, 0.3), 0.6),
            Task("door", 9.0, 1.0, (way[2], tuple(goal)), "door", sigma_s=2.4),
        ),
    )  # fmt: skip
    return problem, plan


def test_everything_is_drawn_where_it_is(scene, monkeypatch, tmp_path):
    problem, plan = scene
    figure = drawn(problem, plan, monkeypatch, tmp_path)
    (axes,) = figure.axes
    outlines = [shapely.Polygon(p.get_xy()) for p in axes.patches if isinstance(p, Polygon)]
    labels = [patch.get_label() for patch in axes.patches if isinstance(patch, Polygon)]
    for item, label in zip(problem.objects, ("pushed", "fixed", "not pushed"), strict=True):
        (found,) = [o for o, text in zip(outlines, labels, strict=True) if text == f"object, {label}"]
        assert found.equals(shapely.Polygon(item.footprint_m))
    # After the push: displaced by 0.5 m and 0.3 m, turned by 0.6 rad about its centre.
    box = shapely.affinity.rotate(shapely.Polygon(BOX_M), 0.6, (0.2, 0.1), use_radians=True)
    expected = shapely.affinity.translate(box, *(problem.objects[0].footprint_m[0] + [0.5, 0.3]))
    ends = [o for o, text in zip(outlines, labels, strict=True) if text == "after the push"]
    assert len(ends) == 2
    for end in ends:
        assert end.symmetric_difference(expected).area < 1e-9
    lines = {line.get_label(): np.array(line.get_data()).T for line in axes.lines[::-1]}
    for task in plan.tasks:
        if task.path_m:
            np.testing.assert_allclose(lines[task.kind], task.path_m)
    np.testing.assert_allclose(lines["start"], [problem.start_m])
    np.testing.assert_allclose(lines["goal"], [problem.goal_m])
    np.testing.assert_allclose(lines["exploration"], [plan.tasks[1].contact_m])
    middle = problem.passages[0].footprint_m.mean(axis=0)
    np.testing.assert_allclose(lines["push open door: 9 s, sigma 2 s"], [middle])
    words = {text.get_text(): text.xy for text in axes.texts}
    assert words["1"] == plan.tasks[1].contact_m
    np.testing.assert_allclose(words["door"], middle)
    for item in problem.objects:
        np.testing.assert_allclose(words[item.id], [item.centre_m[0], item.footprint_m[:, 1].max()])
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(set(shown)) == len(shown) == 13
    # Pushes are red, what the robot only drives is green.
    colours = {line.get_label(): line.get_color() for line in axes.lines}
    assert colours["push"] == colours["sideward"] != colours["navigate"]


def test_the_map_is_turned_as_it_is_in_its_frame(scene, monkeypatch, tmp_path):
    problem, plan = scene
    (axes,) = drawn(problem, plan, monkeypatch, tmp_path, title="100 %").axes
    assert axes.get_title() == "100 %"
    (image,) = axes.images
    left, right, low, high = image.get_extent()
    assert (left, right, low, high) == pytest.approx((0.0, 20.0, 0.0, 10.0))
    to_map = image.get_transform() - axes.transData
    for row, column in ((0, 0), (99, 0), (30, 150)):
        corner = to_map.transform([column * 0.1, row * 0.1])
        np.testing.assert_allclose(corner, problem.map.world_from_cell(np.array([row, column]) - 0.5))
    shade = np.asarray(image.get_array())
    assert image.origin == "lower"
    assert [shade[0, 0], shade[15, 35], shade[55, 5]] == pytest.approx([1.0, 0.0, 0.8])


def test_a_view_is_that_of_what_the_plan_needs_and_a_tenth_more(scene, monkeypatch, tmp_path):
    problem, plan = scene
    (axes,) = drawn(problem, plan, monkeypatch, tmp_path).axes
    points = np.concatenate(
        [
            [problem.start_m, problem.goal_m],
            problem.objects[0].footprint_m,
            *(t.path_m for t in plan.tasks if t.path_m),
        ]
    )
    assert np.ptp(points, axis=0).max() < 10.0
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    ways = problem.map.world_from_cell(np.array([[0, 0], [0, 200], [100, 0], [100, 200]]) - 0.5)
    low, high = np.maximum(low, ways.min(axis=0)), np.minimum(high, ways.max(axis=0))
    np.testing.assert_allclose(np.transpose([axes.get_xlim(), axes.get_ylim()]), [low, high])
    # Without a plan all objects are seen; of 13 m and more the margin is a tenth.
    far = replace(problem, goal_m=problem.map.world_from_cell(np.array([20, 180])))
    (axes,) = drawn(far, Plan(False), monkeypatch, tmp_path).axes
    points = np.concatenate([[far.start_m, far.goal_m], *(item.footprint_m for item in far.objects)])
    margin = 0.1 * np.ptp(points, axis=0).max()
    assert margin > 1.3
    assert axes.get_xlim()[0] == pytest.approx(max(points[:, 0].min() - margin, ways[:, 0].min()))
    assert axes.get_ylim()[1] == pytest.approx(points[:, 1].max() + margin)


def test_footprints_are_drawn_twice_a_metre_along_the_way(scene, monkeypatch, tmp_path):
    problem, plan = scene
    poses = np.array(_poses(plan))
    for task in plan.tasks:
        way = np.array(task.path_m[:2] if task.kind == "push" else task.path_m)
        for a, b in itertools.pairwise(way):
            along = (b - a) / np.hypot(*(b - a))
            on = (np.abs(np.angle(np.exp(1j * (poses[:, 2] - np.arctan2(*along[::-1]))))) < 1e-9) & (
                shapely.distance(shapely.LineString([a, b]), shapely.points(poses[:, :2])) < 1e-9
            )
            places = np.unique(((poses[on, :2] - a) @ along).round(9))
            assert places[[0, -1]] == pytest.approx([0.0, np.hypot(*(b - a))], abs=1e-8)
            assert np.diff(places).max() <= 0.75
    (axes,) = drawn(problem, plan, monkeypatch, tmp_path).axes
    shapes = [shapely.Polygon(p.get_xy()) for p in axes.patches if p.get_label() == "footprint"]
    assert len(shapes) == len(poses)
    for shape, (x, y, heading) in zip(shapes, poses, strict=True):
        turned = shapely.affinity.rotate(shapely.Polygon(FOOT_M), heading, (0, 0), use_radians=True)
        assert shape.symmetric_difference(shapely.affinity.translate(turned, x, y)).area < 1e-9
    disc = replace(problem, robot=RobotModel(0.2))
    labels = {p.get_label() for p in drawn(disc, plan, monkeypatch, tmp_path).axes[0].patches}
    assert "footprint" not in labels


@pytest.mark.parametrize(("turned", "bar_m"), [(False, 0.5), (True, 1.0)])
def test_the_picture_of_a_map_has_its_graph_and_regions(turned, bar_m):
    grid = random_map(np.random.default_rng(8), 60)
    cells = np.concatenate([grid.cells, np.where(grid.cells, grid.cells, 0)[:, ::-1]], axis=0)
    cells = cells.T.copy() if turned else cells
    layers = grid_layers(OccupancyMap(cells, 0.05), SpeedLimits(0.1))
    regions = assign_regions(layers, build_graph(layers))
    graph = regions.graph
    assert graph.nodes > 3
    figure = plot_navigation(regions)
    left, right = figure.axes[:2]
    for axes in (left, right):
        walls = np.asarray(axes.images[0].get_array())
        np.testing.assert_allclose(walls, np.where(cells >= 50, 0.25, np.where(cells < 0, 0.82, 1.0)))
        (lines,) = axes.collections[:1]
        assert len(lines.get_segments()) == len(graph.edges)
        for edge, line in enumerate(lines.get_segments()):
            np.testing.assert_array_equal(line, graph.edge_path(edge)[:, ::-1])
    shown = np.asarray(left.images[1].get_array().filled(np.nan))
    np.testing.assert_allclose(shown, np.where(layers.distance_m > 0, layers.distance_m, np.nan), rtol=1e-6)
    picture = np.asarray(right.images[1].get_array())
    np.testing.assert_array_equal(picture[..., 3] > 0, regions.node >= 0)
    colours = [np.unique(picture[regions.node == k][:, :3], axis=0) for k in range(graph.nodes)]
    assert all(len(one) == 1 for one in colours if len(one))
    several = np.concatenate([one for one in colours if len(one)])
    assert len(np.unique(several.round(6), axis=0)) == len(several)
    np.testing.assert_array_equal(right.collections[1].get_offsets(), graph.node_cells[:, ::-1])
    assert right.get_title(loc="left").startswith(f"b  graph: {graph.nodes} nodes, {len(graph.edges)} edges")
    # A bar of a quarter of the width at most, in the unit of the axes.
    (bar,) = [line for line in left.lines if len(line.get_xdata()) == 2]
    assert np.ptp(bar.get_xdata()) * 0.05 == pytest.approx(bar_m)
    assert left.texts[-1].get_text() == f"{bar_m:g} m"
    # Wide maps are below each other, tall ones beside each other.
    (a, b) = (axes.get_subplotspec().get_gridspec().get_geometry() for axes in (left, right))
    assert a == b == ((2, 1) if turned else (1, 2))
