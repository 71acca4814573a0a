"""Kernels that only kernels call have no machine code of their own; whatever calls them finds the same results."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core import types

from visuohaptic.core.kernels import KERNELS, callees, kernel
from visuohaptic.core.kernels.cache import cache_folder
from visuohaptic.core.kernels.compiler import COMPARED

pytestmark = pytest.mark.skipif(
    not __import__("numba").__version__.startswith(COMPARED), reason="numba compiles callees by itself"
)


def _pair():
    """A kernel and one that it calls, as a new process has them."""

    @kernel
    def inner(x):
        if x < 0.0:
            raise ValueError("negative")
        return np.sqrt(x) * 3.0

    @kernel
    def outer(a):
        total = 0.0
        for i in range(len(a)):
            total += inner(a[i])
        return total

    for one in (inner, outer):
        KERNELS.remove(one)
    return inner, outer


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(tmp_path))
    return cache_folder()


def _is_part(made) -> bool:
    (result,) = made.overloads.values()
    return callees._is_part(result.library)


def test_a_callee_is_completed_when_python_calls_it(folder):
    inner, outer = _pair()
    assert outer(np.array([4.0, 9.0])) == 15.0
    assert _is_part(inner)
    assert not _is_part(outer)
    assert inner(4.0) == 6.0
    assert not _is_part(inner)
    assert outer(np.array([4.0])) == inner(4.0)
    with pytest.raises(ValueError, match="negative"):
        inner(-1.0)


def test_an_error_in_a_callee_reaches_python(folder):
    _, outer = _pair()
    with pytest.raises(ValueError, match="negative"):
        outer(np.array([4.0, -1.0]))
    _, outer = _pair()  # from the cache
    with pytest.raises(ValueError, match="negative"):
        outer(np.array([4.0, -1.0]))


def test_a_kept_callee_serves_another_caller_and_is_replaced_for_python(folder):
    inner, outer = _pair()
    outer(np.ones(1))
    sizes = {path.name: path.stat().st_size for path in folder.iterdir()}
    assert len(sizes) == 2
    inner, _ = _pair()

    @kernel
    def another(x):
        return inner(x) + 1.0

    KERNELS.remove(another)
    assert another(4.0) == 7.0
    assert sum(inner._cache_hits.values()) == 1
    assert _is_part(inner)
    inner, _ = _pair()
    assert inner(4.0) == 6.0
    assert sum(inner._cache_misses.values()) == 1  # what is kept has no machine code
    inner, outer = _pair()
    assert inner(4.0) == 6.0
    assert sum(inner._cache_hits.values()) == 1
    assert not _is_part(inner)


def test_a_kernel_in_the_list_is_always_complete(folder, monkeypatch):
    inner, outer = _pair()
    name = f"{inner.py_func.__module__}:{inner.py_func.__qualname__}"
    monkeypatch.setattr(callees, "_listed", lambda: {name})
    outer.compile((types.Array(types.float64, 1, "C"),))
    assert not _is_part(inner)
    assert inner(4.0) == 6.0
