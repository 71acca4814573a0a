"""CDR compared with rosbags, in both directions, for every supported message."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from visuohaptic.core import InputError
from visuohaptic.io.ros._ros_definitions import _PARTS
from visuohaptic.ros.wire import Field, MessageType, Shape, decode, encode, message_type, parse_definition

STORE = get_typestore(Stores.ROS2_JAZZY)
NAMES = [short.replace("/", "/msg/") for short in _PARTS]
TYPES = {"bool": "?", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"}


def number(kind: str) -> str:
    """NumPy's name of a plain type."""
    return TYPES.get(kind) or kind


def random_value(rng: np.random.Generator, kind: MessageType, field: Field) -> Any:
    """Anything that a field can hold."""
    if field.shape is not Shape.ONE:
        count = field.capacity if field.shape is Shape.ARRAY else int(rng.integers(0, 4))
        one = dataclasses.replace(field, shape=Shape.ONE)
        values = [random_value(rng, kind, one) for _ in range(count)]
        plain = not field.nested and field.kind != "string"
        return np.array(values, dtype=number(field.kind)) if plain else values
    if field.nested:
        return random_message(rng, kind, field.kind)
    if field.kind == "string":
        return "".join(rng.choice(list("abcäß€ /"), int(rng.integers(0, 6))))
    if field.kind == "bool":
        return bool(rng.integers(2))
    if field.kind.startswith("float"):
        return float(np.float32(rng.normal()))
    if field.kind == "byte":  # rosbags reads it with a sign, ROS without
        return int(rng.integers(0, 128))
    limits = np.iinfo(number(field.kind))
    return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))


def random_message(rng: np.random.Generator, kind: MessageType, name: str) -> dict[str, Any]:
    return {field.name: random_value(rng, kind, field) for field in kind.parts[name]}


def for_rosbags(kind: MessageType, name: str, message: dict[str, Any]) -> Any:
    """The same message as an object of rosbags."""

    def one(field: Field, value: Any) -> Any:
        if not field.nested:
            return value
        if field.shape is Shape.ONE:
            return for_rosbags(kind, field.kind, value)
        return [for_rosbags(kind, field.kind, item) for item in value]

    return STORE.types[name](**{field.name: one(field, message[field.name]) for field in kind.parts[name]})


def same(ours: Any, theirs: Any) -> bool:
    if dataclasses.is_dataclass(theirs):
        return all(same(value, getattr(theirs, name)) for name, value in vars(ours).items())
    if isinstance(theirs, np.ndarray):
        return bool(np.array_equal(ours, theirs))
    if isinstance(theirs, list):
        return len(ours) == len(theirs) and all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    return bool(ours == theirs)


@pytest.mark.parametrize("name", NAMES)
def test_bytes_are_those_of_rosbags(name: str) -> None:
    kind = message_type(name)
    for seed in range(8):
        message = random_message(np.random.default_rng(seed), kind, name)
        theirs = for_rosbags(kind, name, message)
        assert encode(message, kind) == bytes(STORE.serialize_cdr(theirs, name))


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_bytes_of_rosbags_are_read(name: str, little: bool) -> None:
    kind = message_type(name)
    for seed in range(4):
        theirs = for_rosbags(kind, name, random_message(np.random.default_rng(seed), kind, name))
        raw = bytes(STORE.serialize_cdr(theirs, name, little_endian=little))
        assert same(decode(raw, kind), theirs)


@pytest.mark.parametrize("little", [True, False])
def test_every_primitive_alone_and_in_a_row_has_the_bytes_of_rosbags(little: bool) -> None:
    """Also those that no supported message has as a single value, such as int64."""
    plain = ("bool", "byte", "char", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
    text = "".join(
        f"uint8 before_{kind}\n{kind} one_{kind}\n{kind}[] row_{kind}\n"
        for kind in (*plain, "float32", "float64")
    )
    name = "some_msgs/msg/Plain"
    kind, store = parse_definition(name, text), get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, name))
    for seed in range(4):
        message = random_message(np.random.default_rng(seed), kind, name)
        theirs = store.types[name](**message)
        raw = bytes(store.serialize_cdr(theirs, name, little_endian=little))
        assert same(decode(raw, kind), theirs)
        if little:
            assert encode(message, kind) == raw


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32), st.data())
def test_damaged_bytes_are_an_error_or_a_message(seed: int, data: st.DataObject) -> None:
    """Cut anywhere it is an error; with bytes changed it may be another message, but nothing else happens."""
    kind = message_type("visualization_msgs/msg/MarkerArray")
    raw = encode(random_message(np.random.default_rng(seed), kind, kind.name), kind)
    with pytest.raises(InputError) as caught:
        decode(raw[: data.draw(st.integers(0, len(raw) - 1))], kind, "/markers")
    assert str(caught.value).startswith("/markers: ")
    spoilt = bytearray(raw)
    for _ in range(3):
        spoilt[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(InputError):
        decode(bytes(spoilt), kind)


HEADER = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}


@pytest.mark.parametrize(
    ("name", "message", "words"),
    [
        ("std_msgs/msg/String", {}, "data missing"),
        ("std_msgs/msg/String", {"data": "a", "date": 1}, "date unknown"),
        ("std_msgs/msg/String", {"data": 1}, "data: found 1, expected a string"),
        ("std_msgs/msg/String", {"data": "a\0b"}, "expected a string without NUL characters"),
        ("std_msgs/msg/String", "a", "expected a mapping"),
        ("std_msgs/msg/Header", HEADER | {"stamp": {"sec": 2**31, "nanosec": 0}}, "stamp.sec: found 2147483648"),
        ("std_msgs/msg/Header", HEADER | {"stamp": {"sec": 0.5, "nanosec": 0}}, "stamp.sec: found 0.5, expected int32"),
        ("sensor_msgs/msg/CompressedImage", {"header": HEADER, "format": "", "data": [256]}, "numbers of uint8"),
        ("sensor_msgs/msg/CompressedImage", {"header": HEADER, "format": "", "data": [0.5]}, "numbers of uint8"),
        ("sensor_msgs/msg/CompressedImage", {"header": HEADER, "format": "", "data": 5}, "a row of uint8"),
        ("geometry_msgs/msg/PoseWithCovariance", {"pose": None, "covariance": []}, "pose: found NoneType"),
        ("diagnostic_msgs/msg/DiagnosticArray", {"header": HEADER, "status": 3}, "status: found 3, expected a sequence"),
    ],
)  # fmt: skip
def test_wrong_fields_are_named(name: str, message: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        encode(message, message_type(name))
    assert words in str(caught.value)


def test_bounds_hold() -> None:
    kind = parse_definition("a/B", "string<=2 text\nint8[<=2] few\nint16[2] two\n")
    good = {"text": "ab", "few": [1], "two": [1, 2]}
    assert decode(encode(good, kind), kind).two.tolist() == [1, 2]
    for name, value in (("text", "abc"), ("few", [1, 2, 3]), ("two", [1])):
        with pytest.raises(InputError, match=name):
            encode(good | {name: value}, kind)


def test_a_large_sequence_is_not_copied() -> None:
    kind = message_type("sensor_msgs/msg/CompressedImage")
    raw = encode({"header": HEADER, "format": "jpeg", "data": bytes(1000)}, kind)
    data = decode(raw, kind).data
    assert not data.flags.owndata
    assert data.size == 1000


def test_other_encodings_are_refused() -> None:
    with pytest.raises(InputError, match="expected CDR"):
        decode(b"\x00\x07\x00\x00aaaa", message_type("std_msgs/msg/String"))
