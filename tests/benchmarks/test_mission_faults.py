"""A slice of the campaign of faults: failures end with a reason, without wrong claims, and with the robot stopped."""

from __future__ import annotations

import pytest
from benchmarks.mission_faults import figures, run

RUNS = [
    ("squeeze", "camera frozen"),
    ("squeeze", "pose frozen"),
    ("grasp", "clock jumps"),
    ("explore", "frames late"),
    ("complete", "state frozen"),
]


@pytest.mark.parametrize(("task", "fault"), RUNS)
def test_a_fault_is_survived(task: str, fault: str) -> None:
    rows = run(tasks=[task], faults=[fault])
    assert rows[0]["success"]
    crashes, wrong, over, late, failed = (row["ours"] for row in figures(rows))
    assert (crashes, wrong, over, late, failed) == (0, 0, 0, 0, 0)
    if fault != "frames late":
        assert not rows[1]["success"]
        assert rows[1]["why"]
