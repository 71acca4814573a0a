"""Reading of measurement tables: CSV, and Parquet with profiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import InputError, Reason, Wrench
from ...core.errors import brief_list
from ...core.files import MAX_DATA_BYTES, CsvRow, check_columns, file_size, read_csv
from ...core.ranges import SECONDS, check_numbers
from .tables import FORCE_COLUMNS, PROFILE_COLUMNS, WRENCH_COLUMNS, arrow

#: Columns of a reference recording: the value, its standard deviation, and newtons per unit.
_REFERENCE_COLUMNS = (
    ("force_N", "force_sigma_N", 1.0),
    ("mass_g", "mass_sigma_g", 9.80665e-3),
    ("mass_kg", "mass_sigma_kg", 9.80665),
)

#: Columns that hold no numbers: how their text is read, and what is expected.
_KINDS: dict[str, tuple[Callable[[str], Any], str]] = {
    "reason": (Reason, f"one of {', '.join(Reason)}"),
    "valid": (
        lambda text: {"0": False, "1": True, "false": False, "true": True}[text.lower()],
        "true or false",
    ),
    "contacts": (int, "a whole number"),
}


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
    names, rows = read_csv(path, ("t_s",))
    known = [columns for columns in _REFERENCE_COLUMNS if columns[0] in names]
    if not known:
        expected = ", ".join(columns[0] for columns in _REFERENCE_COLUMNS)
        raise InputError(
            path, f"found columns {brief_list(names)}; expected t_s and one of {expected}", field="header"
        )
    force, sigma, newton = known[0]
    times: list[float] = []
    values: list[tuple[float, float]] = []
    for row in rows:
        times.append(_value(row, "t_s"))
        check_numbers(f"{path}: line {row.line}", SECONDS, t_s=times[-1])
        values.append((_value(row, force), _value(row, sigma) if sigma in names else 0.0))
        if len(times) > 1 and times[-1] <= times[-2]:
            raise row.problem("found a time that is not later than the previous one", "t_s")
    force_N, sigma_N = newton * np.array(values).T
    return {"t_s": np.array(times), "force_N": force_N, "sigma_N": sigma_N}


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
    if path.suffix.lower() == ".parquet":
        return _read_parquet(path, expected)
    _, rows = read_csv(path, expected, allow_empty=True)
    columns: dict[str, list[Any]] = {name: [] for name in expected}
    for row in rows:
        for name, values in columns.items():
            values.append(_value(row, name))
    return columns


def _value(row: CsvRow, name: str) -> Any:
    text = row[name]
    convert, expected = _KINDS.get(name, (float, "a number"))
    try:
        value = convert(text)
    except (ValueError, KeyError) as error:
        raise row.problem(f"found {text!r}, expected {expected}", name) from error
    if name == "t_s" and not math.isfinite(value):
        raise row.problem(f"found {text!r}, expected a finite time", name)
    return value


def _read_parquet(path: Path, expected: Sequence[str]) -> dict[str, list[Any]]:
    file_size(path)
    pa, pq = arrow()
    try:
        with path.open("rb") as stream:
            file = pq.ParquetFile(stream)
            groups = [file.metadata.row_group(number) for number in range(file.num_row_groups)]
            values = sum(one.column(k).num_values for one in groups for k in range(one.num_columns))
            if values > MAX_DATA_BYTES // 8:  # equal values take hardly any space in the file
                raise InputError(path, f"has {values} values, expected at most {MAX_DATA_BYTES // 8}")
            table = file.read(
                [name for name in file.schema_arrow.names if name in {*expected, *PROFILE_COLUMNS}]
            )
    except (OSError, pa.ArrowException) as error:
        raise InputError(path, f"is not a readable Parquet file ({error})") from error
    names = table.column_names
    check_columns(path, names, expected)
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                path, f"found {names.count(name)} columns of this name, expected one", field=name
            )
        kind, parts = table.schema.field(name).type, table.column(name).chunks
        nulls = sum(part.null_count for part in parts)
        if pa.types.is_list(kind) and name in PROFILE_COLUMNS:
            kind = kind.value_type
            nulls += sum(part.flatten().null_count for part in parts)
        elif name in PROFILE_COLUMNS:
            raise InputError(path, f"found {kind}, expected a list of numbers", field=name)
        good = {
            "valid": pa.types.is_boolean(kind),
            "reason": pa.types.is_string(kind),
            "contacts": pa.types.is_integer(kind),
        }.get(name, pa.types.is_integer(kind) or pa.types.is_floating(kind))
        if not good or nulls:
            raise InputError(path, f"found {kind} with {nulls} nulls", field=name)
    columns: dict[str, list[Any]] = {name: table.column(name).to_pylist() for name in names}
    if not np.isfinite(columns["t_s"]).all():
        raise InputError(path, "found a time that is not finite", field="t_s")
    if "reason" in columns:
        columns["reason"] = [
            _value(CsvRow(path, line, {"reason": text}), "reason")
            for line, text in enumerate(columns["reason"], start=1)
        ]
    return columns
