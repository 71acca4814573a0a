"""The public names of a package: imported at their first use, functions with a check of their arrays."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any

import lazy_loader

__all__ = ["attach", "public"]


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names stand in its stub file.

    Each name is imported when it is first used.

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
    """What a package gives for a name: a function with arrays checks them first.

    Parameters
    ----------
    package
        Name of the package.
    name
        Public name.
    found
        What the module of the package has under this name.
    """
    if not isinstance(found, FunctionType) or hasattr(found, "arrays_checked"):
        return found
    from .array_guard import guarded

    checked = guarded(found)
    if checked is not found:
        checked.__module__ = package
        # The next use, and pickle, find the same object.
        setattr(sys.modules[package], name, checked)
    return checked
