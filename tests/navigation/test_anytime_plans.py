"""Properties of a plan: independent of the resolution, fast, bounded cost, and proof if no plan exists."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from benchmarks._plan_child import described, problem_of

from tests.worlds.floor_scenes import campus, narrow_gap, small_room
from tests.worlds.real_floors import real_scene
from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import alternatives, make_plan
from visuohaptic.navigation.planning.search import (
    SearchLimits,
    _travel_kernels,
    build_search_domain,
    drives,
    push_states,
    search_pushes,
)
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.planning.search.push_lengths import replayed
from visuohaptic.navigation.problem import MovableObject, PlanningProblem

from .plan_check import faults
from .plan_scenes import ROBOT, STOOL, box

#: So long that a busy machine changes no answer.
PATIENT = SearchLimits(budget_s=60.0)


def drawn(size_m, walls, objects, start_m, goal_m, cell_m=0.05):
    """A floor with a border, walls (x0, y0, x1, y1) [m] and objects, on cells of any size."""
    from shapely import Polygon, contains_xy

    cells = np.zeros((round(size_m[1] / cell_m), round(size_m[0] / cell_m)), np.int8)
    border = round(0.1 / cell_m)
    cells[:border] = cells[-border:] = 100
    cells[:, :border] = cells[:, -border:] = 100
    for x0, y0, x1, y1 in walls:
        c0, r0, c1, r1 = (round(value / cell_m) for value in (x0, y0, x1, y1))
        cells[r0:r1, c0:c1] = 100
    rows, columns = np.mgrid[0 : cells.shape[0], 0 : cells.shape[1]]
    for obj in objects:
        inside = contains_xy(Polygon(obj.footprint_m), (columns + 0.5) * cell_m, (rows + 0.5) * cell_m)
        cells[inside] = 100
    return PlanningProblem(
        OccupancyMap(cells, cell_m), ROBOT, np.array(start_m), np.array(goal_m), tuple(objects)
    )


def two_doors(cell_m=0.05, idle=0):
    """Three rooms in a row with a stool in both doors, and boxes that stand free in the rooms."""
    walls, objects = [], []
    for index in range(2):
        x = 2.0 + 2.0 * index
        walls += [(x, 0.0, x + 0.1, 1.0), (x, 1.8, x + 0.1, 3.0)]
        objects.append(MovableObject(f"stool {index}", box(x + 0.05, 1.4, 0.45), STOOL))
    for index in range(idle):
        x, y = 0.4 + 0.5 * (index // 2), 0.45 + 2.1 * (index % 2)
        objects.append(MovableObject(f"idle {index}", box(x, y, 0.2), STOOL))
    return drawn((6.0, 3.0), walls, objects, (0.7, 1.4), (5.3, 1.4), cell_m)


def blind_corridor():
    """The goal is at the end of a corridor that a box fills nearly, and another box stands before it."""
    walls = [(3.0, 0.1, 5.9, 1.6), (3.0, 2.4, 5.9, 3.9)]
    plug = MovableObject("plug", box(3.6, 2.0, 0.6), STOOL)
    other = MovableObject("other", box(1.4, 1.0, 0.35), STOOL)
    return drawn((6.0, 4.0), walls, [plug, other], (0.7, 2.0), (5.5, 2.0))


def test_the_effort_does_not_grow_with_the_resolution():
    found = {cell_m: make_plan(two_doors(cell_m), limits=PATIENT) for cell_m in (0.05, 0.02, 0.01)}
    for cell_m, plan in found.items():
        assert faults(two_doors(cell_m), plan) == []
        assert plan.gap <= SearchLimits().gap
        # By cells of 1 cm there would be thousands of states.
        assert plan.expanded < 200
        # A node is half a radius wide, as far as whole cells allow.
        edge_m = build_search_domain(two_doors(cell_m)).block * cell_m
        assert 0.4 * ROBOT.radius_m < edge_m < 0.6 * ROBOT.radius_m


def test_a_finer_map_gives_no_costlier_plan():
    coarse, costs = make_plan(two_doors(0.1), limits=PATIENT), []
    for cell_m in (0.05, 0.02, 0.01):
        fine = make_plan(two_doors(cell_m), limits=PATIENT)
        assert fine.cost_s <= 1.01 * coarse.cost_s
        costs.append(fine.cost_s)
    # The border cells of 10 cm cost room that finer ones do not: with 5 cm and less the plan is one and the same.
    assert max(costs) <= 1.05 * min(costs)


def test_objects_beside_no_bottleneck_are_left_out_and_said_so():
    plan, alone = (make_plan(two_doors(idle=count), limits=PATIENT) for count in (12, 0))
    assert {task.object for task in plan.pushes} == {"stool 0", "stool 1"}
    assert plan.expanded < 3 * alone.expanded + 50
    (note,) = [note for note in plan.notes if note.startswith("left out")]
    assert "idle 11" in note
    assert "stool" not in note


def test_a_blind_corridor_is_proved():
    plan = make_plan(blind_corridor(), limits=PATIENT)
    assert not plan.reachable
    assert plan.answer == "no plan (proved)"
    assert "plug" in plan.reason


def test_a_proof_leaves_a_plan_that_exists():
    """The same corridor with a place to push the box to: wide behind it."""
    walls = [(3.0, 0.1, 4.2, 1.6), (3.0, 2.4, 4.2, 3.9)]
    plug = MovableObject("plug", box(3.6, 2.0, 0.6), STOOL)
    problem = drawn((6.0, 4.0), walls, [plug], (0.7, 2.0), (5.5, 2.0))
    plan = make_plan(problem, limits=PATIENT)
    assert plan.reachable
    assert faults(problem, plan) == []


def test_the_bound_is_none_above_the_best_plan():
    problem = two_doors()
    soon = make_plan(problem, limits=SearchLimits(budget_s=60.0, gap=1.0))
    told = []
    best = make_plan(problem, limits=SearchLimits(budget_s=60.0, gap=0.0, found=told.append))
    # The lattice, whose nodes have the clearance of their clearest cells, is faster by some per cent than the map.
    assert best.gap < 0.05
    # The first plan is given while better ones are searched: it can be driven, too.
    (first,) = told
    assert faults(problem, first) == []
    assert best.cost_s <= first.cost_s * (1 + 1e-9)
    assert best.cost_s <= soon.cost_s * (1 + 1e-9)
    # Costs of drives are estimated on the lattice and shortened on the map: some per cent.
    assert soon.cost_s / (1.0 + soon.gap) <= 1.05 * best.cost_s


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_gap_hardly_wider_than_the_robot_is_found_or_limits_the_bound(seed):
    coarse, fine = (
        make_plan(problem_of(described(narrow_gap(seed), cell_m)), limits=PATIENT) for cell_m in (0.05, 0.01)
    )
    known_s = min(coarse.cost_s, fine.cost_s)
    for plan in (coarse, fine):
        assert plan.cost_s / (1.0 + plan.gap) < 1.002 * known_s
    assert coarse.cost_s < 1.05 * known_s


def test_a_push_that_opens_a_gap_a_centimetre_wider_than_the_robot_is_found():
    """The gap is 35 cm wide; around it, both bodies have to be pushed, at 48 s."""
    plan = make_plan(problem_of(described(small_room(131), 0.05)), limits=PATIENT)
    assert len(plan.pushes) == 1
    assert plan.cost_s < 28.0


def test_the_relaxed_lattice_is_open_wherever_the_robot_fits():
    """Exact clearance at random points against the node that each lies in."""
    closed = 0
    for block in (1, 2):
        domain = build_search_domain(problem_of(described(small_room(4), 0.05)), block=block)
        shifts = np.random.default_rng(2).uniform(-3.0, 3.0, (len(domain.bodies), 2))
        rows, columns = domain.occupied.shape
        points = np.random.default_rng(3).uniform(0.0, 1.0, (4000, 2)) * (columns, rows)
        fits = np.array([domain.clear_straight(shifts, point, point[None])[0] for point in points])
        nodes = (points[fits] // block).astype(int)
        loose, strict = domain.relaxed.lattice_with(shifts), domain.lattice_with(shifts)
        assert (loose[nodes[:, 1], nodes[:, 0]] >= domain.radius).all()
        assert (loose[strict >= domain.radius] >= domain.radius).all()
        closed += (strict[nodes[:, 1], nodes[:, 0]] < domain.radius).sum()
    assert closed > 0


def test_a_budget_is_kept_and_the_answer_says_that_nothing_is_proved():
    problem = two_doors()
    make_plan(problem)  # compiled by now
    plan = make_plan(problem, limits=SearchLimits(budget_s=60.0, expansions=1))
    assert not plan.reachable
    assert plan.answer == "no plan found (not proved)"
    with pytest.raises(InputError, match="budget_s"):
        SearchLimits(budget_s=0.0)


def counted_clock(monkeypatch, problem):
    """Time is counted in searches over the whole lattice, finer ones and parts by their size: the same on every machine."""
    nodes, spent = build_search_domain(problem).lattice.size, [0.0]

    def counted(kernel):
        def run(clearance, *rest):
            spent[0] += clearance.size / nodes
            return kernel(clearance, *rest)

        return run

    for name in ("travel_field", "flood"):
        monkeypatch.setattr(_travel_kernels, name, counted(getattr(_travel_kernels, name)))
    monkeypatch.setattr(push_states.time, "thread_time", lambda: spent[0])
    monkeypatch.setattr(push_states.time, "monotonic", lambda: 0.0)
    return spent


@pytest.mark.data
def test_straight_pushes_leave_time_for_oblique_ones(data, monkeypatch):
    """A flat where one of two bodies has to be pushed at an angle to its face; straight pushes alone are never through."""
    problem = problem_of(described(real_scene(data / "navigation" / "dev" / "maps", 10), 0.05))
    counted_clock(monkeypatch, problem)
    assert make_plan(problem, limits=SearchLimits(budget_s=3000.0)).reachable


def test_no_plan_is_proved_with_no_budget_where_an_oblique_push_helps(monkeypatch):
    """A box in a door with a post behind it, past which straight pushes do not lead: that is known long before a plan is."""
    walls = [(1.5, 0.0, 1.6, 0.85), (1.5, 1.55, 1.6, 2.6), (2.0, 1.35, 2.1, 1.45)]
    blocking = MovableObject("box", box(1.55, 1.2, 0.44), STOOL)
    problem = drawn((4.5, 2.6), walls, [blocking], (0.6, 1.2), (3.9, 1.2))
    counted_clock(monkeypatch, problem)
    plans = [make_plan(problem, limits=SearchLimits(budget_s=2.0**k)) for k in range(3, 9)]
    assert not any(plan.proved for plan in plans)
    assert any("not proved for oblique pushes" in plan.reason for plan in plans)
    assert plans[-1].reachable
    assert faults(problem, plans[-1]) == []


def test_a_budget_is_kept_in_every_phase_on_a_large_map(monkeypatch):
    problem = problem_of(described(campus(0, rooms=6, objects=40), 0.05))
    spent = counted_clock(monkeypatch, problem)
    for budget in (0.5, 1.5, 3.0, 6.0, 12.0):
        begin = spent[0]
        plan = make_plan(problem, limits=SearchLimits(budget_s=budget))
        assert plan.answer == "no plan found (not proved)"  # it needs pushes, and more searches
        assert spent[0] - begin <= 2.0 * budget


def test_comparing_gives_the_cheapest_plan_itself():
    problem = two_doors()
    assert (
        alternatives(problem, limits=PATIENT)["cheapest"].to_json()
        == make_plan(problem, limits=PATIENT).to_json()
    )


def test_lengths_of_pushes_are_no_longer_than_they_have_to_be():
    """A box in a door as wide as box and robot: pushed until the robot can turn off behind the wall, and no farther."""
    walls = [(2.0, 0.0, 2.4, 1.0), (2.0, 1.8, 2.4, 3.0)]
    box_m, centre_x = 0.5, 2.0
    problem = drawn(
        (5.0, 3.0),
        walls,
        [MovableObject("box", box(centre_x, 1.4, box_m), STOOL)],
        (0.7, 1.4),
        (2.9, 0.5),
        0.02,
    )
    plan = make_plan(problem, limits=PATIENT)
    (push,) = plan.pushes
    # Beyond the wall the robot needs its diameter between the wall's end and the box.
    needed_m = 2.4 + 2 * ROBOT.radius_m - (centre_x - box_m / 2)
    # The last step of the refinement and a cell on either side; the ladder of the search alone is up to 0.3 m longer.
    assert needed_m - 0.04 < np.hypot(*push.displacement_m) < needed_m + 0.0125 + 0.06
    assert faults(problem, plan) == []


def test_a_passage_that_only_blocks_seem_to_have_is_gone_round():
    """Blocks of cells are as clear as their clearest cell: a gap a little too narrow is found out, and the detour found."""
    cells = np.zeros((150, 200), np.int8)
    cells[[0, 1, -1, -2]] = cells[:, [0, 1, -1, -2]] = 100
    cells[:110, 100:104] = 100
    width = int(2 * ROBOT.radius_m / 0.02) - 1  # a cell or two too narrow for the robot
    cells[60 : 60 + width, 100:104] = 0
    problem = PlanningProblem(OccupancyMap(cells, 0.02), ROBOT, np.array([1.0, 1.3]), np.array([3.2, 1.3]))
    plan = make_plan(problem, limits=PATIENT)
    assert plan.reachable
    assert faults(problem, plan) == []
    assert max(y for task in plan.tasks for _, y in task.path_m) > 2.2


def test_compilation_uses_no_budget(tmp_path):
    """In the first run on a machine nothing is compiled yet: a plan may take as long as in any other run."""
    script = """if True:
        import numpy as np
        from visuohaptic.core.kernels import compiled_s
        from visuohaptic.navigation.planning.search import _travel_kernels, push_states
        push_states.WALL_PER_CPU = 1.0  # both clocks count alike
        layer = np.ones((4, 4), np.float32)
        _travel_kernels.clearance_at(layer, 1.0, 1.0)  # what numba itself imports is not timed
        before = compiled_s()
        deadline = push_states.Deadline.after(100.0)
        _travel_kernels.flood(layer, 0.5, np.zeros(1, np.int32), np.zeros(0, np.int32))
        print(100.0 - deadline.left_s, *np.subtract(compiled_s(), before))
    """
    environment = {
        **os.environ,
        "VISUOHAPTIC_CACHE_DIR": str(tmp_path),
        "NUMBA_CPU_NAME": "generic",  # leaves out machine code that is installed
        "PYTHONPATH": os.pathsep.join(map(str, sys.path)),
    }
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    used_s, *compiled = map(float, done.stdout.split())
    assert min(compiled) > 0.0, done.stderr
    assert used_s < 0.5 * min(compiled)


def test_a_drive_that_a_bounded_search_gave_up_is_known_along_that_of_a_plan():
    """What a search with few blocks did not find is no answer for the same pushes with another length."""
    costs = []
    for given_up in (False, True):
        domain = build_search_domain(two_doors())
        heuristic = PushHeuristic(domain, domain.costs, range(len(domain.bodies)))
        found = search_pushes(domain, domain.start, PATIENT)
        longer = replayed(heuristic, found.steps, 0, found.steps[0].length + 1.0)
        if given_up:
            ends = [found.steps[0].shifts_before, domain.start, longer[0].approach]
            shifts, begin, end = longer[0].shifts_after, longer[0].retreat, longer[1].approach
            nothing = domain.block, np.zeros((0, 2)), np.inf, np.zeros((0, 2))
            domain.drives.update({drives._key(*ends): nothing, drives._key(shifts, begin, end): nothing})
        costs.append(drives.changed_drives_cost(domain, found.steps, longer, domain.start, np.inf))
    assert np.isfinite(costs[0])
    assert costs[1] == pytest.approx(costs[0])
