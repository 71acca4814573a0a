"""The search effort for passages in series is additive, not combinatorial."""

from __future__ import annotations

import numpy as np
import pytest

from tests.navigation.plan_check import faults
from tests.navigation.plan_scenes import ROBOT, STOOL, box, rooms, with_objects
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.planning.search import SearchLimits, build_search_domain
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.problem import MovableObject, PlanningProblem


def series(doors):
    """Rooms in a row, a stool in every door."""
    walls, stools = [], []
    for index in range(doors):
        x = 2.0 + 2.0 * index
        walls += [(x, 0, x + 0.1, 1.0), (x, 1.8, x + 0.1, 3.0)]
        stools.append(MovableObject(f"stool {index}", box(x + 0.05, 1.4, 0.45), STOOL))
    grid = rooms(2.0 * doors + 2, 3.0, walls)
    ends = np.array([0.7, 1.4]), np.array([2.0 * doors + 1.3, 1.4])
    return PlanningProblem(with_objects(grid, stools), ROBOT, *ends, tuple(stools))


@pytest.mark.parametrize("doors", [3, 6])
def test_doors_in_series(doors):
    problem = series(doors)
    plan = make_plan(problem, limits=SearchLimits(budget_s=30.0, gap=0.1))
    assert plan.reachable
    assert plan.gap < 0.1
    assert len(plan.pushes) >= doors
    assert not faults(problem, plan)
    # All combinations of a few pushes per door would be thousands. What one costs is the size of the lattice.
    domain = build_search_domain(problem)
    assert plan.expanded * domain.lattice.size < 50 * doors * domain.clearance.size


def test_the_cost_to_go_behind_moved_bodies_is_that_of_a_search_from_the_goal():
    domain = build_search_domain(series(4))
    rng = np.random.default_rng(3)

    def heuristic():
        return PushHeuristic(domain, domain.costs, range(4))

    kept = heuristic()
    kept.field(np.zeros((4, 2)))
    for moved in ([0], [1, 2], [3], [0, 1, 2, 3]):
        shifts = np.zeros((4, 2))
        shifts[moved] = rng.uniform(-9.0, 9.0, (len(moved), 2))
        np.testing.assert_array_equal(kept.field(shifts), heuristic().field(shifts))
        # Up to a target: its own cost is final, those farther away are bounded by it.
        for robot in (domain.start, domain.goal):
            shifts[moved] += 0.25  # a configuration of its own
            whole = heuristic().field(shifts)
            near, _ = domain.seeds(kept.base, robot)
            part = kept.field(shifts, robot)
            np.testing.assert_array_equal(part[near], whole[near])
            assert (part <= whole).all()


def test_a_body_on_the_only_way_is_charged_once_in_the_bound_of_pushing_it():
    """Whichever of two stools in the doors of a row is pushed, the plan that pushes both is not below the bound."""
    problem = series(2)
    cost_s = make_plan(problem, limits=SearchLimits(budget_s=30.0, gap=0.03)).cost_s
    domain = build_search_domain(problem)
    both = PushHeuristic(domain, domain.costs, range(2))
    start, _ = domain.seeds(both.base, domain.start)
    per_s, drive = both.units_per_s, float(both.free_field[start].min())
    crossing = 0.5 * (cost_s / 1.03 * per_s - drive)  # of one door, as the plan is within 3 % of the best
    for body in range(2):
        assert crossing > 2.0 * both.shortest_push(body)
        both.raise_bound(body, crossing)
    for body in range(2):
        assert both.through(start, body) == pytest.approx(drive + 2.0 * crossing, rel=1e-3)
        assert both.through(start, body) < cost_s * per_s
    # Of one that no path is charged for, the push is added.
    one = PushHeuristic(domain, domain.costs, (0,), left_out=(1,))
    one.raise_bound(0, crossing)
    assert one.through(start, 1) == pytest.approx(drive + crossing + one.shortest_push(1), rel=1e-3)


def test_an_oblique_push_costs_the_simulated_risk_of_turning_away():
    from visuohaptic.navigation.planning.search.push_ends import turn_probability
    from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
    from visuohaptic.navigation.problem.push_costs import PushCosts

    problem = series(1)
    domain = build_search_domain(problem)
    cell_m = problem.map.resolution_m
    heuristic = PushHeuristic(domain, PushCosts(), (0,), oblique=True)
    straight = len(domain.bodies[0].contacts)
    lengths = np.array([0.2, 0.4, 0.9]) / cell_m
    assert len(heuristic.contacts(0)) > straight
    for contact in range(straight, len(heuristic.contacts(0))):
        risks = [turn_probability(domain, 0, contact, length) for length in lengths]
        assert 0.0 < risks[0] <= risks[1] <= risks[2] < 1.0
        # The cost without the simulation is a lower bound, and long pushes turn away.
        assert all(heuristic.push_units(0, x, contact) > heuristic.push_units(0, x) for x in lengths)
        once, twice = (
            heuristic.push_units(0, lengths[2], contact),
            2 * heuristic.push_units(0, lengths[0], contact),
        )
        assert risks[2] < 0.4 or once > twice
    assert heuristic.push_units(0, lengths[2], 0) == heuristic.push_units(0, lengths[2])


def test_contacts_follow_the_learnt_centre_of_friction():
    from visuohaptic.navigation.planning.search import build_search_domain, world_from_grid

    problem = series(1)
    stool = problem.objects[0]
    moved = MovableObject(stool.id, stool.footprint_m, stool.tag, friction_offset_m=(0.0, 0.1))
    told = PlanningProblem(problem.map, ROBOT, problem.start_m, problem.goal_m, (moved,))
    body = build_search_domain(told).bodies[0]
    centre = stool.centre_m + np.array([0.0, 0.1])
    for push in body.contacts:
        robot = world_from_grid(told.map, body.centre + push.robot)
        off = centre - robot
        # The push goes through the learnt centre, not through the centroid.
        assert abs(off[0] * push.direction[1] - off[1] * push.direction[0]) < 1e-9


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_push_ends_at_the_same_distance_from_a_body_wherever_both_were_moved(side):
    """In a room whose walls are far away only the bodies count: moved together, they stop the same push at the same length."""
    from visuohaptic.navigation.planning.search.push_lengths import free_length, push_step
    from visuohaptic.navigation.problem.push_costs import PushCosts

    items = (
        MovableObject("crate", box(5.0 - 3.0 * side, 2.0, 0.4), STOOL),
        MovableObject("stool", box(5.0 - 1.9 * side, 2.0, 0.4), STOOL),
    )
    grid = rooms(10.0, 4.0, [])
    problem = PlanningProblem(
        with_objects(grid, list(items)), ROBOT, np.array([0.7, 2.0]), np.array([9.0, 2.0]), items
    )
    domain = build_search_domain(problem)
    heuristic = PushHeuristic(domain, PushCosts(), (0, 1))
    cell_m, far = problem.map.resolution_m, 40.0
    ahead = [
        np.dot(domain.bodies[0].push(k).direction, [side, 0.0]) for k in range(len(domain.bodies[0].contacts))
    ]
    contact = int(np.argmax(ahead))
    assert ahead[contact] == pytest.approx(1.0)
    for shift in (0.0, 30.0 * side, 80.0 * side):
        step = push_step(heuristic, np.array([[shift, 0.0], [shift, 0.0]]), 0, contact, far)
        # Between the faces there are 1.1 m less two halves of 0.4 m; lengths are sampled in steps of half a cell.
        found_m = free_length(heuristic, step, far) * cell_m
        assert 0.7 - 0.5 * cell_m - 1e-6 < found_m < 0.7 + 1e-6, shift
    # Alone it goes on.
    apart = push_step(heuristic, np.array([[80.0 * side, 0.0], [0.0, 0.0]]), 0, contact, far)
    assert free_length(heuristic, apart, far) == pytest.approx(far)
    # Up to the wall of the room, a cell thick: 3.95 m and 5.45 m from the centre of the crate, less half of it.
    for shift, gap_m in ((80.0, 3.75), (50.0, 5.25)):
        alone = push_step(heuristic, np.array([[side * shift, 0.0], [0.0, 80.0]]), 0, contact, 200.0)
        length_m = free_length(heuristic, alone, 200.0) * cell_m
        assert gap_m - 0.5 * cell_m - 1e-6 < length_m < gap_m + 1e-6, shift
