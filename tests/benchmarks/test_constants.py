"""A constant covered by a test is distinguished from one that no test notices."""

from __future__ import annotations

import ast
import json

import numpy as np
import pytest

from benchmarks import _mutant, constants

LAW = """
GRAVITY_m_per_s2 = 9.81
PATIENCE_S = 5.0
TABLE = (1.0, 2.0)
LOW, HIGH = 0, 1
assert TABLE[0] < 1.2


def weight_N(mass_kg, gravity=GRAVITY_m_per_s2):
    return mass_kg * gravity


def patience_s():
    return PATIENCE_S
"""

TESTS = """
import subprocess
import sys

from tiny.labels import EDGE
from tiny.limits import MAX_STEPS
from tiny.law import patience_s, weight_N


def test_weight():
    assert 9.7 < weight_N(1.0) < 9.9


def test_patience():
    assert patience_s() > 0


def test_edge():
    assert EDGE == 4


def test_steps():
    script = "from tiny.steps import steps; raise SystemExit(steps() != 6)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
"""


@pytest.fixture
def project(tmp_path):
    """A package with constants that a test notices in its process and in another one, and some that none does."""
    files = {
        "src/tiny/__init__.py": "",
        "src/tiny/law.py": LAW,
        "src/tiny/labels.py": "EDGE = 4\n\n\ndef edge():\n    return EDGE\n",
        "src/tiny/limits.py": "MAX_STEPS = 3\n",
        "src/tiny/steps.py": "from .limits import MAX_STEPS\n\n\ndef steps():\n    return 2 * MAX_STEPS\n",
        "src/tiny/alone.py": "SIZE = 7\n\n\ndef size():\n    return SIZE\n",
        "tests/test_tiny.py": TESTS,
        "tests/test_red.py": "from tiny.alone import size\n\n\ndef test_size():\n    assert size() == 8\n",
    }
    for name, text in files.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "project"


def test_noticed_and_unnoticed_constants_are_told_apart(project, tmp_path, capsys):
    report = tmp_path / "report" / "rows.jsonl"
    options = ["--root", str(project), "--report", str(report), "--seconds", "100"]
    constants.main([*options, "--only", "GRAVITY|PATIENCE|STEPS|SIZE|TABLE|EDGE"])
    rows = [json.loads(line)["row"] for line in report.read_text().splitlines()[1:]]
    results = {(row["title"].partition(":")[2], row["factor"]): row["result"] for row in rows}
    assert results.pop(("TABLE", "x1.25")) == "crashed"
    assert results.pop(("TABLE", "x0.8")) == "unnoticed"
    assert results == {
        (name, factor): result
        for name, result in {
            "GRAVITY_m_per_s2": "noticed",  # also as a default argument
            "PATIENCE_S": "unnoticed",
            "EDGE": "noticed",  # by a test that calls nothing
            "MAX_STEPS": "noticed",  # imported by name, in a process that the test starts
            "SIZE": "unnoticed",  # its only test fails without any change
        }.items()
        for factor in ("x0.8", "x1.25")
    }
    printed = capsys.readouterr().out
    assert "left out, they fail without any change: tests/test_red.py" in printed
    unnoticed = printed.partition("not noticed:")[2]
    assert "tiny.law:PATIENCE_S (line 3): x0.8 unnoticed, x1.25 unnoticed" in unnoticed
    assert "GRAVITY" not in unnoticed
    kept = report.read_text()
    constants.main([*options, "--only", "GRAVITY"])
    assert report.read_text() == kept, "what is in the report is not done again"


def test_the_nearest_tests_judge_a_sample(project, tmp_path, capsys):
    """By the tests that import a module: those of ``steps`` see ``limits``, which none imports itself."""
    options = ["--root", str(project), "--report", str(tmp_path / "near.jsonl"), "--near", "1"]
    constants.main([*options, "--only", "MAX_STEPS"])
    printed = capsys.readouterr().out
    assert "left out" not in printed, "no test is run without a change"
    assert "tiny.limits:MAX_STEPS x0.8 noticed" in printed
    assert "tiny.limits:MAX_STEPS x1.25 noticed" in printed
    constants.main([*options, "--sample", "2", "--seed", "3", "--list"])
    drawn = capsys.readouterr().out
    assert "2 constants" in drawn
    constants.main([*options, "--sample", "2", "--seed", "3", "--list"])
    assert capsys.readouterr().out == drawn


def test_the_rule_of_what_a_constant_is(project, capsys):
    constants.main(["--root", str(project), "--list"])
    listed = capsys.readouterr().out
    assert "tiny.law:TABLE (line 4)" in listed
    assert "LOW" not in listed
    tree = ast.parse(
        "A = -0.5\nB, C = 2.0, 3\nD = {1: 2.5}\nE = np.deg2rad(8.0)\nF = Law(mu=(3.0,))\nG: float = 1 << 20\n"
        "__version__ = 2\nFORMAT = 2\nP, Q, R = 3, 5, 4\nX = A * 2\nY = Annotated[float, Field(gt=1)]\nZ = 0\n"
        "ON = True\nS = np.zeros((2, 3))\nT = range(3)\n"
    )
    assert set(_mutant.find_constants(tree)) == set("ABCDEFG")


def test_numbers_and_arrays_are_multiplied_away_from_their_value():
    assert [_mutant.multiplied(value, True) for value in (1, -3, 8, 0)] == [2, -4, 10, 0]
    assert [_mutant.multiplied(value, False) for value in (1, -3, 8, 0)] == [0, -2, 6, 0]
    table = _mutant.multiplied(np.array([[1, -3], [8, 0]], np.int8), True)
    assert table.dtype == np.int8
    assert table.tolist() == [[2, -4], [10, 0]]
    assert _mutant.multiplied(np.float32(2.0), False).dtype == np.float32
    np.testing.assert_allclose(_mutant.multiplied(np.array([1.0, -2.0]), True), [1.25, -2.5])
    with pytest.raises(OverflowError):
        _mutant.multiplied(np.uint8(255), True)


def test_compiled_functions_see_the_changed_constant(project, tmp_path):
    """Whatever machine code an earlier run left in the shared cache."""
    kernel = (
        "import numba\n\nGAIN = 4.0\n\n\n@numba.njit(cache=True)\ndef doubled():\n    return 2.0 * GAIN\n"
    )
    (project / "src/tiny/gain.py").write_text(kernel)
    test = "from tiny.gain import doubled\nfrom tiny.use import used\n\n\ndef test_gain():\n    assert 7.9 < used() < 8.1\n"
    (project / "src/tiny/use.py").write_text(
        "from .gain import doubled\n\n\ndef used():\n    return doubled()\n"
    )
    (project / "tests/test_gain.py").write_text(test)
    for other in ("test_tiny.py", "test_red.py"):
        (project / "tests" / other).unlink()
    report = tmp_path / "rows.jsonl"
    constants.main(["--root", str(project), "--report", str(report), "--only", "GAIN"])
    rows = [json.loads(line)["row"] for line in report.read_text().splitlines()[1:]]
    assert [row["result"] for row in rows] == ["noticed", "noticed"]
