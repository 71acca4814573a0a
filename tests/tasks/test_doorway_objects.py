"""Objects in a doorway from laser points: direction of passage, and grouping of points."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.tasks.mobile import doorways, fit_outlines, heading_across, join_sides

from .laser_hits import VIEWS_M, box, scans


def side(x_m: float, low_m: float, high_m: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of a flat side across x, with the noise of the laser."""
    points = np.column_stack([np.full(count, x_m), rng.uniform(low_m, high_m, count)])
    return points + 0.01 * rng.standard_normal(points.shape)


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
def test_objects_are_approached_across_their_near_side(depths_m: tuple[float, ...]) -> None:
    """Near sides of a row are at different depths: that is no reason to push obliquely, which touches corners first."""
    rng = np.random.default_rng(0)
    places = [(2.0 + x, 1.7 + 0.35 * k) for k, x in enumerate(depths_m)]
    groups = [scans(box(0.2, 0.15, 0.0), rng) + place for place in places]
    path = np.column_stack([np.linspace(0.5, 3.5, 31), np.full(31, 2.0), np.full(31, 0.1)])
    heading = heading_across(groups, path)
    assert abs(np.degrees(heading)) < 8.0
    fits = [fit_outlines(one, VIEWS_M + place, heading)[0] for one, place in zip(groups, places, strict=True)]
    turns = [fit.pose[2] for fit in fits]
    # 150 points of 9.3 mm along 20 cm: 0.76 degrees each.
    assert np.sqrt(np.mean(np.square(np.degrees(turns)))) < 1.5


def test_an_object_elsewhere_does_not_turn_the_row_in_a_door() -> None:
    """House 712: a bin 4 m away turned the direction of passage by 65 degrees, and the approach led into a neighbour."""
    rng = np.random.default_rng(0)
    row = [np.add(scans(box(0.2, 0.15, 0.0), rng), (2.0, 1.7 + 0.3 * k)) for k in range(3)]
    bin_m = np.add(scans(box(0.2, 0.2, 0.0), rng), (0.2, 0.6))
    path = np.column_stack([np.linspace(0.0, 3.5, 36), np.full(36, 2.0), np.zeros(36)])
    rows = doorways([row[0], bin_m, row[2], row[1]], 0.34)
    assert sorted(map(len, rows)) == [1, 3]
    headings = np.degrees([heading_across(one, path) for one in rows])
    assert abs(headings).max() < 8.0
    assert abs(np.degrees(heading_across([*row, bin_m], path))) > 30.0
