"""Object databases: local to a robot in a folder (SQLite), or shared by robots (PostgreSQL).

Acknowledged data is durable: a call that writes returns after its transaction, and the arrays
before it, have reached the disk. Writes are atomic under any interruption. Writers, in this
or other processes, are serialised; readers never wait.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from sqlalchemy import Connection, func, select

from ..core import Closing, DatabaseError, InputError, VisuoHapticObject, brief, cards
from . import schema
from .array_store import ArrayStore
from .connection import Connections, connect
from .integrity import Check, check_all
from .merge import merge_objects
from .rows import (
    ALIVE,
    Prepared,
    Summary,
    Written,
    changes_of,
    drop_shards,
    feature_vectors,
    fetch,
    is_current,
    known_s,
    last_change,
    merged_versions,
    next_change,
    row_of,
    store_rows,
    summaries,
)
from .schema import meta, object_
from .shards import ShardFolder

#: Number of objects that :meth:`ObjectDatabase.add_many` writes per transaction.
BATCH = 512  # each transaction syncs the disk four times


def open_database(location: Path | str, *, create: bool = True) -> ObjectDatabase:
    """Open a database of objects: a folder (SQLite) or a server (PostgreSQL).

    Parameters
    ----------
    location
        Folder, or URL such as ``postgresql://host/name``.
    create
        Whether to create a folder's database if it does not exist. Without it, a misspelt path is refused; with it, an
        empty database is created there, even if it is only read.

    Raises
    ------
    DatabaseError
        It cannot be opened, or was written by a newer version.
    InputError
        It does not exist and ``create`` is false.

    Examples
    --------
    >>> import tempfile
    >>> with open_database(tempfile.mkdtemp()) as db:
    ...     _ = db.add(VisuoHapticObject("cup-1", visual_class="cup"))
    ...     db.get("cup-1").visual_class
    'cup'
    """
    return ObjectDatabase(location, create=create)


class ObjectDatabase(Closing):
    """Objects by id; see :func:`open_database`.

    Parameters
    ----------
    location, create
        As in :func:`open_database`.

    Examples
    --------
    >>> with ObjectDatabase("objects") as db:
    ...     _ = db.add(VisuoHapticObject("cup-1", visual_class="cup"))
    ...     [summary.id for summary in db.summaries(visual_class="cup")]
    ['cup-1']
    """

    def __init__(self, location: Path | str, *, create: bool = True) -> None:
        engine, self.where, shards = connect(location, create=create)
        self._turn = threading.RLock()
        self.connections = Connections(engine, self.where)
        self._arrays = ArrayStore(None if shards is None else ShardFolder(shards))
        try:
            with self.connections.reading() as connection:
                known = schema.version_of(connection, self.where)
            if known != schema.VERSION:
                with self.connections.writing() as connection:
                    schema.migrate(connection, self.where)
            with self.connections.reading() as connection:
                #: identity of this database for synchronisation peers
                self.id = str(connection.scalar(select(meta.c.value).where(meta.c.key == "id")))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close all connections and files."""
        self.connections.close()
        self._arrays.close()

    def __len__(self) -> int:
        with self.connections.reading() as connection:
            return int(
                connection.scalar(
                    select(func.count()).select_from(object_).where(object_.c.deleted_s.is_(None))
                )
                or 0
            )

    def __contains__(self, object_id: object) -> bool:
        with self.connections.reading() as connection:
            return connection.execute(ALIVE, {"requested": object_id}).first() is not None

    def get(self, object_id: str) -> VisuoHapticObject:
        """An object with all its arrays, verified against their hash.

        Parameters
        ----------
        object_id
            Id of the object.

        Raises
        ------
        InputError
            The object does not exist.
        DatabaseError
            Its arrays are damaged.
        """
        obj, deleted_s = self.stored([object_id]).get(object_id, (None, None))
        if obj is None or deleted_s is not None:
            raise InputError(self.where, f"there is no object {object_id!r}", remedy="list them first")
        return obj

    def summaries(self, *, visual_class: str | None = None, name: str | None = None) -> list[Summary]:
        """Summaries sorted by id; optionally only one visual class, or names that contain a text.

        One visual class may have several haptic models, each of which is a separate object.

        Parameters
        ----------
        visual_class
            Only objects of this class.
        name
            Only objects with this text in their name.
        """
        with self.connections.reading() as connection:
            return summaries(connection, visual_class, name)

    def features(self, kind: str) -> tuple[Sequence[str], Float[np.ndarray, "m n"]]:
        """Feature vectors of one kind, of all objects.

        Parameters
        ----------
        kind
            Kind of the features, the key in :attr:`.VisuoHapticObject.features`.

        Returns
        -------
        ids
            Ids of the m objects.
        vectors
            Feature vectors, shape (m, n).
        """
        with self.connections.reading() as connection:
            return feature_vectors(connection, kind, self.where)

    def changed(self, since: int) -> tuple[dict[str, int], int]:
        """Objects written or deleted after a change.

        Parameters
        ----------
        since
            Sequence number of that change; 0 for all.

        Returns
        -------
        changes
            Sequence number of the last change by id, including deleted objects, in increasing order.
        change
            Sequence number of the overall last change.
        """
        with self.connections.reading() as connection:
            last = last_change(connection)
            rows = connection.execute(
                select(object_.c.id, object_.c.change)
                .where(object_.c.change > since)
                .order_by(object_.c.change)
            )
            return {row.id: row.change for row in rows}, last

    def last_change(self) -> int:
        """Sequence number of the last change."""
        with self.connections.reading() as connection:
            return last_change(connection)

    def stored(self, ids: Sequence[str]) -> dict[str, tuple[VisuoHapticObject, float | None]]:
        """Objects with the time of their deletion (``None`` if not deleted).

        Parameters
        ----------
        ids
            Ids of objects; unknown ones are omitted.

        Returns
        -------
        dict
            For each id the object and its time of deletion, seconds since the epoch; ``None`` if not deleted.
        """
        for _ in range(5):
            try:
                with self.connections.reading() as connection:
                    found = fetch(connection, ids, self._decode, self._arrays.read_ahead)
                return {one: (item.obj, item.deleted_s) for one, item in found.items()}
            except FileNotFoundError:
                continue  # replaced between the two reads: retry
        raise DatabaseError(f"{self.where}: arrays of {brief(ids)} are missing; check the database")

    def add(self, obj: VisuoHapticObject) -> VisuoHapticObject:
        """Store an object, or merge it with the stored one of the same id.

        The result is durable when this returns.

        Parameters
        ----------
        obj
            Object with an id.

        Returns
        -------
        VisuoHapticObject
            The stored object.

        Raises
        ------
        InputError
            The id does not consist of 1 to 128 letters, digits, ``.``, ``_`` and ``-``, or a text is not Unicode.
        """
        return self._write([obj]).merged[obj.id][0]

    def add_many(
        self,
        objects: Iterable[VisuoHapticObject],
        *,
        batch: int = BATCH,
        stored: Callable[[Sequence[str]], object] | None = None,
    ) -> int:
        """Store many objects; returns their number.

        Parameters
        ----------
        objects
            The objects.
        batch
            Number of objects per transaction.
        stored
            Called with the ids of each transaction after it is durable.
        """
        count = 0
        waiting: list[VisuoHapticObject] = []

        def flush() -> int:
            self._write(waiting)
            if stored is not None:
                stored([obj.id for obj in waiting])
            return len(waiting)

        for obj in objects:
            waiting.append(obj)
            if len(waiting) >= batch:
                count += flush()
                waiting = []
        return count + (flush() if waiting else 0)

    def remove(self, object_id: str, *, t_s: float | None = None) -> None:
        """Delete an object; synchronisation propagates the deletion. Newer evidence restores the object.

        Parameters
        ----------
        object_id
            Id of the object.
        t_s
            Time of the deletion, seconds since the epoch; now by default.

        Raises
        ------
        InputError
            The object does not exist.
        """
        known = self.get(object_id)
        # Evidence with the time of a fast clock does not keep the object.
        now_s = max(time.time(), known_s(known)) if t_s is None else t_s
        self.write_merged({object_id: (VisuoHapticObject(object_id), now_s)})

    def write_merged(self, items: Mapping[str, tuple[VisuoHapticObject, float | None]]) -> Written:
        """Merge versions from another database, including deletions, in one transaction.

        Parameters
        ----------
        items
            For each id an object and its time of deletion, seconds since the epoch, or ``None``.

        Returns
        -------
        Written
            The stored result.
        """
        objects = [obj for obj, _ in items.values()]
        return self._write(objects, {one: deleted_s for one, (_, deleted_s) in items.items()})

    def _write(
        self, objects: Sequence[VisuoHapticObject], deletions: Mapping[str, float | None] | None = None
    ) -> Written:
        """Merge with the stored versions, and store the result."""
        latest: dict[str, VisuoHapticObject] = {}
        for obj in objects:
            latest[obj.id] = merge_objects(latest.get(obj.id, obj), obj)
        prepared: dict[str, Prepared] = {}

        def prepare(connection: Connection, ids: Sequence[str]) -> None:
            known = fetch(connection, ids, self._decode, self._arrays.read_ahead)
            for one in ids:
                obj, old = latest[one], known.get(one)
                deleted_s = None if deletions is None else deletions.get(one)
                if old is not None:
                    obj, deleted_s = merged_versions(
                        old.obj, old.deleted_s, obj, deleted_s, added_here=deletions is None
                    )
                prepared[one] = Prepared(old, obj, deleted_s, *row_of(obj, deleted_s, old))

        # Most of the work is done before other writers have to wait, and repeated where they have changed an object.
        with contextlib.suppress(FileNotFoundError), self.connections.reading() as connection:
            prepare(connection, list(latest))
        blobs = [(item.row, item.arrays) for item in prepared.values() if item.changes and item.needs_shard]
        early = None  # where another process tidies up meanwhile
        with contextlib.suppress(FileNotFoundError), self.connections.storing():
            early = self._arrays.write_early(blobs)
        with self._arrays.tidied_after_failure(), self._turn, self.connections.writing() as connection:
            change = next_change(connection)
            self._arrays.tidy(connection, self.where)
            current = changes_of(connection, list(latest))
            prepare(
                connection, [one for one in latest if not is_current(prepared.get(one), current.get(one))]
            )
            changed = [item for item in prepared.values() if item.changes]
            for item in changed:
                item.row["change"] = change
            unneeded = self._arrays.write(connection, early, [(item.row, item.arrays) for item in changed])
            store_rows(connection, [(item.row, item.old, item.obj) for item in changed])
            replaced = [item.old.row.shard for item in changed if item.old is not None]
            unneeded += drop_shards(connection, replaced)
        self._arrays.remove(unneeded)
        return Written(
            {one: (item.obj, item.deleted_s) for one, item in prepared.items()},
            change,
            frozenset(one for one, item in prepared.items() if item.old is not None),
            frozenset(item.row["id"] for item in changed),
        )

    def check(self) -> Check:
        """Read all data and verify every hash."""
        with self.connections.reading() as connection:
            return check_all(connection, self._arrays.folder, self._decode)

    def _decode(self, row: Any, connection: Connection) -> VisuoHapticObject:
        where = f"{self.where}, object {row.id}"
        try:
            return cards.decode(json.loads(row.card), self._arrays.read(connection, row, where), where)
        except (InputError, ValueError) as error:
            raise DatabaseError(f"{where}: is damaged: {error}") from error
