"""Footprints of synthetic objects in any pose, and annotated bins in a real map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from shapely import Polygon, contains_xy

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.grid import FootprintSettings, find_footprints


def with_box(
    centre: tuple[float, float], size: tuple[float, float], turn: float, yaw: float, hollow: bool = False
) -> OccupancyMap:
    """A room of 4 m with one box in it."""
    grid = OccupancyMap(np.zeros((160, 160), np.int8), 0.025, (3.0, -1.0, yaw))
    cells = np.zeros((160, 160), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    rows, columns = np.indices(cells.shape)
    local = (np.stack([columns, rows], axis=-1) + 0.5) * 0.025 - centre
    c, s = np.cos(turn), np.sin(turn)
    a, b = np.abs(local @ [c, s]), np.abs(local @ [-s, c])
    inside = (a <= size[0] / 2) & (b <= size[1] / 2)
    if hollow:  # a laser sees one side and a bit of the next
        inside &= (local @ np.array([c, s]) < -size[0] / 2 + 0.05) | (
            local @ np.array([-s, c]) < -size[1] / 2 + 0.05
        )
    cells[inside] = 100
    return OccupancyMap(cells, grid.resolution_m, grid.origin)


@settings(max_examples=40, deadline=None)
@example(place=(1.65625, 1.90625), long=0.3125, slender=0.671875, turn=0.921875, yaw=0.0, hollow=False)
@given(
    place=st.tuples(st.floats(1.0, 3.0), st.floats(1.0, 3.0)),
    long=st.floats(0.25, 0.55),
    slender=st.floats(0.6, 1.0),
    turn=st.floats(0, np.pi),
    yaw=st.sampled_from([0.0, 3.14, -0.4]),
    hollow=st.booleans(),
)
def test_a_box_is_found_with_its_size_and_place(
    place: tuple[float, float], long: float, slender: float, turn: float, yaw: float, hollow: bool
) -> None:
    size = (long, long * slender)
    grid = with_box(place, size, turn, yaw, hollow)
    found = find_footprints(grid)
    assert len(found) == 1
    c, s = np.cos(yaw), np.sin(yaw)
    true = np.array([3.0, -1.0]) + np.array([c * place[0] - s * place[1], s * place[0] + c * place[1]])
    if hollow:
        # The hull of an L is the triangle of what was seen; it holds the seen cells and stays in the box.
        assert contains_xy(
            Polygon(found[0].outline_m).buffer(1e-6), *grid.world_from_cell(found[0].cells).T
        ).all()
        assert np.hypot(*(found[0].centre_m - true)) < long / 2
        return
    # Cells whose centre is inside: each side to within a cell's diagonal. Of boxes of up to a tenth more than the smallest
    # area the shortest is meant.
    longer, shorter = found[0].size_m
    assert longer < size[0] + 0.036
    assert shorter > size[1] - 0.036
    assert (size[0] - 0.036) * (size[1] - 0.036) < longer * shorter
    assert longer * shorter < 1.1 * (size[0] + 0.036) * (size[1] + 0.036)
    assert np.hypot(*(found[0].centre_m - true)) < 0.025
    outline = found[0].outline_m
    following = np.roll(outline, -1, axis=0)
    assert np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]) > 0, "counter-clockwise"


def test_the_outline_is_that_of_the_cells() -> None:
    """Four rows and eight columns of a turned grid: its corners are those of the outer cells."""
    grid = with_box((1.0, 1.0), (0.01, 0.01), 0.0, 0.3)
    cells = np.zeros((160, 160), np.int8)
    cells[60:64, 40:48] = 100
    (found,) = find_footprints(OccupancyMap(cells, 0.025, grid.origin))
    c, s = np.cos(0.3), np.sin(0.3)
    corners = 0.025 * np.array([[40, 60], [48, 60], [48, 64], [40, 64]])
    true = Polygon(corners @ [[c, s], [-s, c]] + [3.0, -1.0])
    assert Polygon(found.outline_m).symmetric_difference(true).area < 1e-9
    assert found.size_m == pytest.approx((0.2, 0.1))


def test_size_and_surroundings_decide() -> None:
    assert find_footprints(with_box((2.0, 2.0), (0.9, 0.3), 0.0, 0.0)) == ()
    assert find_footprints(with_box((2.0, 2.0), (0.05, 0.05), 0.0, 0.0)) == ()
    assert find_footprints(with_box((0.1, 2.0), (0.3, 0.3), 0.0, 0.0)) == (), "joined to the wall"
    assert len(find_footprints(with_box((2.0, 2.0), (0.9, 0.3), 0.0, 0.0), FootprintSettings(max_m=1.0))) == 1
    cells = np.full((40, 40), -1, np.int8)
    cells[15:20, 15:20] = 100
    assert find_footprints(OccupancyMap(cells, 0.05)) == (), "nobody has seen what is around it"
    with pytest.raises(InputError, match=r"max_m: found 0.7, expected more than min_m"):
        FootprintSettings(min_m=1.0)


@pytest.mark.data
def test_the_trash_bins_of_freiburg(data: Path) -> None:
    # Nine bins are drawn into the second map as one cell each; at the map's size of about 0.1 m a cell.
    folder = data / "navigation" / "dev" / "maps" / "freiburg"
    without = OccupancyMap.from_image(folder / "freiburg_building52.png", 0.1)
    with_bins = OccupancyMap.from_image(folder / "freiburg_building52_trashbins.png", 0.1)
    drawn = np.argwhere(without.cells != with_bins.cells)
    found = {tuple(cell) for footprint in find_footprints(with_bins) for cell in footprint.cells.tolist()}
    assert {tuple(cell) for cell in drawn.tolist()} <= found
    new = find_footprints(
        replace(with_bins, cells=np.where(without.cells != with_bins.cells, with_bins.cells, 0))
    )
    assert sorted(tuple(f.cells[0]) for f in new) == sorted(tuple(cell) for cell in drawn.tolist())
