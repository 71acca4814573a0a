"""Run by ``test_extras.py`` in a process of its own: every verb's examples where only the core is installed.

Prints a JSON list of ``{"verb", "words", "declared", "code", "error", "written"}``.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import io
import json
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType, ModuleType, SimpleNamespace
from unittest import mock

from tests.cli.help_words import examples

from visuohaptic.cli._extras import CORE, OPTIONAL, needs


class CoreOnly:
    """A finder that knows nothing outside the core and what the core brings itself."""

    def __init__(self, packages: Sequence[str]) -> None:
        core = _closure(packages)
        brings = importlib.metadata.packages_distributions()
        self.blocked = {module for module, made_by in brings.items() if not core & set(map(_plain, made_by))}
        self.blocked |= {library.module for library in OPTIONAL}  # one that is a single library is not listed
        self.blocked -= {"visuohaptic", "tests"}

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> None:
        if name.partition(".")[0] in self.blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _closure(packages: Sequence[str]) -> set[str]:
    """Names of packages, and of all that they require without extras."""
    found: set[str] = set()
    left = [_plain(name) for name in packages]
    while left:
        name = left.pop()
        if name in found:
            continue
        found.add(name)
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            for requirement in importlib.metadata.requires(name) or ():
                if "extra ==" not in requirement:
                    left.append(_plain(re.split(r"[^\w.-]", requirement, maxsplit=1)[0]))
    return found


@contextlib.contextmanager
def interrupted(patience_s: float = 3.0, work_s: float = 0.5) -> Iterator[list[int]]:
    """Ctrl-C for what needs the core only, finds what it needs and waits or computes; the list tells that it came.

    All imports of the same words up to their end are held against what the verb declares in ``test_help_examples.py``.
    """
    came: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.default_int_handler(number, frame)

    timers = ((signal.ITIMER_REAL, signal.SIGALRM, patience_s), (signal.ITIMER_PROF, signal.SIGPROF, work_s))
    for timer, number, seconds in timers:
        signal.signal(number, stop)
        signal.setitimer(timer, seconds)
    try:
        yield came
    finally:
        for timer, _, _ in timers:
            signal.setitimer(timer, 0.0)


def main() -> None:
    from visuohaptic.cli.main import VERBS, verb_parser
    from visuohaptic.cli.main import main as command

    sys.meta_path.insert(0, CoreOnly([library.package for library in CORE]))  # type: ignore[arg-type]
    from visuohaptic.cli.verbs.system import doctor, warmup

    # Each module that is warmed up is imported, and compiles nothing here; the doctor asks two processes.
    warm = SimpleNamespace(import_module=lambda name: importlib.import_module(name) and mock.Mock())
    found = []
    with (
        mock.patch.object(warmup, "importlib", warm),
        mock.patch.multiple(doctor, CORE=CORE[:1], OPTIONAL=()),
    ):
        for verb, (module_name, _) in VERBS.items():
            module = importlib.import_module(module_name)
            for words in examples(verb):
                if " ".join(words[: len(verb.split())]) != verb:
                    continue  # the next step, an example of another verb
                args = verb_parser(verb, module).parse_args(words[len(verb.split()) :])
                out, error = io.StringIO(), io.StringIO()
                with (
                    contextlib.redirect_stdout(out),
                    contextlib.redirect_stderr(error),
                    interrupted() as came,
                ):
                    code = command(words)
                found.append(
                    {
                        "verb": verb,
                        "words": words,
                        "declared": sorted(needs(module, args)),
                        # A compiler that is interrupted may end with an error of its own.
                        "code": 130 if came else code,
                        "error": "" if came else error.getvalue(),
                        "written": sorted(map(str, Path().iterdir())),
                    }
                )
    print(json.dumps(found))


if __name__ == "__main__":
    main()
