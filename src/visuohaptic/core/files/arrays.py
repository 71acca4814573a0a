"""Untrusted arrays (NPZ, NPY): the total size in the headers is checked before memory is allocated."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import InputError
from .regular import MAX_DATA_BYTES, file_size


def read_npz(
    path: Path | str, content: str, *, names: Sequence[str] = (), remedy: str = ""
) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file; no code in it is executed.

    Parameters
    ----------
    path
        File as written by :func:`numpy.savez` or :func:`numpy.savez_compressed`.
    content
        Expected content, for messages ("a stiffness map").
    names
        Required arrays.
    remedy
        How to fix invalid content, for messages.

    Returns
    -------
    dict
        Arrays by name; never Python objects.

    Raises
    ------
    InputError
        The file is missing, not a regular file, or damaged, contains Python objects, would unpack to more than
        ``MAX_DATA_BYTES``, or lacks one of ``names``.
    """
    budget = max(MAX_DATA_BYTES, file_size(path))
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if not all(member.filename.endswith(".npy") for member in members):
                raise ValueError("a member that is not an array")
            if len({member.filename for member in members}) < len(members):
                raise ValueError("a name twice")
            for member in members:
                with archive.open(member) as stream:
                    budget -= _array_bytes(stream, member.file_size)
                if budget < 0:
                    raise ValueError(f"unpacks to more than {MAX_DATA_BYTES} bytes")
            arrays = {}
            for member in members:
                with archive.open(member) as stream:
                    arrays[member.filename.removesuffix(".npy")] = _read_array(stream)
    except Exception as error:  # zip, zlib, the header's tokenizer: damaged files raise many types
        raise _unreadable(path, content, error, remedy) from error
    if missing := [name for name in names if name not in arrays]:
        raise InputError(path, f"is missing in {content}", field=missing[0], remedy=remedy)
    return arrays


def read_npy(path: Path | str, content: str) -> np.ndarray:
    """The array of an NPY file; no code in it is executed.

    Parameters
    ----------
    path
        File as written by :func:`numpy.save`.
    content
        Expected content, for messages ("a vector of features").

    Raises
    ------
    InputError
        The file is missing, not a regular file, damaged, or contains Python objects.
    """
    size = file_size(path)
    try:
        with closing(Path(path).open("rb")) as stream:
            _array_bytes(stream, size)
            stream.seek(0)
            return _read_array(stream)
    except Exception as error:  # the header's tokenizer raises many types
        raise _unreadable(path, content, error, "") from error


def _unreadable(path: Path | str, content: str, error: Exception, remedy: str) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    reason = reason if len(reason) <= 100 else reason[:97] + "..."
    return InputError(path, f"is not {content} ({type(error).__name__}: {reason})", remedy=remedy)


def _array_bytes(stream: IO[bytes], size: int) -> int:
    """Size of an array according to its header, which must equal the remaining ``size`` bytes."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"array format {version}, expected 1.0 or 2.0")
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError("Python objects, expected numbers")
    if min(shape, default=0) < 0:
        raise ValueError(f"the shape {shape}")
    needed = math.prod(shape) * dtype.itemsize
    if needed != size - stream.tell():
        raise ValueError(f"the header declares {needed} bytes, found {size - stream.tell()}")
    return needed


def _read_array(stream: IO[bytes]) -> np.ndarray:
    found: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
    return found
