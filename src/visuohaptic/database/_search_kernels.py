"""Distances between quantised and exact vectors: the time-critical part of the search."""

from __future__ import annotations

import numpy as np

from ..core.kernels import kernel

#: Number of rows whose minimum distance is kept: most segments cannot contain one of the few smallest.
SEGMENT = 256


@kernel
def _squared(level, at):
    difference = np.int16(np.int16(level) - at)
    return np.int16(difference * difference)


@kernel
def _add_eight(codes, features, query, j, sums):
    """Eight features at a time: the sums are read and written once, and eight memory accesses overlap."""
    a, b, c, d = codes[features[j]], codes[features[j + 1]], codes[features[j + 2]], codes[features[j + 3]]
    e, f, g, h = (
        codes[features[j + 4]],
        codes[features[j + 5]],
        codes[features[j + 6]],
        codes[features[j + 7]],
    )
    p, q, r, s = query[j], query[j + 1], query[j + 2], query[j + 3]
    t, u, v, w = query[j + 4], query[j + 5], query[j + 6], query[j + 7]
    for i in range(sums.shape[0]):
        one = np.int16(_squared(a[i], p) + _squared(b[i], q))
        two = np.int16(_squared(c[i], r) + _squared(d[i], s))
        three = np.int16(_squared(e[i], t) + _squared(f[i], u))
        four = np.int16(_squared(g[i], v) + _squared(h[i], w))
        sums[i] = np.int16(sums[i] + np.int16(np.int16(one + two) + np.int16(three + four)))


@kernel
def coarse_distances(codes, features, query, squared, lowest):
    """Squared distances of all quantised rows to a quantised query, in steps.

    Parameters
    ----------
    codes
        Blocks of rows, feature by feature, 0 to 63, uint8, shape (b, n, h).
    features
        Indices of the features known in the query, int64, shape (k,) with k a multiple of 8.
    query
        Their values, 0 to 63, int16, shape (k,).
    squared
        Squared distances, int32, shape (b, h); written.
    lowest
        Minimum of each segment of :data:`SEGMENT` rows, int32, shape (ceil(b h / SEGMENT),); written.
    """
    h = codes.shape[2]
    sums = np.zeros(h, np.int16)
    for block in range(codes.shape[0]):
        rows, out = codes[block], squared[block]
        for i in range(h):
            out[i] = np.int32(0)
        for start in range(
            0, len(features), 16
        ):  # this number of squares of at most 63 fits into unsigned 16 bits
            for i in range(h):
                sums[i] = np.int16(0)
            for j in range(start, min(start + 16, len(features)), 8):
                _add_eight(rows, features, query, j, sums)
            for i in range(h):
                out[i] = np.int32(out[i] + np.int32(np.uint16(sums[i])))
        for start in range(0, h, SEGMENT):
            low = out[start]
            for i in range(start, min(start + SEGMENT, h)):
                low = min(low, out[i])
            lowest[(block * h + start) // SEGMENT] = low


@kernel
def smallest(values, lowest, found):
    """Indices of the smallest values, ascending.

    Parameters
    ----------
    values
        Numbers, int32, shape (m,).
    lowest
        As in :func:`coarse_distances`.
    found
        Indices, int64, shape (k,) with k <= m; written.
    """
    count = 0
    for start in range(0, values.shape[0], SEGMENT):
        if count == found.shape[0] and lowest[start // SEGMENT] >= values[found[count - 1]]:
            continue
        for i in range(start, min(start + SEGMENT, values.shape[0])):
            if count < found.shape[0] or values[i] < values[found[count - 1]]:
                count = min(count + 1, found.shape[0])
                j = count - 1
                while j > 0 and values[found[j - 1]] > values[i]:
                    found[j] = found[j - 1]
                    j -= 1
                found[j] = i


@kernel
def within(squared, lowest, error, largest, reach, found):
    """Indices at which the root of a squared distance is at most ``reach`` plus the row's own error.

    Parameters
    ----------
    squared
        Int32, shape (m,).
    lowest
        As in :func:`coarse_distances`.
    error
        Quantisation error of each row, float32, shape (m,).
    largest
        Maximum error of each segment, float32, shape (ceil(m / SEGMENT),).
    reach
        In the unit of both, float.
    found
        Indices, int64, shape (m,); written.

    Returns
    -------
    int
        Number of indices found.
    """
    count = 0
    for start in range(0, squared.shape[0], SEGMENT):
        limit = largest[start // SEGMENT] + reach
        if lowest[start // SEGMENT] > limit * limit:
            continue
        for i in range(start, min(start + SEGMENT, squared.shape[0])):
            limit = error[i] + reach
            if squared[i] <= limit * limit:
                found[count] = i
                count += 1
    return count


@kernel
def exact_distances(vectors, rows, features, query, out):
    """Euclidean distances of selected rows to a query.

    Parameters
    ----------
    vectors
        All vectors, float64, shape (m, n).
    rows
        Indices of the rows, int64, shape (r,).
    features
        Indices of the features known in the query, int64, shape (k,).
    query
        Their values, float64, shape (k,).
    out
        Distances, float64, shape (r,); written.
    """
    for i in range(len(rows)):
        row = vectors[rows[i]]
        total = 0.0
        for j in range(len(features)):
            d = row[features[j]] - query[j]
            total += d * d
        out[i] = np.sqrt(total)
