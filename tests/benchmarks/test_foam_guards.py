"""Thresholds of the foam sensor's guards, counted in a source of known ones."""

from __future__ import annotations

import ast

from benchmarks import foam_guards

SOURCE = '''
LIMIT = 3.5
FIRST, LAST = range(2)

def judge(value, row, count):
    """A docstring."""
    if value > LIMIT or row[LAST] > LIMIT:  # one constant, compared twice
        return 0
    if count < 6 or row[3] > 0.0 or count == 2:
        return 1
    return value < 0.5 * count
'''


def test_each_threshold_counts_once() -> None:
    assert sorted(foam_guards.thresholds(ast.parse(SOURCE))) == ["LIMIT", "count < 6", "value < 0.5 * count"]


def test_every_module_is_found() -> None:
    found = foam_guards.measure()
    assert tuple(found) == foam_guards.GUARDS
    assert all(lines > 30 for lines, _ in found.values())
    assert "FALSE_ALARM" in found["validity"][1]
