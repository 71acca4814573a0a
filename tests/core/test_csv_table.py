"""CSV tables: what their reader accepts, its one-line errors, and their writer."""

from __future__ import annotations

from pathlib import Path

import pytest

from visuohaptic.core import CalibrationError, InputError
from visuohaptic.core.files import read_csv, write_csv


def _written(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    ["a,b\n1,2\n", "a\tb\n1\t2\n", "\ufeffa;b\r\n\r\n1; 2\r\n", '"a","b"\n"1","2"\n', " a , b \n \n1,2\n"],
)
def test_separators_quotes_marks_and_empty_lines(tmp_path: Path, text: str) -> None:
    names, rows = read_csv(_written(tmp_path, text), ("a",))
    (row,) = rows
    assert names == ["a", "b"]
    assert (row["a"], row.number("b"), row.get("c")) == ("1", 2.0, "")


def test_names_are_folded_and_comments_skipped_on_request(tmp_path: Path) -> None:
    names, rows = read_csv(_written(tmp_path, "# a press\nStress Pa\n#1\n  \n2\n"), spreadsheet=True)
    assert names == ["stress_pa"]
    assert [(row.line, row["stress_pa"]) for row in rows] == [(5, "2")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty, expected a header line and rows"),
        ("a,b\n", "has a header but no rows"),
        ("1,2\n3,4\n", "header: found numbers, expected a header with column names"),
        ("a,a\n1,2\n", "header: found a column name twice"),
        ("b\n1\n", "header: found columns b; missing: a"),
        ("a,b\n1\n", "line 2: found 1 fields, expected 2"),
        ("a\nx\n", "line 2, a: found 'x', expected a number"),
        ("a;b\n1,5;2\n", "line 2, a: found '1,5', expected a number with a decimal point"),
        ("a\ninf\n", "line 2, a: found 'inf', expected a finite number"),
        ("a\n\xff\n" * 2, "line 2, a: found"),
    ],
)
def test_errors_are_one_line_with_their_place(tmp_path: Path, text: str, said: str) -> None:
    path = _written(tmp_path, text)
    with pytest.raises(CalibrationError, match=said) as caught:
        [row.number("a") for row in read_csv(path, ("a",), error=CalibrationError)[1]]
    assert "\n" not in str(caught.value)
    path.write_bytes(b"a\n\xff\n")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        read_csv(path)


def test_a_table_without_rows_is_accepted_on_request(tmp_path: Path) -> None:
    assert list(read_csv(_written(tmp_path, "a\n"), allow_empty=True)[1]) == []


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    write_csv(path, ("name", "x_m"), [('a, "b"', 0.1 + 0.2), ("ä", "")])
    names, rows = read_csv(path)
    assert names == ["name", "x_m"]
    first, second = rows
    assert (first["name"], first.number("x_m"), second["name"], second["x_m"]) == (
        'a, "b"',
        0.1 + 0.2,
        "ä",
        "",
    )
    assert b"\r" not in path.read_bytes()
