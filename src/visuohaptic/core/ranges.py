"""Checks of values: ranges declared in the metadata of dataclass fields, choices, and arrays of finite numbers.

Examples
--------
>>> from dataclasses import dataclass, field
>>> @dataclass(frozen=True)
... class Grip(Ranged):
...     force_N: float = field(default=2.0, metadata=POSITIVE)
...     friction: float = field(default=0.5, metadata=within(0, 2))
>>> Grip(friction=3.0)
Traceback (most recent call last):
visuohaptic.core.errors.InputError: Grip: friction: found 3.0, expected 0 to 2
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from .errors import InputError, brief

_KEY = "visuohaptic range"
#: Larger numbers are not measurements: their squares overflow.
MAX_NUMBER = 1e150


@dataclass(frozen=True, slots=True)
class _Range:
    low: float
    high: float
    strict: bool  #: the lower bound is exclusive

    @property
    def text(self) -> str:
        if math.isfinite(self.high):
            low, high = f"{self.low:g}", f"{self.high:g}"
            return f"more than {low} and at most {high}" if self.strict else f"{low} to {high}"
        if math.isfinite(self.low):
            return f"more than {self.low:g}" if self.strict else f"at least {self.low:g}"
        return "a finite number"

    def holds(self, value: Any) -> bool:
        try:
            number = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):  # the last: an integer beyond all floats
            return False
        inside = (number > self.low if self.strict else number >= self.low) & (number <= self.high)
        return bool((inside & np.isfinite(number)).all())


def above(low: float, high: float = math.inf) -> Mapping[str, Any]:
    """Metadata of a field that must be finite, greater than ``low`` and at most ``high``.

    Parameters
    ----------
    low, high
        Exclusive lower and inclusive upper bound, in the field's unit.
    """
    return {_KEY: _Range(low, high, True)}


def at_least(low: float) -> Mapping[str, Any]:
    """Metadata of a field that must be finite and at least ``low``.

    Parameters
    ----------
    low
        Smallest allowed value, in the field's unit.
    """
    return {_KEY: _Range(low, math.inf, False)}


def within(low: float, high: float) -> Mapping[str, Any]:
    """Metadata of a field from ``low`` to ``high``, inclusive.

    Parameters
    ----------
    low, high
        Smallest and largest allowed value, in the field's unit.
    """
    return {_KEY: _Range(low, high, False)}


FINITE = at_least(-math.inf)
POSITIVE = above(0.0)
NON_NEGATIVE = at_least(0.0)
#: A time [s]: three thousand years; times since 1970 in milliseconds or nanoseconds are beyond it.
SECONDS = within(-1e11, 1e11)


def check_ranges(instance: Any, others: Mapping[str, Any] | None = None) -> None:
    """Check every dataclass field that declares a range, in a ``__post_init__`` that checks more than these.

    A field whose value and default are ``None`` is not given and passes. Arrays are checked elementwise.

    Parameters
    ----------
    instance
        The dataclass instance.
    others
        Range of the fields that declare none, such as ``POSITIVE``; by default they are not checked.

    Raises
    ------
    InputError
        A value is not a finite number in its range; the message names class and field, what was found and expected.
    """
    for one in fields(instance):
        limits = (one.metadata or others or {}).get(_KEY)
        value = getattr(instance, one.name)
        if limits is None or (value is None and one.default is None):
            continue
        if not limits.holds(value):
            raise InputError(
                type(instance).__name__, f"found {brief(value)}, expected {limits.text}", field=one.name
            )


class Ranged:
    """Base of the dataclasses whose fields declare ranges; they are checked when an instance is created."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_ranges(self)


def check_numbers(where: object, limits: Mapping[str, Any], **values: Any) -> None:
    """Check arguments of a function against one range; ``None`` is not given and passes.

    Parameters
    ----------
    where
        Name of the function or file, for the message.
    limits
        Range, such as ``POSITIVE`` or ``within(0, 1)``.
    **values
        Numbers or arrays by their names; arrays are checked elementwise.

    Raises
    ------
    InputError
        A value is not a finite number in the range; the message names it, what was found and expected.
    """
    for name, value in values.items():
        if value is not None and not limits[_KEY].holds(value):
            found = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
            raise InputError(where, f"found {brief(found)}, expected {limits[_KEY].text}", field=name)


def check_choice(where: object, known: Collection[object], value: object, *, field: str = "") -> None:
    """Check that a value is one of those known.

    Parameters
    ----------
    where
        Name of the function or file, for the message.
    known
        Values that are allowed.
    value
        What was found.
    field
        Name of the value inside ``where``, for the message.

    Raises
    ------
    InputError
        It is not; the message lists the known values.
    """
    try:
        found = value in known
    except (TypeError, ValueError):  # a list has no hash, and an array no truth
        found = False
    if not found:
        raise InputError(
            where, f"found {brief(value)}, expected one of {', '.join(map(str, known))}", field=field
        )


def finite_array(
    where: object, values: Any, *shape: int | None, field: str = "", least: int = 1
) -> Float[np.ndarray, "*shape"]:
    """Finite numbers of a shape whose squares do not overflow, as float64.

    Parameters
    ----------
    where
        Name of the function or file, for the message.
    values
        Anything that numpy turns into an array.
    *shape
        Expected sizes; ``None`` for any number.
    field
        Name of the value inside ``where``, for the message.
    least
        Smallest allowed length.

    Raises
    ------
    InputError
        They are no numbers, the shape is another one, or a number is NaN, infinite or beyond :data:`MAX_NUMBER`.
    """
    try:
        array = np.asarray(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, f"found {brief(values)}, expected numbers", field=field) from error
    known = len(shape) == array.ndim and all(
        size in (None, found) for size, found in zip(shape, array.shape, strict=True)
    )
    largest = float(np.abs(array).max(initial=0.0))  # NaN if one is
    if known and len(array) >= least and largest <= MAX_NUMBER:
        return array
    sizes = ", ".join("n" if size is None else str(size) for size in shape) + "," * (len(shape) == 1)
    wrong = f"{largest:.3g}, more than {MAX_NUMBER:g}" if np.isfinite(largest) else "NaN or infinity"
    found = f"shape {array.shape}" if not known or len(array) < least else wrong
    more = f", n >= {least}" if least > 1 else ""
    raise InputError(where, f"found {found}, expected finite numbers ({sizes}){more}", field=field)


def check_order(instance: Any, low: str, high: str) -> None:
    """Check that one field of a dataclass is less than another.

    Parameters
    ----------
    instance
        The dataclass instance.
    low, high
        Names of the fields.

    Raises
    ------
    InputError
        It is not; names class and field, what was found and expected.
    """
    least, found = getattr(instance, low), getattr(instance, high)
    if not least < found:
        raise InputError(
            type(instance).__name__, f"found {found}, expected more than {low} ({least})", field=high
        )
