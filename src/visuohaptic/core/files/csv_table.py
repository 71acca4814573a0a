"""CSV tables with a header line: one reader, one form of its messages, and one writer."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from .atomic import atomic_path
from .regular import MAX_DATA_BYTES, read_text


@dataclass(frozen=True, slots=True)
class CsvRow:
    """One row of a table: its fields by column, without surrounding spaces."""

    path: Path
    line: int  #: in the file
    fields: dict[str, str]
    error: type[InputError] = InputError  #: class of its errors

    def __getitem__(self, name: str) -> str:
        return self.fields[name]

    def get(self, name: str) -> str:
        """Text of a field; empty without that column.

        Parameters
        ----------
        name
            Column.
        """
        return self.fields.get(name, "")

    def number(self, name: str) -> float:
        """Finite number of a field.

        Parameters
        ----------
        name
            Column.

        Raises
        ------
        InputError
            As the table's error class: the field is not a finite number.
        """
        text = self.fields[name]
        try:
            value = float(text)
        except ValueError:
            expected = "a number with a decimal point" if "," in text else "a number"
            raise self.problem(f"found {text[:60]!r}, expected {expected}", name) from None
        if not math.isfinite(value):
            raise self.problem(f"found {text!r}, expected a finite number", name)
        return value

    def problem(self, text: str, name: str = "") -> InputError:
        """An error of the table's class that names this line, to be raised.

        Parameters
        ----------
        text
            What was found, and what was expected.
        name
            Column, if one field is wrong.
        """
        return self.error(self.path, text, field=f"line {self.line}" + (f", {name}" if name else ""))


def check_columns(
    path: Path | str, found: Sequence[str], required: Sequence[str], *, error: type[InputError] = InputError
) -> None:
    """Verify that a table has all required columns.

    Parameters
    ----------
    path
        The table, for the message.
    found, required
        Names of columns.
    error
        Exception class to raise.

    Raises
    ------
    InputError
        As ``error``: columns are missing.
    """
    if missing := [name for name in required if name not in found]:
        raise error(
            path,
            f"found columns {', '.join(found)[:160] or 'none'}; missing: {', '.join(missing)}",
            field="header",
        )


def read_csv(
    path: Path | str,
    required: Sequence[str] = (),
    *,
    max_bytes: int = MAX_DATA_BYTES,
    spreadsheet: bool = False,
    allow_empty: bool = False,
    error: type[InputError] = InputError,
) -> tuple[list[str], Iterator[CsvRow]]:
    """Column names and rows of a CSV table in UTF-8, separated by commas, semicolons or tabs.

    Parameters
    ----------
    path
        The file.
    required
        Columns that must be present.
    max_bytes
        Maximum size [bytes].
    spreadsheet
        Whether people edit it: names are read as lower case, with underscores in place of spaces; rows of
        empty fields and lines that start with ``#`` are skipped.
    allow_empty
        Whether a table may have no rows.
    error
        Exception class to raise.

    Returns
    -------
    names, rows
        The rows are parsed while they are iterated over; empty lines are skipped.

    Raises
    ------
    InputError
        As ``error``: the file cannot be read, lacks a column or has one twice; or, during iteration,
        a row has another number of fields than the header, with its line.
    """
    path = Path(path)
    text = read_text(path, max_bytes, error=error)
    head = text.partition("\n")[0]
    reader = csv.reader(_split(text), delimiter=max(",;\t", key=head.count))

    def lines() -> Iterator[list[str]]:
        try:
            for row in reader:
                fields = [field.strip() for field in row]
                skipped = spreadsheet and (not any(fields) or fields[0].startswith("#"))
                if fields not in ([], [""]) and not skipped:
                    yield fields
        except csv.Error as problem:
            raise error(path, f"is not CSV text ({problem})", field=f"line {reader.line_num}") from problem

    table = lines()
    names = next(table, [])
    if not names:
        raise error(path, "is empty, expected a header line and rows")
    if any(is_number(name) for name in names):
        raise error(path, "found numbers, expected a header with column names", field="header")
    if spreadsheet:
        names = [name.lower().replace(" ", "_") for name in names]
    if len(set(names)) < len(names):
        raise error(path, "found a column name twice", field="header")
    check_columns(path, names, required, error=error)

    def rows() -> Iterator[CsvRow]:
        empty = not allow_empty
        for fields in table:
            if len(fields) != len(names):
                problem = f"found {len(fields)} fields, expected {len(names)}"
                raise error(path, problem, field=f"line {reader.line_num}")
            empty = False
            yield CsvRow(path, reader.line_num, dict(zip(names, fields, strict=True)), error)
        if empty:
            raise error(path, "has a header but no rows")

    return names, rows()


def _split(text: str) -> Iterator[str]:
    """Lines with their ends, one at a time: a stream or a list of them takes several times the memory of the text."""
    start = 0
    while start < len(text):
        end = text.find("\n", start) + 1 or len(text)
        yield text[start:end]
        start = end


def write_csv(path: Path | str, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV table atomically.

    Parameters
    ----------
    path
        File that is created or replaced.
    columns
        Header.
    rows
        Values of each row, as many as columns; floats as the shortest text that parses to the same number.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def is_number(text: str) -> bool:
    """Whether a text is a number, NaN and infinity included.

    Parameters
    ----------
    text
        A word or a cell of a table.
    """
    try:
        float(text)
    except ValueError:
        return False
    return True
