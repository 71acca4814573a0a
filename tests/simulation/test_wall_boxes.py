"""Rectangles cover every wall cell exactly once."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.simulation.floor import merged_rectangles, wall_boxes


@settings(max_examples=60, deadline=None)
@given(arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_every_cell_once(cells):
    count = np.zeros(cells.shape, dtype=int)
    for x0, y0, x1, y1 in merged_rectangles(cells).astype(int):
        count[y0:y1, x0:x1] += 1
    assert (count == cells).all()


def test_a_block_is_one_box_and_its_inside_is_left_out():
    cells = np.zeros((40, 40), dtype=bool)
    cells[5:35, 10:30] = True
    boxes = wall_boxes(OccupancyMap(cells, 0.1))
    # A frame of two cells: below, above, left, right.
    assert len(boxes) == 4
    assert np.allclose(boxes[:, :2].min(axis=0), [1.0, 0.5])
    assert np.allclose(boxes[:, 2:].max(axis=0), [3.0, 3.5])
    area = ((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])).sum()
    assert np.isclose(area, (30 * 20 - 26 * 16) * 0.01)
