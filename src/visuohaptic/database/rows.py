"""Rows of the object databases: queries, merging with stored versions, and replacement."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from sqlalchemy import Connection, and_, bindparam, select

from ..core import InputError, Provenance, VisuoHapticObject, cards
from .exchange import check_id
from .merge import merge_objects
from .schema import counter, feature, object_, shard


@dataclass(frozen=True, slots=True)
class Stored:
    """A row and the object that it contains."""

    obj: VisuoHapticObject
    deleted_s: float | None
    row: Any


@dataclass(frozen=True, slots=True)
class Prepared:
    """An object merged with its stored version, and its new row."""

    old: Stored | None
    obj: VisuoHapticObject
    deleted_s: float | None
    row: dict[str, Any]
    arrays: cards.Arrays

    @property
    def changes(self) -> bool:
        """Whether it differs from the stored version."""
        return self.old is None or (self.old.row.digest, self.old.deleted_s) != (
            self.row["digest"],
            self.deleted_s,
        )

    @property
    def needs_shard(self) -> bool:
        """Whether its arrays are not stored; else the row refers to those of the stored version."""
        return bool(self.arrays) and self.row["shard"] is None


@dataclass(frozen=True, slots=True)
class Written:
    """Result of a write."""

    merged: dict[str, tuple[VisuoHapticObject, float | None]]  #: stored object and time of deletion by id
    change: int  #: sequence number of this write
    known: frozenset[str]  #: ids that existed before
    changed: frozenset[str]  #: ids whose contents have changed


@dataclass(frozen=True, slots=True)
class Summary:
    """List entry of an object."""

    id: str
    name: str
    visual_class: str
    change: int  #: sequence number of its last write


#: One object that is not deleted.
ALIVE = select(object_).where(and_(object_.c.id == bindparam("requested"), object_.c.deleted_s.is_(None)))
_REQUESTED = object_.c.id.in_(bindparam("requested", expanding=True))
#: Several objects, including deleted ones.
MANY = select(object_).where(_REQUESTED)
#: The same, only the sequence numbers of their last writes.
CHANGES = select(object_.c.id, object_.c.change).where(_REQUESTED)


def last_change(connection: Connection) -> int:
    """Sequence number of the last write.

    Parameters
    ----------
    connection
        Open connection of the database.
    """
    return int(connection.scalar(select(counter.c.value)) or 0)


def next_change(connection: Connection) -> int:
    """Sequence number of a new write.

    Parameters
    ----------
    connection
        Connection with an open transaction.
    """
    return int(
        connection.scalar(counter.update().values(value=counter.c.value + 1).returning(counter.c.value))
    )


def row_of(
    obj: VisuoHapticObject, deleted_s: float | None, old: Stored | None
) -> tuple[dict[str, Any], cards.Arrays]:
    """Row and arrays of an object; the sequence number of the write, and the shard of new arrays, are not yet set.

    Parameters
    ----------
    obj
        The object.
    deleted_s
        Time of deletion, seconds since the epoch; ``None`` if not deleted.
    old
        The stored version, or ``None``.

    Raises
    ------
    InputError
        The id is none, or a text is not Unicode, as of a file whose name is not UTF-8.
    """
    check_id(obj.id)
    if zeros := [one for one in (obj.name, obj.visual_class, *obj.features) if "\0" in one]:
        # PostgreSQL stores none: it could not be synchronised.
        raise InputError(f"object {obj.id}", f"found {zeros[0]!r}, expected text without zero bytes")
    card, arrays = cards.encode(obj)
    try:
        text, arrays_sha256 = cards.card_text(card), cards.arrays_digest(arrays) if arrays else ""
        digest = cards.digest_of(text, arrays_sha256)
    except UnicodeEncodeError as error:
        found = f"found {error.object[max(error.start - 20, 0) : error.end]!r}"
        raise InputError(f"object {obj.id}", f"{found}, expected text in Unicode") from error
    stored = old.row if old is not None and old.row.arrays_sha256 == arrays_sha256 else None
    row = {
        "id": obj.id,
        "name": obj.name,
        "visual_class": obj.visual_class,
        "change": 0,
        "card": text,
        "arrays_sha256": arrays_sha256,
        "deleted_s": deleted_s,
        "shard": None if stored is None else stored.shard,
        "row_group": None if stored is None else stored.row_group,
        "digest": digest,
    }
    return row, arrays


def summaries(connection: Connection, visual_class: str | None, name: str | None) -> list[Summary]:
    """Objects that are not deleted, sorted by id; optionally of one visual class, or with a text in their name.

    Parameters
    ----------
    connection
        Open connection of the database.
    visual_class
        Only objects of this class; all with ``None``.
    name
        Only objects with this text in their name, case-insensitive; all with ``None``.
    """
    query = select(object_.c.id, object_.c.name, object_.c.visual_class, object_.c.change)
    query = query.where(object_.c.deleted_s.is_(None)).order_by(object_.c.id)
    if visual_class is not None:
        query = query.where(object_.c.visual_class == visual_class)
    found = [Summary(*row) for row in connection.execute(query)]
    # Not by lower() of the database: SQLite knows only the letters of ASCII, PostgreSQL those of its locale.
    return found if name is None else [one for one in found if name.casefold() in one.name.casefold()]


def feature_vectors(
    connection: Connection, kind: str, where: str
) -> tuple[Sequence[str], Float[np.ndarray, "m n"]]:
    """Ids and feature vectors of one kind, sorted by id.

    Parameters
    ----------
    connection
        Open connection of the database.
    kind
        Kind of the features.
    where
        The database, for messages.

    Raises
    ------
    InputError
        The vectors differ in length.
    """
    rows = connection.execution_options(yield_per=4096).execute(
        select(feature.c.object_id, feature.c.data)
        .where(feature.c.kind == kind)
        .order_by(feature.c.object_id)
    )
    ids: list[str] = []
    data, lengths = bytearray(), set()  # a single copy: a million vectors are gigabytes
    for row in rows:
        ids.append(row.object_id)
        data += row.data
        lengths.add(len(row.data))
    if len(lengths) > 1:
        raise InputError(
            where,
            f"found features {kind!r} of {sorted(n // 8 for n in lengths)} numbers, expected one length",
        )
    return ids, np.frombuffer(data, "<f8").reshape(len(ids), -1 if ids else 0)


def changes_of(connection: Connection, ids: Sequence[str]) -> dict[str, int]:
    """Sequence numbers of the last writes of objects, including deleted ones; unknown ids are omitted.

    Parameters
    ----------
    connection
        Open connection of the database.
    ids
        Ids of the objects.
    """
    return {row.id: row.change for rows in _requested(connection, CHANGES, ids) for row in rows}


def is_current(prepared: Prepared | None, change: int | None) -> bool:
    """Whether an object was merged with the version that is stored now.

    Parameters
    ----------
    prepared
        The merged object; ``None`` if it was not merged.
    change
        Sequence number of the last write of the stored version; ``None`` if there is none.
    """
    return prepared is not None and change == (prepared.old.row.change if prepared.old else None)


def fetch(
    connection: Connection,
    ids: Sequence[str],
    decode: Callable[[Any, Connection], VisuoHapticObject],
    read_ahead: Callable[[Sequence[Any]], object],
) -> dict[str, Stored]:
    """Stored objects by id, including deleted ones; unknown ids are omitted.

    Parameters
    ----------
    connection
        Open connection of the database.
    ids
        Ids of the objects.
    decode
        Decodes the object of a row.
    read_ahead
        Called with the rows to be decoded next.
    """
    found = {}
    for rows in _requested(connection, MANY, ids):
        read_ahead(rows)
        for row in rows:
            found[row.id] = Stored(decode(row, connection), row.deleted_s, row)
    return found


def _requested(connection: Connection, query: Any, ids: Sequence[str]) -> Iterator[Sequence[Any]]:
    """Rows of many ids, in parts that fit into one statement."""
    for start in range(0, len(ids), 500):
        yield connection.execute(query, {"requested": list(ids[start : start + 500])}).all()


def merged_versions(
    local: VisuoHapticObject,
    local_deleted_s: float | None,
    remote: VisuoHapticObject,
    remote_deleted_s: float | None,
    *,
    added_here: bool,
) -> tuple[VisuoHapticObject, float | None]:
    """Merge two versions with their deletions: the latest deletion is valid unless there is later
    information about the object.

    Parameters
    ----------
    local, remote
        Version of this database, and of the other one.
    local_deleted_s, remote_deleted_s
        Times of deletion, seconds since the epoch; ``None`` if not deleted.
    added_here
        Whether the object is being added locally, which reverts a deletion.

    Returns
    -------
    object
        The merged version.
    deleted_s
        Time of deletion, or ``None``.
    """
    deletions_s = [t_s for t_s in (local_deleted_s, remote_deleted_s) if t_s is not None]
    both = merge_objects(local, remote)
    if not deletions_s:
        return both, None
    last_s = max(deletions_s)
    if added_here:
        if known_s(remote) <= last_s:
            # Databases that received the deletion must also receive its reversal.
            again = Provenance("added again", math.nextafter(last_s, math.inf))
            remote = replace(remote, provenance={**remote.provenance, "id": again})
        return remote, None
    return both, None if known_s(both) > last_s else last_s


def known_s(obj: VisuoHapticObject) -> float:
    """Time of an object's latest information, seconds since the epoch; -inf if none has a time.

    Parameters
    ----------
    obj
        The object.
    """
    times = [origin.t_s for origin in obj.provenance.values()]
    times += [one.provenance.t_s for one in obj.evidence] + ([obj.seen.t_s] if obj.seen else [])
    return max((t_s for t_s in times if not math.isnan(t_s)), default=-math.inf)


def store_rows(
    connection: Connection, rows: list[tuple[dict[str, Any], Stored | None, VisuoHapticObject]]
) -> None:
    """Insert new rows, replace old ones, and write their features.

    Parameters
    ----------
    connection
        Connection with an open transaction.
    rows
        For each object its row, the previously stored version (or ``None``), and the object.
    """
    new = [row for row, old, _ in rows if old is None]
    if new:
        connection.execute(object_.insert(), new)
    replaced = [
        {f"new_{key}": value for key, value in row.items()} for row, old, _ in rows if old is not None
    ]
    if replaced:
        connection.execute(
            object_.update()
            .where(object_.c.id == bindparam("new_id"))
            .values({key: bindparam(f"new_{key}") for key in rows[0][0] if key != "id"}),
            replaced,
        )
        connection.execute(
            feature.delete().where(feature.c.object_id == bindparam("old_id")),
            [{"old_id": row["new_id"]} for row in replaced],
        )
    vectors = [
        {
            "object_id": row["id"],
            "kind": kind,
            "change": row["change"],
            "data": np.asarray(vector.values, "<f8").tobytes(),
        }
        for row, _, obj in rows
        if row["deleted_s"] is None
        for kind, vector in obj.features.items()
    ]
    if vectors:
        connection.execute(feature.insert(), vectors)


def drop_shards(connection: Connection, names: list[str | None]) -> list[str]:
    """Delete shards from the table that no object refers to any more.

    Parameters
    ----------
    connection
        Connection with an open transaction.
    names
        Shards that may be unused.

    Returns
    -------
    list
        Names of the deleted shards.
    """
    some = sorted({name for name in names if name is not None})
    if not some:
        return []
    used = set(connection.execute(select(object_.c.shard).where(object_.c.shard.in_(some))).scalars())
    unneeded = [name for name in some if name not in used]
    if unneeded:
        connection.execute(shard.delete().where(shard.c.name.in_(unneeded)))
    return unneeded
