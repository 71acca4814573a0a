"""Databases of objects: one of a robot's own in a folder (SQLite), or one that robots share (PostgreSQL).

What is acknowledged is on the disk: a call that writes returns after its transaction, and the arrays
before it, have reached it. A write is whole or has not happened, whatever interrupts it. Writers, in this
or other processes, take turns; readers never wait.
"""

from __future__ import annotations

import io
import json
import logging
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from sqlalchemy import Connection, func, select
from sqlalchemy.exc import DBAPIError

from ..core import cards
from ..core.errors import DatabaseError, InputError
from ..core.objects import VisuoHapticObject
from ..core.resources import Closing
from . import schema
from .connection import connect_file, connect_server, shown_url
from .integrity import Check, check_all
from .merge import merge_objects
from .rows import ALIVE, MANY, Stored, drop_shards, joined, store_rows
from .schema import counter, feature, meta, object_, shard
from .shards import ShardFolder, pack, unpack

__all__ = ["BATCH", "Check", "ObjectDatabase", "Summary", "open_database"]

_log = logging.getLogger(__name__)

#: Objects that :meth:`ObjectDatabase.add_many` writes in one transaction.
BATCH = 512  # each waits for the disk four times
#: Ids are names of folders in an export, too.
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_NOT_STORED = "; what was being written is not stored"


@dataclass(frozen=True, slots=True)
class Summary:
    """What a list says of an object."""

    id: str
    name: str
    visual_class: str
    change: int  #: number of the write that it comes from


def open_database(location: Path | str, *, create: bool = True) -> ObjectDatabase:
    """Open a database of objects: a folder (SQLite) or a server (PostgreSQL).

    Parameters
    ----------
    location
        Folder, or URL such as ``postgresql://host/name``.
    create
        Whether it is created when it is not there.

    Raises
    ------
    DatabaseError
        It cannot be opened, or comes from a newer version.
    InputError
        There is none and ``create`` is off.

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
    location
        Folder, or URL such as ``postgresql://host/name``.
    create
        Whether it is created when it is not there.

    Examples
    --------
    >>> with ObjectDatabase("objects") as db:
    ...     _ = db.add(VisuoHapticObject("cup-1", visual_class="cup"))
    ...     [summary.id for summary in db.summaries(visual_class="cup")]
    ['cup-1']
    """

    def __init__(self, location: Path | str, *, create: bool = True) -> None:
        self.where = str(location)
        self._folder: ShardFolder | None = None
        self._tidy_due = True
        self._turn = threading.RLock()
        if "://" in self.where:
            self._engine = connect_server(self.where)
            self.where = shown_url(self.where)
        else:
            folder = Path(location)
            if not create and not (folder / "objects.sqlite").is_file():
                raise InputError(
                    folder, "is not a database of objects", remedy="add or import an object first"
                )
            try:
                (folder / "shards").mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(folder, f"cannot be made ({error.strerror})") from error
            self._folder = ShardFolder(folder / "shards")
            self._engine = connect_file(folder / "objects.sqlite")
        try:
            with self._reading() as connection:
                known = schema.version_of(connection)
            if known != schema.VERSION:
                with self._transaction() as connection:
                    schema.migrate(connection, self.where)
            with self._reading() as connection:
                #: identity of this database, for peers
                self.id = str(connection.scalar(select(meta.c.value).where(meta.c.key == "id")))
        except BaseException:
            self._engine.dispose()
            raise

    def close(self) -> None:
        """Close all connections and files."""
        self._engine.dispose()
        if self._folder is not None:
            self._folder.close()

    # ---- reading

    def __len__(self) -> int:
        with self._reading() as connection:
            return int(
                connection.scalar(
                    select(func.count()).select_from(object_).where(object_.c.deleted_s.is_(None))
                )
                or 0
            )

    def __contains__(self, object_id: object) -> bool:
        with self._reading() as connection:
            return connection.execute(ALIVE, {"wanted": object_id}).first() is not None

    def get(self, object_id: str) -> VisuoHapticObject:
        """An object with all its arrays, checked against their hash.

        Parameters
        ----------
        object_id
            Id of the object.

        Raises
        ------
        InputError
            There is no such object.
        DatabaseError
            Its arrays are damaged.
        """
        for _ in range(5):
            with self._reading() as connection:
                row = connection.execute(ALIVE, {"wanted": object_id}).first()
                if row is None:
                    raise InputError(
                        self.where, f"there is no object {object_id!r}", remedy="list them first"
                    )
                try:
                    return self._decode(row, connection)
                except FileNotFoundError:
                    continue  # replaced between the two reads: look again
        raise DatabaseError(f"{self.where}: the arrays of {object_id!r} are missing; check the database")

    def summaries(self, *, visual_class: str | None = None, name: str | None = None) -> list[Summary]:
        """Objects by id; of one visual class, or with a text in their name.

        One visual class may have several haptic models: each of them is an object here.

        Parameters
        ----------
        visual_class
            Only objects of this class.
        name
            Only objects with this text in their name.
        """
        query = select(object_.c.id, object_.c.name, object_.c.visual_class, object_.c.change)
        query = query.where(object_.c.deleted_s.is_(None)).order_by(object_.c.id)
        if visual_class is not None:
            query = query.where(object_.c.visual_class == visual_class)
        if name is not None:
            query = query.where(func.lower(object_.c.name).contains(name.lower(), autoescape=True))
        with self._reading() as connection:
            return [Summary(*row) for row in connection.execute(query)]

    def features(self, kind: str, *, since: int = 0) -> tuple[Sequence[str], Float[np.ndarray, "m n"], int]:
        """Feature vectors of one kind of all objects.

        Parameters
        ----------
        kind
            Kind of the features, the key in :attr:`.VisuoHapticObject.features`.
        since
            Only vectors written after the change of this number.

        Returns
        -------
        ids
            Ids of the m objects.
        vectors
            Feature vectors, shape (m, n).
        change
            Number of the last change.
        """
        with self._reading() as connection:
            last = int(connection.scalar(select(counter.c.value)) or 0)
            rows = connection.execute(
                select(feature.c.object_id, feature.c.data)
                .where(feature.c.kind == kind, feature.c.change > since)
                .order_by(feature.c.object_id)
            ).all()
        lengths = {len(row.data) for row in rows}
        if len(lengths) > 1:
            raise InputError(
                self.where,
                f"found features {kind!r} of {sorted(n // 8 for n in lengths)} numbers, expected one length",
            )
        ids = [row.object_id for row in rows]
        flat = np.frombuffer(b"".join(row.data for row in rows), "<f8")
        return ids, flat.reshape(len(ids), -1) if ids else flat.reshape(0, 0), last

    def changed(self, since: int) -> tuple[Sequence[str], int]:
        """Ids of objects written or deleted after a change.

        Parameters
        ----------
        since
            Number of that change; 0 for all.

        Returns
        -------
        ids
            Ids, deleted objects included.
        change
            Number of the last change.
        """
        with self._reading() as connection:
            last = int(connection.scalar(select(counter.c.value)) or 0)
            rows = connection.execute(
                select(object_.c.id).where(object_.c.change > since).order_by(object_.c.change)
            ).scalars()
            return rows.all(), last

    def stored(self, ids: Sequence[str]) -> dict[str, tuple[VisuoHapticObject, float | None]]:
        """Objects with the time of their deletion (``None`` for living ones).

        Parameters
        ----------
        ids
            Ids of objects; unknown ones are left out.

        Returns
        -------
        dict
            By id the object and when it was deleted, seconds since the epoch; ``None`` if it was not.
        """
        for _ in range(5):
            try:
                with self._reading() as connection:
                    found = self._fetch(connection, ids)
                return {one: (item.obj, item.deleted_s) for one, item in found.items()}
            except FileNotFoundError:
                continue
        raise DatabaseError(f"{self.where}: arrays are missing; check the database")

    # ---- writing

    def add(self, obj: VisuoHapticObject) -> VisuoHapticObject:
        """Store an object, or merge it with the one of the same id.

        It is on the disk when this returns.

        Parameters
        ----------
        obj
            The object.

        Returns
        -------
        VisuoHapticObject
            What is now stored.

        Raises
        ------
        InputError
            The id is not of up to 128 letters, digits, ``.``, ``_`` and ``-``.
        """
        return self._write([obj])[0]

    def add_many(
        self,
        objects: Iterable[VisuoHapticObject],
        *,
        batch: int = BATCH,
        stored: Callable[[Sequence[str]], object] | None = None,
    ) -> int:
        """Store many objects; returns how many.

        Parameters
        ----------
        objects
            The objects.
        batch
            How many are written in one transaction.
        stored
            Called with the ids of each transaction after it has reached the disk.
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
        """Delete an object; synchronisation carries the deletion on. Evidence newer than it brings it back.

        Parameters
        ----------
        object_id
            Id of the object.
        t_s
            Time of the deletion, seconds since the epoch; now when it is not given.

        Raises
        ------
        InputError
            There is no such object.
        """
        if object_id not in self:
            raise InputError(self.where, f"there is no object {object_id!r}")
        now_s = time.time() if t_s is None else t_s
        self.write_merged({object_id: (VisuoHapticObject(object_id), now_s)})

    def write_merged(
        self, items: Mapping[str, tuple[VisuoHapticObject, float | None]]
    ) -> dict[str, tuple[VisuoHapticObject, float | None]]:
        """Join versions from elsewhere, deletions too, with those here, in one transaction.

        Parameters
        ----------
        items
            By id an object and when it was deleted, seconds since the epoch, or ``None``.

        Returns
        -------
        dict
            What is now stored, in the same form.
        """
        objects = [obj for obj, _ in items.values()]
        done = self._write(objects, {one: deleted_s for one, (_, deleted_s) in items.items()})
        return {obj.id: (obj, self._last_deleted.get(obj.id)) for obj in done}

    _last_deleted: dict[str, float | None]

    def _write(
        self, objects: Sequence[VisuoHapticObject], deletions: Mapping[str, float | None] | None = None
    ) -> list[VisuoHapticObject]:
        latest: dict[str, VisuoHapticObject] = {}
        for obj in objects:
            if not _ID.fullmatch(obj.id):
                raise InputError(
                    "object", f"found the id {obj.id!r}, expected up to 128 letters, digits, '.', '_', '-'"
                )
            latest[obj.id] = merge_objects(latest.get(obj.id, obj), obj)
        unneeded: list[str] = []
        dead: dict[str, float | None] = {}
        with self._turn, self._transaction() as connection:
            change = int(
                connection.scalar(
                    counter.update().values(value=counter.c.value + 1).returning(counter.c.value)
                )
            )
            self._tidy(connection)
            known = self._fetch(connection, list(latest))
            rows, blobs = [], []
            for one, obj in latest.items():
                old = known.get(one)
                gone_s = None if deletions is None else deletions.get(one)
                if old is not None:
                    obj, gone_s = joined(old.obj, old.deleted_s, obj, gone_s, asked=deletions is None)
                latest[one], dead[one] = obj, gone_s
                card, arrays = cards.encode(obj)
                row = {
                    "id": one,
                    "name": obj.name,
                    "visual_class": obj.visual_class,
                    "change": change,
                    "card": cards.card_text(card),
                    "arrays_sha256": cards.arrays_digest(arrays) if arrays else "",
                    "deleted_s": gone_s,
                    "shard": None,
                    "row_group": None,
                }
                row["digest"] = cards.digest_of(str(row["card"]), str(row["arrays_sha256"]))
                if old is not None and (old.row.digest, old.deleted_s) == (row["digest"], gone_s):
                    continue  # nothing new
                if old is not None and old.row.arrays_sha256 == row["arrays_sha256"]:
                    row["shard"], row["row_group"] = old.row.shard, old.row.row_group
                elif arrays:
                    blobs.append((row, arrays))
                rows.append((row, old, obj))
            self._store_arrays(connection, blobs)
            store_rows(connection, rows)
            unneeded = drop_shards(connection, [old.row.shard for _, old, _ in rows if old is not None])
        if self._folder is not None:
            self._folder.remove(unneeded)
        self._last_deleted = dead
        return [latest[obj.id] for obj in objects]

    def _store_arrays(self, connection: Connection, blobs: list[tuple[dict[str, Any], cards.Arrays]]) -> None:
        """Arrays into shards, before the rows that name them."""
        if not blobs:
            return
        # On a server one object is one shard: reading it should not carry the others over the net.
        groups = [blobs] if self._folder is not None else [[blob] for blob in blobs]
        for group in groups:
            if self._folder is not None:
                name, sha256, size = self._folder.write([arrays for _, arrays in group])
                data = None
            else:
                import hashlib
                import uuid

                buffer = io.BytesIO()
                pack([arrays for _, arrays in group], buffer)
                data = buffer.getvalue()
                name, sha256, size = uuid.uuid4().hex, hashlib.sha256(data).hexdigest(), len(data)
            connection.execute(shard.insert(), {"name": name, "sha256": sha256, "bytes": size, "data": data})
            for number, (row, _) in enumerate(group):
                row["shard"], row["row_group"] = name, number

    def _tidy(self, connection: Connection) -> None:
        """Once, and while no one else writes: remove what killed writers left."""
        if self._tidy_due and self._folder is not None:
            known = set(connection.execute(select(shard.c.name)).scalars())
            if removed := self._folder.tidy(known):
                _log.info("%s: removed %d files of interrupted writers", self.where, removed)
        self._tidy_due = False

    # ---- integrity

    def check(self) -> Check:
        """Read everything and compare every hash."""
        with self._reading() as connection:
            return check_all(connection, self._folder, self._decode)

    # ---- inside

    def _fetch(self, connection: Connection, ids: Sequence[str]) -> dict[str, Stored]:
        found = {}
        for start in range(0, len(ids), 500):
            some = list(ids[start : start + 500])
            for row in connection.execute(MANY, {"wanted": some}):
                found[row.id] = Stored(self._decode(row, connection), row.deleted_s, row)
        return found

    def _decode(self, row: Any, connection: Connection) -> VisuoHapticObject:
        where = f"{self.where}, object {row.id}"
        arrays: cards.Arrays = {}
        try:
            if row.shard is not None and self._folder is not None:
                arrays = self._folder.read(row.shard, row.row_group)
            elif row.shard is not None:
                import pyarrow.parquet as pq

                data = connection.scalar(select(shard.c.data).where(shard.c.name == row.shard))
                arrays = unpack(pq.ParquetFile(io.BytesIO(data or b"")), row.row_group, where)
            if row.shard is not None and cards.arrays_digest(arrays) != row.arrays_sha256:
                raise DatabaseError(f"{where}: its arrays do not have the hash they were stored with")
            return cards.decode(json.loads(row.card), arrays, where)
        except (InputError, ValueError) as error:
            raise DatabaseError(f"{where}: is damaged: {error}") from error

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        with self._guarded(""), self._engine.connect() as connection:
            yield connection

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        engine = self._engine.execution_options(writes=True)
        with self._guarded(_NOT_STORED), engine.connect() as connection, connection.begin():
            yield connection

    @contextmanager
    def _guarded(self, loss: str) -> Iterator[None]:
        """Errors of the libraries below in our words, with what was lost by them."""
        try:
            yield
        except DBAPIError as error:
            said = " ".join(str(error.orig).split())
            raise DatabaseError(f"{self.where}: {said}{loss}") from error
        except FileNotFoundError:
            raise
        except OSError as error:
            raise DatabaseError(f"{self.where}: {error.strerror or error}{loss}") from error
