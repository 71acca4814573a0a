"""The parser of a verb, and the declaration of an argument in one line: name, type or default, and help."""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Callable, Iterable
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn

from ..core.errors import VisuohapticError


class UsageError(VisuohapticError):
    """A command line that cannot be parsed."""


class Parser(argparse.ArgumentParser):
    """argparse with one line for an error instead of the whole usage."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does; also keeps the options that were given, for :meth:`error`.

        Parameters
        ----------
        args
            Words of the command line.
        namespace
            Receives the values.
        """
        self._words = [word.partition("=")[0] for word in args or () if re.match(r"--\w", word)]
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Raise the message of argparse with the verb, a suggestion, and where to read more.

        Parameters
        ----------
        message
            Of argparse.

        Raises
        ------
        UsageError
            Always.
        """
        if message.startswith("the following arguments are required"):
            known = tuple(self._option_string_actions)
            for word in self._words:  # a misspelt option often is why one is missing
                if not any(option.startswith(word) for option in known):
                    message = f"unrecognized arguments: {word}"
                    break
        unknown = re.search(r"unrecognized arguments: (--?[\w-]+)", message)
        if unknown and (near := almost(unknown[1], self._option_string_actions)):
            message += f"; did you mean {near}?"
        raise UsageError(f"{self.prog.partition(' ')[2]}: {message}; see {self.prog} --help")


def almost(name: str, known: Iterable[str]) -> str:
    """The known name that is spelt most like another one; empty if none is similar.

    Parameters
    ----------
    name
        As it was typed.
    known
        Names that exist.
    """
    import difflib

    return next(iter(difflib.get_close_matches(name, list(known), n=1)), "")


class Add:
    """Declares arguments; passed to verbs as ``add``.

    Called with names, then the type or the default, whose type it has then (``bool`` is a switch, ``list`` an option
    that may be repeated, of text or of another ``type``), then the line of help; options as of
    :meth:`argparse.ArgumentParser.add_argument`, and ``low``, ``high`` of a number, ``above`` where ``low`` itself is
    too low. A ``metavar`` of several words takes as many values.

    Parameters
    ----------
    place
        Parser, or a group of it.

    Examples
    --------
    >>> import argparse
    >>> parser = argparse.ArgumentParser()
    >>> add = Add(parser)
    >>> add("--count", 5, "how many")
    >>> add("--plot", Path, "figure to write")
    >>> parser.parse_args(["--count", "3"])
    Namespace(count=3, plot=None)
    """

    def __init__(self, place: Any) -> None:
        self._place = place

    def __call__(self, *words: Any, **more: Any) -> None:
        """Declare one argument.

        Parameters
        ----------
        words
            Names, type or default, help.
        more
            Options of :meth:`argparse.ArgumentParser.add_argument`; of numbers also ``low``, ``high`` and ``above``.
        """
        *names, kind, said = words
        if len(parts := str(more.get("metavar", "")).split()) > 1:
            more |= {"metavar": tuple(parts), "nargs": len(parts)}
        if kind is bool:
            more["action"] = "store_true"
        elif kind is list:
            more |= {"default": [], "action": "append"}
            kind = more.pop("type", str)
        elif not isinstance(kind, type):
            more["default"] = kind
            kind = Path if isinstance(kind, Path) else type(kind)
        if "low" in more:
            kind = _number(kind, more.pop("low"), more.pop("high", math.inf), more.pop("above", False))
        if kind not in (bool, str):
            more.setdefault("type", _no_nan if kind is float else kind)
        self._place.add_argument(*names, help=said, **more)

    def group(self, title: str) -> Add:
        """Arguments under a title of their own.

        Parameters
        ----------
        title
            In the help.
        """
        return Add(self._place.add_argument_group(title))

    def one_of(self, *, required: bool = False) -> Add:
        """Mutually exclusive arguments.

        Parameters
        ----------
        required
            Whether one of them is required.
        """
        return Add(self._place.add_mutually_exclusive_group(required=required))


def _no_nan(text: str) -> float:
    """Parser of a number: comparisons with NaN, as of limits, would all be false."""
    if math.isnan(value := float(text)):
        raise argparse.ArgumentTypeError(f"found {text}, expected a number")
    return value


_no_nan.__name__ = "float"  # as argparse names it


def _number(kind: Callable[[str], Any], low: float, high: float, above: bool) -> Callable[[str], Any]:
    """Parser of a finite number that rejects values out of range."""
    upper = f" to {high:g}" if math.isfinite(high) else "" if above else " or more"

    def number(text: str) -> Any:
        value = kind(text)
        if not (low <= value <= high and math.isfinite(value)) or (above and value == low):
            raise argparse.ArgumentTypeError(f"found {text}, expected {'more than ' * above}{low:g}{upper}")
        return value

    number.__name__ = getattr(kind, "__name__", "number")
    return number


#: Arguments that name a file to write.
_OUTPUTS = ("out", "csv", "parquet", "plot", "page", "sheet", "mask", "steps", "save")
#: Arguments that name a file that may be updated in its place.
_UPDATED = ("beam", "config")


def overwritten_file(args: argparse.Namespace) -> tuple[str, str] | None:
    """An argument that names a file to write, and what else the same file is; None if there is no such argument.

    Parameters
    ----------
    args
        Of a verb.
    """
    files: dict[str, str] = {}
    for name, value in sorted(vars(args).items(), key=lambda item: item[0] in _OUTPUTS):
        for one in value if isinstance(value, list) else [value]:
            if not isinstance(one, (str, Path)) or "\0" in str(one):
                continue
            path = os.path.realpath(one)  # of a text that is no name of a file as well, however long
            if name not in _OUTPUTS:
                if name not in _UPDATED and os.path.isfile(path):
                    files[path] = f"{one}, which is read"
            elif path in files:
                return name, files[path]
            elif not os.path.isdir(path):
                files[path] = f"{one}, which --{name} writes"
    return None


def wrong_argument(args: argparse.Namespace) -> str:
    """What is wrong with an argument of any verb: a negative seed, or a file that would be lost; empty: nothing.

    Parameters
    ----------
    args
        Of a verb.
    """
    if getattr(args, "seed", None) is not None and args.seed < 0:
        return f"--seed: found {args.seed}, expected 0 or more"
    overwritten = overwritten_file(args)
    return f"--{overwritten[0]} would overwrite {overwritten[1]}, choose another name" if overwritten else ""


def check_figure(args: argparse.Namespace) -> None:
    """Reject a ``--plot`` whose suffix is not that of a figure, before anything is computed.

    Parameters
    ----------
    args
        Of a verb.
    """
    if isinstance(plot := getattr(args, "plot", None), Path):
        from ..core.files import FIGURE_SUFFIXES, check_target

        check_target(plot, FIGURE_SUFFIXES)


def given_options(parser: argparse.ArgumentParser, args: argparse.Namespace) -> frozenset[str]:
    """Options whose value is not the default, as ``--plot``.

    Parameters
    ----------
    parser, args
        Of a verb.
    """
    return frozenset(
        one.option_strings[0]
        for one in parser._actions
        if one.option_strings and getattr(args, one.dest, one.default) != one.default
    )


def with_signed_axes(words: list[str]) -> list[str]:
    """Join ``--up -y`` to ``--up=-y``, and write ``-1e-3`` without an exponent: argparse takes both for options.

    Parameters
    ----------
    words
        Of the command line.
    """
    out: list[str] = []
    for word in words:
        if out and out[-1] == "--up" and word in {"-x", "-y", "-z"}:
            out[-1] += f"={word}"
        elif re.fullmatch(r"-(\d+\.?\d*|\.\d+)[eE][-+]?\d{1,3}", word):
            out.append(f"{Decimal(word):f}")
        else:
            out.append(word)
    return out
