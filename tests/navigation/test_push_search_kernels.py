"""Kernels of the search against SciPy and shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from shapely import Point, Polygon

from visuohaptic.navigation.grid.cost_grid import cell_distance
from visuohaptic.navigation.planning.object_cells import clear_cells, fill_cells
from visuohaptic.navigation.planning.search._push_search_kernels import descend, free_push_length
from visuohaptic.navigation.planning.search._travel_kernels import (
    FAR,
    UNITS,
    flood,
    segment_cost,
    string_pull,
    travel_field,
)
from visuohaptic.navigation.pushing._outline_kernels import disc_touches_at, distance_patch, polygon_distance

from .plan_scenes import box

RADIUS, SLOW = 2.0, 6.0


def cost_per_cell(clearance):
    fraction = np.clip((clearance / RADIUS - 1) / 2, 0, 1)
    return SLOW + fraction * (1 - SLOW)


def plain_field(clearance, source):
    """The same costs in floating point on a graph of SciPy's."""
    rows, columns = clearance.shape
    free = clearance >= RADIUS
    cost = cost_per_cell(clearance)
    entries = []
    for r, c in np.argwhere(free):
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                u, v = r + dr, c + dc
                if (dr or dc) and 0 <= u < rows and 0 <= v < columns and free[u, v]:
                    length = 0.5 * (cost[r, c] + cost[u, v]) * np.hypot(dr, dc)
                    entries.append((r * columns + c, u * columns + v, length))
    i, j, length = np.array(entries).T
    n = rows * columns
    return dijkstra(coo_array((length, (i.astype(int), j.astype(int))), shape=(n, n)), indices=source)


def field_from(clearance, source, radius=RADIUS):
    empty, none = np.zeros((0, 0), np.int16), np.zeros(0, np.int32)
    seeds = np.array([source], np.int32)
    return travel_field(clearance, radius, SLOW, seeds, np.zeros(1, np.int32), empty, none, none, 0, none)


@pytest.mark.parametrize("seed", range(4))
def test_travel_field_reaches_what_dijkstra_reaches_at_no_higher_cost(seed):
    rng = np.random.default_rng(seed)
    clearance = rng.uniform(1.2, 9.0, (23, 31)).astype(np.float32)
    source = int(np.flatnonzero(clearance.ravel() >= RADIUS)[0])
    cost = field_from(clearance, source)
    expected = plain_field(clearance.astype(float), source)
    reached = np.isfinite(expected)
    assert ((cost < FAR) == reached).all()
    # Rounding to whole units: at most one unit and 724 / 1024 for sqrt(1/2) per step.
    assert (cost[reached] / UNITS <= 1.002 * expected[reached] + 0.2).all()
    # Through the edge between two cells it is cheaper by at most that of the octagon of eight directions.
    assert (cost[reached] / UNITS >= expected[reached] * np.cos(np.pi / 8) - 0.2).all()


def test_travel_field_is_the_distance_in_all_directions_and_round_a_corner():
    size = 81
    clearance = np.full((size, size), np.float32(50.0))
    y, x = np.mgrid[0:size, 0:size]
    source = 10 * size + 10
    straight = np.hypot(x - 10.0, y - 10.0)
    found = field_from(clearance, source).reshape(size, size) / UNITS
    far = straight > 10.0
    # First order: the error about a point source grows with the logarithm of the distance. Eight directions have 8.2 %.
    assert (found[far] / straight[far]).min() >= 0.995
    assert (found[far] / straight[far]).max() < 1.025
    clearance[:41, 40] = 0.0  # a wall; the string bends at (40, 41)
    found = field_from(clearance, source).reshape(size, size) / UNITS
    behind = (x > 45) & (y < 30)
    bent = np.hypot(30.0, 31.0) + np.hypot(x - 40.0, y - 41.0)
    assert abs(found[behind] / bent[behind] - 1.0).max() < 0.03


def test_a_descent_over_a_field_is_as_long_as_the_field_says():
    clearance = np.full((60, 90), np.float32(50.0))
    clearance[:40, 45] = 0.0
    source = 10 * 90 + 5
    cost = field_from(clearance, source)
    path = descend(cost, clearance, np.array([source], np.int32), 12 * 90 + 80)
    assert path[0].tolist() == [5, 10]
    assert path[-1].tolist() == [80, 12]
    steps = np.diff(path, axis=0)
    assert (abs(steps) <= 1).all()
    # Eight directions are up to 8.2 % longer than any direction.
    assert 1.0 <= np.hypot(*steps.T).sum() / (cost[12 * 90 + 80] / UNITS) < 1.09


def test_entering_a_region_is_charged_once_seen_from_the_goal():
    clearance = np.full((3, 30), np.float32(50.0))
    region = np.zeros((3, 30), np.int16)
    region[:, 10:15] = 1
    charge = np.array([0, 1000], np.int32)
    none = np.zeros(0, np.int32)
    goal = np.array([1 * 30 + 25], np.int32)
    cost = travel_field(clearance, RADIUS, SLOW, goal, np.zeros(1, np.int32), region, charge, none, 0, none)
    field = cost.reshape(3, 30)
    assert field[1, 20] == 5 * UNITS
    assert field[1, 12] == 13 * UNITS  # inside: the robot is there already
    assert field[1, 5] == 20 * UNITS + 1000


def test_distances_and_touches_agree_with_shapely():
    rng = np.random.default_rng(3)
    for _ in range(30):
        outline = box(*rng.uniform(5, 9, 2), *rng.uniform(1, 5, 2), rng.uniform(0, 3))
        body = Polygon(outline)
        for point in rng.uniform(0, 14, (20, 2)):
            assert polygon_distance(*point, outline) == pytest.approx(body.distance(Point(*point)), abs=1e-9)
        patch, row, column = distance_patch(outline, 3.0)
        r, c = int(rng.integers(patch.shape[0])), int(rng.integers(patch.shape[1]))
        expected = body.distance(Point(c + column + 0.5, r + row + 0.5))
        assert patch[r, c] == pytest.approx(expected, abs=1e-5)
        filled = np.zeros((14, 14), np.bool_)
        fill_cells(filled, outline)
        square = Polygon([(7, 7), (8, 7), (8, 8), (7, 8)])
        assert filled[7, 7] == (body.intersection(square).area > 1e-9)
    shape = box(0, 0, 2.0)
    assert disc_touches_at(shape, 1.0, 0.0, 0.5, 10.0) == pytest.approx(1.5)


def test_a_push_ends_at_a_wall_at_another_object_and_where_the_robot_does_not_fit():
    occupied = np.zeros((20, 40), np.bool_)
    occupied[:, 30] = True
    clear = np.tile(np.abs(30.5 - (np.arange(40) + 0.5)) - 0.5, (20, 1)).astype(np.float32)
    outline = box(10, 10, 3.0)
    none, start = np.zeros((0, 2)), np.zeros(1, np.int32)
    samples = box(10, 10, 2.8)

    def steps(others=none, starts=start, clearance=clear, limit=40.0):
        return free_push_length(
            occupied,
            clearance,
            samples,
            none,
            outline,
            others,
            starts,
            6.0,
            10.0,
            1.0,
            0.0,
            RADIUS,
            limit,
        )

    assert steps() == pytest.approx(18.5)  # from 11.4 to the wall at 30
    assert steps(limit=5.0) == 5
    other = box(20, 10, 3.0)
    assert steps(other, np.array([0, 4], np.int32)) == 7.0  # from 11.4 to 18.5
    narrow = np.full((20, 40), np.float32(9.0))
    narrow[:, 9:] = 1.0
    # From 6 to where the interpolated clearance, 9 at 8.5 and 1 at 9.5, falls below 2.
    assert steps(clearance=narrow) == 3.0


def test_an_object_that_leans_on_a_wall_slides_along_it():
    occupied = np.zeros((20, 40), np.bool_)
    occupied[12:] = True
    clear = np.full((20, 40), np.float32(9.0))
    outline = box(10, 10.6, 3.0)  # its side lies 0.1 cells inside the wall
    none, start = np.zeros((0, 2)), np.zeros(1, np.int32)
    samples = np.concatenate(
        [np.linspace(a, b, 9) for a, b in zip(outline, np.roll(outline, -1, 0), strict=True)]
    )
    assert (
        free_push_length(
            occupied, clear, samples, none, outline, none, start, 6.0, 10.0, 1.0, 0.0, RADIUS, 10.0
        )
        == 10
    )
    # The wall ends, and another one begins beyond a gap: there the object would run into its edge.
    occupied[12:, 15:20] = False
    near = cell_distance(occupied)
    slid = free_push_length(
        occupied, near, samples, none, outline, none, start, 6.0, 5.0, 1.0, 0.0, RADIUS, 30.0
    )
    assert slid == 8.0  # from 11.5, its face, to 20


@pytest.mark.parametrize("seed", range(6))
def test_a_push_meets_no_wall_but_the_one_that_it_leans_on(seed):
    """Against every point of the object and of its margin in every step, without steps that are left out."""
    rng = np.random.default_rng(seed)
    lengths = []
    for _ in range(40):
        occupied = rng.random((30, 40)) < 0.01
        occupied[int(rng.integers(12, 18)), : int(rng.integers(40))] = True
        turn = rng.uniform(-0.2, 0.2)
        centre, ahead = (rng.uniform(5, 9), rng.uniform(10, 19)), np.array([np.cos(turn), np.sin(turn)])
        outline, other = box(*centre, 4.0, angle_rad=turn), box(rng.uniform(14, 30), rng.uniform(5, 22), 2.0)
        samples, around = (
            shapely.get_coordinates(
                shapely.segmentize(Polygon(box(*centre, side, angle_rad=turn)).exterior, 0.45)
            )
            for side in (3.9, 4.6)
        )
        limit, starts = 20.0, np.array([0, 4], np.int32)
        found = free_push_length(
            occupied, cell_distance(occupied), samples, around, outline, other, starts, 1e3, 1e3, *ahead, -np.inf, limit
        )  # fmt: skip
        walls, body = np.pad(occupied, 60, constant_values=True), Polygon(other)
        # From when on a point counts: an object is in no other one at any time.
        free = [np.zeros(len(samples), bool), np.zeros(len(around), bool)]
        expected = limit
        for t in np.arange(0.0, limit + 0.1, 0.5):
            placed = [points + t * ahead for points in (samples, around)]
            inside = [walls[tuple(np.floor(at.T[::-1]).astype(int) + 60)] for at in placed]
            met = shapely.contains_xy(body, *placed[1].T)
            collides = (free[0] & inside[0]).any() or (free[1] & (inside[1] | met)).any()
            if t and (collides or Polygon(placed[0]).intersects(body)):
                expected = t - 0.5
                break
            free = [free[0] | ~inside[0], free[1] | ~(inside[1] | met)]
        assert found == expected
        lengths.append(found)
    assert len(set(lengths)) > 10


def test_a_path_is_pulled_taut_where_that_is_cheaper_only():
    clearance = np.full((30, 30), np.float32(20.0))
    corner = np.array(
        [[2.5, 2.5], *[[x + 0.5, 2.5] for x in range(3, 20)], *[[19.5, y + 0.5] for y in range(3, 20)]]
    )
    kept, cost = string_pull(clearance, RADIUS, SLOW, corner, 80)
    assert list(kept) == [0, len(corner) - 1]
    assert cost == pytest.approx(17 * np.sqrt(2), rel=1e-6)
    clearance[8:22, 5:17] = 0.0
    kept, cost = string_pull(clearance, RADIUS, SLOW, corner, 80)
    assert len(kept) > 2
    for a, b in zip(corner[kept], corner[kept][1:], strict=False):
        assert np.isfinite(segment_cost(clearance, RADIUS, SLOW, *a, *b, False, np.inf))


def test_flood_is_a_connected_component():
    from scipy.ndimage import label

    rng = np.random.default_rng(5)
    clearance = rng.choice([1.0, 3.0], (40, 40), p=[0.45, 0.55]).astype(np.float32)
    labels, _ = label(clearance >= RADIUS, np.ones((3, 3)))
    source = int(np.flatnonzero(labels.ravel())[0])
    seeds, none = np.array([source], np.int32), np.zeros(0, np.int32)
    found = flood(clearance, RADIUS, seeds, none)
    assert (found.reshape(40, 40) == (labels == labels.ravel()[source])).all()
    for target in np.flatnonzero(labels.ravel())[::50].astype(np.int32):
        some = flood(clearance, RADIUS, seeds, np.array([target], np.int32))
        assert some[target] == found[target]
        assert not (some & ~found).any()


def test_an_object_leaves_neither_cells_nor_crumbs_and_takes_no_wall_along():
    occupied = np.zeros((30, 30), np.bool_)
    outline = box(15.2, 15.3, 6.0, 4.0, 0.3)
    body = Polygon(outline)
    for r in range(30):
        for c in range(30):
            # A mapper's object: a little larger than its outline.
            occupied[r, c] = body.distance(Point(c + 0.5, r + 0.5)) < 0.6
    alone = occupied.copy()
    clear_cells(alone, [outline])
    assert not alone.any()
    occupied[:, 20:22] = True  # a wall that passes beside it
    clear_cells(occupied, [outline])
    kept = [r for r in range(30) if not body.buffer(0.01).intersects(Point(21.5, r + 0.5))]
    assert occupied[kept, 21].all()


@pytest.mark.parametrize("turned", [False, True])
def test_cells_shared_with_a_wall_stay_its_own_where_its_face_or_a_closed_door_tells_it(turned):
    # Walls whose faces lie within cells, and what touches them: cells are drawn where they overlap either.
    walls = [shapely.box(0, 0, 12.4, 6.0), shapely.box(17.7, 0, 30, 6.0), shapely.box(0, 0, 30, 2.3)]
    thin, door, beside = shapely.box(12.4, 4.2, 17.7, 5.1), shapely.box(12.4, 3, 17.7, 6), (2, 6, 6, 9)
    shut = shapely.box(12.4, 2.3, 17.7, 6.0)

    def drawn(*shapes):
        columns, rows = np.meshgrid(np.arange(30), np.arange(12))
        squares = shapely.box(columns, rows, columns + 1, rows + 1)
        cells = shapely.intersects(shapely.union_all(shapes).buffer(-1e-6), squares)
        return cells.T.copy() if turned else cells

    def outline(body):
        corners = np.array(body.exterior.coords)[:-1]
        return corners[::-1, ::-1] if turned else corners

    own = drawn(*walls)
    for body, closed in ((thin, False), (thin, True), (shapely.box(*beside), False), (shut, True)):
        cells = drawn(*walls, body)
        clear_cells(cells, *(([], [outline(body)]) if closed else ([outline(body)],)))
        assert (cells == own).all()
    cells = drawn(*walls, door)
    clear_cells(cells, [outline(door)])  # as thick as the wall: no face is seen beside it
    lost = own & ~cells
    assert (cells <= own).all()
    assert (lost <= drawn(shapely.union_all([door]).boundary.buffer(0.01))).all()
