"""The tasks of a plan against the geometry and the costs that they state: contacts, ends, risks, explorations, escapes."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.navigation.plan_scenes import ROBOT, STOOL
from tests.navigation.test_moved_scenes import CELL_M, outline
from tests.navigation.test_moved_scenes import problem as with_area
from visuohaptic.core import HapticTag
from visuohaptic.navigation.planning import alternatives, make_plan, without_pushing
from visuohaptic.navigation.planning.search import SearchLimits, build_search_domain
from visuohaptic.navigation.planning.search.push_ends import end_errors
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, PushCosts, push_cost

PATIENT = SearchLimits(budget_s=60.0)


def problem():
    """The scene without a price of places."""
    return replace(with_area(), areas=())


def with_tags(given, *tags):
    """The same objects with other tags."""
    things = tuple(replace(one, tag=tag) for one, tag in zip(given.objects, tags, strict=True))
    return replace(given, objects=things)


@pytest.fixture(scope="module")
def plan():
    return make_plan(problem(), limits=PATIENT)


def test_a_plan_is_one_way_from_start_to_goal(plan):
    given = problem()
    assert [task.kind for task in plan.tasks] == ["navigate", "push", "navigate"]
    at = given.start_m
    for task in plan.tasks:
        np.testing.assert_allclose(task.path_m[0], at, atol=1e-6)
        steps = [math.dist(a, b) for a, b in itertools.pairwise(task.path_m)]
        assert task.length_m == pytest.approx(sum(steps), rel=1e-6)
        at = task.path_m[-1]
    np.testing.assert_allclose(at, given.goal_m, atol=1e-6)
    assert plan.cost_s == pytest.approx(sum(task.cost_s for task in plan.tasks))
    assert plan.gap < 0.1


def test_a_push_touches_its_object_and_ends_where_it_says(plan):
    (push,) = plan.pushes
    (box,) = [one for one in problem().objects if one.id == push.object]
    shape = shapely.Polygon(box.footprint_m)
    moved = np.array(push.displacement_m)
    length_m = float(np.hypot(*moved))
    ahead = moved / length_m
    assert shape.exterior.distance(shapely.Point(push.contact_m)) < 1e-6
    np.testing.assert_allclose(np.subtract(push.goal_m, box.centre_m), moved, atol=1e-9)
    approach, end, retreat = np.array(push.path_m)
    # 3 cm before the contact, the length of the push, and 3 cm back.
    np.testing.assert_allclose(end - approach, (length_m + 0.03) * ahead, atol=1e-6)
    np.testing.assert_allclose(retreat - approach, length_m * ahead, atol=1e-6)
    touch = approach + 0.03 * ahead
    assert shape.distance(shapely.Point(touch)) == pytest.approx(ROBOT.radius_m, abs=1e-4)
    assert np.hypot(*np.subtract(push.contact_m, touch)) == pytest.approx(ROBOT.radius_m, abs=1e-4)
    expected = push_cost(STOOL, length_m, ROBOT, PushCosts())
    assert push.cost_s == pytest.approx(expected.total_s)
    assert push.failure_probability == pytest.approx(expected.failure_probability)
    assert push.turn_rad == 0.0
    # Nine in ten of the simulated ends are inside of the declared ellipsoid.
    domain = build_search_domain(problem())
    contacts = domain.bodies[0].contacts
    number = int(np.argmax([contact.direction @ ahead for contact in contacts]))
    errors = end_errors(domain, 0, number, length_m / CELL_M)
    covariance = np.array(push.end_covariance)
    np.testing.assert_allclose(covariance, covariance.T)
    inside = (
        np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors) < 6.251
    )  # chi^2 of 3 degrees at 0.9
    assert inside.mean() == pytest.approx(0.9, abs=0.02)


def test_what_stays_and_what_is_left_out_is_said():
    given = with_tags(problem(), STOOL, HapticTag(fixed=True), HapticTag(falls=True))
    notes = make_plan(given, limits=PATIENT).notes
    assert "box 1 is not pushed: fixed" in notes
    assert "box 2 is not pushed: falls when pushed" in notes
    none = make_plan(with_tags(problem(), HapticTag(fixed=True), STOOL, STOOL), limits=PATIENT)
    assert none.proved
    assert "separate start and goal" in none.reason


@pytest.mark.parametrize("detour", [False, True])
def test_an_unknown_object_costs_its_exploration_and_what_happens_if_it_does_not_move(detour):
    """p of the prior: the rest of the plan with 1 - p, the best plan without the object with p."""
    given = problem()
    cells = given.map.cells.copy()
    if detour:
        cells[68:76, 58:60] = 0  # another door, at the upper end
    given = replace(with_tags(given, None, STOOL, STOOL), map=replace(given.map, cells=cells))
    costs = PushCosts(unknown_movable=0.7)
    plan = make_plan(given, costs, PATIENT)
    fixed = make_plan(with_tags(given, HapticTag(fixed=True), STOOL, STOOL), costs, PATIENT)
    assert fixed.reachable == detour
    if not any(task.kind == "explore" for task in plan.tasks):
        assert detour
        assert plan.cost_s == pytest.approx(fixed.cost_s, rel=0.02)
        return
    kinds = [task.kind for task in plan.tasks]
    at = kinds.index("explore")
    explore, push = plan.tasks[at : at + 2]
    assert (explore.object, push.kind, push.object) == ("box 0", "push", "box 0")
    assert explore.cost_s == pytest.approx(costs.explore_time_s)
    assert explore.failure_probability == pytest.approx(0.3)
    assert explore.contact_m == push.contact_m
    # Once explored, its first push fails as 0.2 / (1 + 0.2 + 0.8).
    assert push.failure_probability == pytest.approx(0.1)
    if not detour:
        assert plan.expected_s is None or math.isinf(plan.expected_s)
        return
    before = sum(task.cost_s for task in plan.tasks[: at + 1])
    after = sum(task.cost_s for task in plan.tasks[at + 1 :])
    there = make_plan(
        replace(with_tags(given, HapticTag(fixed=True), STOOL, STOOL), start_m=np.array(plan.tasks[at - 1].path_m[-1])), costs, PATIENT
    )  # fmt: skip
    assert plan.expected_s == pytest.approx(before + 0.7 * after + 0.3 * there.cost_s, rel=0.02)
    assert plan.expected_s <= fixed.cost_s * (1 + 1e-9)


def test_a_start_beside_a_wall_is_left_slowly_and_said_so():
    given = replace(problem(), start_m=np.array([0.05 + 0.12, 2.0]))
    plan = make_plan(given, limits=PATIENT)
    first = plan.tasks[0]
    assert plan.notes[0].startswith("the start is too near to an obstacle: ")
    assert f"{first.length_m:.2f} m away from it first" in plan.notes[0]
    assert first.path_m[0] == pytest.approx((0.17, 2.0))
    away = np.array(first.path_m[1])
    assert away[0] - 0.05 >= ROBOT.radius_m - 1e-6
    assert first.cost_s == pytest.approx(first.length_m / ROBOT.v_min_m_s)
    inside = make_plan(replace(problem(), start_m=np.array([0.02, 2.0])), limits=PATIENT)
    assert inside.proved
    assert "next to a wall or unknown cells, and cannot leave it in a straight line" in inside.reason
    at = problem().objects[1].centre_m
    within = make_plan(replace(problem(), start_m=at), limits=PATIENT)
    assert "next to box 1" in within.reason


def test_alternatives_differ_in_what_they_allow():
    given = problem()
    cells = given.map.cells.copy()
    cells[64:76, 58:60] = 0
    risky = HapticTag(explored=6, failed=3)
    given = replace(with_tags(given, risky, STOOL, STOOL), map=replace(given.map, cells=cells))
    found = alternatives(given, limits=PATIENT)
    assert set(found) == {"cheapest", "most reliable", "no pushing", "most information"}
    assert all(plan.name == name for name, plan in found.items())
    free = without_pushing(given, PATIENT)
    assert not free.pushes
    assert found["no pushing"].cost_s == pytest.approx(free.cost_s)
    assert found["cheapest"].cost_s <= free.cost_s * (1 + 1e-9)
    assert found["most reliable"].failure_probability == min(
        plan.failure_probability for plan in found.values()
    )
    assert found["most information"].tasks == found["cheapest"].tasks


def test_a_goal_beside_what_does_not_move_is_no_goal():
    for goal, fits in ((np.array([5.1, 0.05 + 0.171]), True), (np.array([5.1, 0.05 + 0.169]), False)):
        plan = make_plan(replace(problem(), goal_m=goal), limits=PATIENT)
        assert plan.reachable == fits
        assert fits or plan.reason == "the goal is too near to what cannot be moved"
    thing = MovableObject("post", outline(5.1, 3.0, 0.0), HapticTag(fixed=True))
    near = replace(problem(), goal_m=np.array([5.1, 3.0 - 0.15 - 0.1]), objects=(*problem().objects, thing))
    assert isinstance(near, PlanningProblem)
    assert make_plan(near, limits=PATIENT).reason == "the goal is too near to what cannot be moved"
