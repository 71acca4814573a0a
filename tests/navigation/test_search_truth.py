"""Bounds, lengths and openings of the search on a small floor, against SciPy's paths and components and plain sums."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.sparse.csgraph import dijkstra

from tests.navigation.test_moved_scenes import CELL_M, STILL, problem
from tests.navigation.test_regions import grid_graph
from visuohaptic.navigation.planning.search import build_search_domain
from visuohaptic.navigation.planning.search._travel_kernels import FAR, UNITS
from visuohaptic.navigation.planning.search.drives import drive_cost, drives_cost
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.planning.search.push_lengths import (
    free_length,
    opening_at,
    push_step,
    refine_lengths,
    replanning_units,
    replayed,
)
from visuohaptic.navigation.planning.search.push_search import search_pushes
from visuohaptic.navigation.planning.search.push_states import Deadline, SearchLimits, SearchResult
from visuohaptic.navigation.problem import PushCosts, push_cost

NEVER = Deadline.after(1e9)


@pytest.fixture(scope="module")
def heuristic():
    domain = build_search_domain(problem())
    return PushHeuristic(domain, domain.costs, range(3))


def to_the_right(heuristic, body=0):
    """The contact that pushes the box out of the door."""
    domain = heuristic.domain
    ahead = [domain.bodies[body].push(k).direction[0] for k in range(len(domain.bodies[body].contacts))]
    return int(np.argmax(ahead))


def test_a_push_costs_its_seconds_in_units_of_the_lattice(heuristic):
    domain = heuristic.domain
    robot, tag = domain.robot, domain.bodies[0].obj.tag
    per_s = UNITS * robot.v_max_m_s / (CELL_M * domain.block)
    for length_m in (0.01, 0.3, 1.2):
        expected = push_cost(tag, length_m, robot, PushCosts()).total_s * per_s
        assert heuristic.push_units(0, length_m / CELL_M) == pytest.approx(expected)
    assert heuristic.shortest_push(0) == pytest.approx(
        push_cost(tag, 0.01, robot, PushCosts()).total_s * per_s
    )
    assert heuristic.longest(1) * CELL_M == pytest.approx(2.0)
    assert math.isinf(heuristic.push_units(0, 2.01 / CELL_M))
    assert heuristic.pushes_units(()) == 0.0
    step = push_step(heuristic, STILL, 0, to_the_right(heuristic), 6.0)
    (area,) = domain.problem.areas
    # It ends in the area, 30 s for it.
    assert heuristic.pushes_units((step,)) == pytest.approx(
        heuristic.push_units(0, 6.0) + area.cost_s * per_s
    )


def test_the_cost_to_go_is_that_of_moves_from_node_to_node(heuristic):
    """Any-angle drives are up to 8 % shorter than those in eight directions; charges are those of the bodies on the way."""
    domain = heuristic.domain
    field = heuristic.free_field.reshape(domain.lattice.shape)
    radius = domain.radius
    layer = np.asarray(heuristic.base, dtype=np.float64)
    cost = domain.slow + np.minimum((layer / radius - 1.0) * 0.5, 1.0) * (1.0 - domain.slow)
    cost = np.where(layer >= radius, cost, np.inf)
    moves = grid_graph(cost, 1.0, mean=True)
    truth = dijkstra(moves, indices=heuristic.goal_cells).min(axis=0).reshape(field.shape) * UNITS
    reached = np.isfinite(truth)
    np.testing.assert_array_equal(field < FAR, reached)
    far = truth > 20 * UNITS
    assert (field[reached] <= 1.01 * truth[reached] + heuristic.goal_costs.max()).all()
    assert (field[reached & far] >= 0.9 * truth[reached & far]).all()
    # With the bodies, never less; beyond the door, its box has to be pushed in addition.
    with_bodies = heuristic.field(STILL).reshape(field.shape)
    assert (with_bodies >= field)[reached].all()
    start, _ = domain.seeds(heuristic.base, domain.start)
    charged = with_bodies.ravel()[start].min() - field.ravel()[start].min()
    assert charged == pytest.approx(heuristic.shortest_push(0), rel=1e-3)
    behind = np.floor(np.array([100.0, 70.0]) / domain.block).astype(int)
    assert with_bodies[tuple(behind[::-1])] == field[tuple(behind[::-1])]


def test_the_bound_of_a_plan_with_a_push_is_below_every_such_plan_and_not_far_below(heuristic):
    domain = heuristic.domain
    start, _ = domain.seeds(heuristic.base, domain.start)
    units = heuristic.units / domain.block
    for body in range(3):
        best = math.inf
        for contact in range(len(domain.bodies[body].contacts)):
            for length in (4.0, 8.0, 14.0):
                step = push_step(heuristic, STILL, body, contact, length)
                if free_length(heuristic, step, length) < length - 1e-6:
                    continue
                before, gone = STILL.copy(), step.shifts_after.copy()
                gone[0] += 1e6  # the door is open, for any other push
                before[0] = gone[0] if body else 0.0
                ways = drive_cost(domain, before, domain.start, step.approach)
                ways += drive_cost(domain, gone, step.retreat, domain.goal)
                best = min(best, units * ways + heuristic.push_units(body, length))
        bound = heuristic.through(start, body)
        others = 0.0 if body == 0 else heuristic.shortest_push(0)
        assert bound <= best + others
        assert bound > 0.6 * best


def test_an_opening_is_where_the_goal_is_reached_first(heuristic):
    """By components of the free nodes, for the push that clears the door."""
    domain = heuristic.domain
    step = push_step(heuristic, STILL, 0, to_the_right(heuristic), 30.0)
    free = free_length(heuristic, step, 30.0)
    ahead = domain.bodies[0].push(step.contact).direction
    others = np.array([False, True, True])
    opening = opening_at(domain, STILL, 0, ahead, free, step.approach, others)
    first = math.inf
    for length in np.arange(0.0, free, 0.25):
        shifts = STILL.copy()
        shifts[0] = length * ahead
        layer = domain.lattice_with(shifts)
        parts = label(layer >= domain.radius, np.ones((3, 3)))[0].ravel()
        begin, _ = domain.seeds(layer, step.approach + length * ahead)
        end, _ = domain.seeds(layer, domain.goal)
        if set(parts[begin].tolist()) & set(parts[end].tolist()):
            first = float(length)
            break
    assert 2.0 < first < free
    assert opening.min() == pytest.approx(first, abs=1.0)


def expected_cost(heuristic, steps):
    """Of pushes, drives and repeated pushes [units]."""
    domain = heuristic.domain
    drives = drives_cost(domain, steps, domain.start) * heuristic.units / domain.block
    return heuristic.pushes_units(steps) + drives + replanning_units(heuristic, steps, domain.start)


def test_refined_lengths_have_no_cheaper_neighbour(heuristic):
    """From a push that barely opens the way, and from one that is longer than it has to be."""
    domain = heuristic.domain
    scale = domain.block / heuristic.units
    contact, step = to_the_right(heuristic), 0.05 / CELL_M
    for length in (10.0, 15.5):
        begin = (push_step(heuristic, STILL, 0, contact, length),)
        drives = drives_cost(domain, begin, domain.start)
        known = SearchResult(True, begin, heuristic.pushes_units(begin) * scale + drives, 0.0)
        steps, cost = refine_lengths(heuristic, domain.start, known, NEVER)
        (one,) = steps
        whole = drives_cost(domain, steps, domain.start) + heuristic.pushes_units(steps) * scale
        assert cost == pytest.approx(whole, rel=3e-3)
        found = expected_cost(heuristic, steps)
        assert found <= expected_cost(heuristic, begin) * (1 + 1e-9)
        for off in (-step, -step / 4.0, step / 4.0):
            other = replayed(heuristic, steps, 0, one.length + off)
            assert not other or expected_cost(heuristic, other) > 0.997 * found
        assert 10.0 <= one.length < 15.0
    late, cost = refine_lengths(heuristic, domain.start, known, Deadline.after(-1.0))
    assert (late, cost) == (known.steps, known.cost)


def test_pushes_are_replayed_as_far_as_they_are_free(heuristic):
    domain = heuristic.domain
    contact = to_the_right(heuristic)
    first = push_step(heuristic, STILL, 0, contact, 5.0)
    second = push_step(heuristic, first.shifts_after, 0, contact, 4.0)
    again = replayed(heuristic, (first, second), 0, 6.0)
    assert [one.length for one in again] == [6.0, 4.0]
    ahead = domain.bodies[0].push(contact).direction
    np.testing.assert_allclose(again[1].shifts_after[0], 10.0 * ahead)
    np.testing.assert_allclose(
        again[1].touch, domain.bodies[0].centre + 6.0 * ahead + domain.bodies[0].push(contact).robot
    )
    np.testing.assert_allclose(again[1].retreat - again[1].approach, 4.0 * ahead)
    assert replayed(heuristic, (first, second), 1, 4.5)[0] is first
    for length in (0.0, -1.0, heuristic.longest(0) + 0.1, 1.0 + free_length(heuristic, first, 40.0)):
        assert replayed(heuristic, (first, second), 0, length) == ()
    # The second one, too, has to be free from where the first one ends.
    free = free_length(heuristic, first, 40.0)
    assert replayed(heuristic, (first, second), 0, free - 2.0) == ()


def test_the_search_finds_the_push_that_is_cheapest_of_all_tried(heuristic):
    """Of every contact of the box in the door, in steps of 5 cm."""
    domain = heuristic.domain
    result = search_pushes(domain, domain.start, SearchLimits(budget_s=60.0, gap=0.0))
    assert result.found
    best = math.inf
    for contact in range(len(domain.bodies[0].contacts)):
        limit = free_length(heuristic, push_step(heuristic, STILL, 0, contact, 1.0), 30.0)
        for length in np.arange(1.0, limit, 1.0):
            step = push_step(heuristic, STILL, 0, contact, float(length))
            ways = drives_cost(domain, (step,), domain.start)
            if np.isfinite(ways):
                best = min(best, ways + heuristic.pushes_units((step,)) * domain.block / heuristic.units)
    assert result.bound <= best * (1 + 1e-9)
    # Where the object ends is uncertain: lengths are chosen with the risk that it is in the way, which is not in this cost.
    assert result.cost <= 1.05 * best
    assert result.cost >= result.bound
    assert [step.body for step in result.steps] == [0]
    assert result.left_out == (1, 2) or set(result.left_out) <= {1, 2}
    none = search_pushes(domain, domain.start, active=())
    assert not none.found
    assert none.exhausted
    assert "separate start and goal" in none.reason


@pytest.mark.parametrize("goal_m", [(5.1, 0.9), (2.2, 3.5)])
def test_an_allowed_gap_is_kept_and_saves_work(goal_m):
    """Through the door, and in the first hall, where no push is needed."""
    found = []
    for gap in (0.0, 0.05, 0.4):
        domain = build_search_domain(replace(problem(), goal_m=np.array(goal_m), areas=()))
        result = search_pushes(domain, domain.start, SearchLimits(budget_s=60.0, gap=gap, expansions=400))
        assert result.found
        assert result.bound <= result.cost * (1 + 1e-9)
        found.append(result)
        if gap:
            # Lengths are refined afterwards, for the risk of their ends.
            assert result.cost <= (1.0 + gap) * result.bound * 1.01
    exact, close, loose = found
    assert loose.expanded <= close.expanded <= exact.expanded
    assert exact.cost <= 1.01 * close.cost
    assert close.cost <= 1.01 * loose.cost
    assert max(one.bound for one in found) <= 1.001 * min(one.cost for one in found)
    assert {len(one.steps) for one in found} == {int(goal_m[0] > 3.0)}
