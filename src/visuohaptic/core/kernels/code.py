"""Digest of everything that determines the machine code of a kernel.

The values are taken from memory rather than from the source text. This covers callees in other files,
imported or computed constants, and files edited while the process ran. A function that
uses anything else (an object, a function of a library not listed below) has no digest.
"""

from __future__ import annotations

import enum
import hashlib
import logging
from collections.abc import Iterator
from types import CodeType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.types import Type

_log = logging.getLogger(__name__)

#: Libraries whose functions a cached kernel may use: part of Python, or named in the folder's name.
_LIBRARIES = {"builtins", "cmath", "llvmlite", "math", "numba", "numpy", "operator", "_operator"}


def code_digest(dispatcher: Dispatcher) -> str | None:
    """Digest of everything that determines a kernel's machine code, except the types of its arguments.

    None if the kernel uses a value without an exact text representation, and must not be cached.

    Parameters
    ----------
    dispatcher
        Numba's dispatcher of the kernel.
    """
    try:
        return text_digest("\n".join(_ingredients(dispatcher, set())))
    except _NotPlainError as error:
        _log.debug("%s is not cached: %s", kernel_name(dispatcher), error)
        return None


class _NotPlainError(Exception):
    """A kernel uses a value without an exact text representation."""


def _ingredients(dispatcher: Dispatcher, seen: set[Dispatcher]) -> Iterator[str]:
    """Texts that together determine the machine code of a kernel; already visited kernels are only named."""
    yield kernel_name(dispatcher)
    if dispatcher in seen:
        return
    seen.add(dispatcher)
    yield from (f"{name}={_text(value)}" for name, value in sorted(dispatcher.targetoptions.items()))
    yield from _used(dispatcher.py_func, seen)


def _used(function: Any, seen: set[Dispatcher]) -> Iterator[str]:
    """Texts of a function's code, and of what it uses."""
    yield _text(function.__defaults__)
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    values = {**function.__globals__, **{name: cell.cell_contents for name, cell in cells}}
    for code in _codes(function.__code__):
        yield repr((code.co_code, code.co_exceptiontable, code.co_flags, code.co_argcount))
        yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))
        yield from (_text(value) for value in code.co_consts if not isinstance(value, CodeType))
        for name in (*code.co_names, *code.co_freevars):
            value = values.get(name)
            yield name
            if isinstance(value, Dispatcher):
                yield from _ingredients(value, seen)
            elif isinstance(value, _Intrinsic):  # it generates instructions instead of being compiled
                yield from _used(value._defn, seen)
            elif name in values:
                yield _text(value)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """The code of a function and of all functions and comprehensions inside it."""
    yield code
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _codes(value)


def _text(value: Any) -> str:
    """Exact text of a value that numba may compile into machine code as a constant."""
    kind = type(value).__name__
    if value is None or value is Ellipsis or isinstance(value, (bool, int, float, complex, str, bytes, Type)):
        return f"{kind} {value!r}"
    if isinstance(value, slice):
        return f"{kind} {_text((value.start, value.stop, value.step))}"
    if isinstance(value, (tuple, list)):
        return f"{kind} ({', '.join(map(_text, value))})"
    if isinstance(value, (set, frozenset, dict)):
        items = value.items() if isinstance(value, dict) else value
        return f"{kind} ({', '.join(sorted(map(_text, items)))})"
    if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
        layout = (value.dtype.descr, value.shape, value.strides)
        return f"{kind} {layout} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, type) and issubclass(value, enum.Enum):
        return f"{value.__qualname__} {_text([(one.name, one.value) for one in value])}"
    module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    if isinstance(value, np.ufunc):
        module = "numpy"
    name = getattr(value, "__qualname__", getattr(value, "__name__", None))
    if module is None or name is None or module.partition(".")[0] not in _LIBRARIES:
        raise _NotPlainError(f"it uses {value!r}")
    return f"{module}:{name}"


def kernel_name(dispatcher: Dispatcher) -> str:
    """Name of a kernel in file names.

    Parameters
    ----------
    dispatcher
        Numba's dispatcher of the kernel.
    """
    function = dispatcher.py_func
    return f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")


def text_digest(text: str) -> str:
    """Digest of a text, 32 hexadecimal digits.

    Parameters
    ----------
    text
        Any text.
    """
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:32]
