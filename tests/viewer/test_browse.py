"""The page with many views: each is drawn, clicked and exchanged; a browser shows it."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from tests.patience import PATIENCE_S
from tests.viewer import browser

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.deformation.maps import load_map, save_map
from visuohaptic.deformation.shapes import load_object
from visuohaptic.grasping import GraspTask
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.meshes import PlyMesh, write_ply
from visuohaptic.navigation.problem import Plan, Task
from visuohaptic.navigation.problem.path_plan import Kind
from visuohaptic.viewer import (
    BrowsePage,
    MapView,
    ObjectView,
    StepsView,
    SurfaceView,
    hit_face,
    open_views,
    scale_colours,
)
from visuohaptic.viewer.object_view import Picked, _picked_text

pytest.importorskip("viser", reason="the browser page is an extra")
pytest.importorskip("trimesh", reason="coloured meshes are an extra")

THING = load_object("cup-rim", around=32)
PLAN = Plan(
    True,
    (
        Task("navigate", 3.0, 1.5, ((0.0, 0.0), (1.0, 0.2))),
        Task(
            "push", 7.0, 0.5, ((1.0, 0.2), (1.4, 0.5)), "box|1", goal_m=(2.0, 1.0), displacement_m=(0.4, 0.3)
        ),
    ),
)


def grid() -> OccupancyMap:
    cells = np.zeros((40, 60), np.int8)
    cells[0] = 100
    return OccupancyMap(cells, 0.05, (-0.5, -0.5, 0.3))


def surface() -> PlyMesh:
    points = THING.mesh.vertices_m
    grey = np.full((len(points), 3), 120, np.uint8)
    return PlyMesh(points, THING.surface_faces, grey, {"score": points[:, 0], "sigma_m": points[:, 2]})


@pytest.fixture(scope="module")
def cup() -> ObjectView:
    return ObjectView.of_object(THING, GraspTask(force_N=20.0))


def test_every_view_is_drawn_and_gives_way_to_the_next(cup):
    views = [cup, MapView("office", grid(), PLAN), SurfaceView("surface", surface()), StepsView("bottle")]
    with BrowsePage(views, port=0) as page:
        assert page.url.startswith("http://127.0.0.1:")
        assert page.stage.get("object") is not None
        for name in (*page.names[1:], page.names[0]):
            page.open(name)
        assert page.stage.get("object") is not None
        assert page.stage.get("map") is None
        page.open("office")
        assert page.stage.get("object") is None
        assert "1 pushes" in page.stage.get("tasks").content
        assert "box\\|1" in page.stage.get("tasks").content
        with pytest.raises(InputError, match="found 'kitchen', expected one of cup-rim, office"):
            page.open("kitchen")


def test_a_click_shows_the_point_that_the_ray_meets(cup):
    with BrowsePage([cup], port=0) as page:
        cup._clicked(np.array([1.0, 0.0, 0.05]), np.array([-1.0, 0.0, 0.0]))
        text = page.stage.get("picked").content
        # Cone of radii 26 and 37 mm over 100 mm, clicked at half height.
        assert "Point (3" in text
        assert "N/mm" in text
        assert page.stage.get("curve") is not None
        assert page.stage.get("shape") is not None
        cup._clicked(np.array([1.0, 0.0, 0.5]), np.array([-1.0, 0.0, 0.0]))  # beside it
        assert page.stage.get("picked").content == text


def test_the_curve_is_that_of_the_map_or_of_the_simulation(cup):
    points = THING.mesh.vertices_m
    vertex = int(np.argmin(np.abs(points[:, 2] - 0.05) + np.abs(points[:, 1]) - points[:, 0]))
    linear = cup.pick(vertex)
    np.testing.assert_allclose(linear.curve_N, linear.stiffness_N_per_m * linear.curve_m)
    assert linear.shape_m is not None
    moved = np.linalg.norm(linear.shape_m - points, axis=1)
    assert moved[vertex] == pytest.approx(20.0 / linear.stiffness_N_per_m, rel=0.05)
    deep = cup.pick(vertex, nonlinear=True)
    assert deep.nonlinear
    assert deep.curve_m[-1] > linear.curve_m[-1]
    held = cup.pick(0)
    assert np.isinf(held.stiffness_N_per_m)
    np.testing.assert_array_equal(held.curve_m, 0.0)


def test_grasps_are_listed_with_arrows_or_a_reason(cup):
    with BrowsePage([cup], port=0) as page:
        cup.show_grasps()
        assert "| 1 | 0." in page.stage.get("grasps").content
        assert page.stage.get("arrows") is not None
        for shade in ("grasp score", "contact", "deformation"):
            cup.paint(shade)
            assert shade in page.stage.get("legend").content
    # So much force bends the wall too far; its rim may be pinched, with a finger inside, as long as it is open.
    for closed, said in ((False, "| 1, rim |"), (True, "No grasp:")):
        soft = ObjectView.of_object(THING, GraspTask(force_N=59.0, closed=closed))
        with BrowsePage([soft], port=0) as page:
            soft.show_grasps()
            assert said in page.stage.get("grasps").content


def test_steps_grow_while_touches_arrive():
    steps = StepsView("bottle")
    with BrowsePage([steps], port=0) as page:
        assert "No touch yet" in page.stage.get("steps").content
        steps.ask("y8+ < 4.1 N/mm?")
        assert "touching" in page.stage.get("steps").content
        steps.answer("yes")
        steps.ask("<b>next</b>?")
        steps.answer("no")
        steps.finish("cien")
        content = page.stage.get("steps").content
    assert steps.steps == (("y8+ < 4.1 N/mm?", "yes"), ("<b>next</b>?", "no"))
    assert "It is: cien" in content
    assert "<b>" not in content.replace("\\<", "")


def test_files_become_views(tmp_path, cup):
    save_map(tmp_path / "cup.npz", cup.surface)
    grid().save(tmp_path / "office.yaml")
    (tmp_path / "plan.json").write_text(json.dumps(PLAN.to_json()))
    write_ply(tmp_path / "done.ply", surface())
    (tmp_path / "walk.json").write_text(json.dumps({"steps": [["soft?", "yes"]], "result": "cup"}))
    (tmp_path / "can.yaml").write_text("base: {radius: 30 mm}\nsections: [{height: 80 mm}]\n")
    names = ["cup.npz", "office.yaml", "plan.json", "plan.json", "done.ply", "walk.json", "can.yaml"]
    views = open_views([tmp_path / name for name in names])
    kinds = [type(view) for view in views]
    assert kinds == [ObjectView, MapView, MapView, SurfaceView, StepsView, ObjectView]
    assert views[1].plan is not None
    assert views[2].grid is views[1].grid
    np.testing.assert_array_equal(
        load_map(tmp_path / "cup.npz").vertices_m,
        views[0].surface.vertices_m,
    )
    assert views[3].choices[0] == "sigma_m"
    with BrowsePage(views, port=0) as page:
        for name in page.names:
            page.open(name)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("a.json", "{", "is not valid JSON"),
        ("a.json", "[1]", "found neither tasks of a plan nor steps"),
        ("a.json", '{"steps": [["a", 1]]}', r"expected a list of \[question, answer\]"),
        ("a.txt", "", "found suffix '.txt'"),
        ("a.pgm", "P5", "give the .yaml file of the map"),
        ("a.npz", "no zip", "is not a stiffness map"),
        ("a.yaml", "image: nowhere.pgm\n", "a.yaml"),
    ],
)
def test_files_that_are_none_are_refused(tmp_path, name, content, text):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=text):
        open_views([tmp_path / name])
    with pytest.raises(InputError, match="cannot be read"):
        open_views([tmp_path / "absent.json"])


def test_points_without_colours_are_drawn_plain_and_none_are_refused():
    points, no_faces = THING.mesh.vertices_m, np.zeros((0, 3), int)
    view = SurfaceView("scan", PlyMesh(points, no_faces, None, {}))
    assert view.choices == ("plain",)
    with BrowsePage([view], port=0) as page:
        assert page.stage.get("legend").content == f"**scan**: {len(points)} vertices"
        np.testing.assert_array_equal(page.stage.get("surface").colors, 170)
    with pytest.raises(InputError, match="none: has no vertices"):
        SurfaceView("none", PlyMesh(points[:0], no_faces, None, {}))


def test_what_cannot_be_computed_is_said_on_the_page(cup, monkeypatch):
    def fails(*_, **__):
        raise InputError("confirm_grasp", "found *no* equilibrium")

    monkeypatch.setattr("visuohaptic.viewer.object_view.confirm_grasp", fails)
    with BrowsePage([cup], port=0) as page:
        points = THING.mesh.vertices_m
        cup.show_point(int(np.argmin(np.abs(points[:, 2] - 0.05))), nonlinear=True)
        assert "found \\*no\\* equilibrium" in page.stage.get("picked").content
        assert page.stage.get("shape") is None  # none of the point before


def test_two_views_of_one_name_are_numbered_and_no_view_is_refused():
    with BrowsePage([StepsView("bottle"), StepsView("bottle")], port=0) as page:
        assert page.names == ("bottle (1)", "bottle (2)")
    with pytest.raises(InputError, match="found no views, expected at least one"):
        BrowsePage([], port=0)


def test_a_ray_meets_the_nearer_wall():
    points, faces = THING.mesh.vertices_m, THING.surface_faces
    found = hit_face(points, faces, np.array([0.2, 0.0, 0.05]), np.array([-1.0, 0.0, 0.0]))
    assert found is not None
    np.testing.assert_allclose(found[1][1:], [0, 0.05], atol=1e-12)
    assert found[1][0] == pytest.approx(np.interp(0.05, [0, 0.1], [0.026, 0.037]), rel=0.02)
    assert hit_face(points, faces, np.array([0.2, 0.0, 0.05]), np.array([1.0, 0.0, 0.0])) is None


def test_unknown_values_are_grey():
    tint = scale_colours(np.array([0.0, 1.0, np.nan]), 0.0, 1.0)
    assert tint[0].sum() > tint[1].sum()
    np.testing.assert_array_equal(tint[2], 150)


def test_the_verb_serves_for_a_while(tmp_path, capsys):
    from visuohaptic.cli.main import main

    (tmp_path / "walk.json").write_text(json.dumps({"steps": [], "result": ""}))
    words = ["view", str(tmp_path / "walk.json"), "--port", "0", "--seconds", "0.1", "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["views"] == ["walk"]
    assert found["url"].startswith("http://127.0.0.1:")
    assert main(["view", "nothing.xyz"]) == 2


def picked(stiffness: float, **change) -> str:
    line = np.array([0.0, 1e-3, 2e-3])
    found = Picked(0, np.array([0.01, 0.0, 0.02]), stiffness, 50.0, 0.5, line, 1e3 * line, None, False)
    return _picked_text(replace(found, **change), 1.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (lambda: picked(1000.0), r"Point \(10, 0, 20\) mm, grasp score 0.50  \nStiffness \*\*1.00 ± 0.05 N/mm\*\*: 1.50 mm"),
        (lambda: picked(1000.0, sigma_N_per_m=np.inf), r"\*\*1.00 N/mm\*\*"),
        (lambda: picked(np.nan), "There is no opposite point: it cannot be pinched.$"),
        (lambda: picked(0.0), "The map has no stiffness here.$"),
        (lambda: picked(np.inf), "The wall is clamped here and does not deform.$"),
        (lambda: picked(1000.0, nonlinear=True), "Nonlinear: 1.50 mm.$"),
        (lambda: picked(1000.0, nonlinear=True, note="it snaps"), "Nonlinear: it snaps.$"),
        (lambda: MapView("m")._text(), r"^\*\*m\*\*$"),
        (lambda: MapView("m", grid())._text(), "3.0 x 2.0 m, cells of 5 cm$"),
        (lambda: MapView("m", None, Plan(False, (), "a wall"))._text(), "No plan: a wall.$"),
        (lambda: MapView("m", None, PLAN)._text(), "10.0 s, 2.00 m, 1 pushes, failure probability"),
    ],
)  # fmt: skip
def test_what_a_view_says(text, said):
    assert re.search(said, text()), text()


def test_a_plan_without_a_map_and_a_map_without_an_object_are_drawn():
    still = replace(
        PLAN, tasks=(*PLAN.tasks, Task("push", 1.0, 0.0, ((0.0, 0.0),), "box", goal_m=(1.0, 1.0)))
    )
    ring = np.array([[0.03 * np.cos(a), 0.03 * np.sin(a), z] for z in (0.0, 0.1) for a in (0.0, 2.1, 4.2)])
    faces = np.array([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [2, 0, 5], [0, 3, 5]])
    stiffness = np.array([np.inf, np.inf, np.inf, 100.0, 200.0, np.nan])
    bare = ObjectView("bare", StiffnessMap(ring, faces, stiffness, np.full(6, 10.0)), task=GraspTask())
    assert bare.force_N == 10.0
    for vertex, depth_m in ((0, 0.0), (3, 0.1), (5, 0.0)):
        found = bare.pick(vertex, nonlinear=True)  # there is no object to simulate
        assert found.shape_m is None
        assert not found.nonlinear
        assert found.curve_m[-1] == pytest.approx(depth_m)
    with BrowsePage([MapView("plan", None, still), MapView("nothing"), bare], port=0) as page:
        assert page.stage.get("push1") is not None
        for name in ("nothing", "bare"):
            page.open(name)
        bare.show_point(5)  # nothing rises: no curve is drawn
        assert "cannot be pinched" in page.stage.get("picked").content
        bare.show_grasps()
        assert page.stage.get("grasps").content.startswith("No grasp: ")
        for shade in ("grasp score", "height", "stiffness"):
            bare.paint(shade)
            assert f"**bare**: {shade} from" in page.stage.get("legend").content


def test_every_task_of_a_plan_has_a_colour():
    way = ((0.0, 0.0), (1.0, 0.2))
    plan = Plan(True, tuple(Task(kind, 1.0, 1.0, way) for kind in get_args(Kind)))
    with BrowsePage([MapView("all", grid(), plan)], port=0) as page:
        text = page.stage.get("tasks").content
        assert all(page.stage.get(f"way{number}") is not None for number in range(len(plan.tasks)))
    assert all(f"| {kind} |" in text for kind in get_args(Kind))


def test_no_view_is_lost_because_another_has_its_number_in_its_title():
    with BrowsePage([StepsView(title) for title in ("a", "a", "a (1)", "b")], port=0) as page:
        assert len(page.names) == 4
        assert page.names[:2] == ("a (1)", "a (2)")


@pytest.mark.parametrize("force_N", [0.3, 12.3])
def test_the_slider_begins_at_the_force_of_the_task_however_small(cup, force_N):
    gentle = ObjectView("gentle", cup.surface, task=GraspTask(force_N=force_N))
    with BrowsePage([gentle], port=0) as page:
        slider = page.stage.get("force")
        assert slider.value == pytest.approx(force_N)
        assert slider.min <= force_N <= slider.max


def wait_until_drawn(page: BrowsePage) -> None:
    """Wait until the scene has something in its middle: meshes arrive after the panel, each frame is requested by one call."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (clients := page._server.get_clients()):
        assert time.monotonic() < deadline_s, "no browser"
        time.sleep(0.01)
    (client,) = clients.values()
    while not client.get_render(30, 40, transport_format="png", timeout=PATIENCE_S)[15, 20, 3]:
        assert time.monotonic() < deadline_s, "the middle of the scene stays empty"


@pytest.mark.slow
def test_a_click_in_a_browser(cup, tmp_path):
    if (program := browser.find_chromium()) is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with BrowsePage([cup, StepsView("bottle", [("soft?", "yes")], "cup")], port=0) as page:
        chromium = browser.Browser(program, tmp_path / "profile")
        try:
            chromium.open(page.url)
            chromium.wait_for("stiffness from")
            wait_until_drawn(page)
            chromium.click(*chromium.canvas_centre())
            chromium.wait_for("Point (")
            chromium.screenshot(tmp_path / "cup.png")
            page.open("bottle")
            text = chromium.wait_for("It is: cup")
        finally:
            chromium.close()
    assert "stiffness from" not in text
    outside = [
        address
        for address in chromium.requests
        if not address.startswith(("data:", "blob:http://127.0.0.1", "http://127.0.0.1", "ws://127.0.0.1"))
    ]
    assert outside == [], json.dumps(outside)
    assert (tmp_path / "cup.png").stat().st_size > 10_000


def test_reconstruct_shows_surface_and_glass_on_a_page_with_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    from types import SimpleNamespace

    from visuohaptic import viewer
    from visuohaptic.cli.verbs.geometry.reconstruct import _show
    from visuohaptic.reconstruction import SurfaceMesh
    from visuohaptic.reconstruction.transparency.panes import Pane

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    surface = SurfaceMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    part = SimpleNamespace(hull_m=corners + 2.0, faces=surface.faces)
    pane = Pane(np.array([[0.0, 0, 3], [2, 0, 3], [2, 1, 3], [0, 1, 3]]), 0.001, 20.0)
    said: list[str] = []
    view, shown = viewer.SurfaceView, []
    monkeypatch.setattr(viewer, "SurfaceView", lambda name, mesh: shown.append(mesh) or view(name, mesh))
    _show(
        SimpleNamespace(surface=surface, regions=[part], panes=[pane]),
        SimpleNamespace(report=said.append, seconds=0.1),
    )
    # A tetrahedron of 1 m, its twin, and a pane of 2 x 1 m.
    edges = shown[0].vertices_m[shown[0].faces[:, 1:]] - shown[0].vertices_m[shown[0].faces[:, :1]]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    assert areas.sum() == pytest.approx(2 * (1.5 + 0.5 * 3**0.5) + 2.0)
    # The address ends with a key: a page of another site does not know it.
    assert re.match(r"shown at http://127\.0\.0\.1:\d+/[\w-]{20,}/", said[0])
