"""Compilation of kernels by numba: the same machine code with less work, a paused garbage collector, and a notice."""

from __future__ import annotations

import contextlib
import gc
import logging
import time
from collections.abc import Callable, MutableMapping
from typing import Any
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numba.core import errors, event
from numba.core.base import BaseContext as TargetContext
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import DEFAULT_FLAGS
from numba.core.compiler_lock import global_compiler_lock
from numba.core.event import Listener, register
from numba.core.ir import Assign, Expr
from numba.core.lowering import BaseLower
from numba.core.targetconfig import ConfigStack
from numba.core.typed_passes import NopythonRewrites
from numba.core.types import Array, Type
from numba.core.types.functions import BaseFunction
from numba.core.types.misc import StringLiteral, unliteral
from numba.core.typing.context import BaseContext as TypingContext
from numba.core.untyped_passes import InlineClosureLikes
from numba.np.ufunc.dufunc import DUFunc

from .callees import CHANGES, compiling

_log = logging.getLogger(__name__)


def _resolved_once(function: Any, context: Any, args: tuple[Type, ...], kws: dict[str, Type]) -> Any:
    """Numba's signature of a call to a library function or an operator, resolved once for the same types.

    For every ``+`` of two numbers, numba tries all templates of ``+`` again, and it hashes all options of the
    compiler for each; that is a quarter of the compilation time. The key contains the options that the
    implementations inherit from the calling kernel (``numba.core.cpu``): they are never shared beyond that.
    """
    options = ConfigStack.top_or_none()
    # No arithmetic of numbers with a fraction: one implementation for all options.
    allocates = options is not None and options.nrt and function.typing_key in _ALLOCATIONS
    inherited = options and not allocates and (
        options.nrt, frozenset(options.fastmath.flags), str(options.error_model), options.forceinline
    )  # fmt: skip
    key = function, context, tuple(args), tuple(kws.items()), inherited
    known = _resolved.get(key)
    if known is None:
        with ConfigStack().enter(DEFAULT_FLAGS) if allocates else contextlib.nullcontext():
            signature = _resolve(function, context, args, kws)
        known = _resolved[key] = signature, function.get_impl_key(signature)
    # As numba does after each search: the implementation of the latest call is the one that is used.
    function._impl_keys[known[0].args] = known[1]
    return known[0]


_resolved: dict[Any, tuple[Any, Any]] = {}
_ALLOCATIONS = (np.empty, np.zeros, np.ones, np.full)
_numba: Any = BaseFunction
_resolve = _numba.get_call_type


def _optimise_functions(library: Any, module: Any) -> None:
    """Numba's passes for each function, with one pass manager, and without the functions that are only declared.

    Numba builds the passes anew for every name in a module, of which seven in eight have no body.
    """
    module.data_layout = library._codegen._data_layout
    passes, builder = library._codegen._function_pass_manager()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)


def _refresh_changed(context: Any, refresh: Callable[[Any], None]) -> None:
    """Numba's search for new functions and types, if any was registered since; it searches before each compilation."""
    contexts = {context, getattr(context, "typing_context", context)}
    count = sum(
        len(items)
        for one in contexts
        for registry in one._registries
        for items in vars(registry).values()
        if isinstance(items, list)
    )
    if _registered.get(context) != count:
        refresh(context)
        _registered[context] = count


_registered: MutableMapping[Any, int] = WeakKeyDictionary()
_refresh_types, _refresh_code = TypingContext.refresh, TargetContext.refresh


def _expressions(state: Any) -> list[tuple[str, Expr]]:
    """(variable, its value) of each assignment of an expression in the function that is being compiled."""
    return [
        (one.target.name, one.value)
        for block in state.func_ir.blocks.values()
        for one in block.find_insts(Assign)
        if isinstance(one.value, Expr)
    ]


def _inline_nested(compiler_pass: Any, state: Any) -> bool:
    """Numba's inlining of nested functions, comprehensions, reductions and stencils, for functions that have any.

    For all others, numba analyses and copies the function without any change.
    """
    has_nested = not {"reduce", "stencil"}.isdisjoint(state.func_id.code.co_names) or any(
        value.op in ("make_function", "build_list") for _, value in _expressions(state)
    )
    return bool(has_nested and _inline(compiler_pass, state))


def _rewrite_arrays(compiler_pass: Any, state: Any) -> bool:
    """Numba's fusion of array expressions and reading of fields by name, for functions that have any of them."""

    def is_rewritten(target: str, value: Expr) -> bool:
        if value.op == "call":
            return isinstance(getattr(state.typemap[value.func.name], "typing_key", None), (np.ufunc, DUFunc))
        return value.op == "build_list" or (
            isinstance(state.typemap[target], Array) and value.op in ("unary", "binop")
        )

    has_any = any(isinstance(kind, StringLiteral) for kind in state.typemap.values()) or any(
        is_rewritten(*one) for one in _expressions(state)
    )
    return bool(has_any and _rewrite(compiler_pass, state))


_inline, _rewrite = InlineClosureLikes.run_pass, NopythonRewrites.run_pass


#: Minor version of numba whose other internals are replaced; with another one they are left as they are.
COMPARED = "0.68."
#: What numba does differently while a kernel of this library is compiled: class, name of the method, and method.
_CHANGES: tuple[tuple[Any, str, Any], ...] = ((BaseFunction, "get_call_type", _resolved_once),)
if numba.__version__.startswith(COMPARED):
    _CHANGES += (
        (CPUCodeLibrary, "_optimize_functions", _optimise_functions),
        (TypingContext, "refresh", lambda context: _refresh_changed(context, _refresh_types)),
        (TargetContext, "refresh", lambda context: _refresh_changed(context, _refresh_code)),
        # Entries for callers in C, of which there are none, also of numba's own functions.
        (BaseLower, "create_cfunc_wrapper", lambda lowering: None),
        (InlineClosureLikes, "run_pass", _inline_nested),
        (NopythonRewrites, "run_pass", _rewrite_arrays),
        # Timers that nobody reads, of each nested compilation: every call of LLVM notifies all of them.
        (event, "install_timer", lambda kind, callback: contextlib.nullcontext()),
    )
    _CHANGES += CHANGES
    if hasattr(errors, "HighlightColorScheme"):  # with colorama
        # Numba colours the messages of thousands of errors that it catches itself.
        _CHANGES += ((errors.HighlightColorScheme, "_markup", lambda scheme, text, *style, **more: text),)


def compile_kernel(dispatcher: Any, compiled: Callable[..., Any], signature: Any) -> Any:
    """Compile a kernel to the same machine code with less work; numba is as it was before and after.

    Parameters
    ----------
    dispatcher
        Numba's dispatcher of the kernel.
    compiled
        Its method that compiles.
    signature
        Types of the arguments.
    """
    with global_compiler_lock, compiling(dispatcher, signature):
        before = [getattr(owner, name) for owner, name, _ in _CHANGES]
        try:
            for owner, name, method in _CHANGES:
                setattr(owner, name, method)
            return compiled(signature)
        finally:
            for (owner, name, _), method in zip(_CHANGES, before, strict=True):
                setattr(owner, name, method)


def call_template(typed: Callable[..., Any], args: tuple[Type, ...], kws: dict[str, Type]) -> Any:
    """Numba's argument types of a call from another kernel, without literal values.

    Numba treats ``0`` in a variable's first assignment as a separate type, and would compile the callee for it alone.

    Parameters
    ----------
    typed
        Numba's method of the called kernel.
    args, kws
        Types of the arguments.
    """
    return typed(tuple(map(unliteral, args)), {name: unliteral(kind) for name, kind in kws.items()})


@Listener.register
class _Compilation:
    """Pauses the garbage collector during compilation, when it would traverse millions of compiler objects.

    It also measures the time, and logs once per process that the first run compiles. A process that finds its
    kernels in the cache compiles and logs nothing.
    """

    #: A delay of more than one second interrupts a person's flow of thought (Miller 1968); twice that is logged.
    WAIT_S = 2.0

    def __init__(self) -> None:
        self._depth, self._collecting = 0, False
        self._since_s, self.total_s = (0.0, 0.0), (0.0, 0.0)

    def notify(self, event: Any) -> None:
        """Handle the start, end or failure of a compilation, which may be nested: the time is that of the outermost."""
        if event.is_start and self._depth == 0:
            self._since_s, self._collecting = (time.thread_time(), time.monotonic()), gc.isenabled()
            gc.disable()
        self._depth += 1 if event.is_start else -1
        if self._depth != 0:
            return
        if self._collecting:
            gc.enable()
        before_s, ends_s = self.total_s, (time.thread_time(), time.monotonic())
        cpu_s, wall_s = (
            t + end - since for t, end, since in zip(before_s, ends_s, self._since_s, strict=True)
        )
        self.total_s = cpu_s, wall_s
        if before_s[1] < self.WAIT_S <= wall_s:
            _log.info(
                "compiling kernels, only once on this machine; `visuohaptic warmup` compiles all of them"
            )


_compilation = _Compilation()
register("numba:compile", _compilation)  # numba compiles in one thread at a time


def compiled_s() -> tuple[float, float]:
    """Time that this process has spent on the compilation of kernels: of the processor, and on the clock [s]."""
    return _compilation.total_s
