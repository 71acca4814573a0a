"""Files that grow during a run: written data persist, two runs do not mix, and data of a killed run are kept."""

from __future__ import annotations

import errno
import logging
import os
import stat
import time
from pathlib import Path

import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import (
    GrowingCsv,
    PartFile,
    atomic_path,
    check_unlocked,
    csv_line,
    part_file,
    whole_lines,
    write_text,
)

fcntl = pytest.importorskip("fcntl")


def test_the_name_is_given_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "run.csv"
    target.write_text("of yesterday")
    with_name = PartFile(target)
    assert with_name.write(b"t_s,force_N\n") == 12
    assert with_name.write(csv_line([0.1, "a,b", True, 3])) == 17
    assert with_name.tell() == 29
    assert target.read_text() == "of yesterday"
    assert (tmp_path / "run.csv.part").read_bytes() == b't_s,force_N\n0.1,"a,b",true,3\n'
    with_name.finish()
    assert with_name.closed
    assert target.read_bytes() == b't_s,force_N\n0.1,"a,b",true,3\n'
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]
    with pytest.raises(InputError, match="is closed"):
        with_name.write(b"more")


def test_rows_of_a_table_are_there_before_it_is_closed_and_after_an_error(tmp_path: Path) -> None:
    def run() -> None:
        with GrowingCsv(tmp_path / "run.csv", ("t_s", "name")) as table:
            table.add((0.1, "a"))
            assert (tmp_path / "run.csv.part").read_bytes() == b"t_s,name\n0.1,a\n"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]
    assert (tmp_path / "run.csv").read_bytes() == b"t_s,name\n0.1,a\n"


def test_a_power_failure_loses_no_more_than_the_stated_time(tmp_path: Path, monkeypatch) -> None:
    """What is on the disk is what the last sync has seen; also the last row before a silence is synced."""
    on_disk: list[int] = []

    def sync(handle: int) -> None:
        if os.fstat(handle).st_size and not stat.S_ISDIR(os.fstat(handle).st_mode):
            on_disk.append(os.fstat(handle).st_size)

    monkeypatch.setattr(part_file.os, "fsync", sync)
    monkeypatch.setattr(part_file, "SYNC_S", 0.1)
    file, rows = PartFile(tmp_path / "run.csv"), 2000
    for _ in range(rows):
        file.write(b"0.1,2.5\n")
    end = time.monotonic() + 20.0
    while not (on_disk and on_disk[-1] == 8 * rows) and time.monotonic() < end:
        time.sleep(0.01)
    assert on_disk[-1] == 8 * rows, "without a further row, and before the file is closed"
    assert len(on_disk) < rows / 10, "and not with each row"
    file.finish()


def test_a_disk_that_fails_later_is_told_at_the_next_row(tmp_path: Path, monkeypatch) -> None:
    file = PartFile(tmp_path / "run.csv")

    def fail(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(part_file.os, "fsync", fail)
    file._sync()
    with pytest.raises(
        InputError, match=r"run.csv: cannot be written \(Input/output error\); free disk space"
    ):
        file.write(b"0.1,2.5\n")
    assert file.closed


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS, errno.ENOTSUP])
def test_a_file_system_without_sync_is_written_all_the_same(tmp_path: Path, monkeypatch, number: int) -> None:
    def refuse(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(part_file.os, "fsync", refuse)
    file = PartFile(tmp_path / "run.csv")
    file.write(b"1\n")
    file._sync()
    file.write(b"2\n")
    file.finish()
    assert (tmp_path / "run.csv").read_bytes() == b"1\n2\n"


def test_what_a_killed_run_has_left_is_kept_under_numbers(tmp_path: Path, caplog) -> None:
    for text in ("first", "second"):
        (tmp_path / "run.csv.part").write_text(text)
        with caplog.at_level(logging.WARNING):
            PartFile(tmp_path / "run.csv").discard()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "run.unfinished1.csv.part": "first",
        "run.unfinished2.csv.part": "second",
    }
    assert caplog.messages[-1].endswith("run.unfinished2.csv.part")


def test_two_runs_do_not_write_one_file(tmp_path: Path) -> None:
    first = PartFile(tmp_path / "run.csv")
    first.write(b"a row\nhalf a r")
    for refused in (lambda: PartFile(tmp_path / "run.csv"), lambda: whole_lines(first.part)):
        with pytest.raises(
            InputError, match="another process is writing this file; wait until it has finished"
        ):
            refused()
    first.write(b"ow\n")
    first.finish()
    check_unlocked(tmp_path / "run.csv")
    assert whole_lines(tmp_path / "run.csv") == ["a row", "half a row"]


def test_a_line_without_its_end_is_left_out_and_noise_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes("é\nhalf".encode())
    assert whole_lines(tmp_path / "a") == ["é"]
    (tmp_path / "a").write_bytes(b"ok\n\xff\n")
    with pytest.raises(InputError, match=r"is not UTF-8 text \(byte 3\)"):
        whole_lines(tmp_path / "a")


@pytest.mark.parametrize("use", [PartFile, lambda target: atomic_path(target).__enter__()])
def test_a_place_where_no_file_can_be_is_refused(tmp_path: Path, use) -> None:
    with pytest.raises(InputError, match=r"its folder does not exist; create .*nowhere"):
        use(tmp_path / "nowhere" / "run.csv")
    with pytest.raises(InputError, match="is a folder"):
        use(tmp_path)

    for name in ("a\0b", "a" * 300):
        with pytest.raises(InputError, match="cannot be the name of a file"):
            use(tmp_path / name)


@pytest.mark.parametrize("end", [PartFile.finish, PartFile.discard])
def test_no_other_run_takes_what_is_just_being_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end
) -> None:
    """It would find the part without a lock, keep it as that of a killed run, and its name would be gone."""
    first, refused = PartFile(tmp_path / "run.csv"), []
    for step, done in (("replace", Path.replace), ("unlink", Path.unlink)):

        def at_the_same_time(*words, done=done) -> None:
            with pytest.raises(InputError, match="another process is writing"):
                PartFile(tmp_path / "run.csv")
            refused.append(done(*words))

        monkeypatch.setattr(Path, step, at_the_same_time)
    end(first)
    assert len(refused) == 1
    assert first.closed


def test_texts_with_other_separators_of_lines_are_whole(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(csv_line([1, "a\u2028b"]) + csv_line([2, "c\x85"]))
    assert whole_lines(tmp_path / "a") == ["1,a\u2028b", "2,c\x85"]


class FullDisk:
    """A stream that takes so many bytes."""

    closed = False

    def __init__(self, room: int) -> None:
        self.room, self.taken = room, b""

    def write(self, data: memoryview) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = min(self.room, len(data), 4)
        self.room -= count
        self.taken += bytes(data[:count])
        return count

    def close(self) -> None:
        self.closed = True


def test_a_full_disk_ends_the_run_and_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = PartFile(tmp_path / "run.csv")
    disk = FullDisk(10)
    monkeypatch.setattr(part, "_stream", disk)
    assert part.write(b"12345678") == 8  # in two pieces
    with pytest.raises(
        InputError, match=r"No space left .*; free disk space and run: visuohaptic recording recover"
    ):
        part.write(b"abcd")
    assert disk.taken == b"12345678ab"
    assert part.closed


def test_an_atomic_file_is_there_whole_or_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "map.yaml"
    write_text(target, "old")

    def fill_the_disk() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space") as caught:
        fill_the_disk()
    assert caught.value.filename == str(target)
    assert [path.name for path in tmp_path.iterdir()] == ["map.yaml"]
    assert target.read_text() == "old"
