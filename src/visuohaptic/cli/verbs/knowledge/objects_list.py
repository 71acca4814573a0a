"""``visuohaptic objects list``: list the objects of a database.

reads   a database of objects
writes  the list to stdout

example: visuohaptic objects list --class cup
"""

from __future__ import annotations

from typing import Any

from ._objects import add_database, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--class", str, "only objects of this visual class", dest="visual_class")
    add("--name", str, "only objects with this text in their name")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """List; returns the mapping that ``--json`` prints."""
    with opened(args) as database:
        found = database.summaries(visual_class=args.visual_class, name=args.name)
    for one in found:
        args.report(f"{one.id:<24} {one.visual_class:<16} {one.name}")
    args.report(f"{len(found)} objects")
    return {"objects": [{"id": one.id, "class": one.visual_class, "name": one.name} for one in found]}
