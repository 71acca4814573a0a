"""Comparison of arguments with the annotations of a function."""

from __future__ import annotations

import collections.abc
import dataclasses
import inspect
import sys
import types
import typing
from collections.abc import Callable, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

#: Elements of a sequence that are compared; an error is explained, not searched for.
_ELEMENTS = 100
#: Records inside each other, as the friction of the tag of an object of a problem, with the tuples between them.
_DEPTH = 5
#: Classes in whose place others are usual.
_ALSO: dict[type, tuple[type, ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    tuple: (collections.abc.Sequence, np.ndarray),
    list: (collections.abc.Sequence,),
    collections.abc.Sequence: (collections.abc.Sequence, np.ndarray),
    Path: (Path, str),
}


def mismatch(function: Callable[..., Any], given: Mapping[str, Any]) -> tuple[str, str] | None:
    """The first argument that does not match its annotation, and what is expected; None if all match.

    Parameters
    ----------
    function
        Function with annotations; those that cannot be evaluated are matched by everything.
    given
        Arguments by name.
    """
    scope = getattr(inspect.unwrap(function), "__globals__", {})
    for name, value in given.items():
        parameter = inspect.signature(function).parameters[name]
        if parameter.annotation is parameter.empty or parameter.kind is parameter.VAR_KEYWORD:
            continue
        hint = _hint(parameter.annotation, scope)
        values = value if parameter.kind is parameter.VAR_POSITIONAL else (value,)
        if not all(_matches(one, hint) for one in values):
            return name, _text(hint)
    return None


def inner_mismatch(value: Any, place: str, depth: int = _DEPTH) -> tuple[str, Any, str] | None:
    """The first field inside the records of an argument that does not match its annotation; None if all match.

    Parameters
    ----------
    value
        Argument: a record of the library, a sequence of records, or anything else, which is passed over.
    place
        Its name.
    depth
        Number of records inside each other that are compared.

    Returns
    -------
    Place of the field, what it is, and what is expected.
    """
    parts: list[tuple[str, Any]] = []
    record: type = type(value)
    if isinstance(value, tuple | list):
        parts = [(f"{place}[{index}]", one) for index, one in enumerate(value[:_ELEMENTS])]
    elif dataclasses.is_dataclass(record) and record.__module__.startswith("visuohaptic."):
        for kind in reversed(record.__mro__):  # an annotation is evaluated where it was written
            scope = vars(sys.modules.get(kind.__module__, types))
            own = vars(kind).get("__annotations__", {})
            fields = (one.name for one in dataclasses.fields(record) if one.init and one.name in own)
            for name in filter(partial(hasattr, value), fields):
                field, hint = getattr(value, name), _hint(own[name], scope)
                if not _matches(field, hint):
                    return f"{place}.{name}", field, _text(hint)
                parts.append((f"{place}.{name}", field))
    inside = (inner_mismatch(one, where, depth - 1) for where, one in parts if depth)
    return next((found for found in inside if found), None)


def _hint(annotation: Any, scope: dict[str, Any]) -> Any:
    """What an annotation says; ``Any`` for a name that is imported for type checkers alone."""
    apart = types.SimpleNamespace(__annotations__={"it": annotation})
    try:
        return typing.get_type_hints(apart, scope)["it"]
    except (NameError, AttributeError, TypeError):
        return Any


def _text(hint: Any) -> str:
    """An annotation as a message shows it."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return " or ".join(_text(one) for one in typing.get_args(hint))
    if isinstance(hint, type) and not typing.get_args(hint):
        return "None" if hint is type(None) else hint.__name__
    return str(hint).replace("collections.abc.", "").replace("typing.", "").replace("visuohaptic.", "")


def _matches(value: Any, hint: Any) -> bool:
    """Whether a value can be what an annotation says; also where this cannot be told."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_matches(value, one) for one in parts)
    if origin is typing.Literal:
        return any(value == one for one in parts if type(value) is type(one))
    if origin is collections.abc.Callable:
        return callable(value)
    kind = origin or hint
    if not isinstance(kind, type) or kind in (Any, object):
        return True
    if kind.__module__.startswith("jaxtyping"):
        return _is_numeric(value)
    if getattr(kind, "_is_protocol", False):
        own = [name for name in {*vars(kind), *kind.__annotations__} if not name.startswith("_")]
        return all(hasattr(value, name) for name in own)
    if not isinstance(value, _ALSO.get(kind, kind)) or (isinstance(value, bool) and kind in (int, float)):
        return False
    if kind in (tuple, list, collections.abc.Sequence):
        return not isinstance(value, str | bytes) and _elements_match(value, parts)
    return True


def _is_numeric(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except ValueError:  # rows of unequal length
        return False


def _elements_match(values: Any, parts: tuple[Any, ...]) -> bool:
    # Functions test sequences of any length for emptiness by their truth value, which arrays do not have.
    if isinstance(values, np.ndarray) and (not values.ndim or Ellipsis in parts):
        return False
    if not parts:
        return True
    if len(parts) == 1 or parts[1] is Ellipsis:
        return all(_matches(one, parts[0]) for one in islice(values, _ELEMENTS))
    return len(values) == len(parts) and all(map(_matches, values, parts))
