"""The campaign of the property tests: number of examples, and report of failures."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks._journal import Journal
from benchmarks.laws import Laws

_TESTS = """
from hypothesis import given, settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

@given(st.integers())
@settings(max_examples=3)
def test_law_that_holds(n): assert n == n

@given(st.integers(0, 50))
@settings(max_examples=3)
def test_law_with_an_exception(n): assert n != 17

def test_other(): assert False

class Counter(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.total = 0

    @rule(n=st.integers(0, 9))
    def add(self, n):
        self.total += n
        assert self.total < 10 * self.limit

class Right(Counter):
    limit = 1000

class Wrong(Counter):
    limit = 4

Right.TestCase.settings = Wrong.TestCase.settings = settings(max_examples=1, stateful_step_count=6)
TestRight, TestWrong = Right.TestCase, Wrong.TestCase
"""


def test_laws_are_run_as_often_as_asked(tmp_path: Path) -> None:
    (tmp_path / "test_inner_laws.py").write_text(_TESTS)
    journal = Journal(tmp_path / "laws.jsonl", {})
    words = ["-q", "-p", "no:cacheprovider", "-c", "/dev/null", f"--rootdir={tmp_path}", str(tmp_path)]
    pytest.main(words, plugins=[Laws(200, 60.0, journal)])
    rows = {name.split("::")[1]: row for name, row in journal.rows.items()}
    assert set(rows) == {"test_law_that_holds", "test_law_with_an_exception", "TestRight", "TestWrong"}
    assert rows["test_law_that_holds"] == {"tried": 200, "wrong": 0, "why": ""}
    assert rows["test_law_with_an_exception"]["wrong"] == 1
    assert "n=17" in rows["test_law_with_an_exception"]["why"]
    # State machines, in batches.
    assert rows["TestRight"]["wrong"] == 0
    assert 200 <= rows["TestRight"]["tried"] < 240
    assert rows["TestWrong"]["wrong"] == 1
    assert "state.add" in rows["TestWrong"]["why"]
    # A report goes on: nothing is run twice.
    again = Laws(200, 60.0, Journal(tmp_path / "laws.jsonl", {}))
    assert pytest.main(words, plugins=[again]) == pytest.ExitCode.NO_TESTS_COLLECTED
