"""Shards: the arrays of several objects in one Parquet file, one row group per object, one row per array."""

from __future__ import annotations

import hashlib
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ..core.codec import DTYPES, Arrays, dtype_name
from ..core.errors import DatabaseError, InputError
from ..core.files import atomic_path

__all__ = ["ShardFolder", "file_sha256", "pack", "unpack"]

#: Larger arrays are rejected [bytes].
MAX_ARRAY_BYTES = 1 << 30


def _schema() -> Any:
    import pyarrow as pa

    return pa.schema(
        [
            ("name", pa.string()),
            ("dtype", pa.string()),
            ("shape", pa.string()),  # "120x3"
            ("data", pa.large_binary()),  # little endian, C order
        ]
    )


def pack(items: Sequence[Arrays], sink: Any) -> None:
    """Write the arrays of objects to a path or stream; object i becomes row group i.

    Parameters
    ----------
    items
        Arrays by name, for each object.
    sink
        Path or binary stream.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema()
    # Uncompressed: fast reading of one object matters, and doubles hardly compress.
    with pq.ParquetWriter(
        sink, schema, compression="none", use_dictionary=False, write_statistics=False
    ) as writer:
        # Objects with equal numbers of arrays are written at once: a call for each took a third of an import.
        for count, run in groupby(items, len):
            objects = list(run)
            named = [item for arrays in objects for item in arrays.items()]
            columns = [
                pa.array([name for name, _ in named], pa.string()),
                pa.array([dtype_name(array.dtype) for _, array in named], pa.string()),
                pa.array(["x".join(map(str, array.shape)) for _, array in named], pa.string()),
                pa.array([array.tobytes() for _, array in named], pa.large_binary()),
            ]
            table = pa.table(columns, schema=schema)
            for _ in range(1 if count else len(objects)):  # each empty object is an empty row group
                writer.write_table(table, row_group_size=max(count, 1))


def unpack(file: Any, row_groups: Sequence[int], where: object) -> list[Arrays]:
    """Arrays of selected row groups of an open Parquet file.

    Parameters
    ----------
    file
        ``pyarrow.parquet.ParquetFile`` of a shard.
    row_groups
        Indices of the objects in it.
    where
        The file, for messages.

    Raises
    ------
    InputError
        It is not a shard, or is damaged.
    """
    import pyarrow as pa

    try:
        if bad := [group for group in row_groups if not 0 <= group < file.num_row_groups]:
            raise InputError(where, f"has {file.num_row_groups} row groups, expected number {bad[0]}")
        rows = file.read_row_groups(list(row_groups), use_threads=False).to_pydict()
        arrays = zip(*(rows[column] for column in _schema().names), strict=True)
        counts = [file.metadata.row_group(group).num_rows for group in row_groups]
        found = [dict(_array(where, *next(arrays)) for _ in range(count)) for count in counts]
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"is not a readable shard ({error})") from error
    return found


def _array(where: object, name: str, dtype: str, shape: str, data: bytes) -> tuple[str, np.ndarray]:
    if dtype not in DTYPES or len(data) > MAX_ARRAY_BYTES:
        raise InputError(where, f"array {name!r} is of {dtype!r} with {len(data)} bytes")
    sides = [int(side) for side in shape.split("x")] if shape else []
    return name, np.frombuffer(data, np.dtype(dtype).newbyteorder("<")).reshape(sides)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class ShardFolder:
    """A folder of shards; files are written completely, never changed, and removed when unused.

    Parameters
    ----------
    folder
        The folder, which must exist.
    open_files
        Number of shards kept open for reading.
    """

    def __init__(self, folder: Path, *, open_files: int = 64) -> None:
        self.folder = folder
        self._open: OrderedDict[str, Any] = OrderedDict()
        self._limit = open_files
        self._lock = threading.Lock()

    def path(self, name: str) -> Path:
        """File of a shard.

        Parameters
        ----------
        name
            Name of the shard.
        """
        return self.folder / f"{name}.parquet"

    def write(self, items: Sequence[Arrays]) -> tuple[str, str, int]:
        """Write a new shard; it is durable when this returns.

        Parameters
        ----------
        items
            Arrays by name, for each object.

        Returns
        -------
        name
            Name of the shard.
        sha256
            Digest of the file, 64 hexadecimal digits.
        size
            Size of the file [bytes].
        """
        name = uuid.uuid4().hex
        target = self.path(name)
        with atomic_path(target) as temporary:
            pack(items, temporary)
            sha256, size = file_sha256(temporary), temporary.stat().st_size
        handle = os.open(self.folder, os.O_RDONLY)  # the rename must reach the disk as well
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        return name, sha256, size

    def read(self, name: str, row_groups: Sequence[int]) -> list[Arrays]:
        """Arrays of objects in one shard.

        Parameters
        ----------
        name
            Name of the shard.
        row_groups
            Indices of the objects in it.

        Raises
        ------
        FileNotFoundError
            The shard no longer exists: another process has replaced it.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        with self._lock:
            file = self._open.get(name)
            if file is None:
                try:
                    file = pq.ParquetFile(self.path(name), memory_map=True)
                except FileNotFoundError:
                    raise
                except (pa.ArrowException, OSError) as error:
                    raise DatabaseError(f"{self.path(name)}: is not a readable shard ({error})") from error
                self._open[name] = file
                if len(self._open) > self._limit:
                    self._open.popitem(last=False)[1].close()
            self._open.move_to_end(name)
            return unpack(file, row_groups, self.path(name))

    def remove(self, names: Sequence[str]) -> None:
        """Remove shards that no object refers to.

        Parameters
        ----------
        names
            Names of shards; missing ones are ignored.
        """
        with self._lock:
            for name in names:
                if (file := self._open.pop(name, None)) is not None:
                    file.close()
                self.path(name).unlink(missing_ok=True)

    def tidy(self, known: set[str]) -> int:
        """Remove files left by interrupted writers. Call only while no other process can be writing.

        Parameters
        ----------
        known
            Names of shards that objects refer to.

        Returns
        -------
        int
            Number of removed files.
        """
        unknowns = [
            path for path in self.folder.iterdir() if path.stem not in known or path.suffix != ".parquet"
        ]
        for path in unknowns:
            path.unlink(missing_ok=True)
        return len(unknowns)

    def close(self) -> None:
        """Close all files."""
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()
