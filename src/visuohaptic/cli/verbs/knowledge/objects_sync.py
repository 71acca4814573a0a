"""``visuohaptic objects sync``: synchronise a robot's database with a shared one.

reads   both databases; one that does not exist is created
writes  both; where objects were last seen stays local

example: visuohaptic objects sync postgresql://robots@server/objects
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import database
from ....core.errors import InputError
from ._objects import add_database, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("shared", str, "postgresql://..., or a folder")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Synchronise; returns the mapping that ``--json`` prints."""
    if not _is_there(args.db) and not _is_there(args.shared):
        # Otherwise a mistyped name would create two empty databases and report success.
        raise InputError(
            database.shown_url(args.shared),
            f"is not a database of objects, and neither is {database.shown_url(args.db)}",
            remedy="check both names, or add an object first",
        )
    folders = "://" not in args.db + args.shared
    if args.db == args.shared or (folders and Path(args.db).resolve() == Path(args.shared).resolve()):
        raise InputError(
            database.shown_url(args.shared), "is the database of --db itself, expected another one"
        )
    with opened(args, create=True) as local, database.open_database(args.shared) as shared:
        done = database.synchronise(local, shared)
        return {"shared": shared.where, "sent": done.sent, "received": done.received}


def _is_there(location: str) -> bool:
    """Whether a database exists; a server is assumed to, and opening it raises an error otherwise."""
    return "://" in location or (Path(location) / "objects.sqlite").is_file()
