"""Mutants that a test kills are distinguished from survivors; texts are not mutated."""

from __future__ import annotations

import ast
import sys

import pytest
from benchmarks._mutations import mutate, mutations
from benchmarks.house import read_modules

from benchmarks import mutants

LAW = '''
import logging

_log = logging.getLogger(__name__)
LIMIT_N = 20.0


def safe(force_N, moving=True):
    """Whether a force is safe."""
    if not moving:
        return False
    _log.info("force + 1")
    if force_N < 0:
        raise ValueError("below" + " zero")
    return force_N <= LIMIT_N and force_N + 1 > 0


@kernel
def compiled(x):
    return x + 1
'''
TESTS = """
from tiny.law import safe


def test_limit():
    assert safe(20.0)
    assert not safe(20.1)


def test_at_rest():
    assert not safe(1.0, moving=False)
"""


def test_each_mistake_is_one_and_words_are_left_alone():
    found = mutations(ast.parse(LAW))
    titles = [one.title for one in found]
    assert {
        "20.0 -> 25.0",
        "not moving -> moving",
        "True -> False",
        "force_N <= LIMIT_N -> force_N < LIMIT_N",
    } <= set(titles)
    assert {"force_N <= LIMIT_N -> force_N > LIMIT_N", "force_N + 1 -> force_N - 1", "1 -> 2"} <= set(titles)
    for words in ("below", "_log", "x + 1", "getLogger", "__name__"):
        assert not any(words in title for title in titles), words
    # What is made when the module is imported belongs to no function, defaults as well.
    assert {one.title for one in found if not one.function} == {"20.0 -> 25.0", "True -> False"}
    plain = ast.unparse(ast.parse(LAW))
    changed = [ast.unparse(mutate(ast.parse(LAW), number)) for number in range(len(found))]
    assert plain not in changed
    assert len(set(changed)) == len(changed)


RULED = """
MAX_FILE_BYTES = 64 * 1024
_HEIGHTS = 24


def drawn(axes, length_m, count, limit):
    axes.plot([0, 1], alpha=0.3)
    axes.grid(True)
    if length_m < 2 * limit:
        raise ValueError
    if length_m < 2 * limit or count < 2 * limit:
        return 0
    if count <= limit and length_m <= limit:
        return 1
    return max(round(length_m - 0.5, 3), 1e-12)
"""


def test_what_no_test_can_tell_is_named_by_its_rule():
    found = {one.title: one.rule for one in mutations(ast.parse(RULED)) if one.statement != 9}
    ruled = {title: rule for title, rule in found.items() if rule}
    assert ruled == {
        "64 -> 80": "budget",
        "1024 -> 1280": "budget",
        "64 * 1024 -> 64 / 1024": "budget",
        "0.3 -> 0.375": "look",
        "axes.grid(True) ->": "look",
        "True -> False": "look",
        "3 -> 4": "look",
        # Exactly twice the limit long is nothing; exactly twice as many may well occur.
        "length_m < 2 * limit -> length_m <= 2 * limit": "boundary",
        "1e-12 -> 1.25e-12": "guard",
    }
    assert {"24 -> 30", "axes.plot([0, 1], alpha=0.3) ->", "count <= limit -> count < limit"} <= set(found)
    # Whether exactly the limit is refused is said by its message.
    refused = [one for one in mutations(ast.parse(RULED)) if one.statement == 9]
    assert refused
    assert not any(one.rule for one in refused)


@pytest.mark.skipif(sys.platform != "linux", reason="tests run in forks with limits")
def test_noticed_and_unnoticed_mistakes_are_told_apart(tmp_path, monkeypatch):
    for name, text in {
        "src/tiny/__init__.py": "",
        "src/tiny/law.py": LAW.replace("@kernel\n", ""),
        "tests/test_tiny.py": TESTS,
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "src"))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    module = read_modules(tmp_path / "src")["tiny.law"]
    numbers = {one.title: number for number, one in enumerate(mutations(module.tree))}
    tests = {"tests/test_tiny.py": 0.1}

    def result(title):
        return mutants.judge(module, numbers[title], tests, tmp_path)[0]

    assert result("force_N <= LIMIT_N -> force_N < LIMIT_N") == "killed"
    assert result("20.0 -> 25.0") == "killed"
    assert result("force_N < 0 -> force_N <= 0") == "survived"
    assert mutants.judge(module, 0, {}, tmp_path)[0] == "uncovered"
