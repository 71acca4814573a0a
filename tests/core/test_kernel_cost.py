"""No kernel uses what costs seconds to compile; the costs are in ``docs/architecture.md``.

The typed form of every kernel is read, as numba has it before it makes machine code: the text does not tell an array
from a number. Loops over scalars say the same, run as fast, and cost a tenth.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator

import numpy as np
import pytest
from numba.core import ir, types
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags, compile_extra
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.typed_passes import NopythonTypeInference

import visuohaptic
from visuohaptic.cli._compilation import read_signatures
from visuohaptic.core import KERNELS, kernel
from visuohaptic.core.kernels.compiler import compile_kernel

#: What may be done with a whole array: these read or set its header, or copy memory in one piece.
CHEAP = {"copy", "empty_like", "len", "ravel", "reshape", "zeros_like"}

#: Each argument is unpacked and checked in code of its own: 9 ms for an array.
MAX_ARGUMENTS = 20

#: Parts of the list of signatures that are looked at together.
PACKAGES = sorted({".".join(module.split(".")[:3]) for module in read_signatures()})


class _Typed(Exception):
    """Carries the typed form out of the compiler."""


@register_pass(mutates_CFG=False, analysis_only=True)
class _StopHere(FunctionPass):
    _name = "visuohaptic_stop_here"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state) -> bool:
        raise _Typed(state.func_ir, state.typemap)


class _TypesOnly(CompilerBase):
    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_untyped_pipeline(self.state)
        passes.add_pass(NopythonTypeInference, "types")
        passes.add_pass(_StopHere, "stop")
        passes.finalize()
        return [passes]


def costs(dispatcher, arguments) -> list[str]:
    """What a kernel does with these types that is slow to compile, each with its line."""
    flags = Flags()
    dispatcher.targetdescr.options.parse_as_flags(flags, dispatcher.targetoptions)
    context = dispatcher.typingctx, dispatcher.targetctx

    def typed(arguments):
        compile_extra(*context, dispatcher.py_func, arguments, None, flags, {}, pipeline_class=_TypesOnly)

    with pytest.raises(_Typed) as caught:
        compile_kernel(dispatcher, typed, arguments)
    form, kinds = caught.value.args
    found = {
        f"line {statement.loc.line}: {cost}"
        for block in form.blocks.values()
        for statement in block.body
        for cost in _statement_costs(statement, kinds)
    }
    if len(arguments) > MAX_ARGUMENTS:
        found.add(f"{len(arguments)} arguments, expected at most {MAX_ARGUMENTS}")
    return sorted(found)


def _statement_costs(statement, kinds) -> Iterator[str]:
    def is_array(variable) -> bool:
        return isinstance(kinds[variable.name], types.Array)

    if isinstance(statement, (ir.SetItem, ir.StaticSetItem)):
        if is_array(statement.value):
            yield "an array is assigned to a part of another"
    elif isinstance(statement, (ir.DynamicRaise, ir.DynamicTryRaise)):
        yield "the text of an error is put together"
    expression = statement.value if isinstance(statement, ir.Assign) else None
    if not isinstance(expression, ir.Expr):
        return
    if expression.op in ("binop", "inplace_binop", "unary"):
        if any(map(is_array, expression.list_vars())):
            yield f"{expression.fn.__name__} of whole arrays"
    elif expression.op == "build_string":
        yield "a text is put together"
    elif expression.op == "call":
        function = kinds[expression.func.name]
        given = [kinds[variable.name] for variable in expression.args]
        # A method of an array; or a function that takes arrays, or lists of numbers.
        if isinstance(function, types.BoundFunction):
            name = str(function.typing_key).rpartition(".")[2].strip("')")
        elif not isinstance(function, types.Function) or isinstance(function.typing_key, _Intrinsic):
            return  # a kernel; or instructions as they are, which have no types to be found
        elif any(isinstance(kind, (types.Array, types.List)) for kind in given):
            name = getattr(function.typing_key, "__name__", str(function.typing_key))
        else:
            return
        if name not in CHEAP:
            yield f"{name}() of a whole array or list"


def _kernels(package: str) -> Iterator[tuple[object, tuple[object, ...]]]:
    """Every kernel of a package and the types it is compiled for, with what these call; compiled or loaded."""
    for module, signatures in read_signatures().items():
        if (module + ".").startswith(package + "."):
            for function, arguments in signatures:
                getattr(importlib.import_module(module), function).compile(arguments)
    done: set[tuple[object, object]] = set()
    while todo := [
        (one, arguments)
        for one in KERNELS
        if (one.py_func.__module__ + ".").startswith(package + ".")
        for arguments in one.overloads
        if (one, arguments) not in done
    ]:
        done.update(todo)
        yield from todo  # their callees are loaded while they are looked at


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_no_kernel_is_slow_to_compile(package):
    found = [
        f"{dispatcher.py_func.__module__}:{dispatcher.py_func.__name__} {cost}"
        for dispatcher, arguments in _kernels(package)
        for cost in costs(dispatcher, arguments)
    ]
    assert not found, "write a loop over scalars instead:\n" + "\n".join(dict.fromkeys(found))


def test_every_kernel_can_be_reached_from_the_list():
    """A kernel that the list does not reach is compiled in the middle of somebody's run: see ``PARTS`` there."""
    listed = {
        (module, function) for module, signatures in read_signatures().items() for function, _ in signatures
    }
    for module in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    reached, todo = (
        set(),
        [one for one in KERNELS if (one.py_func.__module__, one.py_func.__name__) in listed],
    )
    while todo:
        one = todo.pop()
        if one not in reached:
            reached.add(one)
            used = inspect.getclosurevars(one.py_func)
            todo += [value for value in used.globals.values() if isinstance(value, Dispatcher)]
    # Peers and twins that other tests of this process have imported are none of the library's.
    own = [one for one in KERNELS if one.py_func.__module__.startswith("visuohaptic.")]
    assert not [f"{one.py_func.__module__}:{one.py_func.__name__}" for one in own if one not in reached]


def _made(function):
    dispatcher = kernel(function)
    KERNELS.remove(dispatcher)
    return dispatcher


def _copies(a, b):
    a[:] = b


def _adds(a, b):
    return a + b[0]


def _accumulates(a, b):
    a *= b


def _sorts(a, b):
    return np.sort(a)[0]


def _orders(a, b):
    return a.argsort()[0]


def _middle(a, b):
    return np.median(a)


def _sums(a, b):
    return a.sum() + b[0]


def _multiplies(a, b):
    return a @ b


def _literal(a, b):
    return np.array([a[0], b[0]])[0]


def _solves(a, b):
    return np.linalg.norm(a)


def _complains(a, b):
    if len(a) != len(b):
        raise ValueError(f"found {len(a)}")


def _loops(a, b):
    total, spare = 0.0, np.empty_like(a)
    row = b[1:]
    for i in range(len(row)):
        spare[i] = a[i] * row[i]
        total += max(spare[i], np.sqrt(abs(row[i])))
    spare[:] = 0.0
    return total


@pytest.mark.parametrize(
    ("function", "cost"),
    [
        (_copies, "assigned"), (_adds, "add"), (_accumulates, "mul"), (_sorts, "sort"), (_orders, "argsort"),
        (_middle, "median"), (_sums, "sum"), (_multiplies, "matmul"), (_literal, "array"), (_solves, "norm"),
        (_complains, "text"),
    ],
)  # fmt: skip
def test_it_refuses(function, cost):
    vector = types.Array(types.float64, 1, "C")
    (found,) = costs(_made(function), (vector, vector))
    assert cost in found


def test_it_accepts_loops():
    vector = types.Array(types.float64, 1, "C")
    assert costs(_made(_loops), (vector, vector)) == []


def test_it_counts_arguments():
    many = _made(lambda a, b, c, d, e, f, g, h, i, j, k, m, n, o, p, q, r, s, t, u, v: a)
    assert costs(many, (types.float64,) * (MAX_ARGUMENTS + 1)) == ["21 arguments, expected at most 20"]
