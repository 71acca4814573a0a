"""Conversion of dataclasses to plain data and back with a check of every field: for YAML, JSON, cards and traces.

Plain data are mappings, lists, strings, numbers, booleans and null. NaN and infinity become the strings ``"nan"``,
``"inf"`` and ``"-inf"``, so that the text is strict JSON. :func:`to_dict` writes all fields, arrays as nested
lists; :func:`from_dict` reads any dataclass according to its field annotations:

- a field that is null or absent takes its default; without a default, it is reported as missing
- unknown fields and values of the wrong type are rejected
- a number may be a string, as YAML 1.1 reads ``1e-3``; an integer may be written ``2.0``
- a dataclass with a class method ``from_number`` may be a single number
- a method ``check_read`` of a dataclass is called to validate it; it raises :class:`.InputError` with the field
"""

from __future__ import annotations

import contextlib
import math
import sys
import types
import typing
from collections.abc import Callable, Hashable, Mapping, Sequence, Sized
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from typing import Any, TypeVar, cast

import numpy as np

from .errors import InputError, brief

#: Arrays by name, with plain numeric types.
Arrays = dict[str, np.ndarray]

RecordT = TypeVar("RecordT")

#: Numeric types allowed for arrays.
DTYPES = frozenset(
    {"bool", "uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"}
)
#: Types whose values are their own encoding.
_PLAIN = frozenset({type(None), str, int, bool})
_MAX_FLOAT = sys.float_info.max
_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


def to_dict(record: Any) -> dict[str, Any]:
    """Convert a dataclass instance or mapping to plain data: all of its fields, arrays as nested lists.

    Parameters
    ----------
    record
        Mapping or dataclass instance whose fields are numbers, strings, enumerations, numeric arrays, tuples,
        mappings with string keys, or such dataclasses.

    Raises
    ------
    InputError
        A field contains something else; the message names the field.
    """
    return cast("dict[str, Any]", encode_record(record, None))


def from_dict(
    kind: type[RecordT],
    data: Any,
    *,
    where: object = "",
    place: str = "",
    arrays: Mapping[str, np.ndarray] | None = None,
) -> RecordT:
    """Create a dataclass instance from plain data, as written by :func:`to_dict` or :func:`encode_record`.

    Parameters
    ----------
    kind
        The dataclass.
    data
        Mapping of its fields, as loaded from YAML or JSON.
    where
        Source file or argument, for messages; by default the name of the dataclass.
    place
        Field that ``data`` represents, for messages; empty for the top level.
    arrays
        Separately stored arrays by their path.

    Raises
    ------
    InputError
        A field is unknown, missing, of the wrong type or out of range: one line with its location.
    """
    reader = _reader(cast("Hashable", kind))
    return cast(RecordT, reader(data, _Context(arrays or {}, where or kind.__name__), place))


def encode_record(value: Any, arrays: Arrays | None, place: str = "") -> Any:
    """Plain data of a value; without ``arrays``, all fields are written, and arrays become lists.

    Parameters
    ----------
    value
        As of :func:`to_dict`.
    arrays
        Filled: array by its path; fields with their default value are omitted.
    place
        Path of the value, before those of its fields.
    """
    kind: Any = type(value)
    if kind in _PLAIN or (kind is float and math.isfinite(value)):
        return value
    if (known := _defaults(kind)) is not None:
        found = {}
        for name, default in known:
            item = getattr(value, name)
            if arrays is None or not (
                item is default or (default == () and isinstance(item, Sized) and not len(item))
            ):
                # Most values are plain; without this shortcut an import takes a quarter longer.
                inner = type(item)
                if not (inner in _PLAIN or (inner is float and math.isfinite(item))):
                    item = encode_record(item, arrays, f"{place}.{name}" if place else name)
                found[name] = item
        return found
    if isinstance(value, (np.ndarray, bytes)):
        array = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.ascontiguousarray(value)
        if dtype_name(array.dtype) not in DTYPES:
            raise InputError(place, f"found an array of {array.dtype}, expected numbers")
        if arrays is None:
            return encode_record(array.tolist(), arrays, place)
        arrays[place] = array.astype(_little_endian(array.dtype), copy=False)
        return {"array": place}
    if isinstance(value, Enum):
        return encode_record(value.value, arrays, place)
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, str):
        return str(value)
    if isinstance(value, Mapping):
        items = value.items() if arrays is None else sorted(value.items())
        inside = f"{place}." if place else ""
        return {str(name): encode_record(item, arrays, f"{inside}{name}") for name, item in items}
    if isinstance(value, (tuple, list)):
        return [encode_record(item, arrays, f"{place}.{index}") for index, item in enumerate(value)]
    raise InputError(
        place or "to_dict",
        f"found {kind.__name__}, expected numbers, texts, arrays, tuples, mappings and dataclasses",
    )


@cache
def dtype_name(kind: np.dtype) -> str:
    """Name of a numeric type; cached, because NumPy rebuilds it each time, which took a fifth of an import.

    Parameters
    ----------
    kind
        Type of an array.
    """
    return kind.name


@cache
def _little_endian(kind: np.dtype) -> np.dtype:
    return kind.newbyteorder("<")


@cache
def _defaults(kind: Any) -> tuple[tuple[str, Any], ...] | None:
    """Fields of a dataclass with their defaults, else ``None``; ``()`` if the default is an empty mapping, list or tuple."""
    if not is_dataclass(kind):
        return None
    empty = {dict: (), list: (), tuple: ()}
    return tuple((f.name, empty.get(cast("Any", f.default_factory), f.default)) for f in fields(kind))


@dataclass(frozen=True, slots=True)
class _Context:
    """State shared by the readers."""

    arrays: Mapping[str, np.ndarray]
    where: object

    def refuse(self, place: str, found: Any, expected: str) -> InputError:
        return InputError(self.where, f"found {brief(found)}, expected {expected}", field=place)


_Reader = Callable[[Any, _Context, str], Any]


@cache
def _reader(hint: Any) -> _Reader:
    """A function that reads a value of this type."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return lambda value, context, place: value
    if origin in (typing.Union, types.UnionType):
        return _read_union(tuple(part for part in inner if part is not type(None)), type(None) in inner)
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return _read_mapping(_reader(inner[1]))
    if origin is tuple:
        return _read_tuple(inner)
    if isinstance(hint, type) and is_dataclass(hint):
        return _read_dataclass(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _read_choice(hint, [one.value for one in hint])
    if origin is typing.Literal:
        return _read_choice(lambda value: inner[inner.index(value)], inner)
    if hint in (str, bool, int, float, bytes):
        return _SCALARS[hint]
    return _read_array(hint)


def _read_union(parts: tuple[Any, ...], optional: bool) -> _Reader:
    readers = [_reader(part) for part in parts]

    def read_union(value: Any, context: _Context, place: str) -> Any:
        """The first alternative that accepts the value; for a state, strings are tried before numbers."""
        if value is None and optional:
            return None
        for read in readers[:-1]:
            try:
                return read(value, context, place)
            except InputError:
                continue
        return readers[-1](value, context, place)

    return read_union


def _read_mapping(read: _Reader) -> _Reader:
    def read_mapping(value: Any, context: _Context, place: str) -> Any:
        if not isinstance(value, dict):
            raise context.refuse(place, value, "a mapping")
        return {str(name): read(item, context, f"{place}.{name}") for name, item in value.items()}

    return read_mapping


def _read_tuple(inner: tuple[Any, ...]) -> _Reader:
    count = None if len(inner) == 2 and inner[1] is Ellipsis else len(inner)
    readers = [_reader(part) for part in inner if part is not Ellipsis]

    def read_tuple(value: Any, context: _Context, place: str) -> Any:
        if not isinstance(value, (list, tuple)) or (count is not None and len(value) != count):
            raise context.refuse(place, value, f"a list of {count if count is not None else 'entries'}")
        return tuple(
            readers[index if count is not None else 0](item, context, f"{place}[{index}]")
            for index, item in enumerate(value)
        )

    return read_tuple


def _read_choice(choose: Callable[[Any], Any], values: Sequence[Any]) -> _Reader:
    """One of a set of values: members of an enumeration, or strings of a ``Literal``."""

    def read_choice(value: Any, context: _Context, place: str) -> Any:
        try:
            return choose(value)
        except ValueError:
            raise context.refuse(place, value, f"one of {', '.join(map(str, values))}") from None

    return read_choice


def _read_dataclass(kind: Any) -> _Reader:
    hints = typing.get_type_hints(kind)
    readers = {f.name: _reader(hints[f.name]) for f in fields(kind) if f.init}
    needed = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
    nullable = {name for name in readers if hints[name] is Any or type(None) in typing.get_args(hints[name])}
    from_number = getattr(kind, "from_number", None)
    check = getattr(kind, "check_read", None)

    def read_fields(value: Any, context: _Context, place: str) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise context.refuse(place, value, "a mapping of fields")
        inside = f"{place}." if place else ""
        for name in value:
            if name not in readers:
                raise InputError(
                    context.where,
                    f"is unknown, expected one of {', '.join(readers)}",
                    field=f"{inside}{name}",
                    remedy="it may come from a newer version",
                )
        for name in needed:
            if name not in value or (value[name] is None and name not in nullable):
                raise InputError(context.where, "is missing", field=f"{inside}{name}")
        return {
            name: readers[name](item, context, f"{inside}{name}")
            for name, item in value.items()
            if item is not None or name in nullable
        }

    def read_dataclass(value: Any, context: _Context, place: str) -> Any:
        if from_number is not None and isinstance(value, (int, float, str)):
            make = partial(from_number, _read_float(value, context, place))
        else:
            make = partial(kind, **read_fields(value, context, place))
        try:
            made = make()
            if check is not None:
                check(made)
        except InputError as error:
            field = ".".join(part for part in (place, error.field) if part)
            raise InputError(context.where, error.problem, field=field, remedy=error.remedy) from error
        return made

    return read_dataclass


def _read_array(hint: Any) -> _Reader:
    def read_array(value: Any, context: _Context, place: str) -> Any:
        if isinstance(value, (list, tuple)):
            return read_list(value, context, place)
        name = value.get("array") if isinstance(value, dict) and len(value) == 1 else None
        if not isinstance(name, str):
            raise context.refuse(place, value, "an array of numbers")
        if name not in context.arrays:
            raise InputError(context.where, f"the array {name!r} is missing", field=place)
        return checked(context.arrays[name], context, place)

    read_entry: _Reader = _read_int
    kind: type = np.int64
    if "float64" in hint.dtypes:
        read_entry, kind = _read_float, np.float64
    elif any(name.startswith("bool") for name in hint.dtypes):
        read_entry, kind = _SCALARS[bool], np.bool_

    def read_list(value: Any, context: _Context, place: str) -> Any:
        def numbers(entry: Any) -> Any:
            if isinstance(entry, (list, tuple)):
                return [numbers(one) for one in entry]
            return read_entry(entry, context, place)

        try:
            array: np.ndarray = np.array(numbers(value), dtype=kind)
        except InputError:
            raise
        except (ValueError, OverflowError, RecursionError) as error:  # ragged, too large or too deep
            raise context.refuse(place, value, "an array of numbers") from error
        return checked(array, context, place)

    def checked(array: np.ndarray, context: _Context, place: str) -> np.ndarray:
        if not isinstance(array, hint):
            raise InputError(
                context.where,
                f"found an array of {array.dtype} with shape {array.shape}, "
                f"expected {hint.dtype.__name__.lower()} with shape ({hint.dim_str})",
                field=place,
            )
        return array

    return read_array


def _read_float(value: Any, context: _Context, place: str) -> float:
    if isinstance(value, str):
        if value in _NOT_FINITE:
            return _NOT_FINITE[value]
        with contextlib.suppress(ValueError):
            value = float(value)  # YAML 1.1 reads 1e-3 as a string
    # A card says "nan" for unknown values; an unquoted .nan comes from a faulty program.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _MAX_FLOAT:
        raise context.refuse(place, value, "a finite number")
    return float(value)


def _read_int(value: Any, context: _Context, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value // 1:
        raise context.refuse(place, value, "a whole number")
    return int(value)


def _read_instance(kind: type, expected: str) -> _Reader:
    def read_instance(value: Any, context: _Context, place: str) -> Any:
        if not isinstance(value, kind):
            raise context.refuse(place, value, expected)
        return value

    return read_instance


def _read_bytes(value: Any, context: _Context, place: str) -> bytes:
    name = value.get("array") if isinstance(value, dict) else None
    if not isinstance(name, str) or name not in context.arrays or context.arrays[name].dtype != np.uint8:
        raise context.refuse(place, value, "an array of bytes")
    return context.arrays[name].tobytes()


_SCALARS: dict[Any, _Reader] = {
    str: _read_instance(str, "a text"),
    bool: _read_instance(bool, "true or false"),
    int: _read_int,
    float: _read_float,
    bytes: _read_bytes,
}
