"""One pass of the search: its queue, the lengths that it tries, and its answers against all pushes of one box."""

from __future__ import annotations

import heapq
import math

import numpy as np
import pytest

from tests.navigation.test_moved_scenes import CELL_M, STILL, problem
from tests.navigation.test_search_truth import NEVER, to_the_right
from visuohaptic.navigation.planning.search import build_search_domain
from visuohaptic.navigation.planning.search.drives import drives_cost
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.planning.search.push_lengths import LENGTH_STEP_M, free_length, push_step
from visuohaptic.navigation.planning.search.push_pass import PushPass, _Queue
from visuohaptic.navigation.planning.search.push_states import Deadline, SearchLimits, SearchState

STEP = LENGTH_STEP_M / CELL_M
LIMITS = SearchLimits(budget_s=60.0)


@pytest.fixture(scope="module")
def heuristic():
    domain = build_search_domain(problem())
    return PushHeuristic(domain, domain.costs, range(3))


@pytest.fixture(scope="module")
def best(heuristic):
    """The least cost of a push of the box in the door, in steps of 5 cm [units]."""
    domain, found = heuristic.domain, math.inf
    for contact in range(len(domain.bodies[0].contacts)):
        limit = free_length(heuristic, push_step(heuristic, STILL, 0, contact, 1.0), 30.0)
        for length in np.arange(STEP, limit, STEP):
            step = push_step(heuristic, STILL, 0, contact, float(length))
            ways = drives_cost(domain, (step,), domain.start) * heuristic.units / domain.block
            found = min(found, ways + heuristic.pushes_units((step,)))
    return found


def first(heuristic):
    return SearchState(0.0, heuristic.domain.start, STILL)


def passed(heuristic, weight=1.0, deadline=NEVER, expansions=500, limits=LIMITS, bodies=None, **options):
    found = PushPass(heuristic, weight, limits, deadline, bodies, relaxed=weight == 1.0)
    return found.run(first(heuristic), expansions, **options)


def test_entries_come_by_cost_and_then_in_their_order():
    queue = _Queue(10.0)
    for number, cost in enumerate((3.0, 1.0, 10.0, 3.0, 12.0, 9.99)):
        queue.push(cost, number)
    assert [heapq.heappop(queue.entries)[2] for _ in range(4)] == [1, 0, 3, 5]
    assert queue.entries == []


@pytest.mark.parametrize("free", [0.6, 3.3, 11.7, 40.0, 80.0])
@pytest.mark.parametrize("opening", [(), (4.2,), (2.0, 9.7), (39.9,)])
def test_the_lengths_that_are_tried_leave_no_gap(heuristic, free, opening):
    """Steps of 5 cm, the longest there is, one just beyond every opening, and none more than half as long again as the last."""
    tried = PushPass(heuristic, 1.0, LIMITS, NEVER)._tried(free, np.array(opening))
    assert tried == sorted(set(tried))
    assert tried[0] > 0.0
    assert tried[-1] <= free
    assert tried[-1] > free - STEP
    whole = [length for length in tried if length < free - 1e-9]
    np.testing.assert_allclose(np.array(whole) / STEP, np.rint(np.array(whole) / STEP), atol=1e-9)
    for at in opening:
        if at <= free:
            beyond = [length - at for length in tried if length > at - 1e-6]
            assert min(beyond, default=math.inf) <= STEP or tried[-1] == free
            # Then one and two steps farther, to 16 steps.
            later = [n * STEP + math.ceil(at / STEP) * STEP for n in (1, 2, 4, 8, 16)]
            assert all(any(abs(length - one) < 1e-6 for one in tried) for length in later if length <= free)
    # Doubling at first, by half from 20 cm to 2 m.
    within = [length for length in tried if 4 * STEP <= length <= 40 * STEP]
    if len(within) > 1:
        assert max(np.divide(within[1:], within[:-1])) <= 1.5 + 1e-9
    if free >= 4 * STEP:
        assert 2 * STEP in tried


def test_a_pass_without_weight_is_optimal_and_bounds_all_plans(heuristic, best):
    result = passed(heuristic, bodies=(0,))
    per_cell = heuristic.units / heuristic.domain.block
    assert result.found
    assert [step.body for step in result.steps] == [0]
    assert result.bound * per_cell <= best * (1 + 1e-9)
    # One push, longer by at most two of its steps than the best one.
    assert result.cost * per_cell <= 1.05 * best
    # Beside the box a passage is as wide as the robot within a cell: it limits the bound.
    assert 0.5 * result.cost < result.bound <= result.cost * (1 + 1e-9)
    weighted = passed(heuristic, 3.0, bodies=(0,), gap=0.3)
    assert weighted.found
    assert result.bound <= weighted.cost
    loose = passed(heuristic, gap=0.3)
    assert loose.cost <= 1.3 * loose.bound * (1 + 1e-9) or loose.cost <= 1.3 * best / per_cell


def test_only_cheaper_plans_than_the_known_one_are_found(heuristic, best):
    less = passed(heuristic, known=0.9 * best, expansions=60)
    assert not less.found
    assert math.isinf(less.cost)
    assert 0.0 < less.bound * heuristic.units / heuristic.domain.block <= 0.9 * best
    assert less.expanded <= 60
    assert passed(heuristic, known=1.2 * best, gap=0.3).found


def test_a_pass_ends_with_its_limits_and_proves_nothing_then(heuristic):
    few = passed(heuristic, expansions=1)
    assert (few.found, few.exhausted, few.expanded) == (False, False, 1)
    late = passed(heuristic, deadline=Deadline.after(-1.0))
    assert (late.found, late.exhausted, late.expanded) == (False, False, 0)
    none = passed(heuristic, limits=SearchLimits(budget_s=60.0, pushes=0))
    assert not none.found
    assert not none.exhausted
    # One push, and no other after it: few states.
    one = passed(heuristic, limits=SearchLimits(budget_s=60.0, pushes=1), bodies=(0,))
    assert [step.body for step in one.steps] == [0]
    assert one.expanded < 100
    # The other boxes are not in the way: pushing only them opens nothing, which two pushes at most show.
    others = passed(heuristic, bodies=(1,), limits=SearchLimits(budget_s=60.0, pushes=1), expansions=300)
    assert not others.found


def test_pushes_start_from_where_the_robot_can_stand(heuristic):
    search = PushPass(heuristic, 1.0, LIMITS, NEVER)
    pairs, stands = heuristic.stands([0])
    assert (search.pairs[search.pairs[:, 0] == 0] == pairs).all()
    for (body, number), stand in zip(pairs.tolist(), stands, strict=True):
        push = heuristic.contacts(body)[number]
        # The stand-off of 3 cm behind the contact's place of the robot.
        np.testing.assert_allclose(stand, push.robot - 0.03 / CELL_M * push.direction)
    step = push_step(heuristic, STILL, 0, to_the_right(heuristic), 5.0)
    np.testing.assert_allclose(
        step.touch - step.approach, 0.03 / CELL_M * heuristic.contacts(0)[step.contact].direction
    )
