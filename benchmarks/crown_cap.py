"""Crown caps opened by touch (Alt 2016, Sec. 3.6.5): 50 bottles, start errors 1 cm on each axis and 5 degrees."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any, Literal

import numpy as np

from visuohaptic.experiments.virtual_opener import open_virtual_cap

SEEDS = 50


def run(seeds: int = SEEDS) -> list[dict[str, Any]]:
    """Bottles opened, by how well the camera sees them."""
    rows: list[dict[str, Any]] = []
    wrong = 0
    cases: tuple[tuple[Literal["start", "tracked", "corner"], str], ...] = (
        ("start", "sight never better than the start error"),
        ("corner", "exactly 1 cm off on each axis"),
        ("tracked", "sight as in Table 3.1"),
    )
    for sight, about in cases:
        started_s = time.process_time()
        trials = [open_virtual_cap(seed, sight) for seed in range(seeds)]
        spent_s = (time.process_time() - started_s) / seeds
        failures = Counter(t.opening.ending.outcome for t in trials if not t.opening.opened)
        wrong += sum(not t.right for t in trials)
        lasted = np.median([t.opening.trace.steps[-1].t_s for t in trials])
        told = ", ".join(f"{count} {name}" for name, count in failures.items()) or "none failed"
        rows.append(
            {
                "name": f"opened, {about}",
                "ours": sum(t.opening.opened for t in trials) * 50 / seeds,
                "unit": "of 50",
                "floor": 45,
                "aim": 49,
                "note": f"{told}; {lasted:.0f} s of robot time (median), {spent_s:.1f} s CPU each",
            }
        )
    rows.append(
        {"name": "wrong claims", "ours": wrong, "unit": "", "floor": 0, "aim": 0, "higher_is_better": False}
    )
    return rows
