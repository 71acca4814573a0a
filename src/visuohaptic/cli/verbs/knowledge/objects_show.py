"""``visuohaptic objects show``: show all that is known of one object.

reads   a database of objects
writes  the object's data to stdout

example: visuohaptic objects show cup-1 --json
"""

from __future__ import annotations

from typing import Any

from ._objects import add_database, described, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("id", str, "id of the object")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Show; returns the mapping that ``--json`` prints."""
    with opened(args) as database:
        return described(database.get(args.id))
