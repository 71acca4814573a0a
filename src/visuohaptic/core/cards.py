"""Cards of objects: what is known of an object as strict JSON with arrays apart, and digests of its contents.

A card leaves out what is not known. ``{"array": name}`` stands in it for the array of that name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .codec import Arrays, dtype_name, encode_record, read_record
from .objects import Estimate, VisuoHapticObject

__all__ = ["Arrays", "arrays_digest", "card_text", "decode", "digest_of", "encode", "order_of"]

_JSON = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def encode(obj: VisuoHapticObject) -> tuple[dict[str, Any], Arrays]:
    """Card and arrays of an object.

    Parameters
    ----------
    obj
        With all that is known of it.

    Returns
    -------
    card
        Plain data of what is known.
    arrays
        Its arrays, by the names that stand in the card.
    """
    arrays: Arrays = {}
    return encode_record(obj, arrays), arrays


def decode(card: Any, arrays: Mapping[str, np.ndarray], where: object = "object") -> VisuoHapticObject:
    """The object of a card.

    Parameters
    ----------
    card
        Plain data, as :func:`encode` makes them.
    arrays
        Arrays by name.
    where
        File that they come from, for messages.

    Raises
    ------
    InputError
        A field is unknown, missing or of the wrong kind or shape.
    """
    return read_record(VisuoHapticObject, card, arrays, where)


def card_text(card: Any) -> str:
    """The card as JSON, always the same for the same contents.

    Parameters
    ----------
    card
        Plain data, as :func:`encode` makes them.
    """
    return _JSON.encode(card)


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of arrays with names, types and shapes.

    Parameters
    ----------
    arrays
        Arrays by name.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"{name}\0{dtype_name(array.dtype)}\0{array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).data if array.size else b"")
    return digest.hexdigest()


def digest_of(text: str, arrays_sha256: str) -> str:
    """SHA-256 of a whole object, from its card's text and its arrays.

    Parameters
    ----------
    text
        The card, as :func:`card_text` writes it.
    arrays_sha256
        Digest of its arrays.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    return hashlib.sha256(f"{text}\0{arrays_sha256}".encode()).hexdigest()


def order_of(value: Any) -> str:
    """A key that puts different contents into a fixed order; estimates are left out of it.

    Parameters
    ----------
    value
        Part of an object.
    """
    arrays: Arrays = {}
    card = encode_record(_without_estimates(value), arrays, "v")
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
