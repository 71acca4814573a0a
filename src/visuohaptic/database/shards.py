"""Shards: the arrays of several objects in one Parquet file, one row per array."""

from __future__ import annotations

import hashlib
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.codec import DTYPES, Arrays, dtype_name
from ..core.errors import DatabaseError, InputError
from ..core.files import MAX_DATA_BYTES, atomic_path

#: Objects in a row group: one per group took half of an import, and the larger groups are, the longer it takes to read one.
_GROUP = 16
#: Encodings of uncompressed values and of their validity, and maximum number of arrays in a row group.
_PLAIN, _MAX_ROWS = {"PLAIN", "RLE", "BIT_PACKED"}, 1_000_000
_COUNT, _PER_GROUP = b"objects", b"objects_per_row_group"


def _schema(count: int) -> Any:
    """Columns of a shard of several objects; without the last one and the numbers, each row group is an object."""
    import pyarrow as pa

    schema = pa.schema(
        [
            ("name", pa.string()),
            ("dtype", pa.string()),
            ("shape", pa.string()),  # "120x3"
            ("data", pa.large_binary()),  # little endian, C order
        ]
    )
    if count == 1:
        return schema
    numbers = {_COUNT: str(count), _PER_GROUP: str(_GROUP)}
    return schema.append(pa.field("object", pa.int32())).with_metadata(numbers)


def pack(items: Sequence[Arrays], sink: Any) -> None:
    """Write the arrays of objects to a path or stream.

    Parameters
    ----------
    items
        Arrays by name, for each object.
    sink
        Path or binary stream.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(len(items))
    # Uncompressed: fast reading of one object matters, and doubles hardly compress.
    with pq.ParquetWriter(
        sink, schema, compression="none", use_dictionary=False, write_statistics=False
    ) as writer:
        for start in range(0, len(items), _GROUP):
            rows = [
                (name, dtype_name(array.dtype), "x".join(map(str, array.shape)), array.tobytes(), number)
                for number, arrays in enumerate(items[start : start + _GROUP], start)
                for name, array in arrays.items()
            ]
            columns = zip(*rows, strict=True) if rows else [[]] * 5
            arrays = [pa.array(column, kind) for kind, column in zip(schema.types, columns, strict=False)]
            writer.write_table(pa.table(arrays, schema=schema), row_group_size=max(len(rows), 1))


def unpack(file: Any, numbers: Sequence[int], where: object) -> list[Arrays]:
    """Arrays of selected objects of an open Parquet file.

    Parameters
    ----------
    file
        ``pyarrow.parquet.ParquetFile`` of a shard.
    numbers
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
        metadata = file.schema_arrow.metadata or {}
        count = int(metadata.get(_COUNT, file.num_row_groups))
        if bad := [number for number in numbers if not 0 <= number < count]:
            raise InputError(where, f"has arrays of {count} objects, expected number {bad[0]}")
        size = max(1, int(metadata.get(_PER_GROUP, 1)))
        groups = sorted({number // size for number in numbers})
        for group in groups:
            _check_plain(file.metadata.row_group(group), where)
        rows = file.read_row_groups(groups, use_threads=False).to_pydict()
        if (owners := rows.get("object")) is None:
            owners = [group for group in groups for _ in range(file.metadata.row_group(group).num_rows)]
        found: dict[int, Arrays] = {number: {} for number in numbers}
        for owner, *array in zip(owners, *(rows[name] for name in _schema(1).names), strict=True):
            if owner in found:
                name, values = _array(where, *array)
                found[owner][name] = values
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"is not a readable shard ({error})") from error
    return [found[number] for number in numbers]


def _check_plain(group: Any, where: object) -> None:
    """Reject packed columns, of which a few bytes may unpack to any size; shards are written without."""
    for column in (group.column(number) for number in range(group.num_columns)):
        plain = column.compression == "UNCOMPRESSED" and set(column.encodings) <= _PLAIN
        if not plain or column.num_values > _MAX_ROWS:
            found = f"{column.num_values} values, {column.compression}, {'/'.join(column.encodings)}"
            raise InputError(
                where, f"found {found}, expected an uncompressed shard", field=column.path_in_schema
            )


def _array(where: object, name: str, dtype: str, shape: str, data: bytes) -> tuple[str, np.ndarray]:
    if dtype not in DTYPES or len(data) > MAX_DATA_BYTES:
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

    def read(self, name: str, numbers: Sequence[int]) -> list[Arrays]:
        """Arrays of objects in one shard.

        Parameters
        ----------
        name
            Name of the shard.
        numbers
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
            return unpack(file, numbers, self.path(name))

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
            path
            for path in self.folder.iterdir()
            if (path.stem not in known or path.suffix != ".parquet") and not path.is_dir()  # as lost+found
        ]
        for path in unknowns:
            path.unlink(missing_ok=True)
        return len(unknowns)

    def close(self) -> None:
        """Close all files."""
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()
