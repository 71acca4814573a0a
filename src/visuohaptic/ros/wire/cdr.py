"""CDR, the wire format of ROS 2 messages: encodes mappings to bytes, decodes bytes to objects with fields.

Every value is aligned to its own size, relative to the end of the four-byte header. Strings are preceded by their length
including a terminating zero, sequences by their number of values.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...core.errors import InputError, brief_list
from .message_types import Field, MessageType, Shape

#: Primitive type -> its code in both ``struct`` and NumPy, of equal size in both; all ROS implementations write
#: little-endian.
_CODES = {
    "bool": "B",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_LITTLE = {kind: np.dtype("<" + code) for kind, code in _CODES.items()}
_BIG = {kind: np.dtype(">" + code) for kind, code in _CODES.items()}
_STRUCTS = {order: {kind: struct.Struct(order + code) for kind, code in _CODES.items()} for order in "<>"}
_HEADER = b"\x00\x01\x00\x00"


def encode(message: Mapping[str, Any], kind: MessageType) -> bytes:
    """Encode a message.

    Parameters
    ----------
    message
        Fields by name, nested messages as mappings, sequences as lists, arrays or bytes.
    kind
        Type of the message.

    Raises
    ------
    InputError
        A field is missing, unknown, of the wrong type or out of range; the error names it.
    """
    out = bytearray(_HEADER)
    _write_message(out, message, kind, kind.name, "")
    return bytes(out)


def _write_message(out: bytearray, value: Any, kind: MessageType, name: str, where: str) -> None:
    if not isinstance(value, Mapping):
        raise _wrong(kind, where, value, f"a mapping of the fields of {name}")
    fields = kind.parts[name]
    if len(value) != len(fields) or any(field.name not in value for field in fields):
        names = {field.name for field in fields}
        missing, unknown = sorted(names - set(value)), sorted(set(value) - names)
        raise InputError(
            kind.name,
            f"{', '.join(missing)} missing" if missing else f"{brief_list(map(str, unknown))} unknown",
            field=where.lstrip("."),
        )
    for field in fields:
        _write_field(out, value[field.name], kind, field, f"{where}.{field.name}")


def _write_field(out: bytearray, value: Any, kind: MessageType, field: Field, where: str) -> None:
    if field.shape is Shape.ONE:
        _write_one(out, value, kind, field, where)
        return
    plain = not field.nested and field.kind != "string"
    items = _plain_array(value, kind, field, where) if plain else value
    try:
        count = len(items)
    except TypeError as error:
        raise _wrong(kind, where, value, "a sequence") from error
    limit = field.capacity
    if field.shape is Shape.ARRAY and count != limit:
        raise _wrong(kind, where, value, f"{limit} values, not {count}")
    if field.shape is Shape.BOUNDED and count > limit:
        raise _wrong(kind, where, value, f"at most {limit} values, not {count}")
    if field.shape is not Shape.ARRAY:
        _align(out, 4)
        out += struct.pack("<I", count)
    if plain:
        if count:
            _align(out, items.itemsize)
        out += items.tobytes()
        return
    for place, item in enumerate(items):
        _write_one(out, item, kind, field, f"{where}[{place}]")


def _write_one(out: bytearray, value: Any, kind: MessageType, field: Field, where: str) -> None:
    if field.nested:
        _write_message(out, value, kind, field.kind, where)
    elif field.kind == "string":
        if not isinstance(value, str) or "\0" in value:
            raise _wrong(kind, where, value, "a string without NUL characters")
        data = value.encode()
        if field.text_capacity and len(data) > field.text_capacity:
            raise _wrong(kind, where, value, f"at most {field.text_capacity} bytes of UTF-8")
        _align(out, 4)
        out += struct.pack("<I", len(data) + 1)
        out += data
        out += b"\0"
    else:
        packer = _STRUCTS["<"][field.kind]
        _align(out, packer.size)
        try:
            out += packer.pack(bool(value) if field.kind == "bool" else value)
        except (struct.error, TypeError, OverflowError) as error:
            raise _wrong(kind, where, value, field.kind) from error


def _plain_array(value: Any, kind: MessageType, field: Field, where: str) -> np.ndarray:
    dtype = _LITTLE[field.kind]
    if isinstance(value, (bytes, bytearray, memoryview)):
        if dtype.itemsize != 1:
            raise _wrong(kind, where, value, f"numbers of {field.kind}")
        return np.frombuffer(value, dtype=dtype)
    array = np.asarray(value)
    if array.ndim != 1:
        raise _wrong(kind, where, value, f"a row of {field.kind}")
    if array.dtype == dtype or not array.size:
        return array.astype(dtype, copy=False)
    whole = dtype.kind in "iu"
    if array.dtype.kind not in ("biu" if whole else "biuf"):
        raise _wrong(kind, where, value, f"numbers of {field.kind}")
    if whole:
        limits = np.iinfo(dtype)
        if int(array.min()) < limits.min or int(array.max()) > limits.max:
            raise _wrong(kind, where, value, f"numbers of {field.kind}")
    return array.astype(dtype)


def _align(out: bytearray, size: int) -> None:
    if pad := -(len(out) - len(_HEADER)) % size:
        out += bytes(pad)


def _wrong(kind: MessageType, where: str, value: Any, expected: str) -> InputError:
    found = repr(value) if isinstance(value, (int, float, str, bool)) else type(value).__name__
    return InputError(kind.name, f"found {found[:60]}, expected {expected}", field=where.lstrip("."))


def decode(data: bytes | memoryview, kind: MessageType, where: str = "") -> Any:
    """Decode a message to an object with its fields as attributes.

    Numeric sequences become NumPy arrays that refer to ``data`` without a copy.

    Parameters
    ----------
    data
        CDR with its four-byte encapsulation header.
    kind
        Type of the message.
    where
        Topic or file, for messages.

    Raises
    ------
    InputError
        The data is truncated, or has another encoding.
    """
    return _Reader(data, kind, where or kind.name).message()


class _Reader:
    """Read position in the bytes of one message."""

    __slots__ = ("data", "end", "kind", "place", "structs", "types", "where")

    def __init__(self, data: bytes | memoryview, kind: MessageType, where: str) -> None:
        self.data, self.kind, self.where = memoryview(data), kind, where
        self.end, self.place = len(self.data), len(_HEADER)
        head = bytes(self.data[:2])
        if self.end < len(_HEADER) or head not in (b"\x00\x00", b"\x00\x01"):
            raise InputError(where, f"begins with {head!r}, expected CDR (00 00 or 00 01)")
        little = head[1] == 1
        self.types, self.structs = (_LITTLE, _STRUCTS["<"]) if little else (_BIG, _STRUCTS[">"])

    def message(self) -> Any:
        return self._message(self.kind.name)

    def _message(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(**{field.name: self._field(field) for field in self.kind.parts[name]})

    def _field(self, field: Field) -> Any:
        if field.shape is Shape.ONE:
            return self._one(field)
        count = field.capacity if field.shape is Shape.ARRAY else self._number("uint32")
        if field.shape is Shape.BOUNDED and count > field.capacity:
            raise self._damaged(f"{field.name} has {count} values, at most {field.capacity} are allowed")
        if field.nested or field.kind == "string":
            # Each element has at least one byte: a corrupted count must not exhaust the memory.
            self._check(count, field.name)
            return [self._one(field) for _ in range(count)]
        dtype = self.types[field.kind]
        if count:
            self._align(dtype.itemsize)
        self._check(count * dtype.itemsize, field.name)
        values = np.frombuffer(self.data, dtype=dtype, count=count, offset=self.place)
        self.place += count * dtype.itemsize
        return values.astype(bool) if field.kind == "bool" else values

    def _one(self, field: Field) -> Any:
        if field.nested:
            return self._message(field.kind)
        if field.kind == "string":
            length = self._number("uint32")
            self._check(length, field.name)
            text = bytes(self.data[self.place : self.place + length])
            self.place += length
            return text.removesuffix(b"\0").decode(errors="replace")
        value = self._number(field.kind)
        return bool(value) if field.kind == "bool" else value

    def _number(self, kind: str) -> Any:
        packer = self.structs[kind]
        self._align(packer.size)
        self._check(packer.size, kind)
        (value,) = packer.unpack_from(self.data, self.place)
        self.place += packer.size
        return value

    def _align(self, size: int) -> None:
        self.place += -(self.place - len(_HEADER)) % size

    def _check(self, length: int, name: str) -> None:
        if self.place + length > self.end:
            raise self._damaged(f"{name} needs {length} bytes, {max(0, self.end - self.place)} are left")

    def _damaged(self, problem: str) -> InputError:
        return InputError(self.where, f"is a damaged {self.kind.name}: {problem}")
