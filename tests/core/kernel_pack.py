"""A package of three modules with two kernels, re-imported in this process or called in a separate one."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import textwrap
from pathlib import Path

from numba.core.event import install_recorder

from visuohaptic.core.kernels import KERNELS

#: Prints the value of ``pack.top.answer(1)`` and how many signatures were compiled for it.
CALL = """
from numba.core.event import install_recorder
with install_recorder("numba:compile") as events:
    from pack.top import answer
    value = answer(1)
print(value, len(events.buffer) // 2)
"""

PACK = {
    "__init__": "",
    "settings": "FACTOR = 10\nNUMBERS = (1, 2)\n",
    "bottom": """
        from visuohaptic.core.kernels import kernel
        from .settings import FACTOR, NUMBERS

        @kernel
        def scaled(x):
            return x * FACTOR + NUMBERS[0]
        """,
    "top": """
        from visuohaptic.core.kernels import kernel
        from .bottom import scaled

        @kernel(error_model="numpy")
        def answer(x):
            return scaled(x) + 1000
        """,
}


def write_module(root: Path, name: str, text: str) -> None:
    path = root / "pack" / f"{name}.py"
    path.parent.mkdir(exist_ok=True)
    path.write_text(textwrap.dedent(text))


def call_pack(root: Path, **environment: str | None) -> tuple[int, int]:
    """(value, compiled signatures) in a new process; None takes a variable away."""
    # Python itself trusts a byte code file when time stamp [s] and size of its source are the same.
    changed = {"PYTHONDONTWRITEBYTECODE": "1", **environment}
    kept = {**os.environ, **{name: value for name, value in changed.items() if value is not None}}
    for name in (name for name, value in changed.items() if value is None):
        kept.pop(name, None)
    done = subprocess.run(
        [sys.executable, "-c", CALL], cwd=root, env=kept, check=True, capture_output=True, text=True
    )
    value, compiled = done.stdout.split()
    return int(value), int(compiled)


def import_pack(root: Path) -> tuple[int, int]:
    """(value, compiled signatures) of modules that are read anew, as a process that begins reads them.

    New functions know nothing of those of before: what they have comes from the cache. It takes a tenth of a process.
    """
    known = len(KERNELS)
    sys.path.insert(0, str(root))
    keep, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    importlib.invalidate_caches()
    try:
        with install_recorder("numba:compile") as events:
            value = importlib.import_module("pack.top").answer(1)
    finally:
        sys.dont_write_bytecode = keep
        sys.path.remove(str(root))
        for name in [name for name in sys.modules if name.partition(".")[0] == "pack"]:
            del sys.modules[name]
        del KERNELS[known:]
    return value, len(events.buffer) // 2


def entries(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())
