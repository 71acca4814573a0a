"""The property tests and state machines with many more examples than in a normal test run.

    python -m benchmarks.laws --packages core navigation --examples 10000 --seconds 120 --report laws.jsonl
                                      prints the tests that fail; exit code 1 if there are any

Each test draws this number of examples, or as many as it can within this CPU time; a run of a state machine is an
example. An existing report is continued.
A failure is stored with its example, which should become a test when the fault is fixed.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import RuleBasedStateMachine

from ._journal import Journal
from .house import ROOT

__all__ = ["Laws", "main"]


#: Examples of a state machine between two looks at its time.
_BATCH = 20


class Laws:
    """A plugin of pytest that runs the property tests alone, each with other settings.

    Parameters
    ----------
    examples, seconds
        Of each test, whichever comes first.
    journal
        Keeps how many examples each test had, and what failed.
    """

    def __init__(self, examples: int, seconds: float, journal: Journal) -> None:
        self._examples, self._seconds, self._journal = examples, seconds, journal
        self._count, self._end_s = 0, 0.0

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[Any]) -> None:
        """Keep the property tests that the journal does not have."""
        kept = [
            item for item in items if (_property(item) or _machine(item)) and item.nodeid not in self._journal
        ]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = kept
        many: dict[str, Any] = {
            "max_examples": self._examples, "database": None, "deadline": None, "derandomize": False,
            "suppress_health_check": list(HealthCheck),
        }  # fmt: skip
        for function in {item.obj for item in kept if _property(item)}:
            # As documented by Hypothesis for plugins that wrap the function called with each example.
            function.hypothesis.inner_test = self._counted(function.hypothesis.inner_test)
            usual = getattr(function, "_hypothesis_internal_use_settings", None)
            function._hypothesis_internal_use_settings = settings(usual, **many)
        for item in kept:
            if (machine := _machine(item)) is not None:
                size = min(_BATCH, self._examples)
                item.cls.settings = settings(item.cls.settings, **(many | {"max_examples": size}))
                machine.__init__ = self._counted(machine.__init__, skipped=False)
                item.obj = self._repeated(item.obj)

    def pytest_runtest_setup(self) -> None:
        """A new test begins."""
        self._count, self._end_s = 0, time.process_time() + self._seconds

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Store the result of a test."""
        if report.when == "call" or report.failed:
            why = "" if report.passed else str(report.longrepr)[-2000:]
            self._journal.put(report.nodeid, {"tried": self._count, "wrong": int(report.failed), "why": why})

    def _counted(self, inner: Callable[..., Any], skipped: bool = True) -> Callable[..., Any]:
        @functools.wraps(inner)
        def run(*args: Any, **named: Any) -> Any:
            if skipped and time.process_time() > self._end_s:
                return None
            self._count += 1
            return inner(*args, **named)

        return run

    def _repeated(self, run: Callable[[], None]) -> Callable[[], None]:
        """A machine cannot leave out examples: it is run in batches until there are enough."""

        @functools.wraps(run)
        def batches() -> None:
            while self._count < self._examples and time.process_time() < self._end_s:
                run()

        return batches


def _property(item: Any) -> bool:
    return hasattr(getattr(item, "obj", None), "hypothesis")


def _machine(item: Any) -> type[RuleBasedStateMachine] | None:
    """State machine of a test, if it has one."""
    return getattr(getattr(item, "obj", None), "_hypothesis_state_machine_class", None)


def main(words: Sequence[str] | None = None) -> int:
    """Run the property tests of some packages; 1 when one fails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packages", nargs="+", default=["."], help="folders of tests (all)")
    parser.add_argument("--examples", type=int, default=10000, help="of each test (10000)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor, of each test (60)")
    parser.add_argument("--report", type=Path, help="keeps each test as it is done")
    given = parser.parse_args(words)
    journal = Journal(given.report, {"campaign": "laws", "examples": given.examples})
    folders = [str(ROOT / "tests" / package) for package in given.packages]
    pytest.main(
        ["-q", "-p", "no:cacheprovider", "--no-header", *folders],
        plugins=[Laws(given.examples, given.seconds, journal)],
    )
    for name, row in journal.rows.items():
        print(f"{row['tried']:7d} {'FAILED' if row['wrong'] else 'holds '} {name}")
    tried = [row["tried"] for row in journal.rows.values()]
    print(
        f"{len(tried)} laws, {sum(tried)} examples, {sum(row['wrong'] for row in journal.rows.values())} do not hold"
    )
    return int(any(row["wrong"] for row in journal.rows.values()))


if __name__ == "__main__":
    raise SystemExit(main())
