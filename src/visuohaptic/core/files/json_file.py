"""Loading of JSON files: regular files of bounded size, with the fields that the parser expects."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError
from .regular import read_text

T = TypeVar("T")


def load_json(
    path: Path | str, what: str, parse: Callable[[Any], T], *, version: int | None = None, remedy: str = ""
) -> T:
    """Load a JSON file and parse its contents.

    Parameters
    ----------
    path
        JSON file, UTF-8.
    what
        Type of file, for messages: ``a classification tree``.
    parse
        Parses the contents; errors that it raises for missing fields or wrong types become a one-line message.
    version
        Required value of the field ``format``; ``None``: files of this type have no such field.
    remedy
        How to fix it, for messages.

    Raises
    ------
    InputError
        The file does not exist, is too large, is not JSON, or lacks fields that ``parse`` expects.
    """
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(path, error.problem, remedy=error.remedy or remedy) from error
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is not valid JSON: {error}", remedy=remedy) from error
    try:
        if version is not None and data["format"] != version:
            raise InputError(path, f"found format {data['format']!r}, expected {version}", remedy=remedy)
        return parse(data)
    except InputError as error:
        if error.remedy or not remedy:
            raise
        raise InputError(error.where, error.problem, field=error.field, remedy=remedy) from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(path, f"is not {what} ({error})", remedy=remedy) from error
