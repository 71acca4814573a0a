"""Atomic file writing: a file is either complete or absent."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError
from .regular import check_target


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Write to the yielded temporary path; on success it replaces ``target``.

    The data is flushed to the disk before the rename, so that after a power
    failure either the old or the new file exists, never a partial one.

    Parameters
    ----------
    target
        File that is created or replaced.

    Raises
    ------
    InputError
        The folder does not exist or is not writable, or ``target`` is a folder, pipe, device or socket.
    """
    target = Path(target)
    check_target(target)
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem}.", suffix=f".part{target.suffix}", dir=target.parent
        )
    except OSError as error:
        raise InputError(target, f"cannot be written ({error.strerror})") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    except OSError as error:
        if error.filename is None:  # errors of write() contain no name: add the affected file
            error.filename = str(target)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_text(target: Path | str, text: str) -> None:
    """Write a UTF-8 text file atomically.

    Parameters
    ----------
    target
        File that is created or replaced.
    text
        Text to write.

    Raises
    ------
    InputError
        See :func:`atomic_path`.
    """
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
