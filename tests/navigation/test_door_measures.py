"""Measures of openings on drawn floors, from the lengths with which these are drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import DoorSettings, door_candidates, free_space, measure
from visuohaptic.navigation.mapping.door_openings import MEASURES, look, narrow_places, without_gaps

CELL_M = 0.05


def floor(rows_m, columns_m, *free_m, walls_m=()):
    """Free rectangles (x0, y0, x1, y1) [m] among walls, and walls in these."""
    cells = np.full((round(rows_m / CELL_M), round(columns_m / CELL_M)), 100, np.int8)
    for value, boxes in ((0, free_m), (100, walls_m)):
        for box in boxes:
            x0, y0, x1, y1 = (round(each / CELL_M) for each in box)
            cells[y0:y1, x0:x1] = value
    return cells


def only(cells, settings=None):
    """The measures of the only opening, by name."""
    space, (opening,), measures = door_candidates(OccupancyMap(cells, CELL_M), settings or DoorSettings())
    np.testing.assert_array_equal(measures, [opening.measures])
    return space, opening, dict(zip(MEASURES, opening.measures.tolist(), strict=True))


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("mirrored", [1, -1])
def test_a_door_between_rooms_of_different_sizes(turns, mirrored):
    """0.9 m wide; on one side the walls step back by 0.5 and 1.2 m, on the other by 2 and 0.3 m, in a room of 1.6 m."""
    plan = floor(6.0, 8.0, (1.0, 1.5, 3.0, 4.1), (3.1, 0.1, 4.7, 3.3), (3.0, 2.0, 3.1, 2.9))
    cells = np.rot90(plan, turns)[:, ::mirrored].copy()
    _, opening, found = only(cells)
    assert opening.width_m == pytest.approx(0.9)
    assert found["width"] == pytest.approx(math.log(0.9 / 0.8))
    # Jambs on both sides of the first room: 0.5 m below, 1.2 m above; of the second 1.9 m below, 0.4 m above.
    crossed = max(min(0.5, 0.4), min(1.2, 1.9))
    same = max(min(0.5, 1.9), min(1.2, 0.4))
    # Free lengths are found in steps of 0.7 cells, along lines between the centres of cells.
    assert math.exp(found["recess"]) == pytest.approx(crossed, abs=1.5 * CELL_M)
    assert math.exp(found["end"]) == pytest.approx(same, abs=1.5 * CELL_M)
    # Half of the narrower room, above half of the door; its centre is looked at every 1.5 cells.
    assert found["clearance_m"] == pytest.approx(0.8 - 0.45, abs=1.5 * CELL_M)
    assert found["wall"] == found["bridged_wall"] == pytest.approx(math.log(6.0))
    assert found["turn_rad"] == pytest.approx(0.0, abs=0.02)
    # Through the door: along x of the plan, so turned and mirrored.
    along = np.array([0.0, 1.0] if turns % 2 == 0 else [1.0, 0.0])
    assert abs(opening.passage @ along) == pytest.approx(1.0)
    assert np.hypot(*opening.passage) == pytest.approx(1.0)
    middle = np.zeros(plan.shape, bool)
    middle[round(2.45 / CELL_M), round(3.05 / CELL_M)] = True
    where = np.argwhere(np.rot90(middle, turns)[:, ::mirrored])[0]
    assert np.hypot(*(opening.middle - where)) < 2.0


def test_clearance_counts_up_to_two_and_a_half_times_that_of_the_door_and_ends_at_the_next_wall():
    """A narrow hall of 1 m behind the door, and a wide one behind its wall; or a hall as wide as it likes."""
    deep = floor(5.0, 9.0, (0.5, 0.5, 4.0, 4.5), (4.1, 0.5, 8.5, 4.5), (4.0, 2.0, 4.1, 2.7))
    assert only(deep)[2]["clearance_m"] == pytest.approx(1.5 * 0.35)
    hall = floor(
        5.0, 9.0, (0.5, 0.5, 4.0, 4.5), (4.1, 0.5, 5.1, 4.5), (4.0, 2.0, 4.1, 2.7), (5.2, 0.5, 8.5, 4.5)
    )
    assert only(hall)[2]["clearance_m"] == pytest.approx(0.5 - 0.35, abs=1.5 * CELL_M)


def partitions(first_m, second_m, gap_m=0.9, hole_m=0.0):
    """A hall of 9 m by 8 m with two pieces of wall in line, and a hole in the second one."""
    half, middle = 0.5 * gap_m, 4.5
    walls = [
        (middle - half - first_m, 3.9, middle - half, 4.0),
        (middle + half, 3.9, middle + half + second_m, 4.0),
    ]
    free = [(0.2, 0.2, 8.8, 7.8)]
    cells = floor(8.0, 9.0, *free, walls_m=walls)
    x0 = round((middle + half + 0.6) / CELL_M)
    cells[:, x0 : x0 + round(hole_m / CELL_M)][round(3.9 / CELL_M) : round(4.0 / CELL_M)] = (
        -1 if hole_m < 0 else 0
    )
    return cells


def extents(cells, place_m=(3.95, 4.5)):
    space = free_space(OccupancyMap(cells, CELL_M))
    opening = measure(space, np.array([round(each / CELL_M) for each in place_m]))
    assert opening is not None
    found = dict(zip(MEASURES, opening.measures.tolist(), strict=True))
    return math.exp(found["wall"]), math.exp(found["bridged_wall"])


def test_a_wall_is_as_long_as_the_smaller_piece_and_scans_leave_gaps_in_it():
    diagonal = math.hypot(1.5, 0.1)
    for pieces in ((1.5, 2.5), (2.5, 1.5)):
        wall, bridged = extents(partitions(*pieces))
        assert wall == pytest.approx(diagonal, abs=1e-6)
        assert bridged == pytest.approx(diagonal, abs=0.03)  # grown and shrunk by two cells
    # With a hole of 15 cm the piece beside the door is 0.6 m long, and the whole again where gaps are bridged.
    wall, bridged = extents(partitions(2.5, 1.5, hole_m=0.15))
    assert wall == pytest.approx(math.hypot(0.6, 0.1), abs=1e-6)
    assert bridged == pytest.approx(diagonal, abs=0.03)
    assert extents(partitions(2.5, 1.5, hole_m=0.3))[1] == pytest.approx(math.hypot(0.6, 0.1), abs=0.05)


@pytest.mark.parametrize(("length_m", "is_wall"), [(1.0, False), (1.1, False), (1.3, True)])
def test_what_stands_alone_and_is_shorter_than_1_2_m_is_furniture(length_m, is_wall):
    space = free_space(
        OccupancyMap(floor(6.0, 6.0, (0.2, 0.2, 5.8, 5.8), walls_m=[(2.0, 3.0, 2.0 + length_m, 3.1)]), CELL_M)
    )
    assert space.free[61, 50] == (not is_wall)


@pytest.mark.parametrize(("gap_m", "is_wall"), [(0.35, True), (0.5, False)])
def test_pieces_of_a_wall_belong_together_up_to_42_cm(gap_m, is_wall):
    """Two of 0.7 m in line; apart, each is furniture."""
    walls = [(1.5, 3.0, 2.2, 3.6), (2.2 + gap_m, 3.0, 2.9 + gap_m, 3.6)]
    space = free_space(OccupancyMap(floor(6.0, 6.0, (0.2, 0.2, 5.8, 5.8), walls_m=walls), CELL_M))
    assert space.free[66, 35] == (not is_wall)
    assert space.free[66, round((2.2 + 0.5 * gap_m) / CELL_M)] == (not is_wall)


@pytest.mark.parametrize(("side_m", "is_wall"), [(0.95, False), (1.05, True)])
def test_unknown_patches_of_less_than_a_square_metre_were_missed_by_the_laser(side_m, is_wall):
    cells = floor(6.0, 6.0, (0.2, 0.2, 5.8, 5.8))
    side = round(side_m / CELL_M)
    cells[40 : 40 + side, 40 : 40 + side] = -1
    assert free_space(OccupancyMap(cells, CELL_M)).free[45, 45] == (not is_wall)


def test_gaps_are_closed_where_no_disc_fits():
    """By the union of all discs in free space, one after the other."""
    rng = np.random.default_rng(4)
    free = np.ones((40, 40), bool)
    free[[0, -1]] = free[:, [0, -1]] = False
    free[rng.integers(0, 40, 25), rng.integers(0, 40, 25)] = False
    rows, columns = np.indices(free.shape)
    blocked = np.argwhere(~free)
    truth = np.zeros_like(free)
    for row, column in np.argwhere(free):
        if np.hypot(*(blocked - (row, column)).T).min() > 3.0:
            truth |= np.hypot(rows - row, columns - column) < 3.0
    assert 0.1 < truth.mean() < 0.8
    np.testing.assert_array_equal(without_gaps(free, 0.3, 0.05), truth)


@pytest.mark.parametrize("turn_deg", [-30, -12, 20, 41])
def test_walls_have_the_direction_in_which_they_are_drawn(turn_deg):
    rows, columns = np.indices((160, 160)) - 79.5
    turn = math.radians(turn_deg)
    across = np.abs(-math.sin(turn) * columns + math.cos(turn) * rows)
    along = np.abs(math.cos(turn) * columns + math.sin(turn) * rows)
    cells = np.where((across < 40) & (along < 60), 0, 100).astype(np.int8)
    found = free_space(OccupancyMap(cells, CELL_M)).direction_rad
    assert math.remainder(found - turn, math.pi / 2) == pytest.approx(0.0, abs=math.radians(1.5))


def test_an_opening_across_the_building_has_the_angle_between_them():
    """A gap in a partition that stands obliquely by 25 degrees in a room along the axes."""
    cells = floor(8.0, 9.0, (0.2, 0.2, 8.8, 7.8))
    rows, columns = np.indices(cells.shape)
    x, y = (columns + 0.5) * CELL_M - 4.5, (rows + 0.5) * CELL_M - 4.0
    c, s = math.cos(math.radians(25)), math.sin(math.radians(25))
    along, across = c * x + s * y, -s * x + c * y
    cells[(np.abs(across) < 0.08) & (np.abs(along) > 0.5) & (np.abs(along) < 1.8)] = 100
    opening = measure(free_space(OccupancyMap(cells, CELL_M)), np.array([80, 90]))
    assert opening.measures[6] == pytest.approx(math.radians(25), abs=0.1)
    assert opening.width_m == pytest.approx(1.0, abs=0.12)


def test_narrow_places_are_between_wide_ones_and_below_the_width_that_is_asked_for():
    cells = floor(5.0, 8.0, (0.5, 0.5, 4.0, 4.5), (4.1, 0.5, 7.5, 4.5), (4.0, 2.0, 4.1, 3.0))
    space = free_space(OccupancyMap(cells, CELL_M))
    (place,) = narrow_places(space, 2.0)
    assert np.abs(place - [2.5 / CELL_M, 4.05 / CELL_M]).max() <= 2.0
    # The clearance there is half of a metre: up to 1.5 times half of the width is let pass.
    assert len(narrow_places(space, 0.72)) == 1
    assert len(narrow_places(space, 0.6)) == 0
    one_room = free_space(OccupancyMap(floor(5.0, 5.0, (0.5, 0.5, 4.5, 4.5)), CELL_M))
    assert len(narrow_places(one_room, 2.0)) == 0


def test_there_is_no_opening_without_two_sides():
    cells = floor(6.0, 6.0, (0.2, 0.2, 5.8, 5.8), walls_m=[(2.0, 3.0, 4.0, 3.1)])
    space = free_space(OccupancyMap(cells, CELL_M))
    assert measure(space, np.array([56, 60])) is None  # beside a wall, nothing opposite
    wide = np.ones((240, 240), bool)
    lonely = free_space(OccupancyMap(np.where(wide, 0, 100).astype(np.int8), CELL_M))
    assert measure(lonely, np.array([120, 120])) is None


def test_values_are_those_of_the_nearest_cells_and_nothing_outside():
    values = np.arange(12.0).reshape(3, 4)
    points = np.array([[0.4, 0.4], [0.6, 3.4], [2.4, 1.6], [-0.6, 0.0], [0.0, 3.6], [2.6, 0.0], [-0.4, -0.4]])
    assert look(values, points).tolist() == [0.0, 7.0, 10.0, 0.0, 0.0, 0.0, 0.0]
    assert look(values > 5, np.array([[2.0, 2.0], [9.0, 9.0]])).tolist() == [True, False]


@pytest.mark.parametrize(("first", "last", "counts"), [(14, 30, True), (18, 34, False)])
def test_walls_step_back_within_85_cm_from_the_middle_of_the_door(first, last, counts):
    """A door of 0.7 m in a passage of 0.8 m by 3.2 m, with niches of half a metre from one cell of 5 cm up to another."""
    cells = floor(5.0, 8.0, (2.4, 2.1, 5.6, 2.9), (1.0, 1.0, 2.4, 4.0), (5.6, 1.0, 7.0, 4.0))
    for columns in (np.s_[80 + first : 80 + last], np.s_[81 - last : 81 - first]):
        cells[32:68, columns] = 0
    cells[[42, 57], 80] = 100
    opening = measure(free_space(OccupancyMap(cells, CELL_M)), np.array([50, 80]))
    assert opening.width_m == pytest.approx(0.7)
    # A disc of 0.42 m does not reach into the corners of a niche.
    assert (math.exp(opening.measures[2]) > 0.4) == counts
    assert counts or math.exp(opening.measures[2]) < 0.15
