"""New objects, fit and agreement of a map, against rooms whose walls are known."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import map_agreement, mark_points, new_objects, scan_fit


@pytest.fixture
def room() -> OccupancyMap:
    """4 m x 3 m in cells of 5 cm, walls around."""
    cells = np.zeros((60, 80), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    return OccupancyMap(cells, 0.05)


def cluster(x_m: float, y_m: float) -> np.ndarray:
    return [x_m, y_m] + 0.02 * np.random.default_rng(0).standard_normal((40, 2))


def test_new_objects_are_separated_and_walls_are_not_new(room: OccupancyMap) -> None:
    wall = np.column_stack([np.full(50, 0.08), np.linspace(0.5, 1.5, 50)])
    found = new_objects(room, np.concatenate([wall, cluster(2.0, 2.0), cluster(2.4, 1.0), [[3.0, 1.5]] * 3]))
    assert [np.round(one.mean(axis=0), 1).tolist() for one in found] == [[2.4, 1.0], [2.0, 2.0]]
    assert new_objects(room, wall) == []
    # Within a decimetre of the wall: not new.
    assert new_objects(room, cluster(2.0, 2.9)) == []


def test_a_scan_fits_where_it_was_made(room: OccupancyMap) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    ahead = np.column_stack([np.cos(angle), np.sin(angle)])
    # Distance to the inner side of the walls from (2, 1.5).
    with np.errstate(divide="ignore"):
        length = np.min(np.abs(np.array([1.95, 1.45]) / ahead), axis=1)
    hits = np.array([2.0, 1.5]) + length[:, None] * ahead
    assert scan_fit(room, hits) == 1.0
    # Shifted by 60 cm only the hits near one wall's line still fit.
    assert scan_fit(room, hits + np.array([0.6, 0.4])) < 0.5


def test_marked_points_are_occupied_and_seen_by_the_agreement(room: OccupancyMap) -> None:
    changed = mark_points(room, [np.array([[2.0, 1.5], [2.1, 1.5]])])
    assert changed.value_at(np.array([[2.0, 1.5]]))[0] == 100
    assert room.value_at(np.array([[2.0, 1.5]]))[0] == 0
    assert map_agreement(room, room) == (1.0, 0.0)
    free, phantom = map_agreement(changed, room)
    assert free == 1.0
    assert phantom == pytest.approx(2 / np.count_nonzero(changed.cells >= 50))
