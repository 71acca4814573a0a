"""Data acknowledged before a kill or a full disk are recovered, and later runs do not modify them."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks._victim import Say, Victim
from benchmarks.hostile_files import _unfinished
from benchmarks.kill_faults import cut_rows, fill_disk, kill, numbers, write

from tests.patience import PATIENCE_S
from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.io import TableWriter, read_force_table, recover
from visuohaptic.io.depth import DepthSequence, write_sequence

from .helpers import profile
from .test_depth_sequence_out import frames


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9")
@pytest.mark.parametrize(
    ("name", "point"),
    [
        ("r.csv", {"cpu_s": 0.02}),
        ("r.csv", {"file_bytes": 60_000}),
        ("r.parquet", {"file_bytes": 90_000}),
        ("r.mcap", {"file_bytes": 70_001}),
        ("r.mcap", {"cpu_s": 0.05}),
        ("scan", {"cpu_s": 0.1}),
    ],
)
def test_all_that_a_killed_run_had_acknowledged_is_recovered(
    tmp_path: Path, name: str, point: dict[str, Any]
) -> None:
    acknowledged = kill(tmp_path / name, **point)
    assert acknowledged > 0
    left = tmp_path / name if name == "scan" else tmp_path / f"{name}.part"
    assert name == "scan" or not (tmp_path / name).exists()
    # Half of a row that was on its way when the process ended.
    if name in ("r.csv", "r.parquet"):
        with left.open("ab") as stream:
            stream.write(b"1.5,true,ok,3.2" if name == "r.csv" else b"\xff\xff\xff\xff\x88\1\0\0half")
    found = recover(left)
    assert found.path == tmp_path / name
    assert numbers(found.path)[:acknowledged] == list(range(acknowledged))
    # What was written and not acknowledged may be there, too; half of it may not.
    assert len(numbers(found.path)) - acknowledged in (0, 1)
    if name != "scan":
        assert left.exists()
        with pytest.raises(InputError, match="exists; name a new file"):
            recover(left)


@pytest.mark.skipif(sys.platform == "win32", reason="the limit for the size of files stands for the disk")
@pytest.mark.parametrize("name", ["r.csv", "r.parquet", "r.mcap"])
def test_a_full_disk_loses_no_acknowledged_row(tmp_path: Path, name: str) -> None:
    acknowledged, message = fill_disk(tmp_path / name, 300_000)
    assert message.startswith(str(tmp_path / name))
    assert f"visuohaptic recording recover {tmp_path / name}.part" in message
    assert [one.name for one in tmp_path.iterdir()] == [f"{name}.part"]
    assert acknowledged > 20
    assert numbers(recover(tmp_path / f"{name}.part").path) == list(range(acknowledged))


def test_cut_recordings_give_all_whole_messages() -> None:
    rows = cut_rows(12)
    assert {row["lost"] for row in rows} == {0}
    assert len({row["whole"] for row in rows}) > 6


def test_the_next_run_leaves_what_a_killed_one_has_left(tmp_path: Path) -> None:
    with TableWriter(tmp_path / "k.parquet") as table:
        table.write(profile(0.0, valid=True, force_N=1.0))
        half = (tmp_path / "k.parquet.part").read_bytes()
    for number in (1, 2):
        (tmp_path / "k.parquet.part").write_bytes(half)
        with TableWriter(tmp_path / "k.parquet") as table:
            table.write(profile(0.0, valid=True, force_N=2.0))
        assert numbers(tmp_path / "k.parquet") == [2.0]
        found = recover(tmp_path / f"k.unfinished{number}.parquet.part")
        assert found.path.name == f"k.unfinished{number}.parquet"
        assert numbers(found.path) == [1.0]


def test_a_sequence_that_was_stopped_is_not_written_over(tmp_path: Path) -> None:
    def broken():
        yield from frames(3)
        raise RuntimeError("the camera is gone")

    with pytest.raises(RuntimeError):
        write_sequence(tmp_path / "scan", broken())
    with pytest.raises(InputError, match="was not completed; run: visuohaptic recording recover"):
        write_sequence(tmp_path / "scan", frames())
    # An image without its pose: the process ended between the two.
    (tmp_path / "scan/depth/000003.png").write_bytes((tmp_path / "scan/depth/000000.png").read_bytes())
    assert recover(tmp_path / "scan").count == 3
    assert len(list(DepthSequence(tmp_path / "scan"))) == 3
    assert (tmp_path / "scan/depth/000003.png.part").exists()
    with pytest.raises(InputError, match="is not an interrupted depth sequence"):
        recover(tmp_path / "scan")


@pytest.mark.skipif(sys.platform == "win32", reason="files are locked by fcntl")
def test_two_runs_at_once_into_one_file_are_refused(tmp_path: Path) -> None:
    def refused_writer(say: Say) -> None:
        try:
            write(tmp_path / "r.csv", say, 3)
        except InputError as error:
            say(str(error))

    with TableWriter(tmp_path / "r.csv") as table:
        table.write(profile(0.0, valid=True, force_N=1.0))
        (message,), _ = Victim.start(refused_writer).end()
        assert "another process is writing this file" in message
        code = "import sys\nfrom visuohaptic.io import recover\nrecover(sys.argv[1])\n"
        done = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "r.csv.part")],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert "another process is writing this file" in done.stderr
        table.write(profile(0.1, valid=True, force_N=2.0))
    assert numbers(tmp_path / "r.csv") == [1.0, 2.0]


def test_the_verb_and_what_it_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv.part").write_text("t_s,force_N\n0.0,1.5\n0.1,2.")
    assert main(["recording", "recover", str(tmp_path / "a.csv.part"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["recovered"] == 1
    assert (tmp_path / "a.csv").read_text() == "t_s,force_N\n0.0,1.5\n"
    refused = {
        "a.csv": "does not end with .part",
        "none.part": "cannot be read",
        "": "is not an interrupted depth sequence",
    }
    (tmp_path / "b.part").write_bytes(b"\0\1\2" * 99)
    (tmp_path / "c.part").write_bytes(b"\xff\xff\xff\xff" * 99)
    (tmp_path / "d.part").write_bytes(b"")
    (tmp_path / "e.part").write_bytes(b"\0\0\0\x20ftypisom\xff\xfe" * 99)  # a video
    refused |= {"b.part": "neither a table", "c.part": "not an unfinished table"}
    refused |= {"d.part": "neither", "e.part": "is neither a table, nor MCAP"}
    for name, reason in refused.items():
        assert main(["recording", "recover", str(tmp_path / name)]) == 2, name
        assert reason in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_a_column_name_that_is_not_utf8_is_refused(tmp_path: Path) -> None:
    part = tmp_path / "n.parquet.part"
    with TableWriter(tmp_path / "n.parquet") as table:
        table.write(profile(0.0))
        whole = part.read_bytes()
    (tmp_path / "n.parquet").unlink()
    part.write_bytes(whole.replace(b"force_N", b"\xfforce_N"))
    with pytest.raises(InputError, match=r"is not an unfinished table.*utf-8"):
        recover(part, tmp_path / "n.parquet")
    assert not (tmp_path / "n.parquet").exists()
    # The name of a list's values is not kept in Parquet.
    part.write_bytes(whole.replace(b"item", b"\xfftem"))
    assert recover(part, tmp_path / "n.parquet").count == 1
    assert len(read_force_table(tmp_path / "n.parquet").t_s) == 1


def test_a_length_that_reaches_beyond_an_unfinished_table_ends_it(tmp_path: Path) -> None:
    """Every fourth byte in turn begins a number that is far too large: rows before it are recovered, or it is refused."""
    part = tmp_path / "w.parquet.part"
    _unfinished(part)
    whole = part.read_bytes()
    recovered = 0
    for place in range(len(whole) * 2 // 3, len(whole) - 4, 4):
        part.write_bytes(whole[:place] + b"\0\0\0\x6d" + whole[place + 4 :])
        with contextlib.suppress(InputError):
            recovered += recover(part, tmp_path / f"{place}.parquet").count
    assert recovered > 0
