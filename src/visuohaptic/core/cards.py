"""Object cards: the known properties of an object as strict JSON with separate arrays, and content digests.

A card omits unknown properties. ``{"array": name}`` is a reference to the array of that name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .codec import Arrays, dtype_name, encode_record, from_dict
from .objects import Estimate, VisuoHapticObject

__all__ = ["Arrays", "arrays_digest", "card_text", "decode", "digest_of", "encode", "order_of"]

_JSON = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def encode(obj: VisuoHapticObject) -> tuple[dict[str, Any], Arrays]:
    """Card and arrays of an object.

    Parameters
    ----------
    obj
        Object with all its known properties.

    Returns
    -------
    card
        Plain data of the known properties.
    arrays
        Arrays by the names used in the card.
    """
    arrays: Arrays = {}
    return encode_record(obj, arrays), arrays


def decode(card: Any, arrays: Mapping[str, np.ndarray], where: object = "object") -> VisuoHapticObject:
    """Decode an object from its card.

    Parameters
    ----------
    card
        Plain data, as returned by :func:`encode`.
    arrays
        Arrays by name.
    where
        Source file, for messages.

    Raises
    ------
    InputError
        A field is unknown or missing, or has the wrong type or shape.
    """
    return from_dict(VisuoHapticObject, card, arrays=arrays, where=where)


def card_text(card: Any) -> str:
    """The card as JSON; deterministic for the same contents.

    Parameters
    ----------
    card
        Plain data, as returned by :func:`encode`.
    """
    return _JSON.encode(card)


def arrays_digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of arrays, including names, types and shapes.

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
    """SHA-256 of a whole object, from the text of its card and the digest of its arrays.

    Parameters
    ----------
    text
        The card, as returned by :func:`card_text`.
    arrays_sha256
        Digest of the arrays.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    return hashlib.sha256(f"{text}\0{arrays_sha256}".encode()).hexdigest()


def order_of(value: Any) -> str:
    """Sort key for a deterministic order of contents; does not depend on estimates.

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
