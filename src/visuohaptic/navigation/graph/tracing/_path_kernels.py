"""Growth of arrays in kernels."""

from __future__ import annotations

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
