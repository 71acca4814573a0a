"""Orders test runs from a process that has imported the libraries already."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path
from typing import Any

from visuohaptic.core import cache_folder

from . import _mutant
from .house import Module

__all__ = ["Server"]


class Server:
    """A process of :mod:`benchmarks._warm`, which ends with this object.

    Parameters
    ----------
    root
        Folder of the project, with its package in ``src``.
    modules
        The modules of the package.
    """

    def __init__(self, root: Path, modules: dict[str, Module]) -> None:
        self._place = tempfile.TemporaryDirectory()
        folder, cache = (Path(self._place.name, name) for name in ("site", "cache"))
        for made in (folder, cache):
            made.mkdir()
        shutil.copy(_mutant.__file__, folder / "sitecustomize.py")
        _link_kernels(cache)
        paths = [str(folder), str(root / "src"), os.environ.get("PYTHONPATH", "")]
        environment = {name: value for name, value in os.environ.items() if name != _mutant.VARIABLE}
        environment |= {
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
            "HYPOTHESIS_STORAGE_DIRECTORY": str(cache / "hypothesis"),
            "VISUOHAPTIC_CACHE_DIR": str(cache),
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # those of other packages take a third of a short run
        }
        command = [sys.executable, "-P", str(Path(__file__).with_name("_warm.py"))]
        self._process = subprocess.Popen(
            [*command, json.dumps(["pytest", *sorted(_libraries(modules))])],
            cwd=root, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )  # fmt: skip
        weakref.finalize(self, _end, self._process)

    def answers(self, order: dict[str, Any]) -> list[dict[str, Any]]:
        """The answers to an order, one for each run; runs that ended their process have an empty one."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(order), file=self._process.stdin, flush=True)
        found = []
        while (line := self._process.stdout.readline()) != "null\n":
            if not line:
                raise SystemExit("the process that runs the tests has ended")
            found.append(json.loads(line))
        lost: dict[str, Any] = {"code": None, "output": "", "seconds": 0.0, "marks": []}
        return found + [lost] * (len(order["runs"]) - len(found))


def _end(process: subprocess.Popen[str]) -> None:
    with process:  # closes its input, and waits
        process.kill()


def _libraries(modules: dict[str, Module]) -> set[str]:
    """What the modules of a package import from elsewhere when they are imported."""
    own = {name.partition(".")[0] for name in modules}
    found: set[str] = set()
    for module in modules.values():
        for node in module.tree.body:
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module))
    return {name for name in found if name.partition(".")[0] not in own}


def _link_kernels(cache: Path) -> None:
    """The user's compiled functions in a cache folder: each is kept under a digest of what its code depends on."""
    source = cache_folder()
    if source is not None and source.is_dir():
        shutil.copytree(source, cache / source.parent.name / source.name, copy_function=_linked)


def _linked(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system
        shutil.copy2(source, target)
