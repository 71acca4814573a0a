"""Exceptions of this library, one class per cause.

Every message is a single line: what was found, what was expected, where, and how
to fix it. The command line prints that line and exits with code 2.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class _Brief(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        try:
            return super().repr_int(x, level)
        except ValueError:  # Python prints no more than 4,300 digits; a hexadecimal number may have them
            return f"an integer of {x.bit_length()} bits"


_BRIEF = _Brief()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxother, _BRIEF.maxlong = 3, 60, 60, 60
#: Words longer than in any language or number format come from damaged files.
_LONG_WORD = re.compile(r"(\S{60})\S{440,}")
#: Room for a list in a message: with the path and the remedy, the line stays below 1,000 characters.
_LIST_ROOM = 600


def brief(value: object) -> str:
    """The found value, for a message: at most 60 characters, regardless of its size.

    Parameters
    ----------
    value
        Any object.
    """
    # Not repr: with nested aliases it could exhaust the memory.
    return cut(_BRIEF.repr(value), 60)


def cut(text: str, most: int) -> str:
    """A text, with dots in place of what exceeds a length.

    Parameters
    ----------
    text
        From a file.
    most
        Length [characters].
    """
    return text if len(text) <= most else text[: most - 3] + "..."


def brief_list(items: Iterable[str], separator: str = ", ") -> str:
    """Names or problems found in a file, for a message: those that fit into 600 characters, and how many more there are.

    Parameters
    ----------
    items
        Texts; one of more than 200 characters is cut.
    separator
        Between two of them.
    """
    texts = [cut(text, 200) for text in items]
    used = kept = 0
    for text in texts:
        used += len(text) + len(separator)
        if used > _LIST_ROOM:
            break
        kept += 1
    more = [f"and {len(texts) - kept} more"] if kept < len(texts) else []
    return separator.join(texts[:kept] + more)


class VisuohapticError(Exception):
    """Base class of all exceptions that this library raises deliberately.

    Examples
    --------
    >>> try:
    ...     raise InputError("sensor.yaml", "found -1, expected more than 0", field="width_m")
    ... except VisuohapticError as error:
    ...     print(error)
    sensor.yaml: width_m: found -1, expected more than 0
    """


class InputError(VisuohapticError, ValueError):
    """An invalid file, field or argument.

    Parameters
    ----------
    where
        File or function argument.
    problem
        What was found and what was expected.
    field
        Field, column or row inside ``where``; empty for the whole.
    remedy
        How to fix it; empty if the problem already states it.
    """

    def __init__(self, where: object, problem: str, *, field: str = "", remedy: str = "") -> None:
        self.where = str(where)
        self.field = _LONG_WORD.sub(r"\1...", field)
        self.problem = _LONG_WORD.sub(r"\1...", problem)
        self.remedy = remedy
        place = f"{self.where}: {self.field}" if field else self.where
        text = f"{place}: {self.problem}" + (f"; {remedy}" if remedy else "")
        super().__init__(" ".join(text.split()))

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments: default pickling between worker processes would lose them.
        return (_rebuild_input_error, (type(self), self.where, self.problem, self.field, self.remedy))


def _rebuild_input_error(
    cls: type[InputError], where: str, problem: str, field: str, remedy: str
) -> InputError:
    return cls(where, problem, field=field, remedy=remedy)


class CalibrationError(InputError):
    """Calibration data that would give wrong measurements: rejected, with the reason."""


class DatabaseError(VisuohapticError):
    """A database that currently cannot be opened, read or written: full disk, lost server, damage."""


class DeviceError(VisuohapticError):
    """A camera or robot that does not respond as specified."""


class StaleFrameError(DeviceError):
    """The newest frame is older than the caller accepts."""


class MissingExtraError(VisuohapticError, ImportError):
    """An optional library is not installed; the message contains the install command.

    Parameters
    ----------
    module
        Name of the package that cannot be imported.
    extra
        Extra of this library that installs the package.
    purpose
        What the package is needed for.
    """

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        self._found = module, extra, purpose
        super().__init__(
            f"{purpose} needs the package '{module}', which is not installed; "
            f"run: pip install 'visuohaptic[{extra}]'"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), self._found


@contextmanager
def needs(module: str, extra: str, purpose: str) -> Iterator[None]:
    """Context manager for the import of an optional library.

    Parameters
    ----------
    module, extra, purpose
        As in :class:`MissingExtraError`, which is raised if the library is not installed.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(module, extra, purpose) from error
