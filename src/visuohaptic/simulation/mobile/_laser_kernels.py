"""Ray casting in a grid of cells, exact to rounding."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel


@kernel
def cast(cells, start_row, start_column, directions, longest):
    """Length of every beam [cells] to the border of the first occupied cell; infinite without an echo.

    Parameters
    ----------
    cells
        1 occupied, 2 opaque without echo, 0 free (rows, columns).
    start_row, start_column
        Grid coordinates of the scanner; cell (i, j) covers i..i+1.
    directions
        Unit vectors (n, 2) as (row, column).
    longest
        Maximum length [cells].
    """
    rows, columns = cells.shape
    lengths = np.full(len(directions), np.inf)
    for beam in range(len(directions)):
        dr, dc = directions[beam, 0], directions[beam, 1]
        i, j = int(math.floor(start_row)), int(math.floor(start_column))
        step_i, step_j = (1 if dr > 0 else -1), (1 if dc > 0 else -1)
        per_i = abs(1.0 / dr) if dr != 0.0 else np.inf
        per_j = abs(1.0 / dc) if dc != 0.0 else np.inf
        next_i = (i + (1 if dr > 0 else 0) - start_row) / dr if dr != 0.0 else np.inf
        next_j = (j + (1 if dc > 0 else 0) - start_column) / dc if dc != 0.0 else np.inf
        length = 0.0
        while length <= longest and 0 <= i < rows and 0 <= j < columns:
            if cells[i, j] == 1:
                lengths[beam] = length
                break
            if cells[i, j] == 2:
                break
            if next_i < next_j:
                length = next_i
                next_i += per_i
                i += step_i
            else:
                length = next_j
                next_j += per_j
                j += step_j
    return lengths
