"""Reading of measurement tables: CSV, and Parquet with profiles."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from ...core.files import file_size
from ...core.measurement import Reason, Wrench
from .tables import FORCE_COLUMNS, PROFILE_COLUMNS, WRENCH_COLUMNS, arrow

__all__ = ["ForceTable", "read_columns", "read_force_table", "read_reference_table", "read_wrench_table"]

#: Columns of a reference recording: the value, its standard deviation, and newtons per unit.
_REFERENCE_COLUMNS = (
    ("force_N", "force_sigma_N", 1.0),
    ("mass_g", "mass_sigma_g", 9.80665e-3),
    ("mass_kg", "mass_sigma_kg", 9.80665),
)


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


def read_force_table(path: Path | str) -> ForceTable:
    """Read a table of force profiles, CSV or Parquet.

    Parameters
    ----------
    path
        CSV or Parquet file.

    Raises
    ------
    InputError
        With the line of the first invalid field.
    """
    columns = read_columns(Path(path), FORCE_COLUMNS)
    profiles: tuple[dict[str, np.ndarray], ...] = ()
    if all(name in columns for name in PROFILE_COLUMNS):
        rows = zip(*(columns[name] for name in PROFILE_COLUMNS), strict=True)
        profiles = tuple(dict(zip(PROFILE_COLUMNS, (np.array(v) for v in row), strict=True)) for row in rows)
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
    """Read a table of wrenches; the covariance contains only the variances.

    Parameters
    ----------
    path
        As in :func:`read_force_table`.

    Raises
    ------
    InputError
        As in :func:`read_force_table`.
    """
    columns = read_columns(Path(path), WRENCH_COLUMNS)
    values = np.array([columns[name] for name in WRENCH_COLUMNS[3:]], dtype=np.float64).T.reshape(-1, 12)
    return tuple(
        Wrench(t_s, valid, reason, row[:3], row[3:6], np.diag(row[6:] ** 2))
        for t_s, valid, reason, row in zip(
            columns["t_s"], columns["valid"], columns["reason"], values, strict=True
        )
    )


def read_reference_table(path: Path | str) -> dict[str, Float[np.ndarray, "n"]]:
    """Read the recording of a scale or another reference sensor: ``t_s`` and one column of force or mass.

    Parameters
    ----------
    path
        CSV with ``t_s`` and ``force_N`` or, for a scale, ``mass_g`` or ``mass_kg`` (times 9.80665 m/s^2); the optional
        column ``force_sigma_N`` or ``mass_sigma_g`` is the standard deviation.

    Returns
    -------
    dict
        ``t_s`` [s], increasing, ``force_N`` and ``sigma_N`` [N].

    Raises
    ------
    InputError
        With the line of the first invalid field, or the columns found.
    """
    path = Path(path)
    header = _header(path)
    known = [columns for columns in _REFERENCE_COLUMNS if columns[0] in header]
    if not known:
        expected = ", ".join(columns[0] for columns in _REFERENCE_COLUMNS)
        raise InputError(
            path,
            f"found columns {', '.join(header) or 'none'}; expected t_s and one of {expected}",
            field="line 1",
        )
    force, sigma, newton = known[0]
    has_sigma = sigma in header
    columns = read_columns(path, ("t_s", force, *((sigma,) if has_sigma else ())))
    found = {
        "t_s": np.array(columns["t_s"], dtype=np.float64),
        "force_N": newton * np.array(columns[force], dtype=np.float64),
        "sigma_N": newton * np.array(columns[sigma], dtype=np.float64)
        if has_sigma
        else np.zeros(len(columns["t_s"])),
    }
    if (np.diff(found["t_s"]) <= 0).any():
        row = int(np.argmax(np.diff(found["t_s"]) <= 0)) + 3
        raise InputError(
            path, "found a time that is not later than the previous one", field=f"line {row}, t_s"
        )
    return found


def _header(path: Path) -> list[str]:
    """First line of a CSV file."""
    file_size(path)
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return next(csv.reader(stream), [])
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is not CSV text ({error})") from error


def read_columns(path: Path, expected: Sequence[str]) -> dict[str, list[Any]]:
    """Read selected columns of a table by name.

    Parameters
    ----------
    path
        CSV or Parquet file.
    expected
        Names of the columns; others are ignored.

    Raises
    ------
    InputError
        With the line of the first invalid field, or the missing columns.
    """
    file_size(path)
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
        raise InputError(path, f"is not CSV text ({error})") from error
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
    pa, pq = arrow()
    try:
        table = pq.read_table(str(path))
    except (OSError, pa.ArrowException) as error:
        raise InputError(path, f"is not a readable Parquet file ({error})") from error
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
