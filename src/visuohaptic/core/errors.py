"""What can go wrong, one class per cause.

Every message is one line: what was found, what was expected, where, and what
to do. The command line turns each of these into exit code 2 and that line.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = [
    "CalibrationError",
    "DatabaseError",
    "DeviceError",
    "InputError",
    "MissingExtraError",
    "StaleFrameError",
    "VisuohapticError",
    "brief",
    "needs",
]

_BRIEF = reprlib.Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxother, _BRIEF.maxlong = 3, 60, 60, 60
#: A word longer than those of any language or number format is what a damaged file held.
_LONG_WORD = re.compile(r"(\S{60})\S{440,}")


def brief(value: object) -> str:
    """What was found, for a message: at most 60 characters, however much the value holds.

    Parameters
    ----------
    value
        Anything.
    """
    # Not repr: of nested aliases it would be as large as the memory.
    text = _BRIEF.repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class VisuohapticError(Exception):
    """Base of everything that this library raises on purpose.

    Examples
    --------
    >>> try:
    ...     raise InputError("sensor.yaml", "found -1, expected more than 0", field="width_m")
    ... except VisuohapticError as error:
    ...     print(error)
    sensor.yaml: width_m: found -1, expected more than 0
    """


class InputError(VisuohapticError, ValueError):
    """A file, field or argument that cannot be used.

    Parameters
    ----------
    where
        File, or function argument, that was read.
    problem
        What was found and what was expected.
    field
        Field, column or row inside ``where``; empty when the whole is meant.
    remedy
        What to do next; empty when the problem says it already.
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
        # Keyword-only arguments: the default would lose them between worker processes.
        return (_rebuild_input_error, (type(self), self.where, self.problem, self.field, self.remedy))


def _rebuild_input_error(
    cls: type[InputError], where: str, problem: str, field: str, remedy: str
) -> InputError:
    return cls(where, problem, field=field, remedy=remedy)


class CalibrationError(InputError):
    """Calibration data that would give a sensor that lies: refused, with the reason."""


class DatabaseError(VisuohapticError):
    """A database that cannot be opened, read or written now: full disk, lost server, damage."""


class DeviceError(VisuohapticError):
    """A camera or robot that does not answer as promised."""


class StaleFrameError(DeviceError):
    """The newest frame is older than the caller accepts."""


class MissingExtraError(VisuohapticError, ImportError):
    """An optional library that is not installed; the message has the install line.

    Parameters
    ----------
    module
        Name of the package that cannot be imported.
    extra
        Extra of this library that installs it.
    purpose
        What it is needed for.
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
    """Around the import of an optional library.

    Parameters
    ----------
    module, extra, purpose
        As in :class:`MissingExtraError`, which is raised where it is not installed.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(module, extra, purpose) from error
