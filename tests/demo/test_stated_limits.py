"""What constants of the demo are said to be, by other means."""

from __future__ import annotations

import pytest

from visuohaptic.demo import floor_chapters, probe_chapters


def test_limits_are_half_way_between_what_they_separate() -> None:
    """Round and other cross-sections; scans that fit the map and scans of a changed one."""
    assert pytest.approx(0.5 * (0.98 + 0.8), abs=0.01) == probe_chapters.ROUND_RATIO
    assert pytest.approx(0.5 * (0.96 + 0.92), abs=0.005) == floor_chapters.MIN_FIT
