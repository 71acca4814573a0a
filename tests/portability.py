"""Rules that find, in the text of a test, what holds on one machine only.

``float-equality``
    ``==``, ``!=`` or ``in`` with a float literal that is not a whole number, also inside a tuple, list or set:
    another compiler, BLAS or CPU rounds the last digits differently. ``round(x, digits) == 0.036`` is allowed,
    and so is a dictionary, which stands for a file that is read back.
``arithmetic-equality``
    ``==`` or ``!=`` in an assertion of a mean, norm, root or the like, whose last digits
    depend on the order of summation and on the library.
``wall-clock``
    An assertion on a difference of two clock readings. A deadline, ``clock() < end``, is allowed: it ends a
    test that would hang.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

CLOCKS = {"perf_counter", "process_time", "monotonic", "time", "time_s", "perf_counter_ns", "process_time_ns"}

#: Reductions and functions whose floating result depends on the order of summation or on the library.
ROUNDED = {
    "mean",
    "std",
    "var",
    "norm",
    "sqrt",
    "hypot",
    "sin",
    "cos",
    "exp",
    "log",
    "trapezoid",
    "det",
    "inv",
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One place that is not portable."""

    line: int
    rule: str
    text: str


def problems(code: str) -> list[Problem]:
    """All places of a module or block that break a rule, in the order of their lines."""
    tree = ast.parse(code)
    found = [
        Problem(node.lineno, rule, ast.unparse(node)[:160])
        for node in ast.walk(tree)
        for rule in _rules_broken(node)
    ]
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Module) and any(
            map(_is_clock, ast.walk(function))
        ):
            found += [Problem(n.lineno, "wall-clock", ast.unparse(n)[:160]) for n in _clock_asserts(function)]
    return sorted(set(found), key=lambda one: (one.line, one.rule))


def _rules_broken(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Compare) and all(
        isinstance(operator, ast.Eq | ast.NotEq | ast.In | ast.NotIn) for operator in node.ops
    ):
        sides = [node.left, *node.comparators]
        if any(map(_has_fraction, sides)) and not any(map(_is_rounded, sides)):
            yield "float-equality"
    if isinstance(node, ast.Assert):
        for compared in ast.walk(node.test):
            if isinstance(compared, ast.Compare) and isinstance(compared.ops[0], ast.Eq | ast.NotEq):
                sides = [compared.left, *compared.comparators]
                if any(map(_is_arithmetic, sides)) and not any(map(_is_tolerant, sides)):
                    yield "arithmetic-equality"


def _has_fraction(node: ast.expr) -> bool:
    """Whether it is a float literal that is not a whole number, or a sequence that holds one."""
    if isinstance(node, ast.UnaryOp):
        return _has_fraction(node.operand)
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        return any(map(_has_fraction, node.elts))
    return isinstance(node, ast.Constant) and isinstance(node.value, float) and not node.value.is_integer()


def _is_rounded(node: ast.expr) -> bool:
    return any(_called(part) == "round" for part in ast.walk(node))


def _is_tolerant(node: ast.expr) -> bool:
    return any(_called(part) in {"approx", "round", "len", "int"} for part in ast.walk(node))


def _is_arithmetic(node: ast.expr) -> bool:
    """Whether the value itself is a mean, a norm or the like."""
    if isinstance(node, ast.Call) and _called(node) in {"float", "abs"} and node.args:
        return _is_arithmetic(node.args[0])
    return _called(node) in ROUNDED


def _called(node: ast.AST) -> str:
    """Last name of what is called; empty when nothing is."""
    if not isinstance(node, ast.Call):
        return ""
    function = node.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _is_clock(node: ast.AST) -> bool:
    return _called(node) in CLOCKS and not node.args  # type: ignore[attr-defined]


def _clock_asserts(function: ast.AST) -> Iterator[ast.Assert]:
    """Assertions of a function that see a difference of clock readings, directly or by a name."""
    spans: set[str] = set()

    def is_span(node: ast.AST) -> bool:
        return any(
            (
                isinstance(part, ast.BinOp)
                and isinstance(part.op, ast.Sub)
                and any(map(_is_clock, ast.walk(part)))
            )
            or (isinstance(part, ast.Name) and part.id in spans)
            for part in ast.walk(node)
        )

    for node in ast.walk(function):  # breadth first: names are assigned before they are asserted on
        if isinstance(node, ast.Assign) and is_span(node.value):
            spans |= {
                part.id for target in node.targets for part in ast.walk(target) if isinstance(part, ast.Name)
            }
        if _called(node) == "append" and any(map(is_span, node.args)):  # type: ignore[attr-defined]
            spans |= {part.id for part in ast.walk(node.func) if isinstance(part, ast.Name)}  # type: ignore[attr-defined]
    for node in ast.walk(function):
        if isinstance(node, ast.Assert) and is_span(node.test):
            yield node
