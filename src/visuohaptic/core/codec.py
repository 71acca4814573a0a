"""Objects as plain data: a card of texts and numbers, and arrays by name; back again with every field checked.

The card mirrors the data classes field by field and leaves out what is not known. An array is ``{"array":
name}`` in the card and stands apart under that name; a NaN or infinity is the text ``"nan"``, ``"inf"`` or
``"-inf"``, so that the card is strict JSON.
"""

from __future__ import annotations

import hashlib
import json
import math
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Any, cast

import numpy as np

from .errors import InputError, brief
from .objects import Estimate, Geometry, HapticTag, Provenance, Sighting, StiffnessMap, VisuoHapticObject

__all__ = ["Arrays", "arrays_digest", "card_text", "decode", "digest_of", "encode", "order_of"]

#: Arrays by name, of plain number types.
Arrays = dict[str, np.ndarray]

#: Number types that arrays may have.
DTYPES = frozenset(
    {"bool", "uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"}
)
#: Of a haptic tag, what has no sign.
_MAGNITUDES = (
    "static_friction_N",
    "dynamic_friction_N",
    "deceleration_s",
    "deformability",
    "stiffness_N_per_m",
)
#: Noise brings a magnitude below zero by more than this many standard deviations once in 10^9.
_MAX_NOISE = 6.0
#: A contour is what a platform touches at once; farther than any building is long are no coordinates of it.
_MAX_CONTOUR_M = 1e3
_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


def encode(obj: VisuoHapticObject) -> tuple[dict[str, Any], Arrays]:
    """Card and arrays of an object."""
    arrays: Arrays = {}
    return _encode(obj, "", arrays), arrays


def _encode(value: Any, place: str, arrays: Arrays) -> Any:
    kind: type = type(value)
    if kind is str or kind is int or kind is bool:
        return value  # most values: asked for by name, an import is a tenth faster
    if value is None or isinstance(value, (bool, np.bool_)):
        return value if value is None else bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, str):
        return str(value)
    if isinstance(value, (np.ndarray, bytes)):
        array = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.ascontiguousarray(value)
        if _name_of(array.dtype) not in DTYPES:
            raise InputError(place, f"found an array of {array.dtype}, expected numbers")
        arrays[place] = array.astype(array.dtype.newbyteorder("<"), copy=False)
        return {"array": place}
    if kind is dict or isinstance(value, Mapping):
        inside = f"{place}." if place else ""
        return {str(name): _encode(item, f"{inside}{name}", arrays) for name, item in sorted(value.items())}
    if isinstance(value, (tuple, list)):
        return [_encode(item, f"{place}.{index}", arrays) for index, item in enumerate(value)]
    if is_dataclass(value) and not isinstance(value, type):
        inside = f"{place}." if place else ""
        found = {}
        for name, default in _defaults(cast("Hashable", kind)):
            item = getattr(value, name)
            if item is default or (
                isinstance(item, (dict, tuple, Mapping)) and not item and default is not MISSING
            ):
                continue
            found[name] = _encode(item, f"{inside}{name}", arrays)
        return found
    raise InputError(place, f"found {type(value).__name__}, which cannot be stored")


@cache
def _name_of(kind: np.dtype) -> str:
    """Name of a number type; NumPy builds it anew each time, which took a tenth of an import."""
    return kind.name


@cache
def _defaults(kind: Any) -> tuple[tuple[str, Any], ...]:
    return tuple((f.name, f.default if f.default_factory is MISSING else ()) for f in fields(kind))


def decode(card: Any, arrays: Mapping[str, np.ndarray], where: object = "object") -> VisuoHapticObject:
    """The object of a card.

    Raises
    ------
    InputError
        A field is unknown, missing or of the wrong kind or shape.
    """
    return typing.cast(VisuoHapticObject, _reader(VisuoHapticObject)(card, _Context(arrays, where), ""))


class _Context:
    """What the readers share."""

    __slots__ = ("arrays", "where")

    def __init__(self, arrays: Mapping[str, np.ndarray], where: object) -> None:
        self.arrays = arrays
        self.where = where

    def refuse(self, place: str, found: Any, expected: str) -> InputError:
        return InputError(self.where, f"found {brief(found)}, expected {expected}", field=place)


_Reader = Callable[[Any, _Context, str], Any]


@cache
def _reader(hint: Any) -> _Reader:
    """A function that reads a value of this type."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _read_union(tuple(part for part in inner if part is not type(None)), type(None) in inner)
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return _read_mapping(_reader(inner[1]))
    if origin is tuple:
        return _read_tuple(inner)
    if isinstance(hint, type) and is_dataclass(hint):
        return _read_dataclass(hint)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return _read_enum(hint)
    if hint in (str, bool, int, float, bytes):
        return _SCALARS[hint]
    return _read_array(hint)


def _read_union(parts: tuple[Any, ...], optional: bool) -> _Reader:
    if set(parts) == {str, float}:  # a state: a word or a number

        def read_word(value: Any, context: _Context, place: str) -> Any:
            return value if isinstance(value, str) else _read_float(value, context, place)

        return read_word
    read = _reader(parts[0])

    def read_optional(value: Any, context: _Context, place: str) -> Any:
        return None if value is None and optional else read(value, context, place)

    return read_optional


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
            readers[index if count is not None else 0](item, context, f"{place}.{index}")
            for index, item in enumerate(value)
        )

    return read_tuple


def _read_enum(kind: type[StrEnum]) -> _Reader:
    def read_enum(value: Any, context: _Context, place: str) -> Any:
        try:
            return kind(value)
        except ValueError:
            raise context.refuse(place, value, f"one of {', '.join(kind)}") from None

    return read_enum


def _read_dataclass(kind: type) -> _Reader:
    hints = typing.get_type_hints(kind)
    readers = {f.name: _reader(hints[f.name]) for f in fields(kind)}
    needed = {f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}

    def read_dataclass(value: Any, context: _Context, place: str) -> Any:
        if not isinstance(value, dict):
            raise context.refuse(place, value, "a mapping of fields")
        if unknown := sorted(str(name) for name in value.keys() - readers.keys()):
            raise InputError(
                context.where,
                f"unknown field {brief(unknown[0])}",
                field=place,
                remedy="it may come from a newer version",
            )
        if missing := sorted(needed - value.keys()):
            raise InputError(context.where, f"the field {missing[0]!r} is missing", field=place)
        inside = f"{place}." if place else ""
        made = kind(**{name: readers[name](item, context, f"{inside}{name}") for name, item in value.items()})
        if kind in _CHECKS:
            _CHECKS[kind](made, context, place)
        return made

    return read_dataclass


def _read_array(hint: Any) -> _Reader:
    def read_array(value: Any, context: _Context, place: str) -> Any:
        name = value.get("array") if isinstance(value, dict) and len(value) == 1 else None
        if not isinstance(name, str):
            raise context.refuse(place, value, "an array")
        if name not in context.arrays:
            raise InputError(context.where, f"the array {name!r} is missing", field=place)
        array = context.arrays[name]
        if not isinstance(array, hint):
            raise InputError(
                context.where,
                f"found an array of {array.dtype} with shape {array.shape}, "
                f"expected {hint.dtypes[0].rstrip('0123456789')} with shape ({hint.dim_str})",
                field=place,
            )
        return array

    return read_array


def _read_float(value: Any, context: _Context, place: str) -> float:
    if isinstance(value, str) and value in _NOT_FINITE:
        return _NOT_FINITE[value]
    # A card says "nan" where something is not known; a bare .nan is what a broken program writes.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise context.refuse(place, value, "a finite number")
    return float(value)


def _read_int(value: Any, context: _Context, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise context.refuse(place, value, "a whole number")
    return value


def _read_bool(value: Any, context: _Context, place: str) -> bool:
    if not isinstance(value, bool):
        raise context.refuse(place, value, "true or false")
    return value


def _read_str(value: Any, context: _Context, place: str) -> str:
    if not isinstance(value, str):
        raise context.refuse(place, value, "a text")
    return value


def _read_bytes(value: Any, context: _Context, place: str) -> bytes:
    name = value.get("array") if isinstance(value, dict) else None
    if not isinstance(name, str) or name not in context.arrays or context.arrays[name].dtype != np.uint8:
        raise context.refuse(place, value, "an array of bytes")
    return context.arrays[name].tobytes()


_SCALARS: dict[Any, _Reader] = {
    str: _read_str,
    bool: _read_bool,
    int: _read_int,
    float: _read_float,
    bytes: _read_bytes,
}


def _check_mesh(mesh: Geometry | StiffnessMap, context: _Context, place: str) -> None:
    count = 0 if mesh.vertices_m is None else len(mesh.vertices_m)
    if (
        mesh.faces is not None
        and mesh.faces.size
        and not (mesh.faces.min() >= 0 and mesh.faces.max() < count)
    ):
        raise InputError(
            context.where, f"faces name vertices outside of 0..{count - 1}", field=f"{place}.faces"
        )
    if isinstance(mesh, StiffnessMap) and not (
        len(mesh.stiffness_N_per_m) == len(mesh.stiffness_sigma_N_per_m) == count
    ):
        raise InputError(context.where, f"expected one stiffness and sigma for {count} vertices", field=place)


def _check_tag(tag: HapticTag, context: _Context, place: str) -> None:
    """Magnitudes are not negative, but for their noise; a contour fits into a building."""
    for name in _MAGNITUDES:
        found: Estimate | None = getattr(tag, name)
        if found is not None and found.value < -_MAX_NOISE * found.predictive_sigma:
            raise InputError(
                context.where, f"found {found.value:g}, expected >= 0", field=f"{place}.{name}.value"
            )
    contour = tag.deformation_shape_m
    if contour is not None and not (np.abs(contour) <= _MAX_CONTOUR_M).all():
        raise InputError(
            context.where,
            f"expected coordinates within {_MAX_CONTOUR_M:g} m",
            field=f"{place}.deformation_shape_m",
        )


def _check_sighting(seen: Sighting, context: _Context, place: str) -> None:
    numbers = (*seen.position_m, seen.sigma_m, seen.t_s)
    if not all(map(math.isfinite, numbers)) or seen.sigma_m < 0:
        raise InputError(context.where, "expected finite position_m, sigma_m >= 0 and t_s", field=place)


def _check_provenance(origin: Provenance, context: _Context, place: str) -> None:
    if math.isinf(origin.t_s):  # it would win every merge
        raise context.refuse(f"{place}.t_s", origin.t_s, "a finite number")


_CHECKS: dict[type, Callable[[Any, _Context, str], None]] = {
    Geometry: _check_mesh,
    StiffnessMap: _check_mesh,
    HapticTag: _check_tag,
    Provenance: _check_provenance,
    Sighting: _check_sighting,
}


def card_text(card: Any) -> str:
    """The card as JSON, always the same for the same contents."""
    return json.dumps(card, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of arrays with names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"{name}\0{_name_of(array.dtype)}\0{array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).data if array.size else b"")
    return digest.hexdigest()


def digest_of(text: str, arrays_sha256: str) -> str:
    """SHA-256 of a whole object, from its card's text and its arrays."""
    return hashlib.sha256(f"{text}\0{arrays_sha256}".encode()).hexdigest()


def order_of(value: Any) -> str:
    """A key that puts different contents into a fixed order; estimates are left out of it."""
    arrays: Arrays = {}
    card = _encode(_without_estimates(value), "v", arrays)
    return card_text(card) + arrays_digest(arrays)


def _without_estimates(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _without_estimates(item) for name, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        names = (f.name for f in fields(value))
        return {
            name: _without_estimates(item)
            for name in names
            if (item := getattr(value, name)) is not None and not isinstance(item, Estimate)
        }
    return value
