"""Shows the ``#:`` comment of a dataclass field in the reference, as if it were its docstring."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Any

import griffe


@cache
def exported(module: Path) -> frozenset[str]:
    """Names that the stub of a room imports from one of its modules."""
    stub = module.with_name("__init__.pyi")
    body = ast.parse(stub.read_text(encoding="utf-8")).body if stub.exists() else ()
    return frozenset(
        alias.name
        for node in body
        if isinstance(node, ast.ImportFrom) and node.module == module.stem
        for alias in node.names
    )


class FieldComments(griffe.Extension):
    """Reads the comment from the source of each attribute."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Give an attribute without docstring the comment behind it, or on the lines above it.

        Constants of a module are shown if the stub of its room exports them.
        """
        if attr.docstring is not None or attr.lineno is None or attr.endlineno is None:
            return
        if isinstance(attr.filepath, list):
            return
        if isinstance(attr.parent, griffe.Module) and attr.name not in exported(attr.filepath):
            return
        try:
            lines = attr.lines_collection[attr.filepath]
        except KeyError:
            return
        found = [
            line.partition("#:")[2].strip()
            for line in lines[attr.lineno - 1 : attr.endlineno]
            if "#:" in line
        ]
        above = attr.lineno - 2
        while above >= 0 and lines[above].strip().startswith("#:"):
            found.insert(0, lines[above].strip()[2:].strip())
            above -= 1
        if text := " ".join(found):
            attr.docstring = griffe.Docstring(text, lineno=attr.lineno, parent=attr)
