"""Validation of the arguments of public functions and classes.

Inside the library, arrays match their annotations. Functions accessed through the package, as applications do, first check
this: type of numbers, byte order, shape. Kernels given other arrays would read invalid memory.

Other arguments are compared with their annotations only after a call has failed with an error of Python or of another
library: what can be computed is computed, and a wrong type is one line that names the argument.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import numpy as np

from ..errors import InputError, VisuohapticError, brief
from ..ranges import MAX_NUMBER
from .annotations import inner_mismatch, mismatch

_ARRAY = re.compile(
    r"(Float|Float32|Int|Int8|UInt8|Bool)\[np\.ndarray, ['\"]([^'\"]*)['\"]\]((?: \| (?:float|int|None|Sequence\[[\w\[\], ]*\]))*)"
)
_TYPES = {"Float": np.float64, "Float32": np.float32, "Int8": np.int8, "UInt8": np.uint8, "Bool": np.bool_}
_WORDS = {
    "Float": "numbers",
    "Float32": "numbers",
    "Int": "integers",
    "Int8": "int8 values",
    "UInt8": "uint8 values",
    "Bool": "truth values",
}


@dataclass(frozen=True, slots=True)
class _ArraySpec:
    """Requirements for one parameter."""

    where: str  #: function
    field: str  #: parameter
    kind: str  #: type according to jaxtyping
    shape: tuple[str, ...]
    scalar: bool  #: whether a scalar is accepted
    optional: bool  #: whether None is accepted

    def checked(self, value: Any, sizes: dict[str, int]) -> Any:
        """The array as the function expects it; the same object if no conversion is needed."""
        if (value is None and self.optional) or (self.scalar and isinstance(value, float | int | np.number)):
            return value
        array = value
        if type(array) is not np.ndarray:
            if value is None or isinstance(value, str | bytes | dict | set | np.ma.MaskedArray):
                raise self._refused(f"found {brief(value)}")
            try:
                array = np.asarray(value)
            except (TypeError, ValueError) as error:
                raise self._refused(f"found {type(value).__name__} with parts of unequal length") from error
        if self.scalar and array.ndim == 0:
            return value
        array = self._typed(array)
        self._check_shape(array.shape, sizes)
        return array

    def _typed(self, array: np.ndarray) -> np.ndarray:
        dtype = _TYPES.get(self.kind, array.dtype.newbyteorder("="))
        kinds = {"Float": "fiub", "Float32": "fiub", "Int": "iu"}.get(self.kind, np.dtype(dtype).kind)
        if array.dtype.kind not in kinds or (len(kinds) == 1 and array.dtype != dtype):
            raise self._refused(f"found an array of {array.dtype}")
        if array.dtype == dtype:
            return array
        with np.errstate(over="ignore"):
            return array.astype(dtype)

    def _check_shape(self, found: tuple[int, ...], sizes: dict[str, int]) -> None:
        names, left = list(self.shape), list(found)
        free = next((place for place, name in enumerate(names) if name[0] in "*."), None)
        if free is not None and len(left) >= len(names) - 1:
            after = len(names) - 1 - free
            left = left[:free] + left[len(left) - after :]
            del names[free]
        if len(left) != len(names):
            raise self._refused(f"found shape {found}")
        for name, size in zip(names, left, strict=True):
            expected = int(name) if name.isdigit() else sizes.setdefault(name, size)
            if size != expected and (name.isdigit() or name.isidentifier()):
                text = f" with {name} = {expected}" if name.isidentifier() else ""
                raise self._refused(f"found shape {found}{text}")

    def _refused(self, problem: str) -> InputError:
        shape = ", ".join(self.shape) + ("," if len(self.shape) == 1 else "")
        return InputError(self.where, f"{problem}, expected {_WORDS[self.kind]} ({shape})", field=self.field)

    def unsuitable(self, value: Any, error: Exception) -> InputError | None:
        """Why an array of the correct type and shape cannot be used in the computation; None if it is not the cause."""
        if not isinstance(value, np.ndarray):
            return None
        if not value.size:
            return InputError(self.where, f"found no values, shape {value.shape}", field=self.field)
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            return InputError(self.where, "found NaN or infinity, expected finite numbers", field=self.field)
        if value.dtype.kind == "f" and np.abs(value).max() > MAX_NUMBER:
            text = f"found {np.abs(value).max():.3g}, expected at most {MAX_NUMBER:.3g}"
            return InputError(self.where, text, field=self.field)
        if value.dtype.kind in "iu" and (value.min() < 0 or "ind" in str(error)):
            text = f"found integers from {value.min()} to {value.max()}, which are not indices ({error})"
            return InputError(self.where, text, field=self.field)
        if not value.flags.writeable:
            return InputError(
                self.where, "found a read-only array, expected a writable array", field=self.field
            )
        if value.dtype.kind == "f" and value.ndim and (len(value) == 1 or (value == value.flat[0]).all()):
            text = f"found {len(value)} equal rows, expected a shape with an extent"
            return InputError(self.where, text, field=self.field)
        return None


def _is_ours(error: Exception) -> bool:
    """Whether an exception was raised in this library rather than in a dependency."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if isinstance(error, ValueError) and "broadcast" in str(
        error
    ):  # raised by NumPy, without a traceback entry
        return False
    return trace is None or str(trace.tb_frame.f_globals.get("__name__", "")).startswith("visuohaptic")


def _specs(function: Callable[..., Any], where: str) -> list[tuple[int, str, _ArraySpec]]:
    """Position, name and specification of the array parameters."""
    found = []
    for place, (name, parameter) in enumerate(inspect.signature(function).parameters.items()):
        if match := _ARRAY.fullmatch(str(parameter.annotation)):
            kind, shape, others = match.groups()
            spec = _ArraySpec(
                where,
                name,
                kind,
                tuple(shape.split()),
                bool({"float", "int"} & set(others.split(" | "))),
                "None" in others or parameter.default is None,
            )
            found.append((place, name, spec))
    return found


def guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function with a check of its arguments: of arrays before the call, of the others where the call fails.

    Parameters
    ----------
    function
        Function with annotations, those of arrays by jaxtyping.
    """
    specs = _specs(function, function.__name__)

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        sizes: dict[str, int] = {}
        given = list(args)
        for place, name, spec in specs:
            if place < len(given):
                given[place] = spec.checked(given[place], sizes)
            elif name in kwargs:
                kwargs[name] = spec.checked(kwargs[name], sizes)
        try:
            return function(*given, **kwargs)
        except Exception as error:
            if refusal := _refusal(function, function.__name__, specs, given, kwargs, error):
                raise refusal from error
            if specs and not _is_ours(error) and not isinstance(error, VisuohapticError):
                raise InputError(
                    function.__name__, f"cannot be computed from these arrays ({error})"
                ) from error
            raise

    vars(checked)["arguments_checked"] = True
    return checked


def guard_class(made: type) -> None:
    """Let the arguments of a class be checked where its creation or one of its public class methods fails.

    Parameters
    ----------
    made
        Class with its own ``__init__``; others are left as they are.
    """
    create = vars(made).get("__init__")
    if (
        not isinstance(create, FunctionType)
        or hasattr(create, "arguments_checked")
        or getattr(made, "_is_protocol", False)
    ):
        return

    for name, method in list(vars(made).items()):
        if method is create:
            setattr(made, name, _explained(create, made.__name__))
        elif isinstance(method, classmethod) and not name.startswith("_"):
            setattr(made, name, classmethod(_explained(method.__func__, f"{made.__name__}.{name}")))


def _explained(function: Callable[..., Any], where: str) -> Callable[..., Any]:
    """Wrap a function with a check of its arguments where it fails."""

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except Exception as error:
            if refusal := _refusal(function, where, _specs(function, where), args, kwargs, error):
                raise refusal from error
            raise

    vars(checked)["arguments_checked"] = True
    return checked


def _refusal(
    function: Callable[..., Any],
    where: str,
    specs: list[tuple[int, str, _ArraySpec]],
    args: Sequence[Any],
    kwargs: Mapping[str, Any],
    error: Exception,
) -> InputError | None:
    """Which argument is the cause of a foreign error; None if all are as they are annotated.

    An error of ours that has a foreign cause came from a function that was called with this argument.
    """
    if isinstance(error, VisuohapticError) and error.__cause__ is None:
        return None
    try:
        given = inspect.signature(function).bind(*args, **kwargs).arguments
    except TypeError:  # arguments that the function does not have: Python says which
        return None
    arrays = {name: spec for _, name, spec in specs if name in given}
    for name, spec in arrays.items():
        try:
            spec.checked(given[name], {})
        except InputError as refusal:
            return refusal
    if wrong := mismatch(function, {name: value for name, value in given.items() if name not in arrays}):
        name, expected = wrong
        return InputError(where, f"found {brief(given[name])}, expected {expected}", field=name)
    if isinstance(error, VisuohapticError):
        return None
    for name, value in given.items():
        if inside := inner_mismatch(value, name):
            place, found, expected = inside
            return InputError(where, f"found {brief(found)}, expected {expected}", field=place)
    return next((why for name, spec in arrays.items() if (why := spec.unsuitable(given[name], error))), None)
