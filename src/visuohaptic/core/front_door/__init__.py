"""Public names of a package: lazily imported, functions and classes with a check of their arguments."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any

import lazy_loader

__all__ = ["attach", "public"]


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names are listed in its stub file.

    Each name is imported on first use.

    Parameters
    ----------
    package
        ``__name__`` of the package.
    file
        ``__file__`` of the package.
    """
    load, names_of, names = lazy_loader.attach_stub(package, file)

    return lambda name: public(package, name, load(name)), names_of, names


def public(package: str, name: str, found: Any) -> Any:
    """The object that a package exports under a name: functions are wrapped with a check of their arguments.

    So are the creation and the class methods of classes, in place.

    Parameters
    ----------
    package
        Name of the package.
    name
        Public name.
    found
        Object of this name in the package's module.
    """
    if isinstance(found, type) and not issubclass(found, BaseException):
        for kind in found.__mro__:  # class methods may be inherited
            if kind.__module__.startswith("visuohaptic.") and "__init__" in vars(kind):
                from .array_guard import guard_class

                guard_class(kind)
    if not isinstance(found, FunctionType) or hasattr(found, "arguments_checked"):
        return found
    from .array_guard import guarded

    checked = guarded(found)
    checked.__module__ = package
    # Later uses, and pickle, get the same object.
    setattr(sys.modules[package], name, checked)
    return checked
