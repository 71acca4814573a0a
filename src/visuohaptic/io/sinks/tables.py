"""Measurements as tables: CSV, and Parquet with the profiles."""

from __future__ import annotations

import csv
import logging
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError, MissingExtraError
from ...core.files import keep_unfinished
from ...core.measurement import ForceProfile, Reason, Wrench
from ...core.resources import Closing

__all__ = [
    "FORCE_COLUMNS",
    "WRENCH_COLUMNS",
    "ForceTable",
    "TableWriter",
    "read_force_table",
    "read_wrench_table",
]

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
_AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
WRENCH_COLUMNS = (
    "t_s",
    "valid",
    "reason",
    *_AXES,
    *(axis.replace("_", "_sigma_") for axis in _AXES),
)
#: List columns of a force table, in Parquet only.
_PROFILE_COLUMNS = ("s_m", "delta_m", "delta_sigma_m", "pressure_Pa")

#: Rows that are collected before they are written to Parquet.
_GROUP = 500


@dataclass(frozen=True, slots=True, eq=False)
class ForceTable:
    """Columns of a force table with n rows."""

    t_s: Float[np.ndarray, "n"]
    valid: Bool[np.ndarray, "n"]
    reason: tuple[Reason, ...]
    force_N: Float[np.ndarray, "n"]
    force_sigma_N: Float[np.ndarray, "n"]
    contacts: Int[np.ndarray, "n"]
    image_N: Float[np.ndarray, "n"]
    calibration_N: Float[np.ndarray, "n"]
    model_N: Float[np.ndarray, "n"]
    zero_N: Float[np.ndarray, "n"]
    #: profiles by row (Parquet only): s_m, delta_m, delta_sigma_m, pressure_Pa
    profiles: tuple[dict[str, Float[np.ndarray, "K"]], ...] = ()


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
                    row += [
                        np.asarray(getattr(measured, name), dtype=np.float64) for name in _PROFILE_COLUMNS
                    ]
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
                lists = _PROFILE_COLUMNS if kind is ForceProfile else ()
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
        pa, pq = _arrow()
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


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError("pyarrow", "recording", "Parquet") from error
    return pa, pq


def read_force_table(path: Path | str) -> ForceTable:
    """Read a table of force profiles back, CSV or Parquet.

    Parameters
    ----------
    path
        CSV or Parquet file.

    Raises
    ------
    InputError
        With the line of the first bad field.
    """
    columns = _read(Path(path), FORCE_COLUMNS)
    profiles: tuple[dict[str, np.ndarray], ...] = ()
    if all(name in columns for name in _PROFILE_COLUMNS):
        rows = zip(*(columns[name] for name in _PROFILE_COLUMNS), strict=True)
        profiles = tuple(dict(zip(_PROFILE_COLUMNS, (np.array(v) for v in row), strict=True)) for row in rows)
    numbers = {
        name: np.array(columns[name], dtype=np.float64)
        for name in FORCE_COLUMNS
        if name not in ("valid", "reason", "contacts")
    }
    return ForceTable(
        valid=np.array(columns["valid"], dtype=bool),
        reason=tuple(columns["reason"]),
        contacts=np.array(columns["contacts"], dtype=np.int64),
        profiles=profiles,
        **numbers,
    )


def read_wrench_table(path: Path | str) -> tuple[Wrench, ...]:
    """Read a table of wrenches back; the covariance has the variances only.

    Parameters
    ----------
    path
        CSV or Parquet file.

    Raises
    ------
    InputError
        With the line of the first bad field.
    """
    columns = _read(Path(path), WRENCH_COLUMNS)
    values = np.array([columns[name] for name in WRENCH_COLUMNS[3:]], dtype=np.float64).T.reshape(-1, 12)
    return tuple(
        Wrench(t_s, valid, reason, row[:3], row[3:6], np.diag(row[6:] ** 2))
        for t_s, valid, reason, row in zip(
            columns["t_s"], columns["valid"], columns["reason"], values, strict=True
        )
    )


def _read(path: Path, expected: Sequence[str]) -> dict[str, list[Any]]:
    if path.suffix == ".parquet":
        return _read_parquet(path, expected)
    columns: dict[str, list[Any]] = {name: [] for name in expected}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = csv.reader(stream)
            found = next(rows, [])
            _check_columns(path, found, expected)
            places = {name: found.index(name) for name in expected}
            for row in rows:
                if not row:
                    continue
                if len(row) != len(found):
                    raise InputError(
                        path,
                        f"found {len(row)} fields, expected {len(found)}",
                        field=f"line {rows.line_num}",
                    )
                for name, place in places.items():
                    where = f"line {rows.line_num}, {name}"
                    columns[name].append(_value(path, where, name, row[place]))
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is no CSV text ({error})") from error
    return columns


def _check_columns(path: Path, found: Sequence[str], expected: Sequence[str]) -> None:
    missing = [name for name in expected if name not in found]
    if missing:
        raise InputError(
            path,
            f"found columns {', '.join(found) or 'none'}; missing: {', '.join(missing)}",
            field="line 1" if path.suffix != ".parquet" else "",
        )


def _value(path: Path, where: str, name: str, text: str) -> Any:
    try:
        if name == "reason":
            return Reason(text)
        if name == "valid":
            return {"0": False, "1": True, "false": False, "true": True}[text.strip().lower()]
        if name == "contacts":
            return int(text)
        value = float(text)
    except (ValueError, KeyError) as error:
        kinds = {
            "reason": f"one of {', '.join(Reason)}",
            "valid": "true or false",
            "contacts": "a whole number",
        }
        raise InputError(
            path, f"found {text!r}, expected {kinds.get(name, 'a number')}", field=where
        ) from error
    if name == "t_s" and not math.isfinite(value):
        raise InputError(path, f"found {text!r}, expected a finite time", field=where)
    return value


def _read_parquet(path: Path, expected: Sequence[str]) -> dict[str, list[Any]]:
    pa, pq = _arrow()
    try:
        table = pq.read_table(str(path))
    except (OSError, pa.ArrowException) as error:
        raise InputError(path, f"is no readable Parquet file ({error})") from error
    _check_columns(path, table.column_names, expected)
    for name in expected:
        kind = table.schema.field(name).type
        good = (
            pa.types.is_boolean(kind)
            if name == "valid"
            else pa.types.is_string(kind)
            if name == "reason"
            else pa.types.is_integer(kind) or pa.types.is_floating(kind)
        )
        if not good or table.column(name).null_count:
            raise InputError(path, f"found {kind} with {table.column(name).null_count} nulls", field=name)
    columns: dict[str, list[Any]] = {name: table.column(name).to_pylist() for name in table.column_names}
    columns["reason"] = [
        _value(path, f"row {row}, reason", "reason", text) for row, text in enumerate(columns["reason"])
    ]
    return columns
