"""Kernels that only kernels call: they become part of their callers, and get no machine code of their own.

They have no entry for Python either. When Python calls such a kernel nevertheless, it is compiled again, with both.
Kernels in the list of signatures are called by Python, and are always compiled with both.

Numba alone links functions after LLVM has prepared them for a processor, here they are linked before: branches and the
order of instructions differ, results do not.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba import _dynfunc
from numba.core import sigutils
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.cpu import CPUContext
from numba.core.environment import lookup_environment
from numba.core.lowering import BaseLower
from numba.core.targetconfig import ConfigStack

_LISTED = Path(__file__).parents[1] / "kernel_signatures.txt"

#: The kernels that are being compiled, each on behalf of the one before it; numba compiles in one thread at a time.
_compiling: list[Any] = []


@contextlib.contextmanager
def compiling(dispatcher: Any, signature: Any) -> Iterator[None]:
    """Note that a kernel is compiled; if Python asks for it, code that is only for callers is forgotten.

    Parameters
    ----------
    dispatcher
        Numba's dispatcher of the kernel.
    signature
        Types of the arguments.
    """
    arguments = tuple(sigutils.normalize_signature(signature)[0])
    if (
        not _compiling
        and arguments in dispatcher.overloads
        and _is_part(dispatcher.overloads[arguments].library)
    ):
        del dispatcher.overloads[arguments]
    _compiling.append(dispatcher)
    try:
        yield
    finally:
        _compiling.pop()


def add_overload(dispatcher: Any, add: Callable[[CompileResult], None], result: CompileResult) -> None:
    """Numba's registration of a compiled signature: only what has an entry for Python becomes known to it.

    Parameters
    ----------
    dispatcher, add
        Numba's dispatcher of the kernel, and its own method.
    result
        Compilation result.
    """
    if _is_part(result.library):
        dispatcher.overloads[tuple(result.signature.args)] = result
    else:
        add(result)


def reduced(result: CompileResult) -> Any:
    """Numba's picklable form of a result; with empty machine code if it has none.

    Parameters
    ----------
    result
        Compilation result.
    """
    if not _is_part(result.library):
        return result._reduce()
    result.library._compiled_object = b""
    *state, _ = result._reduce()
    return (*state, ())  # its constants are given to its callers


def rebuilt(context: Any, state: Any) -> CompileResult | None:
    """A result from its picklable form; None if Python asks for a kernel that has no machine code.

    Parameters
    ----------
    context
        Numba's code generator.
    state
        As from :func:`reduced`.
    """
    is_part = state[0][2][0] == b""
    if is_part and len(_compiling) < 2:
        return None
    with _part() if is_part else contextlib.nullcontext():
        return CompileResult._rebuild(context, *state)


@contextlib.contextmanager
def _part() -> Iterator[None]:
    _loading.append(True)
    try:
        yield
    finally:
        _loading.pop()


_loading: list[bool] = []


def _is_part(library: Any) -> bool:
    return getattr(library, "is_part", False)


@functools.cache
def _listed() -> frozenset[str]:
    lines = _LISTED.read_text(encoding="utf-8").splitlines() if _LISTED.exists() else ()
    return frozenset(line.partition(" ")[0] for line in lines)


def _has_no_entry(function: Any) -> bool:
    """Whether a function is compiled on behalf of a kernel only, so that it needs no entry for Python."""
    if _loading:
        return True
    flags = ConfigStack.top_or_none()
    if flags is None or not _compiling:
        return False
    own = _compiling[-1].py_func
    name = f"{own.__module__}:{own.__qualname__}"
    is_own = (function.modname, function.qualname) == (own.__module__, own.__qualname__)
    return bool(flags.no_cpython_wrapper) or (len(_compiling) > 1 and is_own and name not in _listed())


def _create_entry(lowering: Any, release_gil: bool = False) -> None:
    if not _has_no_entry(lowering.fndesc):
        _entry(lowering, release_gil)


def _executable(context: Any, library: Any, function: Any, environment: Any) -> Any:
    """Numba's entry point of a function; without any machine code for one that has no entry for Python."""
    if _has_no_entry(function):
        library.is_part = True
        library._ensure_finalized()
        name = function.qualname.split(".")[-1]
        return _dynfunc.make_function(function.lookup_module(), name, name, 0, environment, (library,))
    entry = _get_executable(context, library, function, environment)
    for variable in library._final_module.global_variables:
        found = lookup_environment(variable.name) if variable.name.startswith("_ZN08NumbaEnv") else None
        if found is not None:
            library.codegen.set_env(variable.name, found)
    return entry


def _finalize(library: Any) -> None:
    if _is_part(library):
        library._finalize_dynamic_globals()
        library._finalized = True
    else:
        _finalize_module(library)


_entry, _get_executable = BaseLower.create_cpython_wrapper, CPUContext.get_executable
_finalize_module = CPUCodeLibrary._finalize_final_module

#: What numba does differently: class, name of the method, and method.
CHANGES: tuple[tuple[Any, str, Any], ...] = (
    (BaseLower, "create_cpython_wrapper", _create_entry),
    (CPUContext, "get_executable", _executable),
    (CPUCodeLibrary, "_finalize_final_module", _finalize),
)
