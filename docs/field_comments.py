"""Shows the ``#:`` comment of a dataclass field in the reference, as if it were its docstring."""

from __future__ import annotations

from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """Reads the comment from the source of each attribute."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Give an attribute without docstring the comment behind it, or on the lines above it."""
        if attr.docstring is not None or attr.lineno is None or attr.endlineno is None:
            return
        if isinstance(attr.filepath, list):
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
