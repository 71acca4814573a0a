"""Sideward pushes release the object before the end, and each failure is named."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visuohaptic.core import HapticTag, InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.pushing import PushModel, line_path
from visuohaptic.reproduce.pushes import (
    LocalCostmap,
    PushedObject,
    PushLimits,
    PushScene,
    SidewardOutcome,
    SidewardPushSettings,
    evaluate_push,
    plan_sideward_push,
)

RADIUS_M = 0.17
BOX = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
PLACE = np.array([3.0, 2.0])


@pytest.fixture
def hall():
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    return OccupancyMap(cells, 0.05)


@pytest.fixture
def corridor():
    """0.7 m wide with a bay on one side behind the box."""
    cells = np.full((80, 120), 100, np.int8)
    cells[33:47, 1:119] = 0
    cells[33:60, 62:80] = 0
    return OccupancyMap(cells, 0.05)


def check(map, plan, place):
    rows, columns = np.nonzero(map.cells == 100)
    walls = shapely.union_all(
        shapely.box(columns * 0.05, rows * 0.05, columns * 0.05 + 0.05, rows * 0.05 + 0.05)
    )
    assert plan.outcome is SidewardOutcome.RELEASED
    assert shapely.LineString(plan.path_m[:, :2]).distance(walls) > RADIUS_M - 0.05
    for x, y, yaw in plan.trace.object_m[:: max(1, len(plan.path_m) // 15)]:
        c, s = np.cos(yaw), np.sin(yaw)
        assert shapely.Polygon(BOX @ np.array([[c, s], [-s, c]]) + [x, y]).distance(walls) > 0
    # Past the object: the platform at the end does not touch it any more.
    x, y, yaw = plan.trace.object_m[-1]
    c, s = np.cos(yaw), np.sin(yaw)
    last = shapely.Polygon(BOX @ np.array([[c, s], [-s, c]]) + [x, y])
    assert last.distance(shapely.Point(plan.path_m[-1, :2])) > RADIUS_M - 1e-3


def test_a_box_in_a_hall_is_brushed_aside(hall):
    plans = plan_sideward_push(hall, PushedObject(BOX + PLACE), (1.5, 2.0), (4.5, 2.0))
    assert plans
    for plan in plans[:5]:
        check(hall, plan, PLACE)
        assert plan.path_m[0, 0] < 3.0 < plan.path_m[-1, 0]
        assert plan.cost_s > 4.0


def test_a_box_in_a_corridor_needs_the_bay(corridor):
    place = np.array([3.0, 2.0])
    settings = SidewardPushSettings(samples=8)
    for plan in plan_sideward_push(
        corridor, PushedObject(BOX + place), (1.5, 2.0), (4.5, 2.0), settings=settings
    )[:3]:
        check(corridor, plan, place)
    closed = OccupancyMap(corridor.cells.copy(), 0.05)
    closed.cells[45:, :] = 100
    # 0.6 m; box 0.3 m and platform 0.34 m wide.
    assert plan_sideward_push(closed, PushedObject(BOX + place), (1.5, 2.0), (4.5, 2.0)) == ()


def test_each_failure_has_its_name(hall):
    model = PushModel.patch(BOX)
    costmap = LocalCostmap.around(hall, BOX + PLACE, 2.5)
    scene = PushScene.with_model(costmap, model, (3.0, 2.0, 0.0), PushLimits(RADIUS_M))

    def outcome(start, end):
        return evaluate_push(scene, line_path(np.array(start), np.array(end)))[0]

    assert outcome((2.5, 2.0), (3.5, 2.0)) is SidewardOutcome.CONTACT
    assert outcome((2.5, 2.6), (3.5, 2.6)) is SidewardOutcome.UNTOUCHED
    assert outcome((2.5, 2.25), (3.9, 2.25)) is SidewardOutcome.RELEASED
    assert outcome((3.0, 2.5), (3.0, 0.4)) is SidewardOutcome.COLLISION
    assert outcome((2.5, 3.9), (3.5, 3.9)) is SidewardOutcome.BLOCKED


def test_a_fixed_object_is_never_pushed(hall):
    assert (
        plan_sideward_push(hall, PushedObject(BOX + PLACE, HapticTag(fixed=True)), (1.5, 2.0), (4.5, 2.0))
        == ()
    )


def test_the_way_has_to_lead_somewhere(hall):
    with pytest.raises(InputError, match="expected two places"):
        plan_sideward_push(hall, PushedObject(BOX + PLACE), (1.5, 2.0), (1.5, 2.0))
