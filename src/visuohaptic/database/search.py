"""Exact nearest-neighbour search of feature vectors.

Every vector is stored twice: exactly, and quantised to 64 levels per feature. With x̂ for the quantised x, and q̂ for the
quantised query, the triangle inequality gives

    |q̂ - x̂| - |q - q̂| - |x - x̂|  <=  |q - x|,

so exact distances are needed only for vectors whose left side does not exceed an upper bound of the k-th smallest
distance: that of the k vectors with the smallest quantised distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from .database import ObjectDatabase

#: Levels of a quantised feature: squares of 16 differences fit into 16 bits (:func:`coarse_distances`).
_LEVELS = 64
#: Maximum number of features before the sums of squares overflow 32 bits.
MAX_FEATURES = (2**31 - 1) // (_LEVELS - 1) ** 2
#: Rows per block, whose 16-bit sums take half of the L1 cache (32 KB).
_BLOCK = 8192


@dataclass(frozen=True, slots=True)
class Match:
    """One of the nearest neighbours."""

    id: str
    distance: float  #: Euclidean, over the features known in the query


class FeatureIndex:
    """Exact search through 10^6 vectors in milliseconds; uses 9 bytes of memory per feature.

    Parameters
    ----------
    ids
        One id per vector.
    vectors
        Finite numbers, shape (m, n).

    Raises
    ------
    InputError
        The vectors are not finite, do not match the ids in number, or are too long.
    """

    def __init__(self, ids: Sequence[str], vectors: Float[np.ndarray, "m n"]) -> None:
        self._ids, self._vectors = list(ids), _checked(ids, vectors)
        from ._search_kernels import SEGMENT

        m, n = self._vectors.shape
        sample = self._vectors[:: max(1, m // 1000)]
        self._centre = np.median(sample, axis=0) if m else np.zeros(n)
        self._step = _best_step(sample - self._centre)
        rows = max(1, min(_BLOCK, m))
        blocks = -(-m // rows)
        self._codes = np.zeros((blocks, n + 1, rows), np.uint8)  # plus a padding feature that is 0 everywhere
        error = np.zeros(m, np.float32)  # in steps, like the sums
        parts = [slice(start, start + rows) for start in range(0, m, rows)]
        for part in parts:
            error[part] = _rounded(self._vectors[part] - self._centre, self._step)[1] / self._step
        # In the order of their errors: the largest error of a segment is then hardly more than the others.
        self._order = np.argsort(error, kind="stable")
        self._error = error[self._order]
        self._largest_error = self._error[np.minimum(np.arange(SEGMENT - 1, m + SEGMENT - 1, SEGMENT), m - 1)]
        for block, part in enumerate(parts):
            code, _ = _rounded(self._vectors[self._order[part]] - self._centre, self._step)
            self._codes[block, :n, : len(code)] = code.T
        self._squared = np.empty((blocks, rows), np.int32)
        self._lowest = np.empty(-(-self._squared.size // SEGMENT), np.int32)

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def bytes(self) -> int:
        """Memory of the vectors and of the index."""
        return sum(array.nbytes for array in (self._vectors, self._codes, self._error, self._squared))

    def nearest(self, query: Float[np.ndarray, "n"], count: int = 1) -> list[Match]:
        """The nearest vectors, nearest first; ties are ordered by id.

        Parameters
        ----------
        query
            Feature vector, shape (n,); NaN if unknown.
        count
            Number of neighbours.

        Raises
        ------
        InputError
            The query has another length or no finite value, or ``count`` is less than 1.
        """
        q = _query(query, self._vectors.shape[1], count)
        m = len(self._ids)
        if m == 0:
            return []
        from ._search_kernels import coarse_distances, smallest, within

        known = np.flatnonzero(~np.isnan(q))
        code, error = _rounded(q[None, known] - self._centre[known], self._step)
        eights = len(known) + -len(known) % 8
        features, levels = np.full(eights, len(q)), np.zeros(eights, np.int16)
        features[: len(known)], levels[: len(known)] = known, code[0]
        coarse_distances(self._codes, features, levels, self._squared, self._lowest)
        squared = self._squared.ravel()[:m]
        first = np.empty(min(count, m), np.int64)
        smallest(squared, self._lowest, first)
        reach = (self._distances(self._order[first], known, q).max() + float(error[0])) / self._step
        near = np.empty(m, np.int64)
        # A small allowance for rounding of these sums and of the 32-bit errors.
        reach = reach * (1 + 1e-6) + 1e-5
        near = near[: within(squared, self._lowest, self._error, self._largest_error, reach, near)]
        near = self._order[near]
        distance = self._distances(near, known, q)
        order = np.lexsort((near, distance))[:count]
        return [Match(self._ids[near[i]], float(distance[i])) for i in order]

    def _distances(self, rows: np.ndarray, known: np.ndarray, q: np.ndarray) -> Float[np.ndarray, "rows"]:
        from ._search_kernels import exact_distances

        out = np.empty(len(rows))
        exact_distances(self._vectors, rows, known, q[known], out)
        return out


def index_of(database: ObjectDatabase, kind: str) -> FeatureIndex:
    """Index of the features of one kind, of all objects in a database.

    Parameters
    ----------
    database
        The database.
    kind
        Kind of the features, the key in :attr:`.VisuoHapticObject.features`.
    """
    return FeatureIndex(*database.features(kind))


def _rounded(offset: Float[np.ndarray, "rows n"], step: float) -> tuple[np.ndarray, np.ndarray]:
    """Quantised offsets from the centre, and the distance between each row and its quantised version."""
    middle = (_LEVELS - 1) / 2
    code = np.clip(np.rint(offset / step + middle), 0, _LEVELS - 1)
    return code.astype(np.uint8), np.linalg.norm(offset - (code - middle) * step, axis=1)


def _best_step(offset: Float[np.ndarray, "rows n"]) -> float:
    """Step with the smallest quantisation error: small steps clip, large ones are coarse."""
    widest = float(np.abs(offset).max(initial=0.0))
    if widest == 0.0:
        return 1.0
    # From the step without clipping down to one that clips all but the rarest values.
    steps = 2 * widest / (_LEVELS - 1) * 2.0 ** -np.arange(0, 16, 0.25)
    return float(steps[np.argmin([_rounded(offset, step)[1].mean() for step in steps])])


def _checked(ids: Sequence[str], vectors: np.ndarray) -> Float[np.ndarray, "m n"]:
    vectors = np.ascontiguousarray(vectors, dtype=float)
    if (
        vectors.ndim != 2
        or len(vectors) != len(ids)
        or vectors.shape[1] > MAX_FEATURES
        or not np.isfinite(vectors).all()
    ):
        raise InputError(
            "vectors",
            f"found shape {vectors.shape} for {len(ids)} ids, expected one row of at most {MAX_FEATURES} "
            "finite numbers for each",
        )
    return vectors


def _query(query: np.ndarray, n: int, count: int) -> Float[np.ndarray, "n"]:
    q = np.asarray(query, dtype=float)
    if (q.shape != (n,) and n) or np.isinf(q).any() or (n and np.isnan(q).all()):
        raise InputError(
            "query", f"found shape {q.shape}, expected {n} numbers, NaN where not known, not all NaN"
        )
    if count < 1:
        raise InputError("count", f"found {count}, expected 1 or more")
    return q
