"""Drives of a rectangle among walls, against an exhaustive search over places and headings with polygons of shapely."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tests.navigation.plan_scenes import STOOL
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.planning.footprint import FootprintDrives
from visuohaptic.navigation.planning.footprint.footprint_drives import MOVES
from visuohaptic.navigation.planning.search import SearchLimits, build_search_domain
from visuohaptic.navigation.planning.search.drives import pull_string
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.planning.search.push_lengths import push_step
from visuohaptic.navigation.planning.search.push_states import Deadline
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel

CELL_M = 0.05
#: 0.5 m by 0.28 m, its centre of rotation 5 cm behind the middle [cells].
SHAPE = np.array([[6.0, -2.8], [6.0, 2.8], [-4.0, 2.8], [-4.0, -2.8]])
ROBOT = RobotModel.of_footprint(SHAPE * CELL_M)
REACH = math.hypot(6.0, 2.8)


@pytest.fixture(scope="module")
def domain():
    """A room of 2.8 m by 2.2 m; a wall of 10 cm with a gap of 40 cm near its lower end, and a box beyond it."""
    cells = np.zeros((44, 56), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:, 26:28] = 100
    cells[8:16, 26:28] = 0
    box = MovableObject("box", np.array([[2.0, 1.2], [2.3, 1.2], [2.3, 1.5], [2.0, 1.5]]), STOOL)
    ends = np.array([0.6, 1.6]), np.array([2.4, 0.6])
    return build_search_domain(PlanningProblem(OccupancyMap(cells, CELL_M), ROBOT, *ends, (box,)))


def obstacles(domain, shifts, without=()):
    """Occupied squares and outlines [cells]."""
    rows, columns = np.nonzero(domain.occupied)
    bodies = [shapely.Polygon(b.outline + s) for k, (b, s) in enumerate(zip(domain.bodies, shifts, strict=True))
              if k not in without]  # fmt: skip
    return shapely.union_all([*shapely.box(columns, rows, columns + 1, rows + 1), *bodies])


def placed(places, headings):
    """Corners at poses."""
    c, s = np.cos(headings), np.sin(headings)
    turns = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
    return SHAPE @ turns + np.asarray(places)[..., None, :]


def swept(path, begin, end):
    """Everything that the robot covers: it turns on the spot, the shorter way, and drives ahead."""
    headings = [math.atan2(*(b - a)[::-1]) for a, b in itertools.pairwise(path)]
    parts, now = [], begin
    for k, point in enumerate(path):
        following = headings[k] if k < len(headings) else end
        if not (math.isnan(now) or math.isnan(following)):
            turn = (following - now + math.pi) % (2.0 * math.pi) - math.pi
            angles = now + np.linspace(0.0, turn, 1 + math.ceil(abs(turn) / 0.02))
            parts += list(shapely.polygons(placed(np.broadcast_to(point, (len(angles), 2)), angles)))
        if k < len(headings):
            both = placed(path[k : k + 2], np.full(2, following))
            parts.append(shapely.MultiPoint(both.reshape(-1, 2)).convex_hull)
            now = following
    return parts


def slowness(domain, distance):
    """v_max / v at a distance [cells], Eq. (4.1)."""
    share = np.clip((distance / (ROBOT.radius_m / CELL_M) - 1.0) / 2.0, 0.0, 1.0)
    return domain.slow + share * (1.0 - domain.slow)


def cost_of(domain, walls, path, begin, end):
    """Cost of driving [cells at full speed], by distances at every eighth of a cell, and of turning at the outer corner's speed."""
    total = 0.0
    for a, b in itertools.pairwise(path):
        length = float(np.hypot(*(b - a)))
        count = math.ceil(8 * length)
        places = a + (np.arange(count)[:, None] + 0.5) / count * (b - a)
        total += length * slowness(domain, shapely.distance(walls, shapely.points(places))).mean()
    headings = [begin, *(math.atan2(*(b - a)[::-1]) for a, b in itertools.pairwise(path)), end]
    for now, following in itertools.pairwise(headings):
        if not (math.isnan(now) or math.isnan(following)):
            total += REACH * abs((following - now + math.pi) % (2.0 * math.pi) - math.pi)
    return total


def exhaustive(domain, walls, start, goal, begin, end):
    """Least cost over places a cell apart and the same headings, each step and each turn tested by polygons."""
    rows, columns = domain.occupied.shape
    off = start - np.floor(start)
    x, y = np.meshgrid(np.arange(columns) + off[0], np.arange(rows) + off[1])
    nodes = np.stack([x, y], axis=-1).reshape(-1, 2)
    angles = np.arctan2(MOVES[:, 1], MOVES[:, 0])
    count = len(angles)
    shapely.prepare(walls)
    costs = slowness(domain, shapely.distance(walls, shapely.points(nodes)))
    starts, ends, weights = [], [], []
    for k, ((dx, dy), angle) in enumerate(zip(MOVES, angles, strict=True)):
        onto = nodes + np.array([dx, dy])
        inside = (onto >= 0).all(axis=1) & (onto[:, 0] < columns) & (onto[:, 1] < rows)
        at = np.flatnonzero(inside)
        both = np.concatenate(
            [placed(nodes[at], np.full(len(at), angle)), placed(onto[at], np.full(len(at), angle))], 1
        )
        free = ~shapely.intersects(walls, shapely.convex_hull(shapely.multipoints(both)).astype(object))
        at, to = at[free], at[free] + dy * columns + dx
        starts.append(at * count + k)
        ends.append(to * count + k)
        weights.append(math.hypot(dx, dy) * 0.5 * (costs[at] + costs[to]))
        turn = (angles[(k + 1) % count] - angle + math.pi) % (2.0 * math.pi) - math.pi
        halves = [placed(nodes, np.full(len(nodes), angle + part * turn)) for part in (0.0, 0.5, 1.0)]
        at = np.flatnonzero(
            ~shapely.intersects(walls, shapely.convex_hull(shapely.multipoints(np.concatenate(halves, 1))))
        )
        for a, b in ((k, (k + 1) % count), ((k + 1) % count, k)):
            starts.append(at * count + a)
            ends.append(at * count + b)
            weights.append(np.full(len(at), REACH * turn))
    graph = csr_array(
        (np.concatenate(weights), (np.concatenate(starts), np.concatenate(ends))),
        shape=(len(nodes) * count,) * 2,
    )
    first = int(np.argmin(np.hypot(*(nodes - start).T)))
    seeds = [
        k
        for k in range(count)
        if math.isnan(begin) or abs(math.remainder(angles[k] - begin, 2 * math.pi)) < 1e-6
    ]
    found = dijkstra(graph, indices=[first * count + k for k in seeds], min_only=True).reshape(-1, count)
    near = np.hypot(*(nodes - goal).T) < 1e-6
    last = [
        k for k in range(count) if math.isnan(end) or abs(math.remainder(angles[k] - end, 2 * math.pi)) < 1e-6
    ]
    return float(found[near][:, last].min())


NAN = math.nan
PLACES = {"left": np.array([12.0, 32.0]), "low": np.array([8.0, 8.0]), "right": np.array([48.0, 12.0]), "top": np.array([46.0, 36.0])}  # fmt: skip


@pytest.mark.parametrize(
    ("start", "goal", "begin", "end"),
    [
        ("left", "right", NAN, NAN),
        ("left", "top", math.pi / 2, math.pi),
        ("low", "left", NAN, 0.0),
    ],
)
def test_a_drive_is_free_and_hardly_dearer_than_the_best_of_all(domain, start, goal, begin, end):
    shifts = np.array([[1.3, -0.4]])
    walls = obstacles(domain, shifts)
    start, goal = PLACES[start], PLACES[goal]
    path, cost = FootprintDrives(domain).drive(shifts, start, goal, begin, end)
    np.testing.assert_allclose(path[[0, -1]], [start, goal], atol=1e-9)
    for part in swept(path, begin, end):
        assert part.buffer(-1e-3).intersection(walls).area < 1e-6
    # Midpoints of an eighth of a radius, beside corners, where the slope of the distance changes.
    assert cost == pytest.approx(cost_of(domain, walls, path, begin, end), rel=1e-3)
    best = exhaustive(domain, walls, start, goal, begin, end)
    # On a lattice the ways are longer by a few per cent, and the search is guided by an estimate.
    assert 0.93 * best < cost < 1.06 * best
    disc = pull_string(domain, shifts, start, goal)[1]
    assert cost > 0.999 * disc


def test_drives_among_moved_bodies_do_not_depend_on_those_before(domain):
    rng = np.random.default_rng(3)
    kept = FootprintDrives(domain)
    fine = kept.factor
    assert fine * 0.01 == pytest.approx(CELL_M)
    for shifts in [np.zeros((1, 2)), *rng.uniform(-14.0, 6.0, (4, 1, 2)), np.zeros((1, 2))]:
        walls = obstacles(domain, shifts)
        counts = kept._counts(shifts)
        np.testing.assert_array_equal(counts, FootprintDrives(domain)._counts(shifts))
        cells = np.diff(counts, axis=1) > 0
        box = domain.bodies[0].outline + shifts
        (left, low), (right, high) = np.maximum(fine * box.min(axis=0) - 7, 0), fine * box.max(axis=0) + 8
        rows, columns = np.mgrid[int(low) : int(high), int(left) : int(right)]
        rows, columns = (each.ravel()[::3] for each in (rows, columns))
        squares = shapely.box(columns / fine, rows / fine, (columns + 1) / fine, (rows + 1) / fine)
        shapely.prepare(walls)
        on_map = (rows < len(cells)) & (columns < cells.shape[1])
        # A cell is occupied where the square shares an area with what is there, as far as it is not a sliver.
        apart = ~shapely.intersects(walls, squares) & on_map
        within = shapely.contains_properly(walls, squares) & on_map
        assert within.any()
        assert apart.any()
        assert not cells[rows[apart], columns[apart]].any()
        assert cells[rows[within], columns[within]].all()


def test_a_push_is_free_where_its_sweep_is(domain):
    heuristic = PushHeuristic(domain, domain.costs, (0,))
    drives = FootprintDrives(domain)
    rng = np.random.default_rng(6)
    found = []
    for shift in rng.uniform(-12.0, 10.0, (24, 1, 2)):
        for contact in range(len(domain.bodies[0].contacts)):
            step = push_step(heuristic, shift, 0, contact, float(rng.uniform(1.0, 8.0)))
            ahead = domain.bodies[0].push(contact).direction
            heading = math.atan2(*ahead[::-1])
            assert drives.heading(step) == pytest.approx(heading)
            ends = placed(np.stack([step.approach, step.touch + step.length * ahead]), np.full(2, heading))
            hull = shapely.MultiPoint(ends.reshape(-1, 2)).convex_hull
            walls = obstacles(domain, shift, without=(0,))
            inside = shapely.box(0, 0, *domain.occupied.shape[::-1]).contains(hull)
            overlap = hull.intersection(walls).area
            free = inside and overlap < 1e-6
            if free or not inside or overlap > 1e-3:  # fine cells decide the rest
                assert drives.push_is_free(step) == free
                found.append(free)
    assert 10 < sum(found) < len(found) - 10
    assert math.isnan(drives.heading(None))


def test_it_backs_off_farther_only_where_it_has_to(domain):
    """Behind the push a wall of the gap keeps it from turning at once; after half of the push there is room."""
    heuristic = PushHeuristic(domain, domain.costs, (0,))
    drives = FootprintDrives(domain)
    ahead = [domain.bodies[0].push(k).direction[0] for k in range(len(domain.bodies[0].contacts))]
    contact = int(np.argmax(ahead))
    for shift, expected in ((np.array([[0.0, 0.0]]), 0.0), (np.array([[-5.0, -15.0]]), None)):
        last = push_step(heuristic, shift, 0, contact, 6.0)
        end = np.array([46.0, 36.0])
        path, cost, share = drives.leg(
            last.shifts_after, (last.retreat, drives.heading(last)), last, None, end
        )
        assert len(path)
        assert np.isfinite(cost)
        at = last.retreat + share * (last.approach - last.retreat)
        np.testing.assert_allclose(path[[0, -1]], [at, end], atol=1e-9)
        walls = obstacles(domain, last.shifts_after)
        for part in swept(path, drives.heading(last), NAN):
            assert part.buffer(-1e-3).intersection(walls).area < 1e-6
        if expected is not None:
            assert share == pytest.approx(expected)
        for less in (0.0, 0.5):
            if less < share - 1e-9:
                place = last.retreat + less * (last.approach - last.retreat)
                assert not len(drives.drive(last.shifts_after, place, end, drives.heading(last))[0])


def test_no_drive_is_searched_after_the_deadline_and_none_leads_out_of_a_cage(domain):
    shifts = np.zeros((1, 2))
    late = FootprintDrives(domain, Deadline.after(-1.0))
    path, cost = late.drive(shifts, PLACES["left"], PLACES["right"])
    assert (len(path), cost) == (0, math.inf)
    # A place is reached at once, if it can turn there.
    path, cost = late.drive(shifts, PLACES["left"], PLACES["left"], 0.3, 1.0)
    assert (len(path), cost) == (1, pytest.approx(0.7 * REACH))
    beside = np.array([23.0, 30.0])
    path, cost = late.drive(shifts, beside, beside, math.pi / 2, 0.0)
    assert (len(path), cost) == (0, math.inf)
    narrow = replace(domain, bodies=())
    assert not len(FootprintDrives(narrow).drive(np.zeros((0, 2)), PLACES["left"], np.array([26.5, 30.0]))[0])


def test_the_bound_of_a_plan_is_that_of_the_circle_inside(domain):
    """Which drives the same way or a shorter one; turns and detours of the corners count against it."""
    plan = make_plan(domain.problem, limits=SearchLimits(budget_s=20.0))
    disc = make_plan(
        replace(domain.problem, robot=RobotModel(ROBOT.radius_m)), limits=SearchLimits(budget_s=20.0)
    )
    assert plan.reachable
    assert plan.cost_s > disc.cost_s
    bound_s = plan.cost_s / (1.0 + plan.gap)
    assert 0.85 * disc.cost_s < bound_s < 1.01 * disc.cost_s
    assert plan.length_m >= 0.98 * disc.length_m
