"""Results as standard JSON: no NaN, no Python-specific types."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from typing import Any


def plain(value: Any) -> Any:
    """Convert a result to mappings, lists, numbers, strings and ``None``.

    NaN and infinities become ``None`` because JSON cannot represent them.
    NumPy scalars and arrays, dataclasses, enumerations and paths are
    supported; NumPy itself is not imported for that.

    Parameters
    ----------
    value
        Result of a verb.

    Raises
    ------
    TypeError
        A value has an unsupported type: an error in the verb, not in its input.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, str):
        return str(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if callable(to_list := getattr(value, "tolist", None)):  # NumPy arrays and scalars
        return plain(to_list())
    raise TypeError(f"a result has a value of type {type(value).__name__}, which JSON cannot represent")


def picked(record: Any, names: str) -> dict[str, Any]:
    """Selected attributes of a record, as plain data.

    Parameters
    ----------
    record
        Anything with attributes.
    names
        Names of the attributes, separated by spaces.

    Examples
    --------
    >>> picked(1.5 + 2.5j, "real imag")
    {'real': 1.5, 'imag': 2.5}
    """
    return {name: plain(getattr(record, name)) for name in names.split()}


def dumps(value: Any) -> str:
    """Serialise to one line of JSON.

    Parameters
    ----------
    value
        Result of a verb.
    """
    return json.dumps(plain(value), ensure_ascii=False, allow_nan=False)
