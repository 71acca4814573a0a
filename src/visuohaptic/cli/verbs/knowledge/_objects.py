"""Common parts of the ``objects`` verbs: location of the database, and summary of an object."""

from __future__ import annotations

import os
from typing import Any

from .... import core, database
from ....core.objects import VisuoHapticObject

#: Environment variable that names the database if ``--db`` is not given.
VARIABLE = "VISUOHAPTIC_OBJECTS"


def add_database(add: Any) -> None:
    """The option that every one of these verbs has.

    Parameters
    ----------
    add
        Of the verb.
    """
    add(
        "--db",
        str,
        f"database: a folder, or postgresql://...; by default ${VARIABLE}, else objects.db",
        default=os.environ.get(VARIABLE, "objects.db"),
        metavar="FOLDER|URL",
    )


def opened(args: Any, *, create: bool = False) -> Any:
    """The database of ``--db``.

    Parameters
    ----------
    args
        With ``db``.
    create
        Create it where it is missing.
    """

    return database.open_database(args.db, create=create)


def described(obj: VisuoHapticObject) -> dict[str, Any]:
    """An object without its arrays: those are named with their shapes.

    Parameters
    ----------
    obj
        As stored.
    """

    card, arrays = core.encode(obj)
    card.pop("evidence", None)
    shapes = {name: "x".join(map(str, array.shape)) for name, array in arrays.items()}
    return {**card, "evidence": len(obj.evidence), "arrays": shapes}
