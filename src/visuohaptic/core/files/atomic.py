"""Files that are either whole or not there, and what a run that was killed has left."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError

__all__ = ["atomic_path", "keep_unfinished", "write_text"]

_log = logging.getLogger(__name__)


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Write to the yielded temporary path; on success it replaces ``target``.

    The data is flushed to the disk before the rename, so that after a power
    cut either the old or the new file is there, never half of one.

    Parameters
    ----------
    target
        File that is created or replaced.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written, or ``target`` is a folder itself.
    """
    target = Path(target)
    if not target.parent.is_dir():
        raise InputError(target, "its folder does not exist", remedy=f"create {target.parent}")
    if target.is_dir():
        raise InputError(target, "is a folder, expected the name of a file to write")
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
        if error.filename is None:  # writing knows no names: which file met the full disk?
            error.filename = str(target)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_text(target: Path | str, text: str) -> None:
    """Write a whole UTF-8 text file, or nothing.

    Parameters
    ----------
    target
        File that is created or replaced.
    text
        Its contents.

    Raises
    ------
    InputError
        See :func:`atomic_path`.
    """
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def keep_unfinished(part: Path, target: Path) -> None:
    """Give what a killed run has left in ``part`` a name of its own, and say so in the log.

    Parameters
    ----------
    part
        Name of a streamed file while it is written.
    target
        Its name when it is whole; ``run.csv`` gives ``run.recovered1.csv``.
    """
    if not part.exists():
        return
    number = 1
    while (kept := target.with_name(f"{target.stem}.recovered{number}{target.suffix}")).exists():
        number += 1
    part.rename(kept)
    _log.warning("%s is left of a run that did not end; kept as %s", part, kept)
