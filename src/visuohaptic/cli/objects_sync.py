"""``visuohaptic objects sync``: a robot's database and a shared one."""

from __future__ import annotations

import argparse
from typing import Any

from ._objects import add_database, opened

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "Exchange what is new with a shared database."
EPILOG = """\
reads   both databases
writes  both; where objects were seen last stays here

example: visuohaptic objects sync postgresql://robots@server/objects
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("shared", help="postgresql://..., or a folder")
    add_database(parser)


def run(args: Any) -> dict[str, Any]:
    """Synchronise; the mapping is what ``--json`` prints."""
    from ..objects.database import open_database
    from ..objects.sync import synchronise

    with opened(args, create=True) as local, open_database(args.shared) as shared:
        done = synchronise(local, shared)
        return {"shared": shared.where, "sent": done.sent, "received": done.received}
