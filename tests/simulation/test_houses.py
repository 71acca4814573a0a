"""Random houses: requirements of a platform, checked with a flood fill, independently of the planners."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from visuohaptic.simulation.houses import GuidedPlatform, House, office_house, random_house

ROBOT_M = 0.17


def joined(house: House, *, with_obstacles: bool, without: str = "") -> bool:
    """Whether the centre of the platform can get from the start to the table."""
    grid = house.fine_grid()
    free = grid.cells == 0
    rows, columns = np.indices(free.shape)
    x, y = np.moveaxis(grid.world_from_cell(np.stack([rows, columns], axis=-1)), -1, 0)
    room = ndimage.distance_transform_edt(free) * grid.resolution_m > ROBOT_M
    for one in house.obstacles if with_obstacles else ():
        if one.name == without:
            continue
        # Half of the smaller side: a disc inside of each, so that "joined" is not denied too easily.
        room &= np.hypot(x - one.x_m, y - one.y_m) > ROBOT_M + 0.5 * min(one.length_m, one.width_m)
    labels, _ = ndimage.label(room)
    start, table = (
        tuple(grid.cell_from_world(np.array(p)).astype(int)) for p in (house.start[:2], house.table_m)
    )
    return bool(labels[start] and labels[start] == labels[table])


@pytest.mark.parametrize("seed", range(2, 42, 2))
def test_the_table_is_reached_unless_the_doorway_is_blocked_and_again_without_the_bin(seed: int) -> None:
    house = random_house(seed)
    assert joined(house, with_obstacles=False)
    assert not joined(house, with_obstacles=True)
    assert joined(house, with_obstacles=True, without="bin")


def test_people_move_things_between_days_and_not_the_walls() -> None:
    first, second, other = random_house(4), random_house(4, visit=1), random_house(6)
    np.testing.assert_array_equal(first.grid.cells, second.grid.cells)
    assert {one.name: one.mass_kg for one in first.obstacles} == {
        one.name: one.mass_kg for one in second.obstacles
    }
    assert any(
        (a.x_m, a.y_m) != (b.x_m, b.y_m)
        for a in first.obstacles
        for b in second.obstacles
        if a.name == b.name
    )
    assert first.grid.shape != other.grid.shape or (first.grid.cells != other.grid.cells).any()


def test_plans_lie_in_all_directions() -> None:
    """Of 20 houses the doorways are crossed along x and along y, and in both senses."""
    row = [random_house(seed).obstacles for seed in range(0, 40, 2)]
    headings = {round(one[0].yaw_rad / (0.5 * np.pi)) % 4 for one in row}
    assert len(headings) == 4


def test_wheels_are_off_by_two_per_cent_of_the_way() -> None:
    """200 platforms led 10 m straight: the error along is 2 % of it, the chance of more than a fifth off is 1e-4."""
    house = random_house(2)
    ends = []
    for seed in range(200):
        platform = GuidedPlatform(
            house, (0.0, 0.0, 0.0), np.random.default_rng(seed), np.random.default_rng(0)
        )
        for _ in range(20):
            platform.go((0.5, 0.0, 0.0))
        assert platform.pose[0] == pytest.approx(10.0)
        ends.append(platform.odometry()[0])
    assert np.std(ends) == pytest.approx(0.2, rel=0.2)


def test_the_office_is_as_it_was_drawn() -> None:
    house = office_house(np.random.default_rng(0))
    assert {one.name for one in house.obstacles} == {"light bin", "heavy box", "fixed leg"}
    assert joined(house, with_obstacles=False)
    assert not joined(house, with_obstacles=True)
