"""Push goals: open floor, beside a wall, and a blocked doorway; batch and single evaluation agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.reproduce.pushes import FootprintSamples, LocalCostmap, goal_map
from visuohaptic.reproduce.pushes.goal_maps import blocked_parts, in_collision

RADIUS_M = 0.17
STOOL = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def rooms(door=True, yaw=0.0):
    """6 x 4 m, a wall in the middle with a doorway of 0.8 m."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:, 58:62] = 100
    if door:
        cells[32:48, 58:62] = 0
    return OccupancyMap(cells, 0.05, (0.0, 0.0, yaw))


def goals(map, place, **rest):
    outline = STOOL + place
    costmap = LocalCostmap.around(map, outline, 1.5)
    footprint = FootprintSamples.of(STOOL, RADIUS_M, map.resolution_m)
    return costmap, goal_map(costmap, footprint, (*place, 0.0), RADIUS_M, reach_m=1.5, **rest)


def at(costmap, layer, point):
    row, column = costmap.map.cell_from_world(np.array(point))
    return bool(layer[row, column])


def test_open_floor_and_a_wall_are_goals_a_doorway_is_not():
    costmap, found = goals(rooms(), np.array([2.0, 2.0]))
    assert at(costmap, found.goal, (1.5, 2.0))
    # Close to the wall in the middle: one part of the ring is blocked.
    assert at(costmap, found.goal, (2.65, 1.2))
    # In the doorway it fits, and two parts are blocked: a plug.
    assert at(costmap, found.free, (3.0, 2.0))
    assert not at(costmap, found.goal, (3.0, 2.0))
    # In the wall it does not fit.
    assert not at(costmap, found.free, (3.0, 1.2))


def test_the_blocked_path_stays_free():
    path = np.array([[0.5, 2.0], [5.5, 2.0]])
    costmap, found = goals(rooms(), np.array([2.0, 2.0]), blocked_path_m=path)
    assert not at(costmap, found.goal, (1.5, 2.0))
    assert not at(costmap, found.goal, (1.5, 2.25))  # 0.1 m between outline and path
    assert at(costmap, found.goal, (1.5, 2.4))  # 0.25 m


def test_a_turned_map_has_the_same_goals():
    straight, found = goals(rooms(), np.array([2.0, 2.0]))
    c, s = np.cos(0.5), np.sin(0.5)
    rotation = np.array([[c, -s], [s, c]])
    map = rooms(yaw=0.5)
    place = rotation @ [2.0, 2.0]
    outline = STOOL @ rotation.T
    costmap = LocalCostmap.around(map, outline + place, 1.5)
    turned = goal_map(
        costmap, FootprintSamples.of(outline, RADIUS_M, 0.05), (*place, 0.0), RADIUS_M, reach_m=1.5
    )
    rows, columns = np.nonzero(
        straight.map.inside(np.stack(np.mgrid[: found.goal.shape[0], : found.goal.shape[1]], -1))
    )
    points = straight.map.world_from_cell(np.column_stack([rows, columns]))
    other = np.array(
        [
            at(costmap, turned.goal, rotation @ p)
            if bool(costmap.map.inside(costmap.map.cell_from_world(rotation @ p)))
            else False
            for p in points
        ]
    )
    mine = found.goal[rows, columns]
    # Samples of a turned outline fall on other cells: only at the border of the goals.
    assert (other != mine).mean() < 0.06


def test_the_object_itself_is_no_obstacle_and_unknown_is_one():
    map = rooms()
    map.cells[37:43, 37:43] = 100
    costmap, found = goals(map, np.array([2.0, 2.0]))
    assert at(costmap, found.goal, (2.1, 2.0))
    map.cells[60:, :] = -1
    outline = STOOL + np.array([2.0, 2.0])
    seen = LocalCostmap.around(map, outline, 1.5)
    assert not at(seen, seen.distance_m > 0, (2.0, 3.2))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_many_poses_are_each_what_one_is(seed):
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((30, 40)) < 0.06, 100, 0).astype(np.int8)
    map = OccupancyMap(cells, 0.05, (0.3, -0.2, float(rng.uniform(-3, 3))))
    centre = map.world_from_cell(np.array([15, 20]))
    costmap = LocalCostmap.around(map, STOOL * 0.2 + centre, 2.0)
    footprint = FootprintSamples.of(STOOL, RADIUS_M, 0.05)
    poses = np.column_stack([centre + rng.uniform(-0.3, 0.3, (5, 2)), rng.uniform(-3, 3, 5)])
    parts = blocked_parts(costmap, footprint, poses, RADIUS_M)
    count = in_collision(costmap, footprint, poses)
    for k, (x, y, yaw) in enumerate(poses):
        c, s = np.cos(yaw), np.sin(yaw)

        def nearer(points, limit, c=c, s=s, x=x, y=y):
            return [
                float(costmap.distance_at(np.array([x + c * u - s * v, y + s * u + c * v]))) < limit
                for u, v in points
            ]

        ring = nearer(footprint.ring_m, RADIUS_M)
        runs = sum(now and not before for before, now in zip([ring[-1], *ring], ring, strict=False))
        assert parts[k] == (1 if all(ring) else runs)
        inside = nearer([(0.0, 0.0)], footprint.inside_m)
        assert count[k] == sum(nearer(footprint.inner_m, costmap.margin_m)) + sum(inside)


def test_a_footprint_off_the_map_is_refused():
    with pytest.raises(InputError, match="expected one on the map"):
        LocalCostmap.around(rooms(), STOOL + np.array([50.0, 50.0]), 1.0)


def test_an_object_at_a_wall_may_leave_it_but_not_go_into_it():
    map = rooms(door=False)
    place = np.array([2.9 - 0.15, 2.0])  # its side is on the wall's cells
    costmap = LocalCostmap.around(map, STOOL + place, 1.0)
    footprint = FootprintSamples.of(STOOL, RADIUS_M, 0.05)

    def grows(step):
        poses = np.column_stack([place + np.arange(20)[:, None] * np.array(step), np.zeros(20)])
        return np.flatnonzero(np.diff(in_collision(costmap, footprint, poses)) > 0)

    assert not len(grows((-0.02, 0.0)))
    assert not len(grows((-0.02, 0.02)))
    assert grows((0.02, 0.0))[0] <= 3
