"""Structure of a ROS 2 message type, and its type hash (REP-2016, RIHS01)."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from ...core.errors import InputError
from ...io.ros._ros_definitions import definition

#: Placeholder for the hash in Humble, which has none.
NO_HASH = "TypeHashNotSupported"

#: ``type_description_interfaces/FieldType`` of each type allowed in a ``.msg`` file.
_TYPE_IDS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,  # of a .msg file; a character in IDL has another id
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_NESTED, _BOUNDED_STRING = 1, 21

_FIELD = re.compile(
    r"(?P<kind>[A-Za-z][\w/]*)(?:<=(?P<text>\d+))?"
    r"(?P<array>\[(?:<=(?P<bound>\d+)|(?P<count>\d+))?\])?\s+(?P<name>[a-z]\w*)\s*(?P<rest>.*)"
)
_CONSTANT = re.compile(r"[A-Za-z]\w*(?:<=\d+)?\s+[A-Z]\w*\s*=")


class Shape(IntEnum):
    """Number of values of a field; the numbers are the offsets of the type's id."""

    ONE = 0
    ARRAY = 48  #: a fixed number
    BOUNDED = 96  #: up to a number
    SEQUENCE = 144  #: any number


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message."""

    name: str
    kind: str  #: a primitive type such as ``float64``, or a message such as ``std_msgs/msg/Header``
    shape: Shape = Shape.ONE
    capacity: int = 0  #: capacity of an array or a bounded sequence
    text_capacity: int = 0  #: capacity of a bounded string; 0 = any length

    @property
    def nested(self) -> bool:
        """Whether the field is itself a message."""
        return "/" in self.kind


@dataclass(frozen=True, slots=True, eq=False)
class MessageType:
    """A message type with all nested message types."""

    name: str  #: for example ``geometry_msgs/msg/WrenchStamped``
    parts: Mapping[str, tuple[Field, ...]]  #: its fields, and those of all nested messages

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of the message itself."""
        return self.parts[self.name]

    def type_hash(self) -> str:
        """``RIHS01_`` and the SHA-256 of its description (REP-2016).

        Includes names and types of all fields, but not comments, constants and default values.
        """
        described = {name: _description(name, fields) for name, fields in self.parts.items()}
        whole = {
            "type_description": described.pop(self.name),
            "referenced_type_descriptions": [described[name] for name in sorted(described)],
        }
        return "RIHS01_" + hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def _description(name: str, fields: tuple[Field, ...]) -> dict[str, Any]:
    return {
        "type_name": name,
        "fields": [
            {
                "name": field.name,
                "type": {
                    "type_id": field.shape + _type_id(field),
                    "capacity": field.capacity,
                    "string_capacity": field.text_capacity,
                    "nested_type_name": field.kind if field.nested else "",
                },
            }
            for field in fields
        ],
    }


def _type_id(field: Field) -> int:
    if field.nested:
        return _NESTED
    return _BOUNDED_STRING if field.text_capacity else _TYPE_IDS[field.kind]


@functools.cache
def message_type(datatype: str) -> MessageType:
    """A standard message type supported by this library.

    Parameters
    ----------
    datatype
        Such as ``std_msgs/msg/String``.

    Raises
    ------
    InputError
        It is not supported; the error lists all supported types.

    Examples
    --------
    >>> message_type("std_msgs/msg/String").type_hash()[:14]
    'RIHS01_df668c7'
    """
    return parse_definition(datatype, definition(datatype))


def parse_definition(datatype: str, text: str) -> MessageType:
    """Parse a ``ros2msg`` text: the message, then nested ones, each after a line ``MSG: package/Name``.

    Parameters
    ----------
    datatype
        Such as ``std_msgs/msg/String``.
    text
        Definition in the ``ros2msg`` encoding of MCAP.

    Raises
    ------
    InputError
        A line is invalid, or a nested message is missing.
    """
    name = _full_name(datatype, "")
    parts: dict[str, list[Field]] = {name: []}
    now = name
    for number, raw in enumerate(text.splitlines(), start=1):
        line = _without_comment(raw).strip()
        if not line or set(line) == {"="}:
            continue
        if line.startswith("MSG:"):
            now = _full_name(line[4:].strip(), "")
            parts[now] = []
        elif not _CONSTANT.match(line):
            parts[now].append(_field(line, now, f"{datatype}, line {number}"))
    for owner, fields in parts.items():
        if not fields:  # like rosidl: C has no empty structs
            fields.append(Field("structure_needs_at_least_one_member", "uint8"))
        for field in fields:
            if field.nested and field.kind not in parts:
                raise InputError(datatype, f"the definition of {field.kind} in {owner} is missing")
    return MessageType(name, {key: tuple(fields) for key, fields in _used(name, parts).items()})


def _used(name: str, parts: Mapping[str, list[Field]]) -> dict[str, list[Field]]:
    """Messages reachable from one message; a hash must not depend on unrelated definitions in a text."""
    found: dict[str, list[Field]] = {}
    waiting = [name]
    while waiting:
        now = waiting.pop()
        if now not in found:
            found[now] = parts[now]
            waiting += [field.kind for field in parts[now] if field.nested]
    return found


def _without_comment(line: str) -> str:
    """Remove a comment: cut at the first ``#`` that is not inside a quoted default."""
    quote = ""
    for place, letter in enumerate(line):
        if letter in "'\"":
            quote = "" if quote == letter else quote or letter
        elif letter == "#" and not quote:
            return line[:place]
    return line


def _field(line: str, owner: str, where: str) -> Field:
    match = _FIELD.fullmatch(line)
    if match is None:
        raise InputError(where, f"found {line!r}, expected 'type name'")
    kind, package = match["kind"], owner.split("/")[0]
    if kind not in _TYPE_IDS:
        if kind in ("wstring", "time", "duration", "int128", "uint128"):
            raise InputError(where, f"the type {kind} is not supported")
        kind = "std_msgs/msg/Header" if kind == "Header" else _full_name(kind, package)
    text = int(match["text"] or 0)
    if text and kind != "string":
        raise InputError(where, f"found {line!r}; only a string has a bound of its length")
    if match["bound"]:
        return Field(match["name"], kind, Shape.BOUNDED, int(match["bound"]), text)
    if match["count"]:
        return Field(match["name"], kind, Shape.ARRAY, int(match["count"]), text)
    shape = Shape.SEQUENCE if match["array"] else Shape.ONE
    return Field(match["name"], kind, shape, 0, text)


def _full_name(name: str, package: str) -> str:
    words = name.split("/")
    if len(words) == 1 and package:
        words = [package, *words]
    if len(words) == 2:
        words = [words[0], "msg", words[1]]
    if len(words) != 3 or not all(re.fullmatch(r"[A-Za-z]\w*", word) for word in words):
        raise InputError("datatype", f"found {name!r}, expected a name as std_msgs/msg/String")
    return "/".join(words)
