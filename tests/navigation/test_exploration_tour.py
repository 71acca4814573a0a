"""Tours against every order of a small floor, with benefits and times computed another way."""

from __future__ import annotations

import itertools
from dataclasses import replace

import networkx
import numpy as np
import pytest

from visuohaptic.core import HapticTag, InputError
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import alternatives, exploration_tour, extend_graph, without_pushing
from visuohaptic.navigation.planning.exploration import (
    Orienteering,
    benefit_by_set,
    best_order,
    expected_benefit,
    nearest_contact,
    upper_bound,
)
from visuohaptic.navigation.planning.exploration import orienteering as search
from visuohaptic.navigation.planning.exploration.tour_planner import _why_not
from visuohaptic.navigation.planning.search import SearchLimits, build_search_domain
from visuohaptic.navigation.planning.search.search_domain import world_from_grid
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, PushCosts, push_node

from .plan_check import faults
from .plan_scenes import ROBOT, box, rooms, with_objects

P = 0.5  # prior of PushCosts


@pytest.fixture(scope="module")
def floor():
    """Two doors to the room on the right, each blocked (first, second); a blocked door between two dead ends (wall)."""
    walls = [
        (9.0, 0.0, 9.1, 1.0), (9.0, 1.8, 9.1, 6.0), (9.0, 6.8, 9.1, 8.0),
        (0.0, 4.0, 0.5, 4.1), (1.3, 4.0, 8.0, 4.1), (0.0, 2.6, 8.0, 2.7), (0.0, 5.4, 8.0, 5.5),
    ]  # fmt: skip
    objects = [
        MovableObject("first", box(9.05, 1.4, 0.45)),
        MovableObject("second", box(9.05, 6.4, 0.45)),
        MovableObject("wall", box(0.9, 4.05, 0.45)),
        MovableObject("free", box(6.0, 1.2, 0.3)),
        MovableObject("behind", box(10.7, 4.0, 0.4)),
    ]
    grid = with_objects(rooms(12.0, 8.0, walls), objects)
    return PlanningProblem(grid, ROBOT, np.array([4.0, 1.0]), np.array([6.0, 6.4]), tuple(objects))


@pytest.fixture(scope="module")
def truth(floor):
    """Times between start, approach poses and goal by the planner, and the graph with every object movable."""
    ids = ["first", "second", "wall", "free"]
    places = {"start": floor.start_m, "goal": floor.goal_m}
    domain = build_search_domain(floor)
    for body in domain.bodies[:4]:
        path, _, _ = nearest_contact(domain, body)
        places[body.obj.id] = world_from_grid(floor.map, path[-1])
    times = {
        (a, b): without_pushing(replace(floor, start_m=places[a], goal_m=places[b])).cost_s
        for a, b in itertools.combinations(places, 2)
    }
    times |= {(b, a): time_s for (a, b), time_s in times.items()}
    layers = grid_layers(floor.map, SpeedLimits(ROBOT.radius_m))
    visual = build_graph(layers)
    moves = HapticTag(fixed=False, explored=1)
    nodes = [push_node(replace(item, tag=moves), ROBOT) for item in floor.objects[:4]]
    return ids, times, extend_graph(visual, assign_regions(layers, visual), ROBOT, nodes)


def gain(joint, moved, id):
    """Eq. (4.2) for one set of objects that were found movable, by another library."""

    def paths(ids):
        graph = networkx.Graph()
        graph.add_nodes_from(range(joint.visual.nodes + len(joint.added)))
        closed = {node.number for node in joint.added if node.kind.id not in ids}
        for (a, b), cost in zip(*(one.tolist() for one in joint.edges()), strict=True):
            if not {a, b} & closed and cost < graph.get_edge_data(a, b, {"weight": np.inf})["weight"]:
                graph.add_edge(a, b, weight=cost)
        ends = joint.node(id).neighbours.tolist()
        found = {end: networkx.single_source_dijkstra_path_length(graph, end) for end in ends}
        return {(a, b): found[a].get(b, np.inf) for a, b in itertools.combinations(ends, 2)}

    before, after = paths(moved), paths({*moved, id})
    opens = any(np.isinf(before[pair]) and np.isfinite(after[pair]) for pair in before)
    saved = [before[pair] - after[pair] for pair in before if np.isfinite(before[pair])]
    return np.array([opens, max(saved, default=0.0)])


@pytest.fixture(scope="module")
def gains(truth):
    """Benefit of each object after each subset of the others."""
    ids, _, joint = truth
    return {
        (frozenset(moved), id): gain(joint, set(moved), id)
        for id in ids
        for size in range(len(ids))
        for moved in itertools.combinations([other for other in ids if other != id], size)
    }


def best_of_all_orders(ids, times, gains, budget_s, goal):
    """Greatest (openings, seconds) over every order of every subset that is in time."""
    best = (0.0, 0.0)
    for size in range(len(ids) + 1):
        for order in itertools.permutations(ids, size):
            stops = ["start", *order, *(["goal"] if goal else [])]
            time_s = sum(times[leg] for leg in itertools.pairwise(stops)) + PushCosts().explore_time_s * size
            if time_s > budget_s:
                continue
            total = np.zeros(2)
            for index, id in enumerate(order):
                worlds = [
                    (gains[frozenset(moved), id], P ** len(moved) * (1 - P) ** (index - len(moved)))
                    for known in range(index + 1)
                    for moved in itertools.combinations(order[:index], known)
                ]
                total += P * sum(value * weight for value, weight in worlds)
            best = max(best, tuple(np.round(total, 5)))
    return best


@pytest.mark.parametrize(("budget_s", "goal"), [(35.0, False), (60.0, False), (75.0, True), (600.0, True)])
def test_no_order_is_better(floor, truth, gains, budget_s, goal):
    ids, times, _ = truth
    tour = exploration_tour(floor, budget_s, to_goal=goal)
    assert (tour.opens, tour.benefit_s) == pytest.approx(
        best_of_all_orders(ids, times, gains, budget_s, goal), abs=1e-4
    )
    assert tour.time_s <= budget_s
    assert tour.bound == pytest.approx((tour.opens, tour.benefit_s))
    assert sum(step.time_s for step in tour.steps) <= tour.time_s + 1e-6
    assert {step.object for step in tour.steps} | set(tour.left_out) == {item.id for item in floor.objects}
    assert tour.left_out["behind"].startswith("cannot be touched")
    assert tour.left_out["free"] == "opens no shorter way"
    paths = [task.path_m for task in tour.tasks if task.path_m]
    assert all(a[-1] == pytest.approx(b[0]) for a, b in itertools.pairwise(paths))


def test_the_most_informative_plan_is_the_tour_that_ends_at_the_goal(floor):
    tour = exploration_tour(floor, 600.0, to_goal=True)
    plans = alternatives(floor, limits=SearchLimits(0.2))
    plan = plans["most information"]
    assert [task.object for task in plan.tasks if task.kind == "explore"] == [
        step.object for step in tour.steps
    ]
    assert np.allclose(plan.tasks[-1].path_m[-1], floor.goal_m)
    assert faults(floor, plan) == []
    # Where nothing is worth touching it is the cheapest one.
    known = replace(floor, objects=tuple(replace(o, tag=HapticTag(fixed=True)) for o in floor.objects))
    plans = alternatives(known, limits=SearchLimits(0.2))
    assert plans["most information"].tasks == plans["cheapest"].tasks


def test_the_second_door_is_worth_what_the_first_one_leaves(floor, gains):
    tour = exploration_tour(floor, 600.0)
    steps = {step.object: step for step in tour.steps}
    one, other = (steps[id] for id in steps if id != "wall")
    assert one.opens == pytest.approx(P)
    # It opens the room only if the other door did not; else it shortens the ways into it.
    assert other.opens == pytest.approx(P * (1 - P))
    assert other.benefit_s > 0


def test_what_is_left_out_of_a_tour_says_why():
    """Two objects that take 6 s with the way back of 5 s, of which one gains nothing; a third has no way back."""
    visit, finish = 10**6 * np.full((4, 3), 6), 10**6 * np.array([0, 5, 5, -1])
    values = np.array([[[1, 0], [0, 0], [1, 0]]])
    said = [_why_not(Orienteering(visit, finish, 10 * 10**6, values), index) for index in range(3)]
    assert said == [
        "takes 11.0 s by itself",
        "opens no shorter way",
        "the goal cannot be reached from there without pushing",
    ]
    enough = Orienteering(visit, finish, 11 * 10**6, values)
    assert _why_not(enough, 0) == "other objects gain more within the budget"


def test_a_wrong_budget_an_enclosed_goal_and_no_unknown_object(floor):
    with pytest.raises(InputError, match="budget_s"):
        exploration_tour(floor, 0.0)
    enclosed = replace(floor, goal_m=np.array([10.5, 1.0]))  # in the room behind the blocked doors
    tour = exploration_tour(enclosed, 600.0, to_goal=True)
    assert (tour.steps, tour.bound) == ((), (0.0, 0.0))
    assert tour.left_out["first"].startswith("the goal cannot be reached")
    known = replace(floor, objects=())
    assert exploration_tour(known, 60.0).summary == "nothing to explore"


def random_instance(rng, count, sets):
    places = rng.uniform(0, 100, (count + 2, 2))
    times = np.rint(np.hypot(*(places[:, None] - places).transpose(2, 0, 1))).astype(np.int64)
    visit = times[:-1, 1:-1] + 8
    visit[rng.random(visit.shape) < 0.1] = -1
    visit[rng.random(visit.shape) < 0.1] = 0  # beside the last one
    values = np.stack([rng.integers(0, 3, (sets, count)), rng.integers(0, 50, (sets, count))], axis=2)
    return Orienteering(visit, times[:-1, -1], int(rng.integers(60, 300)), values)


@pytest.mark.parametrize("by_set", [True, False])
def test_random_tours_equal_every_order_tried(by_set, monkeypatch):
    rng = np.random.default_rng(4)
    for _ in range(12):
        problem = random_instance(rng, 5, 2**5 if by_set else 1)
        if by_set:  # most objects fit, so that the order decides the benefit, too
            problem = replace(problem, budget_us=300)
        best = (0, 0)
        for size in range(6):
            for order in itertools.permutations(range(5), size):
                stops = [0, *(index + 1 for index in order)]
                legs = [problem.visit_us[a, b - 1] for a, b in itertools.pairwise(stops)]
                if min(legs, default=0) < 0 or sum(legs) + problem.finish_us[stops[-1]] > problem.budget_us:
                    continue
                sets = [sum(1 << one for one in order[:k]) * by_set for k in range(size)]
                gained = sum((problem.values[s, i] for s, i in zip(sets, order, strict=True)), np.zeros(2))
                best = max(best, tuple(gained.astype(int).tolist()))
        found = problem.tour(best_order(problem))
        assert (found[0] if found else (0, 0)) == best
        if not by_set:
            with monkeypatch.context() as patch:
                quick = problem.tour(few_ways(problem, patch, 3))
            assert (quick[0] if quick else (0, 0)) <= best
            bound = upper_bound(problem)
            assert best[0] <= bound[0]
            assert best[1] <= bound[1]


def test_the_sets_of_many_objects_are_evaluated_in_parts(truth, monkeypatch):
    ids, _, joint = truth
    whole = expected_benefit(joint, tuple(ids), 0.3)
    monkeypatch.setattr(benefit_by_set, "AT_ONCE", 1)
    parts = expected_benefit(joint, tuple(ids), 0.3)
    assert np.allclose(parts.opens, whole.opens)
    assert np.allclose(parts.saved_s, whole.saved_s)


def test_the_benefit_of_a_single_object_is_that_of_the_joint_graph(truth):
    _, _, joint = truth
    for node in joint.added:
        alone = replace(joint, added=(replace(node, number=joint.visual.nodes),))
        found = expected_benefit(alone, (node.kind.id,), 1.0)
        assert (np.inf if found.opens[0, 0] else found.saved_s[0, 0]) == pytest.approx(
            alone.benefit_s(node.kind.id)
        )


def few_ways(problem, patch, most):
    """The search with this number of sets for every number of visits."""
    patch.setattr(search, "EXACT_OBJECTS", 0)
    patch.setattr(search, "TRIED", most * problem.visit_us.shape[1] ** 2)
    return best_order(problem)


def test_a_few_ways_lose_few_per_cent(monkeypatch):
    rng = np.random.default_rng(11)
    totals = np.zeros(2)
    for _ in range(8):
        problem = random_instance(rng, 8, 1)
        problem.values[:, :, 0] = 0
        exact = best_order(problem)
        with monkeypatch.context() as patch:
            tours = [problem.tour(order) for order in (few_ways(problem, patch, 24), exact)]
        totals += [0 if tour is None else tour[0][1] for tour in tours]
    assert 0.95 * totals[1] <= totals[0] <= totals[1]


@pytest.mark.parametrize("seed", range(20))
def test_the_knapsack_is_bounded_by_that_of_fractions_and_by_no_more(seed):
    """Against every subset: the bound is never below the best one, and above it by less than the best single item."""
    rng = np.random.default_rng(seed)
    weights, values = rng.integers(0, 30, 8).tolist(), rng.integers(1, 50, 8).tolist()
    room = int(rng.integers(0, 90))
    chosen = itertools.product((False, True), repeat=8)
    subsets = [
        (sum(itertools.compress(weights, one)), sum(itertools.compress(values, one))) for one in chosen
    ]
    best = max(value for weight, value in subsets if weight <= room)
    found = search._knapsack(weights, values, room)
    assert best <= found <= best + max(values)
    if room >= sum(weights):
        assert found == sum(values)
    assert (
        search._knapsack(weights, values, 0)
        <= sum(v for w, v in zip(weights, values, strict=True) if not w) + 1
    )


def test_many_objects_keep_to_the_budget_and_the_bound():
    rng = np.random.default_rng(5)
    problem = random_instance(rng, 25, 1)
    (opens, saved), time = problem.tour(best_order(problem))
    assert time <= problem.budget_us
    assert 0 < opens <= upper_bound(problem)[0]
    assert saved <= upper_bound(problem)[1]
