"""Points on paths of cells: how many, where, and that corners stay."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.navigation.planning.search.cell_paths import resampled


@pytest.mark.parametrize("count", [0, 12, 40])
def test_a_resampled_path_has_its_corners_and_the_requested_number_of_points(count: int) -> None:
    """An L of 7 and 4 cells: all points lie on it, their gaps are at most the even one, and they are about as many as asked for."""
    corners = np.array([[1.0, 2.0], [8.0, 2.0], [8.0, 6.0]])
    found = resampled(corners, count)
    assert all(np.isclose(found, corner).all(axis=1).any() for corner in corners)
    assert (np.isclose(found[:, 1], 2.0) | np.isclose(found[:, 0], 8.0)).all()
    gaps = np.hypot(*np.diff(found, axis=0).T)
    assert gaps.sum() == pytest.approx(11.0)
    even = max(count - 3, 2)
    assert gaps.max() <= 11.0 / (even - 1) + 1e-9
    # Both ends of the even points are corners; only the middle one is added.
    assert even <= len(found) <= max(count, 3)
