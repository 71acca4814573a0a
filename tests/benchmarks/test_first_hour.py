"""The table of what new users expect names tests that exist; sizes count everything that is installed."""

from __future__ import annotations

from benchmarks.first_hour import EXPECTATIONS, distributions, megabytes
from benchmarks.house import ROOT


def test_every_expectation_has_its_tests():
    assert len(EXPECTATIONS) == len({what for what, _, _ in EXPECTATIONS}) == 20
    assert sum(answer == "yes" for _, answer, _ in EXPECTATIONS) >= 17
    for _, answer, tests in EXPECTATIONS:
        assert answer.startswith(("yes", "partly: "))
        assert all((ROOT / path).is_file() for path in tests.split())


def test_sizes_are_those_of_the_requirements_and_theirs():
    core, demo = distributions("visuohaptic"), distributions("visuohaptic[demo]")
    assert {"numba", "llvmlite", "numpy"} <= core < demo
    assert "matplotlib" in demo - core
    assert megabytes("numpy") > 20
