"""The gate of JSON files: regular, of bounded size, and of the fields that their reader takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError
from .regular import read_text

__all__ = ["MAX_JSON_BYTES", "load_json"]

#: Files larger than this are refused before they are parsed (bytes).
MAX_JSON_BYTES = 256 * 1024 * 1024

T = TypeVar("T")


def load_json(
    path: Path | str,
    what: str,
    parse: Callable[[Any], T],
    *,
    version: int | None = None,
    remedy: str = "",
) -> T:
    """What a function makes of the contents of a file.

    Parameters
    ----------
    path
        JSON file, UTF-8.
    what
        Kind of file, for messages: ``a classification tree``.
    parse
        Takes the contents; what it raises of fields that are missing or of another type becomes one line.
    version
        Field ``format`` that the file must have; ``None``: files of this kind have none.
    remedy
        What to do next, for messages.

    Raises
    ------
    InputError
        There is no such file, it is too large, not JSON, or has not the fields that ``parse`` takes.
    """
    try:
        text = read_text(path, MAX_JSON_BYTES)
    except InputError as error:
        raise InputError(path, error.problem, remedy=error.remedy or remedy) from error
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is not valid JSON: {error}", remedy=remedy) from error
    try:
        if version is not None and data["format"] != version:
            raise InputError(path, f"found format {data['format']!r}, expected {version}")
        return parse(data)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(path, f"is not {what} ({error})", remedy=remedy) from error
