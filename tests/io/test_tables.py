"""Tables against the csv module and pyarrow."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.patience import PATIENCE_S
from visuohaptic.core import InputError, Reason, Wrench
from visuohaptic.io.sinks import (
    FORCE_COLUMNS,
    TableWriter,
    read_force_table,
    read_reference_table,
    read_wrench_table,
    table_reader,
)

from .helpers import profile

PROFILES = [profile(0.1 * n, valid=n != 2, force_N=n / 3) for n in range(5)]


@pytest.mark.parametrize("suffix", ["csv", "parquet", "CSV", "Parquet"])
def test_forces_go_round(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run.{suffix}"
    with TableWriter(path) as table:
        for one in PROFILES:
            table.write(one)
        assert not path.exists()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    back = read_force_table(path)
    assert back.t_s.tolist() == [p.t_s for p in PROFILES], "numbers come back to the last bit"
    assert back.force_N.tolist() == [p.force_N for p in PROFILES]
    assert back.valid.tolist() == [True, True, False, True, True]
    assert back.reason[2] is Reason.OCCLUDED
    assert back.contacts.tolist() == [1] * 5
    np.testing.assert_array_equal(back.force_sigma_N, [p.force_sigma_N for p in PROFILES])
    if suffix.lower() == "parquet":
        np.testing.assert_array_equal(back.profiles[3]["delta_m"], PROFILES[3].delta_m)
        np.testing.assert_array_equal(back.profiles[3]["pressure_Pa"], PROFILES[3].pressure_Pa)


def test_columns_by_independent_readers(tmp_path: Path) -> None:
    for suffix in ("csv", "parquet"):
        with TableWriter(tmp_path / f"run.{suffix}") as table:
            table.write(PROFILES[1])
    with (tmp_path / "run.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0])[:6] == ("t_s", "valid", "reason", "force_N", "force_sigma_N", "contacts")
    assert rows[0]["model_N"] == "0.03"
    schema = pq.read_schema(tmp_path / "run.parquet")
    assert schema.field("force_N").metadata == {b"unit": b"N"}
    assert schema.field("pressure_Pa").metadata == {b"unit": b"Pa"}
    assert schema.field("delta_sigma_m").metadata == {b"unit": b"m"}


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_wrenches_go_round(tmp_path: Path, suffix: str) -> None:
    covariance = np.diag(np.arange(1.0, 7.0) ** 2)
    sent = Wrench(1.25, False, Reason.STALE, np.array([0.1, 2, 3]), np.array([4.0, 5, 6]), covariance)
    # Linux also allows names that are not UTF-8.
    path = tmp_path / f"{os.fsdecode(b'w' + bytes([255]) * (sys.platform == 'linux'))}.{suffix}"
    with TableWriter(path) as table:
        table.write(sent)
    (back,) = read_wrench_table(path)
    assert (back.valid, back.reason) == (False, Reason.STALE)
    assert back.t_s == pytest.approx(1.25)
    np.testing.assert_array_equal(back.force_N, sent.force_N)
    np.testing.assert_array_equal(back.moment_Nm, sent.moment_Nm)
    np.testing.assert_allclose(back.covariance, covariance, rtol=1e-15)


def test_rows_are_on_disk_at_once(tmp_path: Path) -> None:
    table = TableWriter(tmp_path / "run.csv")
    for one in PROFILES:
        table.write(one)
    # Not closed, as after a crash.
    lines = (tmp_path / "run.csv.part").read_text().splitlines()
    assert len(lines) == 6
    table.close()


def test_kinds_do_not_mix(tmp_path: Path) -> None:
    wrench = Wrench(0.0, True, Reason.OK, np.zeros(3), np.zeros(3), np.eye(6))
    with TableWriter(tmp_path / "a.csv") as table:
        table.write(PROFILES[0])
        with pytest.raises(InputError, match="found a Wrench, expected ForceProfile as before"):
            table.write(wrench)
    with pytest.raises(InputError, match=r"found suffix '\.xlsx', expected \.csv or \.parquet"):
        TableWriter(tmp_path / "a.xlsx")


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("0.1,1,ok,abc,0,0,0,0,0,0", r"line 3, force_N: found 'abc', expected a number"),
        ("0.1,maybe,ok,1,0,0,0,0,0,0", r"line 3, valid: found 'maybe', expected true or false"),
        ("0.1,1,fine,1,0,0,0,0,0,0", r"line 3, reason: found 'fine', expected one of ok, occluded"),
        ("nan,1,ok,1,0,0,0,0,0,0", r"line 3, t_s: found 'nan', expected a finite time"),
        ("0.1,1,ok,1,0,1.5,0,0,0,0", r"line 3, contacts: found '1.5', expected a whole number"),
        ("0.1,1,ok", r"line 3: found 3 fields, expected 10"),
    ],
)
def test_bad_rows_are_named(tmp_path: Path, row: str, problem: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(",".join(FORCE_COLUMNS) + "\n0.0,1,ok,1,0,0,0,0,0,0\n" + row + "\n")
    with pytest.raises(InputError, match=problem):
        read_force_table(path)


def test_bad_files(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,force_N\n1,2\n")
    with pytest.raises(InputError, match=r"header: found columns t_s, force_N; missing: valid, reason"):
        read_force_table(tmp_path / "a.csv")
    (tmp_path / "a.parquet").write_bytes(b"PAR1 nothing")
    with pytest.raises(InputError, match="is not a readable Parquet file"):
        read_force_table(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="cannot be read"):
        read_force_table(tmp_path / "none.csv")


def test_a_small_file_of_many_equal_rows_is_refused_before_they_take_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [name for name in FORCE_COLUMNS if name not in ("valid", "reason", "contacts")]
    rows = {"valid": np.ones(200_000, bool), "reason": ["ok"] * 200_000, "contacts": np.zeros(200_000, int)}
    pq.write_table(pa.table(rows | {name: np.zeros(200_000) for name in names}), tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 100_000
    monkeypatch.setattr(table_reader, "MAX_DATA_BYTES", 8_000_000)
    with pytest.raises(InputError, match=r"has \d+ values, expected at most 1000000"):
        read_force_table(tmp_path / "a.parquet")


@pytest.mark.parametrize(
    ("text", "force_N", "sigma_N"),
    [
        ("t_s,force_N,force_sigma_N\n0,1.5,0.1\n1,2,0.2\n", [1.5, 2.0], [0.1, 0.2]),
        ("t_s,force_N\n0,1.5\n1,2\n", [1.5, 2.0], [0.0, 0.0]),
        # Standard gravity.
        ("mass_g,t_s,mass_sigma_g\n100,0,1\n0,1,1\n", [0.980665, 0.0], [0.00980665, 0.00980665]),
    ],
)
def test_a_scale_says_newtons_or_grams(tmp_path: Path, text: str, force_N: list, sigma_N: list) -> None:
    (tmp_path / "scale.csv").write_text(text)
    found = read_reference_table(tmp_path / "scale.csv")
    assert found["t_s"].tolist() == [0.0, 1.0]
    assert found["force_N"] == pytest.approx(force_N)
    assert found["sigma_N"] == pytest.approx(sigma_N)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,weight\n0,1\n", "header: found columns t_s, weight; expected t_s and one of force_N, mass_g"),
        ("", "is empty"),
        ("t_s,force_N\n0,1\n2,1\n2,1\n", "line 4, t_s: found a time that is not later than the previous one"),
        ("force_N\n1\n", "missing: t_s"),
        ("t_s,force_N\n0,x\n", "line 2, force_N: found 'x', expected a number"),
    ],
)
def test_a_bad_scale_is_told_by_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "scale.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_reference_table(tmp_path / "scale.csv")


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_what_a_killed_run_has_left_is_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, suffix: str
) -> None:
    path = tmp_path / f"k.{suffix}"
    part = tmp_path / f"k.{suffix}.part"
    for number in (1, 2):
        part.write_bytes(b"rows of run %d" % number)
        with TableWriter(path) as table:
            table.write(PROFILES[0])
        assert (tmp_path / f"k.unfinished{number}.{suffix}.part").read_bytes() == b"rows of run %d" % number
        assert not part.exists()
    assert len(read_force_table(path).t_s) == 1
    assert [
        record.getMessage().count("is kept; to recover it: visuohaptic recording recover")
        for record in caplog.records
    ] == [1, 1]


def test_a_full_disk_leaves_no_table_with_its_final_name(tmp_path: Path) -> None:
    """The limit for the size of files stands for the disk: it fails in the same system call."""
    script = (
        "import resource, signal, sys\n"
        "from tests.io.helpers import profile\n"
        "from visuohaptic.io import TableWriter\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "try:\n"
        "    with TableWriter(sys.argv[1]) as table:\n"
        "        for n in range(100):\n"
        "            table.write(profile(0.1 * n, valid=True, force_N=1.0))\n"
        "except ValueError as error:\n"
        "    print(error)\n"
    )
    path = tmp_path / "o.csv"
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr
    assert str(path) in done.stdout
    assert "o.csv.part" in done.stdout
    assert done.stdout.count("\n") == 1
    assert [one.name for one in tmp_path.iterdir()] == ["o.csv.part"]


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("t_s", [0.0, float("nan")], "t_s: found a time that is not finite"),
        ("contacts", [1.0, 1.5], "contacts: found double with 0 nulls"),
        ("delta_m", [0.001, 0.002], "delta_m: found double, expected a list of numbers"),
        ("pressure_Pa", [[1.0], [None]], "pressure_Pa: found double with 1 nulls"),
        ("s_m", [["a"], ["b"]], "s_m: found string with 0 nulls"),
    ],
)
def test_a_table_of_parquet_is_checked_like_one_of_text(
    tmp_path: Path, name: str, values: list, said: str
) -> None:
    rows = {column: [0.0, 1.0] for column in FORCE_COLUMNS} | {"valid": [True] * 2, "reason": ["ok"] * 2}
    pq.write_table(pa.table(rows | {"contacts": [0, 1], name: values}), tmp_path / "a.parquet")
    with pytest.raises(InputError, match=said):
        read_force_table(tmp_path / "a.parquet")


def test_columns_of_parquet_are_unique_and_need_no_reason(tmp_path: Path) -> None:
    table = pa.table({"t_s": [0.0, 0.5], "speed_m_s": [0.1, 0.2], "turn_rate_rad_s": [0.0, 0.4]})
    pq.write_table(table, tmp_path / "a.parquet")
    names = ("t_s", "speed_m_s", "turn_rate_rad_s")
    read = table_reader.read_columns(tmp_path / "a.parquet", names)["turn_rate_rad_s"]
    assert read == table["turn_rate_rad_s"].to_pylist()
    pq.write_table(table.append_column("t_s", table["t_s"]), tmp_path / "a.parquet")
    with pytest.raises(InputError, match="columns of this name"):
        table_reader.read_columns(tmp_path / "a.parquet", names)
