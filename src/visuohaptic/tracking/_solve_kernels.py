"""Compiled kernels: damped normal equations of small problems, and the median of a few values."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ..core.kernels import kernel

#: Flags of kernels without infinities and without the checks of Python's division.
FAST = {"fastmath": True, "error_model": "numpy", "nogil": True}


@kernel(**FAST)
def solve_step(matrix, vector, active, damping, step):
    """Solve the damped system for the active unknowns by Cholesky; False if it is singular.

    ``step`` (m,) becomes ``-(M + damping diag M)^-1 v`` on the active unknowns, 0 elsewhere.

    Parameters
    ----------
    matrix, vector
        M (m, m) and v (m,).
    active
        Unknowns to solve for, (m,).
    damping
        Relative to the diagonal.
    step
        Filled with the solution, (m,).
    """
    n = 0
    which = np.zeros(len(active), np.int64)
    for k in range(len(active)):
        step[k] = 0.0
        if active[k]:
            which[n] = k
            n += 1
    lower = np.zeros((n, n))
    z = np.zeros(n)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[which[i], which[j]]
            if i == j:
                diagonal = total * (1.0 + damping)
                total = diagonal
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-10 * diagonal:
                    return False
                lower[i, i] = np.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
        total = -vector[which[i]]
        for k in range(i):
            total -= lower[i, k] * z[k]
        z[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = z[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * z[k]
        z[i] = total / lower[i, i]
        step[which[i]] = z[i]
    return True


@kernel(error_model="numpy", nogil=True)
def median(values, count, work):
    """Median of the first ``count`` > 0 values, by Hoare's selection: numba's own takes a second to compile.

    Parameters
    ----------
    values
        Numbers, (n,); not changed.
    count
        Number of values, 1 to n.
    work
        Overwritten, (n,).
    """
    for i in range(count):
        work[i] = values[i]
    middle, low, high = count // 2, 0, count - 1
    while low < high:
        pivot = work[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while work[i] < pivot:
                i += 1
            while work[j] > pivot:
                j -= 1
            if i <= j:
                work[i], work[j] = work[j], work[i]
                i += 1
                j -= 1
        # Now all values up to j are at most the pivot, and all from i on at least.
        low, high = (low, j) if middle <= j else ((i, high) if middle >= i else (middle, middle))
    if count % 2 == 1:
        return work[middle]
    below = work[0]
    for i in range(1, middle):
        below = max(below, work[i])
    return 0.5 * (below + work[middle])
