"""Calls of library functions are resolved once, with the same machine code, and never shared between options."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.caching import NullCache
from numba.core.types.functions import BaseFunction

from visuohaptic.core.kernels import KERNELS, compiler, kernel

VECTOR = types.Array(types.float64, 1, "C")


def _kernel(**options):
    """A new kernel, as a new process has it."""

    def smoothed(a):
        out = np.empty((len(a), 3))
        for i in range(len(a)):
            out[i, 0] = max(a[i - 1], a[i]) / 2.0
            out[i, 1] = min(a[i], 1.0) + a[i] * a[i]
            out[i, 2] = np.hypot(a[i], out[i, 1])
        return out

    made = kernel(**options)(smoothed)
    KERNELS.remove(made)
    made._cache = NullCache()
    return made


def _instructions(made) -> list[str]:
    """The machine instructions, without the names of symbols, which contain a running number."""
    (text,) = made.inspect_asm().values()
    return [line.split()[0] for line in text.splitlines() if line[:1] == "\t" and line[1:2] not in (".", "")]


def test_a_second_kernel_resolves_nothing_again(monkeypatch):
    _kernel().compile((VECTOR,))
    searched = []

    def resolve(function, *rest):
        searched.append(function)
        return original(function, *rest)

    original = compiler._resolve
    monkeypatch.setattr(compiler, "_resolve", resolve)
    _kernel().compile((VECTOR,))
    assert searched == []


def test_other_functions_are_compiled_by_numba_alone(monkeypatch):
    _kernel().compile((VECTOR,))
    assert BaseFunction.get_call_type is compiler._resolve
    for owner, name, method in compiler._CHANGES:
        assert vars(owner)[name] is not method
        assert vars(owner)[name].__module__.startswith("numba.")
    monkeypatch.setattr(compiler, "_resolved", {})
    numba.njit(lambda a: a[0] + a[1]).compile((VECTOR,))
    assert not compiler._resolved
    _kernel().compile((VECTOR,))
    assert compiler._resolved


def test_what_is_registered_later_is_found(monkeypatch):
    """Numba's lists of functions are read again when they have grown."""
    searched = []
    monkeypatch.setattr(compiler, "_refresh_types", searched.append)
    monkeypatch.setattr(compiler, "_registered", {})
    _kernel().compile((VECTOR,))
    assert len(searched) == 1
    _kernel().compile((VECTOR,))
    assert len(searched) == 1
    registry = next(iter(searched[0]._registries))
    monkeypatch.setattr(registry, "functions", [*registry.functions, None])
    _kernel().compile((VECTOR,))
    assert len(searched) == 2


def test_the_machine_code_is_that_of_numba_alone():
    _kernel().compile((VECTOR,))
    ours = _kernel()
    ours.compile((VECTOR,))
    plain = _kernel()
    del plain.compile
    plain.compile((VECTOR,))
    assert _instructions(ours) == _instructions(plain)
    assert len(_instructions(ours)) > 50


def _written_with_arrays(a, b):
    """What loops over scalars never need: expressions, a comprehension, a nested function, a list, a conversion."""

    def shifted(x):
        return x + b[0]

    doubled = np.sqrt(a * 2.0) + b
    steps = np.array([shifted(i) for i in range(3)])
    return (doubled - a).sum() + steps.sum() + np.array([1.0, a[0]]).sum()


def test_kernels_with_array_expressions_and_nested_functions_are_as_numba_makes_them():
    """The passes that are left out for kernels without them are done for these."""
    made, plain = kernel(_written_with_arrays), kernel(_written_with_arrays)
    for one in (made, plain):
        KERNELS.remove(one)
        one._cache = NullCache()
    made.compile((VECTOR, VECTOR))
    del plain.compile
    plain.compile((VECTOR, VECTOR))
    a, b = np.array([1.0, 4.0]), np.array([0.5, 2.0])
    assert made(a, b) == plain(a, b) == pytest.approx(_written_with_arrays(a, b), rel=1e-14)
    # The functions of numba that it calls are linked before they are prepared for machine code: branches differ.
    numbers = [name for name in _instructions(made) if name.endswith(("sd", "pd"))]
    assert sorted(numbers) == sorted(name for name in _instructions(plain) if name.endswith(("sd", "pd")))


def test_options_that_change_the_code_of_library_functions_are_distinguished(monkeypatch):
    """Fast mathematics before or after strict mathematics: each kernel is compiled as it is alone."""
    monkeypatch.setattr(compiler, "_resolved", {})
    alone, fast = _kernel(), _kernel(fastmath=True)
    alone.compile((VECTOR,))
    fast.compile((VECTOR,))
    monkeypatch.setattr(compiler, "_resolved", {})
    fast_first, second = _kernel(fastmath=True), _kernel()
    fast_first.compile((VECTOR,))
    second.compile((VECTOR,))
    assert _instructions(second) == _instructions(alone)
    assert _instructions(fast_first) == _instructions(fast)
    assert _instructions(fast) != _instructions(alone)
