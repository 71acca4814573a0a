"""Every kernel of the library uses the common decorator, and importing compiles nothing."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import visuohaptic

ROOT = Path(visuohaptic.__file__).parent

#: Imports every module, then says how many kernels were defined, compiled and cannot be cached.
IMPORT_ALL = """
import importlib, pkgutil, visuohaptic
from numba.core.event import install_recorder
with install_recorder("numba:compile") as events:
    for module in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
from visuohaptic.core.kernels import KERNELS, code_digest
print(len(KERNELS), len(events.buffer), sum(len(one.overloads) for one in KERNELS))
print(*[one.py_func.__qualname__ for one in KERNELS if code_digest(one) is None])
"""


def test_importing_every_module_compiles_nothing_and_every_kernel_can_be_cached():
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], check=True, capture_output=True, text=True)
    counts, uncached = done.stdout.splitlines()
    defined, events, overloads = map(int, counts.split())
    assert defined > 200
    assert (events, overloads) == (0, 0)
    assert uncached == ""


def test_only_the_decorator_calls_numba():
    """A second way to compile would have a cache that can be stale."""
    jits = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "stencil", "generated_jit", "overload"}
    texts = {path: path.read_text(encoding="utf-8") for path in ROOT.rglob("*.py")}
    for path, text in texts.items():
        named = "numba" in text and path != ROOT / "core/kernels/cache.py"
        for node in ast.walk(ast.parse(text)) if named else ():
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("numba"):
                found = {name.name for name in node.names} & jits
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                found = {node.attr} & jits if node.value.id in {"nb", "numba"} else set()
            else:
                continue
            assert not found, f"{path}:{node.lineno}: use visuohaptic.core.kernels.kernel"
