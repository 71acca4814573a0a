"""Distances between bytes: the fast part of the search."""

from __future__ import annotations

import numpy as np

from ..core.kernels import kernel

__all__ = ["byte_distances"]


@kernel(boundscheck=False)
def byte_distances(rows, query, known, out):
    """Squared distances of int8 rows (m, n) to an int16 query (n) into int32 ``out`` (m), where ``known`` is 1.

    All in 32 bits: wider numbers would halve what the processor does at a time. n <= 8000 cannot overflow.

    Parameters
    ----------
    rows
        Quantised vectors, int8, shape (m, n).
    query
        Quantised query, int16, shape (n,).
    known
        1 where the query is known, else 0, int16, shape (n,).
    out
        Squared distances, int32, shape (m,); written.
    """
    n = query.shape[0]
    for i in range(rows.shape[0]):
        total = np.int32(0)
        for j in range(n):
            d = np.int32((np.int32(rows[i, j]) - np.int32(query[j])) * np.int32(known[j]))
            total = np.int32(total + np.int32(d * d))
        out[i] = total
