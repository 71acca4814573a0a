"""Arrays of objects: in a folder of shards next to the database, or in rows of a server."""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import uuid
from collections.abc import Iterator, Sequence
from typing import Any

from sqlalchemy import Connection, select

from ..core import cards
from ..core.errors import DatabaseError
from .schema import shard
from .shards import ShardFolder, pack, unpack

#: Row of an object, and its arrays.
Blob = tuple[dict[str, Any], cards.Arrays]

_log = logging.getLogger(__name__)


class ArrayStore:
    """Storage of the arrays of objects.

    Parameters
    ----------
    folder
        Folder of shards; ``None``: the shards are rows of the database.
    """

    def __init__(self, folder: ShardFolder | None) -> None:
        self.folder = folder
        self._tidy_due = folder is not None
        self._ahead: dict[tuple[str, int], cards.Arrays] = {}

    def close(self) -> None:
        """Close all files."""
        if self.folder is not None:
            self.folder.close()

    def write_early(self, blobs: Sequence[Blob]) -> dict[str, Any] | None:
        """Write arrays into a shard of the folder before the transaction, so that other writers need not wait for the disk.

        Parameters
        ----------
        blobs
            For each object its row, which receives shard and index, and its arrays.

        Returns
        -------
        dict or None
            Row of the shard for :meth:`write`; ``None`` if nothing was written.
        """
        if self.folder is None or not blobs:
            return None
        name, sha256, size = self.folder.write([arrays for _, arrays in blobs])
        for number, (row, _) in enumerate(blobs):
            row["shard"], row["row_group"] = name, number
        return {"name": name, "sha256": sha256, "bytes": size, "data": None}

    def write(self, connection: Connection, early: dict[str, Any] | None, blobs: Sequence[Blob]) -> list[str]:
        """Write those arrays that are not yet in a shard, before the rows that refer to them.

        Parameters
        ----------
        connection
            Connection with an open transaction.
        early
            Result of :meth:`write_early`.
        blobs
            For each object its row, which receives shard and index, and its arrays.

        Returns
        -------
        list
            The early shard if it is not needed.
        """
        mine = [row for row, _ in blobs if early is not None and row["shard"] == early["name"]]
        if early is not None and self.folder is not None and not self.folder.path(early["name"]).is_file():
            for row in mine:  # another process has tidied up meanwhile
                row["shard"] = None
            mine = []
        shards = [early] if early is not None and mine else []
        unneeded = [early["name"]] if early is not None and not mine else []
        missing = [blob for blob in blobs if blob[1] and blob[0]["shard"] is None]
        if (late := self.write_early(missing)) is not None:
            shards.append(late)
        elif missing:  # on a server, each object has its own shard: reading it should not transfer others over the network
            for row, arrays in missing:
                buffer = io.BytesIO()
                pack([arrays], buffer)
                data, row["shard"], row["row_group"] = buffer.getvalue(), uuid.uuid4().hex, 0
                sha256 = hashlib.sha256(data).hexdigest()
                shards.append({"name": row["shard"], "sha256": sha256, "bytes": len(data), "data": data})
        if shards:
            connection.execute(shard.insert(), shards)
        return unneeded

    @contextlib.contextmanager
    def tidied_after_failure(self) -> Iterator[None]:
        """A shard that was written early for a transaction that fails is removed by the next one."""
        try:
            yield
        except BaseException:
            self._tidy_due = self.folder is not None
            raise

    def read(self, connection: Connection, row: Any, where: str) -> cards.Arrays:
        """Arrays of an object, verified against their hash.

        Parameters
        ----------
        connection
            Open connection of the database.
        row
            Row of the object.
        where
            Database and object, for messages.

        Raises
        ------
        DatabaseError
            The arrays do not match their hash.
        FileNotFoundError
            The shard no longer exists: another process has replaced it.
        InputError
            The shard is damaged.
        """
        if row.shard is None:
            return {}
        if self.folder is not None:
            ahead = self._ahead.pop((row.shard, row.row_group), None)
            arrays = self.folder.read(row.shard, [row.row_group])[0] if ahead is None else ahead
        else:
            import pyarrow.parquet as pq

            data = connection.scalar(select(shard.c.data).where(shard.c.name == row.shard))
            arrays = unpack(pq.ParquetFile(io.BytesIO(data or b"")), [row.row_group], where)[0]
        if cards.arrays_digest(arrays) != row.arrays_sha256:
            raise DatabaseError(f"{where}: its arrays do not match their stored hash")
        return arrays

    def read_ahead(self, rows: Sequence[Any]) -> None:
        """Prefetch the arrays of the following rows, all of a shard at once.

        Parameters
        ----------
        rows
            Rows of the objects.

        Raises
        ------
        FileNotFoundError
            A shard no longer exists: another process has replaced it.
        """
        self._ahead = {}
        if self.folder is None:
            return
        groups: dict[str, list[int]] = {}
        for row in rows:
            if row.shard is not None:
                groups.setdefault(row.shard, []).append(row.row_group)
        for name, chosen in groups.items():
            for number, arrays in zip(chosen, self.folder.read(name, chosen), strict=True):
                self._ahead[name, number] = arrays

    def remove(self, names: Sequence[str]) -> None:
        """Remove the files of shards that no object refers to any more.

        Parameters
        ----------
        names
            Names of the shards.
        """
        if self.folder is not None:
            self.folder.remove(names)

    def tidy(self, connection: Connection, where: str) -> None:
        """Remove, once and while no other process is writing, the files left by killed writers.

        Parameters
        ----------
        connection
            Connection with an open transaction.
        where
            The database, for the log.
        """
        if self._tidy_due and self.folder is not None:
            known = set(connection.execute(select(shard.c.name)).scalars())
            if removed := self.folder.tidy(known):
                _log.info("%s: removed %d files of interrupted writers", where, removed)
        self._tidy_due = False
