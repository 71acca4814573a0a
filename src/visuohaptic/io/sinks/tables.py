"""Measurements as tables, written row by row: CSV, and Parquet with the profiles."""

from __future__ import annotations

import csv
import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...core.errors import InputError, MissingExtraError
from ...core.files import keep_unfinished
from ...core.measurement import ForceProfile, Wrench
from ...core.resources import Closing

__all__ = ["FORCE_COLUMNS", "WRENCH_COLUMNS", "TableWriter"]

_log = logging.getLogger(__name__)

FORCE_COLUMNS = (
    "t_s",
    "valid",
    "reason",
    "force_N",
    "force_sigma_N",
    "contacts",
    "image_N",
    "calibration_N",
    "model_N",
    "zero_N",
)
AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
WRENCH_COLUMNS = (
    "t_s",
    "valid",
    "reason",
    *AXES,
    *(axis.replace("_", "_sigma_") for axis in AXES),
)
#: List columns of a force table, in Parquet only.
PROFILE_COLUMNS = ("s_m", "delta_m", "delta_sigma_m", "pressure_Pa")

#: Rows that are collected before they are written to Parquet.
_GROUP = 500


def _force_row(profile: ForceProfile) -> list[Any]:
    budget = profile.budget
    return [
        float(profile.t_s),
        bool(profile.valid),
        str(profile.reason),
        float(profile.force_N),
        float(profile.force_sigma_N),
        len(profile.contacts),
        float(budget.image_N),
        float(budget.calibration_N),
        float(budget.model_N),
        float(budget.zero_N),
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

    The kind of the first row fixes the columns. The file is called
    ``NAME.part`` until it is closed. A CSV row is with the operating system
    when ``write`` returns, so that a crash loses nothing; Parquet is written
    in groups of rows and is whole only after ``close``. What a killed run has
    left in ``NAME.part`` is kept under another name.

    Parameters
    ----------
    path
        ``.csv`` or ``.parquet``.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        if self.path.suffix not in (".csv", ".parquet"):
            raise InputError(path, f"found {self.path.suffix!r}, expected .csv or .parquet")
        if not self.path.parent.is_dir():
            raise InputError(path, "its folder does not exist", remedy=f"create {self.path.parent}")
        self.part = self.path.with_name(self.path.name + ".part")
        self._kind: type | None = None
        self._columns: tuple[str, ...] = ()
        self._stream: IO[str] | None = None
        self._parquet: _ParquetRows | None = None
        self._open = True

    def write(self, measured: ForceProfile | Wrench) -> None:
        """Append one measurement.

        Parameters
        ----------
        measured
            Measurement of the kind of the first one.

        Raises
        ------
        InputError
            It is of another kind, or the file cannot be written.
        """
        if not self._open:
            raise InputError(self.path, "is closed")
        if self._kind is None:
            self._begin(type(measured))
        if self._kind is not None and type(measured) is not self._kind:
            raise InputError(
                self.path,
                f"found a {type(measured).__name__}, expected {self._kind.__name__} as before",
            )
        row = _force_row(measured) if isinstance(measured, ForceProfile) else _wrench_row(measured)
        try:
            if self._parquet is not None:
                if isinstance(measured, ForceProfile):
                    row += [np.asarray(getattr(measured, name), dtype=np.float64) for name in PROFILE_COLUMNS]
                self._parquet.add(row)
            elif self._stream is not None:
                # ``repr`` of a float is the shortest text that reads back as the same number.
                texts = [
                    str(v).lower() if isinstance(v, bool) else (repr(v) if isinstance(v, float) else v)
                    for v in row
                ]
                csv.writer(self._stream, lineterminator="\n").writerow(texts)
                self._stream.flush()
        except OSError as error:
            raise self._stopped(error) from error

    def _begin(self, kind: type) -> None:
        self._columns = FORCE_COLUMNS if kind is ForceProfile else WRENCH_COLUMNS
        try:
            keep_unfinished(self.part, self.path)
            if self.path.suffix == ".parquet":
                lists = PROFILE_COLUMNS if kind is ForceProfile else ()
                self._parquet = _ParquetRows(self.part, self._columns, lists)
            else:
                self._stream = self.part.open("x", newline="", encoding="utf-8")
                csv.writer(self._stream, lineterminator="\n").writerow(self._columns)
        except OSError as error:
            raise InputError(self.path, f"cannot be written ({error.strerror})") from error
        self._kind = kind

    def _stopped(self, error: OSError) -> InputError:
        """Nothing more is written, and what is not whole does not get the name of the table."""
        self._open = False
        return InputError(
            self.path,
            f"cannot be written ({error.strerror or error}); the rows so far are in {self.part.name}",
        )

    def close(self) -> None:
        """Finish the file and give it its name; harmless when repeated.

        Without any row it is a force table with its header only.

        Raises
        ------
        InputError
            The disk is full: the rows so far stay in ``NAME.part``.
        """
        if not self._open:
            return
        if self._kind is None:
            self._begin(ForceProfile)
        self._open = False
        try:
            if self._parquet is not None:
                self._parquet.close()
            if self._stream is not None:
                self._stream.flush()
                os.fsync(self._stream.fileno())
                self._stream.close()
        except OSError as error:
            raise self._stopped(error) from error
        self.part.replace(self.path)


class _ParquetRows:
    """Rows collected into groups."""

    def __init__(self, path: Path, columns: Sequence[str], lists: Sequence[str]) -> None:
        pa, pq = arrow()
        kinds = {"valid": pa.bool_(), "reason": pa.string(), "contacts": pa.int32()}
        fields = [
            pa.field(name, kinds.get(name, pa.float64()), metadata={"unit": _unit(name)}) for name in columns
        ]
        fields += [pa.field(name, pa.list_(pa.float64()), metadata={"unit": _unit(name)}) for name in lists]
        self._schema = pa.schema(fields)
        self._pa = pa
        self._rows: list[list[Any]] = []
        self._writer = pq.ParquetWriter(str(path), self._schema, compression="zstd")

    def add(self, row: list[Any]) -> None:
        self._rows.append(row)
        if len(self._rows) >= _GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            columns = [
                self._pa.array(values, type=field.type)
                for values, field in zip(zip(*self._rows, strict=True), self._schema, strict=True)
            ]
            self._writer.write_table(self._pa.table(columns, schema=self._schema))
            self._rows = []

    def close(self) -> None:
        self._flush()
        self._writer.close()


def arrow() -> tuple[Any, Any]:
    """The modules ``pyarrow`` and ``pyarrow.parquet``."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError("pyarrow", "tables", "Parquet") from error
    return pa, pq
