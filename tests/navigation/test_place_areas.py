"""Where pushed objects end: areas of objects.yaml, and the routes of the navigation graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.worlds.floor_scenes import doors_in_series
from tests.worlds.maps import World, raster
from visuohaptic.core import Estimate, HapticTag, InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import build_graph
from visuohaptic.navigation.grid import grid_layers
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.problem import (
    MovableObject,
    PlaceArea,
    Plan,
    PlanningProblem,
    PushCosts,
    RobotModel,
    areas_from_data,
    objects_from_data,
)

WORLD = doors_in_series(0, 1)
ROBOT = RobotModel(0.17)


def _problem(*areas: PlaceArea) -> PlanningProblem:
    tag = HapticTag(static_friction_N=Estimate(5.0, 0.0), fixed=False, falls=False, explored=1)
    objects = tuple(
        MovableObject(body.id, body.outline_m, tag, pose_sigma=(0.0, 0.0)) for body in WORLD.bodies
    )
    ends = np.array(WORLD.start_m), np.array(WORLD.goal_m)
    return PlanningProblem(OccupancyMap(raster(WORLD, 0.05), 0.05), ROBOT, *ends, objects, areas=areas)


def _end(plan: Plan, world: World = WORLD) -> shapely.Polygon:
    """Outline of the pushed box after the plan."""
    shift = sum(np.array(push.displacement_m) for push in plan.pushes)
    return world.bodies[0].moved(shift).polygon


def test_an_object_ends_beside_an_area_to_avoid_where_that_costs_less() -> None:
    plan = make_plan(_problem())
    end = _end(plan)
    x, y = end.centroid.coords[0]
    outline_m = shapely.get_coordinates(shapely.box(x - 0.25, y - 0.25, x + 0.25, y + 0.25))[:-1]
    avoid = shapely.Polygon(outline_m).buffer(-0.05)  # cells of 5 cm
    beside = make_plan(_problem(PlaceArea("route", outline_m, 30.0)))
    assert end.intersects(avoid)
    assert not _end(beside).intersects(avoid)
    assert plan.cost_s <= beside.cost_s < plan.cost_s + 30.0
    # A tenth of a second is worth no other push: the plan is the same, and it is said.
    cheap = make_plan(_problem(PlaceArea("route", outline_m, 0.1)))
    assert cheap.tasks == plan.tasks
    assert "box0 ends in a place to avoid, at 0.1 s" in cheap.notes


def test_an_object_ends_in_a_preferred_area() -> None:
    end = _end(make_plan(_problem()))
    x, y = end.centroid.coords[0]
    outline_m = shapely.get_coordinates(shapely.box(x + 0.2, y - 0.6, x + 1.4, y + 0.6))[:-1]
    inside = make_plan(_problem(PlaceArea("corner", outline_m, 60.0, prefer=True)))
    assert shapely.Polygon(outline_m).buffer(0.05).contains(_end(inside))
    assert not any("place to avoid" in note for note in inside.notes)


def test_an_object_keeps_the_routes_of_the_graph_free() -> None:
    problem = _problem()
    static = OccupancyMap(raster(WORLD, 0.05, bodies=False), 0.05)
    graph = build_graph(grid_layers(static, ROBOT))
    routes = shapely.multipoints(static.world_from_cell(graph.path_cells))
    without, kept = (make_plan(problem, PushCosts(on_route_s=cost_s)) for cost_s in (0.0, 60.0))
    assert shapely.distance(_end(without), routes) < ROBOT.radius_m - 0.05
    assert shapely.distance(_end(kept), routes) > ROBOT.radius_m - 0.05  # cells of 5 cm


def test_areas_are_lines_of_the_objects_file() -> None:
    entry = {"id": "exit", "type": "avoid", "footprint_m": [[0, 0], [1, 0], [1, 1]], "cost_s": 20}
    data = {"objects": [entry, {**entry, "id": "corner", "type": "prefer"}]}
    avoid, prefer = areas_from_data(data)
    assert (avoid.id, avoid.cost_s, avoid.prefer, prefer.prefer) == ("exit", 20.0, False, True)
    assert objects_from_data(data) == ()
    with pytest.raises(InputError, match=r"objects\[0\].cost_s: is missing"):
        areas_from_data({"objects": [{**entry, "cost_s": None}]})
    with pytest.raises(InputError, match="twice"):
        replace(_problem(avoid), areas=(avoid, avoid))


@pytest.mark.parametrize("cost_s", [-3.0, np.nan, np.inf])
def test_costs_are_finite_and_not_negative(cost_s) -> None:
    with pytest.raises(InputError, match=r"PushCosts: on_route_s: found .*, expected at least 0"):
        PushCosts(on_route_s=cost_s)
