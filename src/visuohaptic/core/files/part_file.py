"""Files that grow for a whole run: they have another name until they are whole."""

from __future__ import annotations

import csv
import io
import logging
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import InputError
from .regular import file_size, read_bytes

__all__ = ["PartFile", "check_unlocked", "csv_line", "lock", "whole_lines"]

_log = logging.getLogger(__name__)


class PartFile:
    """A file that is called ``NAME.part`` until it is finished.

    What ``write`` has taken is with the operating system when it returns: a killed process loses none of it. What a
    killed run has left under this name is kept as ``NAME.unfinished1...``.

    Parameters
    ----------
    target
        Name of the finished file; an older one is replaced.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written, ``target`` is a folder, or another run is writing it.
    """

    def __init__(self, target: Path | str) -> None:
        self.path = Path(target)
        self.part = self.path.with_name(self.path.name + ".part")
        if not self.path.parent.is_dir():
            raise InputError(target, "its folder does not exist", remedy=f"create {self.path.parent}")
        if self.path.is_dir():
            raise InputError(target, "is a folder, expected a file name")
        try:
            if self.part.exists():
                _keep(self.part, self.path)
            self._stream = self.part.open("xb", buffering=0)
            lock(self._stream)
        except OSError as error:
            raise InputError(target, f"cannot be written ({error.strerror})") from error

    @property
    def closed(self) -> bool:
        """Whether nothing more is taken."""
        return self._stream.closed

    def write(self, data: bytes) -> int:
        """Append to the file.

        Parameters
        ----------
        data
            Bytes.

        Returns
        -------
        int
            How many: all.

        Raises
        ------
        InputError
            The disk is full; nothing more is taken, and what was written before stays in ``NAME.part``.
        """
        if self._stream.closed:
            raise InputError(self.path, "is closed")
        left = memoryview(data)
        try:
            while left:
                left = left[self._stream.write(left) :]
        except OSError as error:
            raise self._stopped(error) from error
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""

    def tell(self) -> int:
        """How many bytes are written."""
        return self._stream.tell()

    def finish(self) -> None:
        """Give the file its name, on the disk.

        Raises
        ------
        InputError
            The disk is full: what was written before stays in ``NAME.part``.
        """
        try:
            os.fsync(self._stream.fileno())
            self._stream.close()
            self.part.replace(self.path)
        except OSError as error:
            raise self._stopped(error) from error

    def discard(self) -> None:
        """Remove ``NAME.part``: what was in it is in the file of that name now."""
        self._stream.close()
        self.part.unlink()

    def _stopped(self, error: OSError) -> InputError:
        self._stream.close()
        return InputError(
            self.path,
            f"cannot be written ({error.strerror or error})",
            remedy=f"make room and run: visuohaptic recording recover {self.part}",
        )


def check_unlocked(path: Path) -> None:
    """Refuse a file that another process is writing.

    Parameters
    ----------
    path
        File that may be in use.

    Raises
    ------
    InputError
        Another process writes it, or it cannot be read.
    """
    file_size(path)
    try:
        with path.open("rb") as stream:
            lock(stream)
    except BlockingIOError as error:
        raise InputError(path, "another run is writing this file", remedy="wait for its end") from error
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error


def _keep(part: Path, target: Path) -> None:
    """Give what a killed run has left a name of its own, and say so in the log."""
    check_unlocked(part)
    number = 1
    while (kept := target.with_name(f"{target.stem}.unfinished{number}{target.suffix}.part")).exists():
        number += 1
    part.rename(kept)
    _log.warning(
        "%s is left of a run that did not end; kept: visuohaptic recording recover %s makes it whole",
        part,
        kept,
    )


def lock(stream: io.IOBase) -> None:
    """Hold a file for this process alone, until it is closed or the process ends; not on Windows.

    Parameters
    ----------
    stream
        The open file.

    Raises
    ------
    OSError
        Another process holds it.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows
        return
    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


def whole_lines(path: Path) -> list[str]:
    """Lines of a text that was being written; one without its end is left out.

    Parameters
    ----------
    path
        File that grew line by line.

    Raises
    ------
    InputError
        It cannot be read, is not UTF-8, or another run is writing it.
    """
    check_unlocked(path)
    data = read_bytes(path, file_size(path))
    try:
        return data[: data.rfind(b"\n") + 1].decode().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(path, f"is not UTF-8 text (byte {error.start})") from error


def csv_line(values: Iterable[Any]) -> bytes:
    """One row of a CSV file; floats as the shortest text that reads back as the same number.

    Parameters
    ----------
    values
        Numbers, texts and truth values.
    """
    text = io.StringIO()
    texts = [str(value).lower() if isinstance(value, bool) else value for value in values]
    csv.writer(text, lineterminator="\n").writerow(texts)
    return text.getvalue().encode()
