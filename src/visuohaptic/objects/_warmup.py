"""Loads or compiles the kernel of the search."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """One search of two vectors, through the door that everybody takes."""
    from .search import ByteIndex

    ByteIndex(["a", "b"], np.eye(2)).nearest(np.zeros(2))
