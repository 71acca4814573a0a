"""Check of a Python block without running it: every name of this library that it uses exists."""

from __future__ import annotations

import ast
import collections.abc
import inspect
import textwrap
import types
import typing
from typing import Any

#: Stands for a value whose type nothing tells.
UNKNOWN = object()


def unknown_names(code: str) -> list[str]:
    """Imports, attributes and keyword arguments of ours that do not exist, and values that nothing defines.

    Follows what a block imports through calls, attributes, ``with`` and ``for``. An attribute may be taken
    of a value whose type is not ours or not known, but not of a name that the block never defines.
    """
    tree = ast.parse(code)
    reader = _Reader()
    for node in tree.body:
        reader.visit(node)
    return reader.problems


class _Reader(ast.NodeVisitor):
    """Types of a block's names, by annotation; ``problems`` is what was not found."""

    def __init__(self) -> None:
        self.types: dict[str, Any] = {}  #: name -> ("value", class) or ("object", what was imported)
        self.problems: list[str] = []

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        for alias in node.names:
            self.types[alias.asname or alias.name] = UNKNOWN
            if (node.module or "").startswith("visuohaptic"):
                scope: dict[str, Any] = {}
                try:
                    exec(f"from {node.module} import {alias.name} as it", scope)
                except ImportError as error:
                    self.problems.append(str(error))
                else:
                    self.types[alias.asname or alias.name] = ("object", scope["it"])

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self.types[alias.asname or alias.name.partition(".")[0]] = UNKNOWN

    def visit_Assign(self, node: ast.Assign) -> None:
        kind = self._type(node.value)
        for target in node.targets:
            self._bind(target, kind)

    def visit_With(self, node: ast.With) -> None:
        for item in node.items:
            kind = self._type(item.context_expr)
            if item.optional_vars is not None:
                self._bind(item.optional_vars, kind)
        for inner in node.body:
            self.visit(inner)

    def visit_For(self, node: ast.For) -> None:
        kind = self._type(node.iter)
        element = (
            _returned(kind[1], "__iter__") if isinstance(kind, tuple) and kind[0] == "value" else UNKNOWN
        )
        self._bind(node.target, element)
        for inner in node.body:
            self.visit(inner)

    def visit_Expr(self, node: ast.Expr) -> None:
        self._type(node.value)

    def _bind(self, target: ast.expr, kind: Any) -> None:
        if isinstance(target, ast.Name):
            self.types[target.id] = kind
        else:
            for part in ast.walk(target):
                if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                    self.types[part.id] = UNKNOWN

    def _type(self, node: ast.expr) -> Any:
        """What an expression gives; looks into all its parts on the way."""
        if isinstance(node, ast.Name):
            return self.types.get(node.id, UNKNOWN)
        if isinstance(node, ast.Attribute):
            if isinstance(node.value, ast.Name) and node.value.id not in self.types:
                self.problems.append(f"{node.value.id} of {ast.unparse(node)} is not defined")
            return self._attribute(self._type(node.value), node.attr, ast.unparse(node))
        if isinstance(node, ast.Call):
            for part in [*node.args, *(word.value for word in node.keywords)]:
                self._type(part)
            return self._call(self._type(node.func), node)
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.expr):
                self._type(part)
        return UNKNOWN

    def _attribute(self, of: Any, name: str, text: str) -> Any:
        if not isinstance(of, tuple):
            return UNKNOWN
        what, it = of
        if what == "object":
            if not hasattr(it, name):
                self.problems.append(f"{text} does not exist")
                return UNKNOWN
            return ("object", getattr(it, name))
        if name not in _members(it):
            self.problems.append(f"{text}: {it.__name__} has no {name}")
            return UNKNOWN
        found = inspect.getattr_static(it, name, None)
        if isinstance(found, property):
            return _value(_hints(found.fget).get("return"))
        return ("object", getattr(it, name)) if callable(found) else _value(_hints(it).get(name))

    def _call(self, of: Any, node: ast.Call) -> Any:
        if not isinstance(of, tuple) or of[0] != "object" or not callable(of[1]):
            return UNKNOWN
        it = of[1]
        words = inspect.signature(it).parameters
        if not any(word.kind is word.VAR_KEYWORD for word in words.values()):
            for word in node.keywords:
                if word.arg is not None and word.arg not in words:
                    self.problems.append(f"{ast.unparse(node.func)} has no argument {word.arg}")
        if inspect.isclass(it):
            return ("value", it)
        owner = getattr(it, "__self__", None)
        returned = _hints(it).get("return")
        return ("value", owner) if inspect.isclass(owner) and returned is typing.Self else _value(returned)


def _hints(it: Any) -> dict[str, Any]:
    """Annotations; none where one of them cannot be evaluated, as a shape of jaxtyping."""
    try:
        return typing.get_type_hints(it)
    except (NameError, TypeError, AttributeError, SyntaxError):
        return {}


def _value(kind: Any) -> Any:
    """One of our classes, or the first of our classes in a union, an iterator or a generator."""
    if inspect.isclass(kind) and kind.__module__.startswith("visuohaptic"):
        return ("value", kind)
    wraps = {types.UnionType, typing.Union, collections.abc.Iterator, collections.abc.Generator}
    if typing.get_origin(kind) in wraps:
        return next(
            (found for part in typing.get_args(kind) if (found := _value(part)) is not UNKNOWN), UNKNOWN
        )
    return UNKNOWN


def _returned(kind: type, method: str) -> Any:
    return _value(_hints(getattr(kind, method, None)).get("return"))


def _members(kind: type) -> set[str]:
    """Attributes of the class, its annotated fields, and what its methods set on ``self``."""
    found = set(dir(kind))
    for one in kind.__mro__[:-1]:
        found |= set(vars(one).get("__annotations__", ()))
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(one)))
        except (OSError, TypeError):
            continue
        found |= {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name) and node.value.id == "self"
        }  # fmt: skip
    return found
