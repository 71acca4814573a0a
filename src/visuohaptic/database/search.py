"""The nearest feature vectors, exactly.

Every vector is kept twice: as it is, and rounded to one byte a feature. With x̂ for the rounded x, and q̂ for the
rounded query, the triangle inequality gives

    |q̂ - x̂| - |q - q̂| - |x - x̂|  <=  |q - x|  <=  |q̂ - x̂| + |q - q̂| + |x - x̂|,

so the bytes decide on almost all vectors, and only those that may be among the k nearest are compared in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from .database import ObjectDatabase

__all__ = ["ByteIndex", "FeatureIndex", "Match", "PlainIndex", "index_of"]

#: Vectors may have so many features before the byte distances overflow.
MAX_FEATURES = 8000


@dataclass(frozen=True, slots=True)
class Match:
    """One of the nearest."""

    id: str
    distance: float  #: Euclidean, over the features that the query knows


class FeatureIndex(Protocol):
    """What a search offers, whatever is below it."""

    def nearest(self, query: Float[np.ndarray, "n"], count: int = 1) -> list[Match]:
        """The nearest vectors, nearest first.

        Parameters
        ----------
        query
            Feature vector, shape (n,); NaN where it is not known.
        count
            How many.
        """


class PlainIndex(FeatureIndex):
    """Every vector compared in full: the reference, and good enough for some thousands.

    Parameters
    ----------
    ids
        Id of each vector.
    vectors
        Finite numbers, shape (m, n).
    """

    def __init__(self, ids: Sequence[str], vectors: Float[np.ndarray, "m n"]) -> None:
        self._ids, self._vectors = list(ids), _checked(ids, vectors)

    def __len__(self) -> int:
        return len(self._ids)

    def nearest(self, query: Float[np.ndarray, "n"], count: int = 1) -> list[Match]:
        """The nearest vectors, nearest first; see :class:`FeatureIndex`."""
        q, known = _query(query, self._vectors.shape[1], count)
        if not self._ids:
            return []
        return _best(self._ids, self._vectors, np.arange(len(self._ids)), q, known, count)


class ByteIndex(FeatureIndex):
    """Exact search through 10^5 vectors in milliseconds; memory for 9 bytes a feature.

    Parameters
    ----------
    ids
        One for each vector.
    vectors
        Finite numbers.
    """

    def __init__(self, ids: Sequence[str], vectors: Float[np.ndarray, "m n"]) -> None:
        self._ids, self._vectors = list(ids), _checked(ids, vectors)
        m, n = self._vectors.shape
        if n > MAX_FEATURES:
            raise InputError("ByteIndex", f"found {n} features, expected at most {MAX_FEATURES}")
        self._centre = np.median(self._vectors, axis=0) if m else np.zeros(n)
        # Rare large values are clipped, which costs their rows precision and no one else.
        width = float(np.quantile(np.abs(self._vectors - self._centre), 0.9999)) if m and n else 0.0
        self._step = width / 127 if width > 0 else 1.0
        self._bytes = np.empty((m, n), np.int8)
        self._error = np.empty(m)
        for start in range(0, m, 4096):
            part = slice(start, start + 4096)
            offset = self._vectors[part] - self._centre
            self._bytes[part] = np.clip(np.rint(offset / self._step), -127, 127)
            self._error[part] = np.linalg.norm(offset - self._bytes[part] * self._step, axis=1)
        self._squared = np.empty(m, np.int32)

    def __len__(self) -> int:
        return len(self._ids)

    def nearest(self, query: Float[np.ndarray, "n"], count: int = 1) -> list[Match]:
        """The nearest vectors, nearest first; see :class:`FeatureIndex`."""
        q, known = _query(query, self._vectors.shape[1], count)
        m = len(self._ids)
        if m == 0:
            return []
        count = min(count, m)
        from ._search_kernels import byte_distances

        offset = np.where(known, q - self._centre, 0.0)
        rounded = np.clip(np.rint(offset / self._step), -381, 381).astype(np.int16)
        slack = self._error + np.linalg.norm(offset - rounded * self._step)
        byte_distances(self._bytes, rounded, known.astype(np.int16), self._squared)
        about = np.sqrt(self._squared) * self._step
        reach = np.partition(about + slack, count - 1)[count - 1]
        # A little more, for the rounding of these sums themselves.
        near = np.flatnonzero(about - slack <= reach * (1 + 1e-9) + 1e-12)
        return _best(self._ids, self._vectors, near, q, known, count)


def index_of(database: ObjectDatabase, kind: str) -> ByteIndex:
    """Index over the features of one kind of all objects in a database.

    Parameters
    ----------
    database
        The database.
    kind
        Kind of the features, the key in :attr:`.VisuoHapticObject.features`.
    """
    ids, vectors, _ = database.features(kind)
    return ByteIndex(ids, vectors)


def _best(
    ids: Sequence[str],
    vectors: Float[np.ndarray, "m n"],
    near: np.ndarray,
    q: Float[np.ndarray, "n"],
    known: np.ndarray,
    count: int,
) -> list[Match]:
    distance = np.empty(len(near))
    for start in range(0, len(near), 4096):  # in blocks that stay in the cache
        part = near[start : start + 4096]
        distance[start : start + 4096] = np.linalg.norm(
            np.where(known, vectors[part] - np.where(known, q, 0.0), 0.0), axis=1
        )
    if count < len(near):
        limit = np.partition(distance, count - 1)[count - 1]
        keep = distance <= limit
        near, distance = near[keep], distance[keep]
    # At equal distances by place, so that the answer is always the same.
    order = np.lexsort((near, distance))[:count]
    return [Match(ids[near[i]], float(distance[i])) for i in order]


def _checked(ids: Sequence[str], vectors: np.ndarray) -> Float[np.ndarray, "m n"]:
    vectors = np.ascontiguousarray(vectors, dtype=float)
    if vectors.ndim != 2 or len(vectors) != len(ids) or not np.isfinite(vectors).all():
        raise InputError(
            "vectors",
            f"found shape {vectors.shape} for {len(ids)} ids, expected one row of finite numbers for each",
        )
    return vectors


def _query(query: np.ndarray, n: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    q = np.asarray(query, dtype=float)
    if (q.shape != (n,) and n) or np.isinf(q).any() or (n and np.isnan(q).all()):
        raise InputError(
            "query", f"found shape {q.shape}, expected {n} numbers, NaN where not known, not all NaN"
        )
    if count < 1:
        raise InputError("count", f"found {count}, expected 1 or more")
    return q, ~np.isnan(q)
