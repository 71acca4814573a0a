"""Findings of the doctor, on simulated faulty libraries."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from visuohaptic.cli._extras import CORE, OPTIONAL, Library
from visuohaptic.cli.verbs.system.doctor import examine


def ill(trial: str, extra: str = "plot") -> Library:
    return Library("numpy", "numpy", extra, "arrays", trial)


def test_a_healthy_library_has_its_version():
    import numpy

    finding = examine(ill(""))
    assert (finding.version, finding.problem, finding.remedy) == (numpy.__version__, "", "")


@pytest.mark.parametrize(
    ("trial", "problem", "remedy"),
    [
        ("raise SystemExit(0)", "ended with code 0", "pip install --force-reinstall numpy"),
        ("import os; os.abort()", "crashed with signal 6", "pip install --force-reinstall numpy"),
        ("import no_such", "No module named 'no_such'", "pip install 'visuohaptic[plot]'"),
        (
            "raise ImportError('libGL.so.1: cannot open shared object file: No such file')",
            "ImportError: libGL.so.1: cannot open shared object file: No such file",
            "sudo apt-get install libgl1",
        ),
    ],
)
def test_each_illness_has_its_line(trial, problem, remedy):
    finding = examine(ill(trial))
    assert (finding.version, finding.problem, finding.remedy) == ("", problem, remedy)


def test_a_library_that_hangs_is_left():
    assert examine(ill("import time; time.sleep(60)"), patience_s=1.0).problem == "did not answer within 1 s"


def test_the_table_agrees_with_the_project_file():
    """Every dependency is examined, and with the extra that really brings it."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]

    def names(requirements):
        plain = {text.partition(">")[0].partition(";")[0].partition("[")[0].strip() for text in requirements}
        return plain - {"visuohaptic"}  # an extra that brings another one

    declared = dict.fromkeys(names(project["dependencies"]), "")
    for extra, requirements in project["optional-dependencies"].items():
        if extra != "all":
            declared |= dict.fromkeys(names(requirements), extra)
    assert {library.package: library.extra for library in (*CORE, *OPTIONAL)} == declared
