"""No test and no block of the documentation depends on the last digits, the clock or the machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs.test_blocks import PAGES, blocks
from tests.portability import problems

TESTS = Path(__file__).resolve().parent


def told(code: str) -> list[tuple[int, str]]:
    return [(found.line, found.rule) for found in problems(code)]


def test_no_test_depends_on_the_machine():
    found = {
        str(path.relative_to(TESTS)): here
        for path in TESTS.rglob("*.py")
        if (here := problems(path.read_text(encoding="utf-8")))
    }
    assert found == {}


def test_no_block_of_the_documentation_depends_on_the_machine():
    found = {
        f"{page.name}:{line}": here
        for page in PAGES
        for line, code in blocks(page.read_text(encoding="utf-8"))
        if (here := problems(code))
    }
    assert found == {}


@pytest.mark.parametrize(
    "code",
    [
        "assert p == 0.5",
        "assert p != -0.5",
        "assert 0.5 == p",
        "assert size == (0.3, 1)",
        "assert s in {0.1, 0.2}",
        "assert p == approx(1) and q == 0.5",
    ],
)
def test_a_fraction_compared_exactly_is_found(code):
    assert told(code) == [(1, "float-equality")]


def test_an_exact_mean_or_norm_is_found():
    assert told("assert np.mean(x) == y") == [(1, "arithmetic-equality")]
    assert told("assert float(np.linalg.norm(x)) == 1") == [(1, "arithmetic-equality")]


def test_an_assertion_on_elapsed_time_is_found():
    direct = "def test():\n    t = time.perf_counter()\n    work()\n    assert time.perf_counter() - t < 1\n"
    named = "def test():\n    t = clock()\n    d = time.monotonic() - t\n    assert d < 1\n"
    listed = "def test():\n    for _ in x:\n        s.append(perf_counter() - t)\n    assert min(s) < 1\n"
    assert [told(text) for text in (direct, named, listed)] == [[(4, "wall-clock")]] * 3


@pytest.mark.parametrize(
    "code",
    [
        "assert p == approx(0.5)",
        "assert round(p, 3) == 0.036",
        "assert [round(c, 2) for c in x] == [0.05, 0.18]",
        "assert n == 2.0",
        "assert json.loads(text) == {'force_N': 0.5}",
        "assert p < 0.5",
        "end = monotonic() + 60\nassert monotonic() < end",
        "seconds = perf_counter() - start\nprint(seconds)\nassert done",
    ],
)
def test_what_holds_everywhere_is_left_alone(code):
    assert told(code) == []
