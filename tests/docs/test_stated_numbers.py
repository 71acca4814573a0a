"""Numbers of pages are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from visuohaptic.core import resources
from visuohaptic.navigation.planning.footprint import footprint_drives
from visuohaptic.navigation.planning.search import push_lengths

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize(
    ("page", "sentence", "value"),
    [
        (
            "navigation_plan.md",
            r"cells of at most (\d+) cm that they overlap",
            100.0 * footprint_drives.FINE_M,
        ),
        (
            "navigation_plan.md",
            r"rounded up to (\d+) cm where there is space",
            100.0 * push_lengths.LENGTH_STEP_M,
        ),
        ("ros.md", r"waits at most (\d+) s for a running search", resources.WAIT_S),
    ],
)
def test_a_page_states_the_number_of_the_code(page: str, sentence: str, value: float) -> None:
    found = re.search(sentence, (DOCS / page).read_text(encoding="utf-8"))
    assert found is not None, sentence
    assert float(found[1]) == pytest.approx(value)
