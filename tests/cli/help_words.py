"""The examples that ``--help`` shows, and which optional modules a command line imports."""

from __future__ import annotations

import builtins
import contextlib
import importlib
import shlex
from collections.abc import Iterator, Sequence
from typing import Any
from unittest import mock

from visuohaptic.cli._extras import OPTIONAL, needs
from visuohaptic.cli.main import VERBS, verb_parser

#: The reader that may say by itself what is missing, for it comes before all else, and the drivers of cameras,
#: which do without what is not there.
MAY_LOOK = {"visuohaptic.io.meshes.mesh", "visuohaptic.io.frames._camera_drivers"}


def help_text(verb: str) -> str:
    return verb_parser(verb, importlib.import_module(VERBS[verb][0])).format_help()


def examples(verb: str) -> list[list[str]]:
    """Words of each ``visuohaptic ...`` line of the help, from the word "example" on."""
    found = []
    after = False
    for line in help_text(verb).splitlines()[1:]:
        text = line.strip()
        for start in ("examples", "example:", "Example:", "example"):
            if text.startswith(start) and (not found or not after):
                after, text = True, text.removeprefix(start).strip()
        if after and text.startswith("visuohaptic "):
            found.append(shlex.split(text)[1:])
        elif after and found:
            break
    return found


@contextlib.contextmanager
def recorded_imports() -> Iterator[set[str]]:
    """Modules that our own code asks for by an import statement inside a function, first names only."""
    found: set[str] = set()
    real = builtins.__import__

    def record(
        name: str, globals: Any = None, locals: Any = None, fromlist: Sequence[str] = (), level: int = 0
    ) -> Any:
        importer = str((globals or {}).get("__name__", ""))
        if level == 0 and importer.startswith("visuohaptic.") and importer not in MAY_LOOK:
            found.add(name.partition(".")[0])
        return real(name, globals, locals, fromlist, level)

    with mock.patch.object(builtins, "__import__", record):
        yield found


def undeclared(words: Sequence[str], imported: set[str]) -> set[str]:
    """Optional modules that were imported, and that nothing says the words need."""
    verb = next(name for name in (" ".join(words[:2]), words[0]) if name in VERBS)
    module = importlib.import_module(VERBS[verb][0])
    declared = needs(module, verb_parser(verb, module).parse_args(list(words[len(verb.split()) :])))
    brought = {"mcap"} if "mcap_ros2" in declared else set()
    return (imported & {library.module for library in OPTIONAL}) - declared - brought
