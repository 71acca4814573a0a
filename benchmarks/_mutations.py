"""Typical programming mistakes, applied to the syntax tree of a module one at a time.

Operators: the boundary of a comparison is included or excluded, or the comparison is inverted; ``+ -``, ``* /``, ``and or`` and
similar pairs are exchanged; ``not`` is removed; True becomes False; an integer is incremented, from 8 on multiplied by 1.25 as
a float is; a call whose result is not used is removed. Texts are not changed: messages of errors and logs, strings, annotations,
decorators, ``__all__``. Neither are compiled functions, which are tested against plain twins.

Some changes are no mistakes, because no correct test can tell them from the original. :attr:`Mutation.rule` names the rule:

- *boundary*: of ``<`` and ``<=`` between real numbers of which one is computed: they are never equal. Not where the comparison
  decides a refusal, which names its limit.
- *guard*: a positive number of at most 1e-9 that prevents a division by zero or a logarithm of it.
- *budget*: a constant in bytes, or of a BLOCK or CHUNK of work; a limit of memory a quarter higher is as good.
- *look*: sizes, colours, limits and grids of a figure, and to how many digits a number is rounded.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from .house import is_compiled

__all__ = ["Mutation", "mutate", "mutations"]

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_TURNED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
}
_COUNTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
#: Fields of a node that no test can observe, or that are texts.
_SILENT = {"annotation", "returns", "decorator_list", "type_params", "type_comment"}
#: Integers from here on are amounts: one more changes them by less than the fifth that a constant is tested for.
_COUNTED_UP = 8
_GUARD = 1e-9
_BYTES = re.compile(r"_BYTES$|(^|_)(BLOCK|CHUNK)(_|$)")
_UNIT = re.compile(r"_(m|mm|s|rad|N|Pa|kg|J|px|Nm|mL|g|deg|Hz)\d?$|_per_")
#: Calls and arguments that only decide how a figure looks.
_LOOKS = {"alpha", "figsize", "fontsize", "linewidth", "lw", "markersize", "ms", "zorder", "dpi"}
_LOOKS |= {
    "grid",
    "legend",
    "set_xlim",
    "set_ylim",
    "tight_layout",
    "subplots_adjust",
    "tick_params",
    "set_aspect",
}
_WORDS = ("_log", "logging", "warnings", "typing", "__")


@dataclass(frozen=True, slots=True)
class Mutation:
    """One mistake."""

    line: int
    statement: int  #: line of the statement that it is in, as coverage tells it
    function: str  #: empty at the level of the module
    title: str  #: before and after
    rule: str = ""  #: by which it is no mistake


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a statement is."""

    statement: int = 0
    function: str = ""
    inside: str = ""  #: what it is part of: "refusal", "budget" or "look"


_Site = tuple[Mutation, Callable[[], None]]


def mutations(tree: ast.Module) -> list[Mutation]:
    """All mistakes of a module, in the order of its text; ``tree`` is not changed.

    Parameters
    ----------
    tree
        The module.
    """
    return [found for found, _ in _sites(tree, _Place())]


def mutate(tree: ast.Module, number: int) -> ast.Module:
    """The module with one mistake; changes ``tree``.

    Parameters
    ----------
    tree
        The module.
    number
        Place in what :func:`mutations` lists.
    """
    list(_sites(tree, _Place()))[number][1]()
    return ast.fix_missing_locations(tree)


def _sites(node: ast.AST, place: _Place) -> Iterator[_Site]:
    if _is_silent(node):
        return
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        place = _Place(node.lineno, node.name)
    elif isinstance(node, ast.stmt):
        place = _Place(node.lineno, place.function, _part(node))
    yield from _of(node, place)
    for name, value in ast.iter_fields(node):
        if name in _SILENT:
            continue
        # Default values are evaluated when the module is imported.
        here = _Place(place.statement) if isinstance(node, ast.arguments) else place
        if isinstance(node, ast.keyword) and node.arg in _LOOKS:
            here = _Place(place.statement, place.function, "look")
        for number, child in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(child, ast.AST):
                continue
            if (
                isinstance(node, ast.Call)
                and name == "args"
                and number == 1
                and ast.unparse(node.func) in ("round", "np.round")
            ):
                here = _Place(place.statement, place.function, "look")
            if (new := _replacement(child)) is not None:
                there = here
                if isinstance(child, ast.stmt):
                    there = _Place(child.lineno, place.function, _part(child))
                yield _told(child, new, there), _setter(node, name, number, new)
            yield from _sites(child, here)


def _is_silent(node: ast.AST) -> bool:
    """Whether no change of a node is a mistake that a test should notice."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.FunctionDef) and is_compiled(node):
        return True
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("__"):
        return True
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return True
    return isinstance(node, ast.Expr) and (
        not isinstance(node.value, ast.Call) or ast.unparse(node.value.func).startswith(_WORDS)
    )


def _of(node: ast.AST, place: _Place) -> Iterator[_Site]:
    """Mistakes that change a field of the node itself."""
    if isinstance(node, ast.Compare):
        for table in (_COMPARED, _TURNED):
            for number, operator in enumerate(node.ops):
                if type(operator) in table:
                    new = ast.Compare(node.left, list(node.ops), node.comparators)
                    new.ops[number] = table[type(operator)]()
                    yield _told(node, new, place), _setter(node, "ops", number, new.ops[number])
    elif isinstance(node, ast.BinOp) and type(node.op) in _COUNTED and not _is_text(node):
        operator = _COUNTED[type(node.op)]()
        yield _told(node, ast.BinOp(node.left, operator, node.right), place), _setter(node, "op", 0, operator)
    elif isinstance(node, ast.AugAssign) and type(node.op) in _COUNTED:
        operator = _COUNTED[type(node.op)]()
        changed = ast.AugAssign(node.target, operator, node.value)
        yield _told(node, changed, place), _setter(node, "op", 0, operator)
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield _told(node, ast.BoolOp(other, node.values), place), _setter(node, "op", 0, other)


def _replacement(node: ast.AST) -> ast.AST | None:
    """Replacements of a whole node."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return node.operand
    if isinstance(node, ast.Expr) and not _is_silent(node):
        return ast.Pass()
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            return ast.Constant(not node.value)
        if isinstance(node.value, int):
            return ast.Constant(node.value + 1 if node.value < _COUNTED_UP else node.value * 5 // 4)
        if isinstance(node.value, float) and node.value:
            return ast.Constant(1.25 * node.value)
    return None


def _is_text(node: ast.BinOp) -> bool:
    """Whether an operator concatenates strings."""
    return any(
        isinstance(one, ast.JoinedStr) or (isinstance(one, ast.Constant) and isinstance(one.value, str))
        for one in (node.left, node.right)
    )


def _told(old: Any, new: ast.AST, place: _Place) -> Mutation:
    title = f"{ast.unparse(old)} -> {'' if isinstance(new, ast.Pass) else ast.unparse(new)}"
    rule = place.inside if place.inside in ("budget", "look") else ""
    if isinstance(old, ast.Constant) and isinstance(old.value, float) and 0 < old.value <= _GUARD:
        rule = "guard"
    if isinstance(old, ast.Compare) and isinstance(new, ast.Compare) and place.inside != "refusal":
        rule = "boundary" if _is_boundary(old, new) else rule
    return Mutation(old.lineno, place.statement, place.function, " ".join(title.split()), rule)


def _part(statement: ast.stmt) -> str:
    """What the expressions of a statement are part of."""
    if isinstance(statement, ast.If) and any(isinstance(one, ast.Raise) for one in statement.body):
        return "refusal"
    if isinstance(statement, ast.Assign) and _BYTES.search(ast.unparse(statement.targets[0])):
        return "budget"
    call = statement.value if isinstance(statement, ast.Expr) else None
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr in _LOOKS:
        return "look"
    return ""


def _is_boundary(old: ast.Compare, new: ast.Compare) -> bool:
    """Whether only a boundary of real numbers changes, at least one of which is computed."""
    for left, a, b, right in zip(
        [old.left, *old.comparators], old.ops, new.ops, old.comparators, strict=False
    ):
        if type(a) is not type(b):
            same = {type(a), type(b)} in ({ast.Lt, ast.LtE}, {ast.Gt, ast.GtE})
            computed = isinstance(left, ast.BinOp) or isinstance(right, ast.BinOp)
            return same and computed and (_is_real(left) or _is_real(right))
    return False


def _is_real(node: ast.AST) -> bool:
    """Whether a real number is part of an expression: by its fraction, or by the unit in its name."""
    for one in ast.walk(node):
        name = one.id if isinstance(one, ast.Name) else one.attr if isinstance(one, ast.Attribute) else ""
        if _UNIT.search(name) or (isinstance(one, ast.Constant) and isinstance(one.value, float)):
            return True
    return False


def _setter(owner: ast.AST, field: str, number: int, new: ast.AST) -> Callable[[], None]:
    def change() -> None:
        value = getattr(owner, field)
        if isinstance(value, list):
            value[number] = new
        else:
            setattr(owner, field, new)

    return change
