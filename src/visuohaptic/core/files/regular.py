"""Regular files of bounded size: pipes, devices, sockets and folders are rejected before they are opened."""

from __future__ import annotations

import errno
import stat
from collections.abc import Sequence
from difflib import get_close_matches
from itertools import islice
from pathlib import Path

from ..errors import InputError

#: Larger files that are written by hand, and larger texts of other kinds, are rejected before they are parsed [bytes].
MAX_HAND_BYTES = 16 << 20
MAX_TEXT_BYTES = 256 << 20
#: The same of tables, images, arrays and their parts, and of files that are read at once [bytes].
MAX_DATA_BYTES, MAX_FILE_BYTES = 1 << 30, 2 << 30
#: Maximum number of files of a folder that are considered.
MAX_BESIDE = 1000

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def file_size(path: Path | str, max_bytes: int | None = None, *, error: type[InputError] = InputError) -> int:
    """Size of a regular file [bytes], without opening it.

    Parameters
    ----------
    path
        File; symbolic links are followed.
    max_bytes
        Maximum accepted size [bytes]; None: unlimited.
    error
        Exception class to raise.

    Raises
    ------
    InputError
        As ``error``: the file does not exist, is too large, or is a folder, pipe, device or socket.
    """
    try:
        found = Path(path).stat()
    except (OSError, ValueError) as problem:
        raise error(path, _unreadable(problem), remedy=similar_names(path)) from problem
    if not stat.S_ISREG(found.st_mode):
        what = f"cannot be read: it is {_kind(found.st_mode)}, expected a file"
        raise error(path, what, remedy=_files_in(Path(path)))
    if max_bytes is not None and found.st_size > max_bytes:
        raise error(path, f"has {found.st_size} bytes, expected at most {max_bytes}")
    return found.st_size


def check_target(path: Path | str, suffixes: Sequence[str] = ()) -> Path:
    """Reject the name of a file to write that is in use by something else: it would be replaced (``/dev/null``, too).

    Parameters
    ----------
    path
        File that is created or replaced; symbolic links are followed.
    suffixes
        Suffixes of formats that can be written, in lower case; any by default.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        Another suffix, the folder does not exist, or ``path`` is a folder, pipe, device or socket, or cannot be a name.
    """
    path = check_name(path)
    if suffixes and path.suffix.lower() not in suffixes:
        expected = " or ".join(part for part in (", ".join(suffixes[:-1]), suffixes[-1]) if part)
        raise InputError(path, f"found suffix {path.suffix!r}, expected {expected}")
    if not path.parent.is_dir():
        raise InputError(path, "its folder does not exist", remedy=f"create {path.parent}")
    if path.exists() and not path.is_file():
        raise InputError(path, f"is {_kind(path.stat().st_mode)}, expected the name of a file to write")
    return path


def check_name(path: Path | str) -> Path:
    """Reject a name that no file can have: too long, or with a zero byte.

    Parameters
    ----------
    path
        File or folder; it need not exist.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        It cannot be a name.
    """
    try:
        Path(path).lstat()
    except (OSError, ValueError) as problem:
        if isinstance(problem, ValueError) or problem.errno == errno.ENAMETOOLONG:
            reason = problem.strerror if isinstance(problem, OSError) else problem
            raise InputError(path, f"cannot be the name of a file ({reason})") from problem
    return Path(path)


def _kind(mode: int) -> str:
    return next((name for check, name in _KINDS if check(mode)), "a special file")


def _files_in(folder: Path) -> str:
    """Suggestion for a folder that was named for a file: some files in it; empty if there are none."""
    try:
        names = sorted(one.name for one in islice(folder.iterdir(), MAX_BESIDE) if one.is_file())
    except OSError:
        return ""
    return f"it has {', '.join(names[:3])}{', ...' if names[3:] else ''}" if names else ""


def similar_names(path: Path | str) -> str:
    """Suggestion for a missing file: a file in the same folder with a similar name.

    Parameters
    ----------
    path
        A missing file.

    Returns
    -------
    str
        ``did you mean map.yaml?``; empty if there is no similar name.
    """
    path = Path(path)
    try:
        beside = [other.name for other in islice(path.parent.iterdir(), MAX_BESIDE)]
    except (OSError, ValueError):
        return ""
    found = get_close_matches(path.name, [name for name in beside if name != path.name], n=1)
    return f"did you mean {path.parent / found[0]}?" if found else ""


def read_bytes(
    path: Path | str, max_bytes: int = MAX_DATA_BYTES, *, error: type[InputError] = InputError
) -> bytes:
    """Contents of a regular file of at most ``max_bytes``.

    Parameters
    ----------
    path
        The file.
    max_bytes
        Maximum size [bytes].
    error
        Exception class to raise.

    Raises
    ------
    InputError
        As ``error``: see :func:`file_size`; or the file cannot be read.
    """
    size = file_size(path, max_bytes, error=error)
    try:
        with Path(path).open("rb") as stream:
            parts = [stream.read(size)]
            # Kernel files report 0 bytes and contain more; others may grow.
            while size <= max_bytes and (more := stream.read(1 << 20)):
                parts.append(more)
                size += len(more)
    except OSError as problem:
        raise error(path, _unreadable(problem)) from problem
    if size > max_bytes:
        raise error(path, f"has more than {max_bytes} bytes")
    return b"".join(parts)


def read_head(path: Path | str, count: int) -> bytes:
    """First bytes of a regular file, at most ``count``, to identify its format.

    Parameters
    ----------
    path
        The file.
    count
        Number of bytes.

    Raises
    ------
    InputError
        See :func:`file_size`; or the file cannot be read.
    """
    file_size(path)
    try:
        with Path(path).open("rb") as stream:
            return stream.read(count)
    except OSError as problem:
        raise InputError(path, _unreadable(problem)) from problem


def read_text(
    path: Path | str, max_bytes: int = MAX_TEXT_BYTES, *, error: type[InputError] = InputError
) -> str:
    """Text of a UTF-8 file of at most ``max_bytes``, without byte order mark.

    Line endings become ``\\n``, as in files opened in text mode.

    Parameters
    ----------
    path, max_bytes, error
        As in :func:`read_bytes`.

    Raises
    ------
    InputError
        As ``error``: see :func:`read_bytes`; or the file is not UTF-8.
    """
    size = file_size(path, error=error)
    if size > max_bytes and b"\0" in read_head(path, 1024):  # a video, say: its size is not the problem
        found = f"is not UTF-8 text (found a zero byte), and has {size} bytes, expected at most {max_bytes}"
        raise error(path, found)
    try:
        text = read_bytes(path, max_bytes, error=error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(path, f"is not UTF-8 text (byte {problem.start})") from problem
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unreadable(problem: OSError | ValueError) -> str:
    reason = problem.strerror if isinstance(problem, OSError) else problem
    return f"cannot be read ({reason})"
