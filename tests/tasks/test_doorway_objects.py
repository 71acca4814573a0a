"""Objects in a doorway from laser points: position of the near side, and grouping of points."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core.geometry import rotation_2d
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.tasks.mobile import heading_across, join_sides, near_side


def side(x_m: float, low_m: float, high_m: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of a flat side across x, with the noise of the laser."""
    points = np.column_stack([np.full(count, x_m), rng.uniform(low_m, high_m, count)])
    return points + 0.01 * rng.standard_normal(points.shape)


@pytest.mark.parametrize("count", [60, 400])
@pytest.mark.parametrize("heading_rad", [0.0, 2.1])
def test_the_near_side_is_not_where_the_nearest_point_is(count: int, heading_rad: float) -> None:
    """Of 400 points with a noise of 10 mm the nearest is 30 mm too near; a push would expect its touch there."""
    turn = rotation_2d(heading_rad)
    errors = []
    for seed in range(20):
        points = side(2.0, -0.1, 0.1, count, np.random.default_rng(seed)) @ turn.T
        (x, y), width = near_side(points, heading_rad)
        errors.append((np.array([x, y]) @ turn)[0] - 2.0)
        assert 0.19 < width < 0.26
    # The smallest of twelve means with standard errors of up to 4.5 mm is 1.6 of them too near: 7 mm, +- 0.6 here.
    assert -0.009 < np.mean(errors) < 0.0


def test_a_side_that_is_seen_behind_a_face_is_of_the_same_box() -> None:
    """A box that is deeper than wide, and few beams on the far end of its side; a bin next to it is another object."""
    rng = np.random.default_rng(0)
    face, bin_m = side(2.0, -0.08, 0.08, 200, rng), side(2.0, 0.2, 0.38, 200, rng)
    end = side(2.22, 0.06, 0.08, 16, rng)
    found = join_sides([face, end, bin_m], 0.0)
    assert sorted(len(one) for one in found) == [200, 216]
    behind = side(2.5, -0.05, 0.05, 16, rng)
    assert len(join_sides([face, behind], 0.0)) == 2


@pytest.mark.parametrize("depths_m", [(0.0, 0.03, 0.0), (0.05, 0.0, -0.02), (0.0,)])
def test_objects_are_approached_across_the_wall_of_their_doorway(depths_m: tuple[float, ...]) -> None:
    """Near sides of a row are at different depths: that is no reason to push obliquely, which touches corners first."""
    cells = np.zeros((80, 80), np.int8)
    cells[:, 40] = 100  # a wall across x with a doorway of one metre
    cells[30:50, 40] = 0
    rng = np.random.default_rng(0)
    groups = [side(2.0 + x, 1.6 + 0.35 * k, 1.8 + 0.35 * k, 200, rng) for k, x in enumerate(depths_m)]
    path = np.column_stack([np.linspace(0.5, 3.5, 31), np.full(31, 2.0), np.full(31, 0.1)])
    assert abs(np.degrees(heading_across(groups, path, OccupancyMap(cells, 0.05)))) < 1.5
