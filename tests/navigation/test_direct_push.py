"""Direct pushes open the way, go straight through the centre, and end where they said."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from visuohaptic.core import Estimate, HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.pushing import PushModel, line_path, load_of_feet, simulate_push
from visuohaptic.reproduce.pushes import (
    DirectPushSettings,
    PushedObject,
    PushLimits,
    centre_from_tag,
    plan_direct_push,
)

RADIUS_M = 0.17
STOOL = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
PLACE = np.array([3.0, 2.0])
PATH = np.array([[1.0, 2.0], [5.0, 2.0]])


@pytest.fixture
def doorway():
    """A stool in a doorway of 1 m between two rooms."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:, 58:62] = 100
    cells[30:50, 58:62] = 0
    cells[37:43, 57:63] = 100
    return OccupancyMap(cells, 0.05)


def test_a_stool_in_a_doorway_is_pushed_through_and_aside(doorway):
    plans = plan_direct_push(
        doorway,
        PushedObject(STOOL + PLACE),
        robot_m=(1.0, 2.0),
        blocked_path_m=PATH,
        settings=DirectPushSettings(reach_m=1.5),
    )
    assert plans
    free = doorway.cells.copy()
    free[37:43, 57:63] = 0
    rows, columns = np.nonzero(free == 100)
    walls = shapely.union_all(
        shapely.box(columns * 0.05, rows * 0.05, columns * 0.05 + 0.05, rows * 0.05 + 0.05)
    )
    for plan in plans:
        # (a) (d): the contact lies on the outline, the line of the push goes through the centre.
        assert shapely.Polygon(STOOL + PLACE).exterior.distance(shapely.Point(plan.contact.point_m)) < 1e-3
        ahead = np.array([math.cos(plan.contact.platform_m[2]), math.sin(plan.contact.platform_m[2])])
        lever = PLACE - plan.contact.platform_m[:2]
        assert abs(ahead[0] * lever[1] - ahead[1] * lever[0]) < 1e-9
        # (c): from the room where the robot is.
        assert plan.path_m[0, 0] < 3.0
        # Robot and object pass: measured to the walls themselves, not to cells.
        platform = shapely.LineString(plan.path_m[:, :2])
        assert platform.distance(walls) > RADIUS_M - 0.05
        moved = [shapely.Polygon(STOOL + PLACE + p[:2] - plan.path_m[0, :2]) for p in plan.path_m]
        assert all(shape.distance(walls) > 0 for shape in moved)
        # The way is open: the platform passes the object, and nothing else is blocked by it.
        assert shapely.LineString(PATH).distance(moved[-1]) > RADIUS_M - 0.05
        assert plan.cost_s == pytest.approx(4.0 + plan.length_m / 0.05)
        assert 0.0 <= plan.failure_probability <= 1.0
    expected = [
        plan.cost_s / (1 - plan.failure_probability) for plan in plans[:4] if plan.failure_probability < 1
    ]
    assert expected == sorted(expected)


def test_a_corridor_without_room_has_no_plan():
    cells = np.full((40, 120), 100, np.int8)
    cells[14:24, 1:119] = 0  # 0.5 m wide: nothing passes the stool, wherever it stands
    map = OccupancyMap(cells, 0.05)
    path = np.array([[0.5, 0.95], [5.5, 0.95]])
    assert (
        plan_direct_push(
            map, PushedObject(STOOL + np.array([3.0, 0.95])), robot_m=(0.5, 0.95), blocked_path_m=path
        )
        == ()
    )


@pytest.mark.parametrize(
    "tag",
    [
        HapticTag(fixed=True),
        HapticTag(falls=True),
        HapticTag(static_friction_N=Estimate(25.0, 1.0)),
    ],
)
def test_what_cannot_be_pushed_has_no_plan(doorway, tag):
    assert plan_direct_push(doorway, PushedObject(STOOL + PLACE, tag)) == ()


def test_what_is_fixed_for_one_platform_is_not_for_a_stronger_one(doorway):
    tag = HapticTag(static_friction_N=Estimate(25.0, 1.0))
    assert plan_direct_push(
        doorway,
        PushedObject(STOOL + PLACE, tag),
        PushLimits(push_force_max_N=40.0),
        settings=DirectPushSettings(samples=0),
    )


def test_the_contact_is_moved_to_the_centre_that_the_first_push_told():
    # Feet with the mass 4 cm off to the left of a push along x: a push through the footprint's centre turns it.
    model = PushModel(STOOL, 0.9 * STOOL, load_of_feet(0.9 * STOOL, (0.0, 0.04)), 0.4)

    def turned(offset):
        start = np.array([-0.15 - RADIUS_M - 1e-4, offset])
        trace = simulate_push(
            model, (0.0, 0.0, 0.0), line_path(start, start + np.array([0.1, 0.0]), 0.005), RADIUS_M
        )
        return trace.object_m[-1, 2]

    first = turned(0.0)
    assert first > 0.05  # left, towards the side of the mass
    tag = HapticTag(rotation_rad_per_m=Estimate(first / 0.1, 0.05), explored=1)
    offset = centre_from_tag(tag, 0.0, PushModel(STOOL, 0.9 * STOOL, load_of_feet(0.9 * STOOL)), RADIUS_M)
    assert offset[0] == pytest.approx(0.0, abs=1e-12)
    assert offset[1] == pytest.approx(0.04, abs=0.015)
    assert abs(turned(offset[1])) < 0.35 * first
