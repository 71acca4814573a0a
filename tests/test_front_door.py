"""``import visuohaptic as vh``: every name exists, is documented with an example, and is loaded only on use."""

from __future__ import annotations

import ast
import doctest
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import visuohaptic as vh

STUB = Path(vh.__file__).with_suffix(".pyi")
NAMES = sorted(set(vh.__all__) - {"__version__"})


def test_the_names_are_those_of_the_stub():
    nodes = ast.parse(STUB.read_text(encoding="utf-8")).body
    listed = [alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert len(listed) == len(set(listed))
    assert sorted([*listed, "__version__"]) == sorted(vh.__all__)
    assert dir(vh) == sorted(vh.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_each_name_is_documented_for_itself(name):
    found = getattr(vh, name)
    text = inspect.getdoc(found)
    # A dataclass without a docstring has its signature for one, a class that of its base.
    assert text
    assert not text.startswith(f"{name}(")
    assert not inspect.isclass(found) or found.__doc__


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_name_runs(name, tmp_path, monkeypatch, fewer_explorations):
    """At least one statement that is not skipped, and what it prints is what the docstring says."""
    monkeypatch.chdir(tmp_path)
    found = getattr(vh, name)
    module = sys.modules[inspect.unwrap(found).__module__]
    (example,) = doctest.DocTestFinder(recurse=False).find(found, name, module, dict(vars(module)))
    statements = [one for one in example.examples if not one.options.get(doctest.SKIP)]
    assert statements, f"{name} has no example that runs"
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    failed, _ = runner.run(example, out=said.append)
    assert not failed, "".join(said)


def test_the_import_loads_no_library():
    """Neither arrays nor images nor compiled kernels, and no module of ours but the version."""
    script = "import sys, visuohaptic as vh; dir(vh); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"cv2", "numba", "numpy", "pydantic", "scipy", "yaml"}
    assert {name for name in loaded if name.startswith("visuohaptic")} == {
        "visuohaptic",
        "visuohaptic._version",
    }


def test_a_name_that_is_not_there_says_so():
    with pytest.raises(AttributeError, match="FoamSensors"):
        _ = vh.FoamSensors
