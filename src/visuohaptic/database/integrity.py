"""Integrity check: whether all data referenced by a database exists and is unchanged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, select, text

from ..core import cards
from ..core.errors import DatabaseError, InputError
from .schema import object_, shard
from .shards import ShardFolder, file_sha256


@dataclass(frozen=True, slots=True)
class Check:
    """Result of an integrity check."""

    objects: int
    shards: int
    problems: tuple[str, ...]  #: empty if the database is intact


def check_all(
    connection: Connection, folder: ShardFolder | None, decode: Callable[[Any, Connection], object]
) -> Check:
    """Verify every stored hash against the data.

    Parameters
    ----------
    connection
        Open connection of the database.
    folder
        Folder of shards; ``None`` if they are rows of the database.
    decode
        Decodes the object of a row.
    """
    problems = []
    if folder is not None:
        said = connection.execute(text("PRAGMA integrity_check")).scalars().all()
        problems += [f"SQLite: {line}" for line in said if line != "ok"]
        broken = connection.execute(text("PRAGMA foreign_key_check")).all()
        problems += [f"SQLite: broken reference {tuple(row)}" for row in broken]
    shards = connection.execute(select(shard.c.name, shard.c.sha256, shard.c.bytes)).all()
    for row in shards:
        if folder is not None:
            path = folder.path(row.name)
            if not path.is_file():
                problems.append(f"shard {row.name} is missing")
            elif file_sha256(path) != row.sha256:
                problems.append(f"shard {row.name} has another hash")
    count = 0
    for row in connection.execute(select(object_)).all():
        count += 1
        try:
            decode(row, connection)
        except (DatabaseError, InputError, FileNotFoundError) as error:
            problems.append(f"object {row.id}: {error}")
        if cards.digest_of(row.card, row.arrays_sha256) != row.digest:
            problems.append(f"object {row.id} has another hash")
    return Check(count, len(shards), tuple(problems))
