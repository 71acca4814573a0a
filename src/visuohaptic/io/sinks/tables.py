"""Measurement tables, written row by row: CSV, and Parquet with profiles."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ...core import Closing, ErrorBudget, ForceProfile, Wrench
from ...core.errors import InputError, needs
from ...core.files import PartFile, atomic_path, check_target, csv_line

_BUDGET = tuple(part.name for part in fields(ErrorBudget))
FORCE_COLUMNS = ("t_s", "valid", "reason", "force_N", "force_sigma_N", "contacts", *_BUDGET)
AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
WRENCH_COLUMNS = (*FORCE_COLUMNS[:3], *AXES, *(axis.replace("_", "_sigma_") for axis in AXES))
#: List columns of a force table, in Parquet only.
PROFILE_COLUMNS = ("s_m", "delta_m", "delta_sigma_m", "pressure_Pa")

#: Rows per group of a Parquet file.
_GROUP = 500


def _force_row(profile: ForceProfile) -> list[Any]:
    forces = float(profile.force_N), float(profile.force_sigma_N)
    budget = (float(getattr(profile.budget, name)) for name in _BUDGET)
    return [
        float(profile.t_s),
        bool(profile.valid),
        str(profile.reason),
        *forces,
        len(profile.contacts),
        *budget,
    ]


def _wrench_row(wrench: Wrench) -> list[Any]:
    sigmas = np.sqrt(np.diag(wrench.covariance))
    numbers = np.concatenate([wrench.force_N, wrench.moment_Nm, sigmas])
    return [float(wrench.t_s), bool(wrench.valid), str(wrench.reason), *(float(value) for value in numbers)]


def _unit(column: str) -> str:
    if column in ("valid", "reason", "contacts"):
        return "1"
    return column.rpartition("_")[2]


class TableWriter(Closing):
    """Writes force profiles or wrenches, one row each, to ``.csv`` or ``.parquet``.

    The type of the first row determines the columns. The file is named
    ``NAME.part`` until it is closed; a row is passed to the operating system before
    ``write`` returns, so that a crash loses nothing: ``visuohaptic recording
    recover`` completes the file. Until closed, rows of a Parquet file are Arrow
    messages. The remainder of a killed run is kept under another name.

    Parameters
    ----------
    path
        ``.csv`` or ``.parquet``.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = check_target(path, (".csv", ".parquet"))
        self._schema: Any = None
        self._packed = self.path.suffix.lower() == ".parquet"
        if self._packed:
            arrow()
        self._file = PartFile(self.path)
        self.part = self._file.part  #: name until closed
        self._kind: type | None = None

    def write(self, measured: ForceProfile | Wrench) -> None:
        """Append one measurement.

        Parameters
        ----------
        measured
            Measurement of the same type as the first one.

        Raises
        ------
        InputError
            The type differs, or the disk is full: the previous rows remain in ``NAME.part``.
        """
        if self._kind is None:
            self._begin(type(measured))
        if type(measured) is not self._kind:
            raise InputError(
                self.path,
                f"found a {type(measured).__name__}, expected {self._kind.__name__ if self._kind else ''} as before",
            )
        row = _force_row(measured) if isinstance(measured, ForceProfile) else _wrench_row(measured)
        if self._schema is None:
            self._file.write(csv_line(row))
            return
        if isinstance(measured, ForceProfile):
            row += [np.asarray(getattr(measured, name), dtype=np.float64) for name in PROFILE_COLUMNS]
        pa, _ = arrow()
        columns = [pa.array([value], type=field.type) for value, field in zip(row, self._schema, strict=True)]
        self._file.write(pa.record_batch(columns, schema=self._schema).serialize())

    def _begin(self, kind: type) -> None:
        columns = FORCE_COLUMNS if kind is ForceProfile else WRENCH_COLUMNS
        if not self._packed:
            self._file.write(csv_line(columns))
        else:
            self._schema = _schema(columns, PROFILE_COLUMNS if kind is ForceProfile else ())
            self._file.write(self._schema.serialize())
        self._kind = kind

    def close(self) -> None:
        """Finish and rename the file; may be called repeatedly.

        Without any row, it is a force table that contains only the header.

        Raises
        ------
        InputError
            The disk is full: the previous rows remain in ``NAME.part``.
        """
        if self._file.closed:
            return
        if self._kind is None:
            self._begin(ForceProfile)
        if self._schema is None:
            self._file.finish()
        else:
            pack_rows(self._file.part, self.path)
            self._file.discard()


def _schema(columns: Sequence[str], lists: Sequence[str]) -> Any:
    pa, _ = arrow()
    kinds = {"valid": pa.bool_(), "reason": pa.string(), "contacts": pa.int32()}
    fields = [
        pa.field(name, kinds.get(name, pa.float64()), metadata={"unit": _unit(name)}) for name in columns
    ]
    fields += [pa.field(name, pa.list_(pa.float64()), metadata={"unit": _unit(name)}) for name in lists]
    return pa.schema(fields)


def pack_rows(part: Path, target: Path) -> int:
    """Write the rows of an Arrow stream, which may be truncated, as Parquet; returns their number.

    Parameters
    ----------
    part
        Arrow stream with one row per message.
    target
        Parquet file that is created or replaced.

    Raises
    ------
    InputError
        ``part`` does not start as such a stream, or ``target`` cannot be written.
    """
    pa, pq = arrow()
    count = 0
    try:
        # Memory-mapped: a damaged header may declare more than the file contains.
        rows = pa.ipc.open_stream(pa.memory_map(os.fsencode(part)))
        _ = rows.schema.names  # those that are not UTF-8 are refused here
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise InputError(part, f"is not an unfinished table ({error})") from error
    try:
        with (
            atomic_path(target) as temporary,
            temporary.open("wb") as stream,
            pq.ParquetWriter(stream, rows.schema, compression="zstd") as packed,
        ):
            while group := _next_rows(pa, rows):
                packed.write_table(pa.Table.from_batches(group).combine_chunks())
                count += len(group)
    except OSError as error:
        raise InputError(
            target,
            f"cannot be written ({error.strerror or error})",
            remedy=f"free disk space and run: visuohaptic recording recover {part}",
        ) from error
    return count


def _next_rows(pa: Any, rows: Any) -> list[Any]:
    """The next rows, at most one group; a truncated row at the end is omitted."""
    group: list[Any] = []
    try:
        while len(group) < _GROUP:
            row = rows.read_next_batch()
            row.validate(full=True)  # damaged lengths could exceed the file
            group.append(row)
    except (StopIteration, OSError, pa.ArrowException):
        pass
    return group


def arrow() -> tuple[Any, Any]:
    """The modules ``pyarrow`` and ``pyarrow.parquet``."""
    with needs("pyarrow", "tables", "Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    return pa, pq
