"""Length, travel cost and clearance of a path over cells, and growth of arrays."""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel


@kernel(error_model="numpy")
def longer(array: np.ndarray) -> np.ndarray:
    """The same array with doubled capacity.

    Parameters
    ----------
    array
        Values (n,).
    """
    larger = np.empty(2 * len(array) + 16, array.dtype)
    for k in range(len(array)):
        larger[k] = array[k]
    return larger


@kernel(error_model="numpy")
def longer_rows(array: np.ndarray) -> np.ndarray:
    """The same table with doubled capacity.

    Parameters
    ----------
    array
        Values (n, m).
    """
    larger = np.empty((2 * len(array) + 16, array.shape[1]), array.dtype)
    for k in range(len(array)):
        for column in range(array.shape[1]):
            larger[k, column] = array[k, column]
    return larger


@kernel(error_model="numpy")
def cost(distance: float, speeds: np.ndarray) -> float:
    """Travel cost at a clearance, Eq. (4.1) [s/m].

    Parameters
    ----------
    distance
        Clearance [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    fraction = min(max((distance / speeds[0] - 1.0) / 2.0, 0.0), 1.0)
    return speeds[1] + fraction * (speeds[2] - speeds[1])


@kernel(error_model="numpy")
def measure(
    path: np.ndarray,
    begin: int,
    end: int,
    distance: np.ndarray,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[float, float, float]:
    """Length [m], cost [s] and clearance [m] of path cells ``begin..end - 1``.

    Parameters
    ----------
    path
        Cells (flat).
    begin, end
        First and past-the-last index in ``path``.
    distance
        Clearance of each cell [m], (rows, columns) float32.
    resolution_m
        Edge length of a cell [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    columns = distance.shape[1]
    flat = distance.ravel()
    straight, diagonal = 0, 0
    total = 0.0
    before = cost(flat[path[begin]], speeds)
    clearance = float(flat[path[begin]])
    for k in range(begin + 1, end):
        a, b = path[k - 1], path[k]
        here = cost(flat[b], speeds)
        clearance = min(clearance, float(flat[b]))
        if a // columns != b // columns and a % columns != b % columns:
            diagonal += 1
            total += math.sqrt(2.0) * (before + here)
        else:
            straight += 1
            total += before + here
        before = here
    return (straight + math.sqrt(2.0) * diagonal) * resolution_m, 0.5 * total * resolution_m, clearance
