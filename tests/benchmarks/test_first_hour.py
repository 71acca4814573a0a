"""The table of what new users expect names tests that exist; sizes count everything that is installed."""

from __future__ import annotations

from benchmarks.first_hour import EXPECTATIONS, distributions, megabytes
from benchmarks.house import ROOT

from benchmarks import first_hour


def test_every_expectation_names_tests_that_exist():
    assert len(EXPECTATIONS) == 20
    for proofs in EXPECTATIONS.values():
        assert proofs
        for proof in proofs:
            if isinstance(proof, str):
                path, _, name = proof.partition("::")
                assert f"def {name.partition('[')[0]}" in (ROOT / path).read_text()


def test_an_expectation_is_answered_by_what_its_proofs_do(tmp_path, monkeypatch):
    """A command that fails makes it partly met, and not met alone."""
    good, bad = ["-c", "pass"], ["-c", "1 / 0"]
    proofs = {
        "met": (good,),
        "partly": (good, [*bad, "x"]),
        "not met": (bad,),
        "gone": ("tests/no_such_test.py",),
    }
    monkeypatch.setattr(first_hour, "EXPECTATIONS", proofs)
    monkeypatch.setattr("pytest.main", lambda words, plugins: 0)
    rows = {
        what: (count["passed"], count["failed"])
        for what, count, _, _ in first_hour.expectation_rows(tmp_path)
    }
    assert rows == {"met": (1, 0), "partly": (1, 1), "not met": (0, 1), "gone": (0, 1)}


def test_sizes_are_those_of_the_requirements_and_theirs():
    core, demo = distributions("visuohaptic"), distributions("visuohaptic[demo]")
    assert {"numba", "llvmlite", "numpy"} <= core < demo
    assert "matplotlib" in demo - core
    assert megabytes("numpy") > 20
