"""Doors of synthetic buildings in every pose, and of real floors compared with annotations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import doors_evidence, doors_training, nav_doors
from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import (
    DoorSettings,
    door_probability,
    find_doors,
    free_space,
    measure,
    plan_measures,
)


def two_rooms(width_m: float, place_m: float, resolution_m: float = 0.05, yaw: float = 0.0) -> OccupancyMap:
    """Two rooms of 4 m x 5 m with unknown around, a wall of 0.15 m between them and a door in it."""
    scale = 1.0 / resolution_m
    cells = np.full((round(6 * scale), round(9.15 * scale)), -1, np.int8)

    def fill(x0: float, y0: float, x1: float, y1: float, value: int) -> None:
        cells[round(y0 * scale) : round(y1 * scale), round(x0 * scale) : round(x1 * scale)] = value

    fill(0.4, 0.4, 8.75, 5.6, 100)
    fill(0.5, 0.5, 4.5, 5.5, 0)
    fill(4.65, 0.5, 8.65, 5.5, 0)
    fill(4.5, place_m - width_m / 2, 4.65, place_m + width_m / 2, 0)
    return OccupancyMap(cells, resolution_m, (1.0, -2.0, yaw))


def test_the_odds_of_a_door_are_the_exponential_of_its_weighted_measures() -> None:
    """Even odds without evidence; 4 to 1 for one measure of ln 2, weighed twice; 1 to 10 by the constant alone."""
    weights = np.array([2.0, 0.0])
    found = door_probability(np.array([[0.0], [np.log(2.0)], [-np.log(2.0)]]), weights)
    np.testing.assert_allclose(found, [0.5, 0.8, 0.2], rtol=1e-12)
    alone = door_probability(np.zeros((1, 1)), np.array([2.0, -np.log(10.0)]))
    np.testing.assert_allclose(alone, 1.0 / 11.0, rtol=1e-12)
    with pytest.raises(InputError, match="found 3 weights, expected 2"):
        door_probability(np.zeros((1, 1)), np.zeros(3))


@settings(max_examples=25, deadline=None)
@given(
    width_m=st.floats(0.75, 1.2),
    place_m=st.floats(1.3, 4.7),
    yaw=st.sampled_from([0.0, 3.14, 0.7]),
    turn=st.integers(0, 3),
    resolution_m=st.sampled_from([0.05, 0.04, 0.025]),
)
def test_a_door_is_found_wherever_it_is(
    width_m: float, place_m: float, yaw: float, turn: int, resolution_m: float
) -> None:
    grid = two_rooms(width_m, place_m, resolution_m, yaw)
    turned = OccupancyMap(np.rot90(grid.cells, turn).copy(), resolution_m, grid.origin)
    found = find_doors(turned)
    assert len(found.doors) == 1
    door = found.doors[0]
    # Both edges of the gap are rounded to cells.
    assert door.width_m == pytest.approx(width_m, abs=1.01 * resolution_m)
    middle = np.zeros(grid.shape, bool)
    row, column = round(place_m / resolution_m), round(4.575 / resolution_m)
    middle[row, column] = True
    where = turned.world_from_cell(np.argwhere(np.rot90(middle, turn))[0])
    # A wall of three to six cells: the shortest line between the jambs lies anywhere in its thickness.
    assert np.hypot(*(door.middle_m - where)) < 0.15
    assert found.adjacency == {(1, 2)}
    cells = turned.cell_from_world(
        np.stack([door.middle_m - 0.5 * door.passage, door.middle_m + 0.5 * door.passage])
    )
    assert tuple(int(found.rooms[tuple(cell)]) for cell in cells) == door.rooms


def test_no_door_where_none_is() -> None:
    # A pillar beside a wall, a gap that is too narrow, an opening as wide as a hall, an empty map.
    room = np.full((120, 120), 100, np.int8)
    room[5:115, 5:115] = 0
    room[50:60, 22:30] = 100
    assert find_doors(OccupancyMap(room, 0.05)).doors == ()
    for width_m in (0.3, 3.0):
        assert find_doors(two_rooms(width_m, 3.0)).doors == ()
    assert find_doors(OccupancyMap(np.zeros((50, 50), np.int8), 0.05)).doors == ()
    assert find_doors(OccupancyMap(np.full((50, 50), -1, np.int8), 0.05)).doors == ()
    assert find_doors(OccupancyMap(np.full((1, 1), 100, np.int8), 0.05)).doors == ()


def test_a_row_of_rooms_on_a_corridor() -> None:
    cells = np.full((180, 330), -1, np.int8)
    cells[8:172, 8:322] = 100
    cells[10:46, 10:320] = 0  # corridor of 1.8 m
    for number in range(5):
        left = 10 + 62 * number
        cells[49:170, left : left + 60] = 0
        cells[46:49, left + 2 : left + 20] = 0  # doors of 0.9 m beside the partitions
    # The first is in the corner of the floor, where no wall steps back beside it: a door, but a less certain one.
    grid = OccupancyMap(cells, 0.05)
    assert len(find_doors(grid).doors) >= 4
    found = find_doors(grid, DoorSettings(min_confidence=0.3))
    truth = np.array([[(10 + 62 * n + 11) * 0.05, 47.5 * 0.05] for n in range(5)])
    middles = np.array([door.middle_m for door in found.doors])
    assert len(middles) == 5
    far = np.hypot(*(middles[:, None] - truth[None]).transpose(2, 0, 1))
    assert far.min(axis=0).max() < 0.15
    corridor = int(found.rooms[20, 100])
    assert len(found.adjacency) == 5
    assert all(corridor in pair for pair in found.adjacency)


def test_rooms_end_at_likelier_doors() -> None:
    # A cupboard, a room in two parts with two openings between them, and a hall; all but the cupboard in one chain.
    area_m2 = np.array([0.0, 0.5, 9.0, 4.0, 50.0])
    rooms, probability = [(1, 2), (2, 3), (3, 2), (3, 4), (0, 4)], np.array([0.9, 0.2, 0.5, 0.8, 0.7])
    around, room = plan_measures(rooms, area_m2, probability).T
    assert around == pytest.approx([1.0, 1.0, 0.2, 1.0, 1.0])
    assert np.exp(2.0 * room) == pytest.approx([0.8, 4.0, 13.0, 13.0, 0.8])
    wide = plan_measures([(1, 2)], np.array([0.0, 49.0, 50.0]), np.array([0.5]))[0, 1]
    assert np.exp(wide) == pytest.approx(6.0)


def test_jambs_are_walls_and_the_way_between_is_free() -> None:
    grid = two_rooms(0.9, 2.0)
    opening = measure(free_space(grid), np.array([40, 91]))
    assert opening is not None
    assert opening.width_m == pytest.approx(0.9, abs=0.051)
    assert abs(opening.passage @ [0, 1]) == pytest.approx(1.0)
    for jamb in opening.jambs.astype(int):
        assert grid.occupied[tuple(jamb)]


def test_a_door_that_noise_has_made_narrow_is_found() -> None:
    # A door of 0.7 m whose jambs are thickened by two cells of 5 cm each keeps 0.5 m.
    found = find_doors(two_rooms(0.5, 3.0))
    assert len(found.doors) == 1
    assert found.adjacency == {(1, 2)}


def test_a_door_between_walls_of_dashes_is_found() -> None:
    # Lasers that look along a wall hit it here and there: of three cells two were never seen.
    grid = two_rooms(0.9, 3.0)
    cells = grid.cells.copy()
    rows, columns = np.indices(cells.shape)
    cells[(cells == 100) & ((rows + columns) % 3 > 0)] = -1
    found = find_doors(OccupancyMap(cells, 0.05))
    assert len(found.doors) == 1
    assert found.adjacency == {(1, 2)}


def test_confidence_is_a_probability_on_buildings_that_trained_nothing() -> None:
    # Training stopped at seed 46. Two standard errors of a fraction of 0.91 of about 80 doors are 0.06.
    rows = [doors_evidence.play(f"generated {seed}") for seed in range(48, 68, 2)]
    told = np.concatenate([row["confidence"] for row in rows])
    true = np.concatenate([row["true"] for row in rows])
    assert true.sum() / sum(row["drawn"] for row in rows) > 0.8
    assert true.mean() > 0.85
    assert abs(told.mean() - true.mean()) < 0.06
    # The surest are declared 0.97; three standard errors of that fraction of 60 doors are 0.07.
    assert true[told > 0.9].mean() > 0.9


def test_training_recovers_the_weights_that_made_the_labels() -> None:
    rng = np.random.default_rng(4)
    weights = np.array([0.7, 1.5, 0.8, 1.0, 0.0, 0.6, -2.0])
    measures = rng.normal(size=(20000, len(weights)))
    is_door = rng.random(len(measures)) < 1 / (1 + np.exp(-(measures @ weights - 1.0)))
    found = doors_training.fit(measures, is_door, np.ones(len(measures)))
    # The standard error of a weight is about 1 / sqrt(n mean(p (1 - p))), 0.025: four of them.
    assert np.abs(found - np.append(weights, -1.0)).max() < 0.1


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match=r"max_width_m: found 1.0, expected more than min_width_m"):
        DoorSettings(min_width_m=2.0, max_width_m=1.0)


@pytest.mark.data
def test_doors_that_people_have_drawn(data: Path) -> None:
    # Floor 1; both floors are in the benchmark.
    folder = data / "navigation" / "dev" / "maps" / "ut_gdc_1"
    grid = OccupancyMap.load(folder / "1.yaml")
    corners, approach = nav_doors.drawn_doors(folder / "doors.yaml")
    found = find_doors(grid)
    pairs = nav_doors.matched(found, corners)
    assert len(pairs) >= 0.8 * len(corners)
    joined = [nav_doors.joins_its_rooms(grid, found, i, approach[j]) for i, j in pairs]
    assert np.mean(joined) >= 0.8
