"""Files that grow during a run: they have a temporary name until they are complete."""

from __future__ import annotations

import csv
import errno
import io
import logging
import os
import threading
import weakref
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..resources import Closing
from .regular import check_target, file_size, read_bytes

_log = logging.getLogger(__name__)

#: Data is synced to the disk this long after it was written, at the latest [s]: a power failure loses no more, and the time
#: that the disk takes for it. Shorter times wear out memory cards.
SYNC_S = 1.0
#: Errors of file systems that have no such call, as some in user space and on networks.
_CANNOT_SYNC = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP)


class PartFile:
    """A file named ``NAME.part`` until it is finished.

    Data is passed to the operating system before ``write`` returns: if the process is killed, none is lost. It is synced to
    the disk, in another thread, within :data:`SYNC_S`: a power failure loses what was written since. What a killed run has
    left under this name is kept as ``NAME.unfinished1...``.

    Parameters
    ----------
    target
        Name of the finished file; an older one is replaced.

    Raises
    ------
    InputError
        The folder does not exist or is not writable, ``target`` is a folder, pipe, device or socket, or another process is writing the file.
    """

    def __init__(self, target: Path | str) -> None:
        self.path = Path(target)
        self.part = self.path.with_name(self.path.name + ".part")
        check_target(target)
        self._timer: threading.Timer | None = None
        self._use = threading.Lock()  #: held while the file is synced, and to close it
        self._failure: OSError | None = None
        try:
            if self.part.exists():
                _keep(self.part, self.path)
            self._stream = self.part.open("xb", buffering=0)
            lock(self._stream)
            _sync_folder(self.part.parent)
        except OSError as error:
            raise InputError(target, f"cannot be written ({error.strerror})") from error

    @property
    def closed(self) -> bool:
        """Whether the file accepts no more data."""
        return self._stream.closed

    def write(self, data: bytes) -> int:
        """Append to the file.

        Parameters
        ----------
        data
            Data to append.

        Returns
        -------
        int
            Number of bytes written: always all.

        Raises
        ------
        InputError
            The disk is full or failed; the file is closed, and what was written before remains in ``NAME.part``.
        """
        if self._stream.closed:
            raise InputError(self.path, "is closed")
        if self._failure is not None:
            raise self._stopped(self._failure) from self._failure
        left = memoryview(data)
        try:
            while left:
                left = left[self._stream.write(left) :]
        except OSError as error:
            raise self._stopped(error) from error
        if self._timer is None or not self._timer.is_alive():
            # The timer keeps no file open that nobody else has.
            self._timer = threading.Timer(SYNC_S, _sync, (weakref.ref(self),))
            self._timer.daemon = True
            self._timer.start()
        return len(data)

    def _sync(self) -> None:
        # Writes from now on need another timer, since they may be too late for this one.
        self._timer = None
        with self._use:
            try:
                if not self._stream.closed:
                    _sync_file(self._stream.fileno())
            except OSError as error:
                self._failure = error

    def flush(self) -> None:
        """Does nothing: writes are unbuffered."""

    def tell(self) -> int:
        """Number of bytes written."""
        return self._stream.tell()

    def finish(self) -> None:
        """Sync the file to disk and rename it to its final name.

        Raises
        ------
        InputError
            The disk is full: what was written before remains in ``NAME.part``.
        """
        try:
            _sync_file(self._stream.fileno())
            self._end(lambda: self.part.replace(self.path))
        except OSError as error:
            raise self._stopped(error) from error

    def discard(self) -> None:
        """Remove ``NAME.part``: its contents have been written to the file with the final name."""
        self._end(self.part.unlink)

    def _end(self, step: Callable[[], object]) -> None:
        """Close after the last step, so that no other run takes what is left of this one; Windows keeps the names of open files."""
        if os.name == "nt":
            self._close()
        step()
        self._close()

    def _close(self) -> None:
        if (timer := self._timer) is not None:
            timer.cancel()
        with self._use:
            self._stream.close()

    def _stopped(self, error: OSError) -> InputError:
        self._close()
        return InputError(
            self.path,
            f"cannot be written ({error.strerror or error})",
            remedy=f"free disk space and run: visuohaptic recording recover {self.part}",
        )


def _sync(file: weakref.ref[PartFile]) -> None:
    if (alive := file()) is not None:
        alive._sync()


def _sync_file(handle: int) -> None:
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file outlast a power failure, where the file system can; Windows has no such call."""
    if os.name == "nt":
        return
    # A folder that may be written but not read cannot be synced either; a disk that fails is noticed by the writes.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def check_unlocked(path: Path) -> None:
    """Reject a file that another process is writing.

    Parameters
    ----------
    path
        File to check.

    Raises
    ------
    InputError
        Another process is writing it, or it cannot be read.
    """
    file_size(path)
    try:
        with path.open("rb") as stream:
            lock(stream)
    except BlockingIOError as error:
        raise InputError(
            path, "another process is writing this file", remedy="wait until it has finished"
        ) from error
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error


def _keep(part: Path, target: Path) -> None:
    """Rename the remainder of a killed run, and log it."""
    check_unlocked(part)
    number = 1
    while (kept := target.with_name(f"{target.stem}.unfinished{number}{target.suffix}.part")).exists():
        number += 1
    part.rename(kept)
    _log.warning(
        "%s remains of an interrupted run and is kept; to recover it: visuohaptic recording recover %s",
        part,
        kept,
    )


def lock(stream: io.IOBase) -> None:
    """Lock a file for this process until it is closed or the process ends; no effect on Windows.

    Parameters
    ----------
    stream
        The open file.

    Raises
    ------
    OSError
        Another process has locked it.
    """
    try:
        import fcntl
    except ImportError:  # not available on Windows
        return
    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


def whole_lines(path: Path) -> list[str]:
    """Complete lines of a text that may still be written; an incomplete last line is omitted.

    Parameters
    ----------
    path
        File written line by line.

    Raises
    ------
    InputError
        It cannot be read, is not UTF-8, or another process is writing it.
    """
    check_unlocked(path)
    data = read_bytes(path, file_size(path))
    try:
        return data[: data.rfind(b"\n") + 1].decode().split("\n")[:-1]  # texts may hold other separators
    except UnicodeDecodeError as error:
        raise InputError(path, f"is not UTF-8 text (byte {error.start})") from error


def csv_line(values: Iterable[Any]) -> bytes:
    """One row of a CSV file; floats as the shortest text that parses to the same number.

    Parameters
    ----------
    values
        Numbers, strings and booleans.
    """
    text = io.StringIO()
    texts = [str(value).lower() if isinstance(value, bool) else value for value in values]
    csv.writer(text, lineterminator="\n").writerow(texts)
    return text.getvalue().encode()


class GrowingCsv(Closing):
    """A CSV table that is written row by row.

    The file is named ``NAME.part`` until it is closed; a row has been passed to the operating system when
    :meth:`add` returns.

    Parameters
    ----------
    path
        Output CSV file.
    columns
        Header.
    """

    def __init__(self, path: Path | str, columns: Iterable[str]) -> None:
        self._file = PartFile(path)
        self._file.write(csv_line(columns))

    def add(self, values: Iterable[Any]) -> None:
        """Append a row.

        Parameters
        ----------
        values
            As many as columns; see :func:`csv_line`.

        Raises
        ------
        InputError
            The disk is full: the rows so far stay in ``NAME.part``.
        """
        self._file.write(csv_line(values))

    def close(self) -> None:
        """Finish and rename the file; may be called repeatedly."""
        if not self._file.closed:
            self._file.finish()
