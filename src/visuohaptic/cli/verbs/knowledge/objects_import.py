"""``visuohaptic objects import``: import objects from folders.

reads   folders with card.yaml, arrays.parquet and mesh.glb, whose hashes are checked
writes  into the database, 512 objects per transaction

example: visuohaptic objects import kitchen_export
"""

from __future__ import annotations

from typing import Any

from ._objects import add_database, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy", "trimesh")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("folder", str, "folder with a card, or with folders that have cards", nargs="+")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Import; returns the mapping that ``--json`` prints."""
    from itertools import chain, islice

    from ....database import BATCH, import_objects

    objects = chain.from_iterable(import_objects(folder) for folder in args.folder)
    first = list(
        islice(objects, BATCH)
    )  # read before the database is created, so that an invalid file leaves no empty database
    with opened(args, create=True) as database:
        count = database.add_many(chain(first, objects))
    return {"database": database.where, "imported": count}
