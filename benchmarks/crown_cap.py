"""Crown caps opened by touch (Alt 2016, Sec. 3.6.5): 50 bottles, start errors of 1 cm on each axis and 5 degrees.

Each command prints the fraction of bottles that were opened.

    python -m benchmarks crown_cap                                       the wrench is the truth with noise
    python -m benchmarks.crown_cap --seeds 50 --first 1000               other bottles
    python -m benchmarks.crown_cap --beam --sight start --seeds 10       the wrench is read from images of the rod
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any, Literal

import numpy as np

from visuohaptic.core.camera import Camera
from visuohaptic.rigs import open_virtual_cap

from ._opener_sensor import OpenerSensor

SEEDS = 50


CASES: tuple[tuple[Literal["start", "tracked", "corner"], str], ...] = (
    ("start", "sight never better than the start error"),
    ("corner", "exactly 1 cm off on each axis"),
    ("tracked", "sight as in Table 3.1"),
)


def run(
    seeds: int = SEEDS,
    first: int = 0,
    *,
    beam: bool = False,
    half: bool = False,
    sights: tuple[str, ...] = (),
) -> list[dict[str, Any]]:
    """Bottles opened, by visibility to the camera."""
    rows: list[dict[str, Any]] = []
    wrong = 0
    camera = Camera.simple(800, 448, 900.0) if half else None
    sensor = OpenerSensor(camera=camera) if beam or half else None
    for sight, about in CASES:
        if sights and sight not in sights:
            continue
        started_s = time.process_time()
        trials = [open_virtual_cap(seed, sight, sensor=sensor) for seed in range(first, first + seeds)]
        spent_s = (time.process_time() - started_s) / seeds
        failures = Counter(t.opening.ending.outcome for t in trials if not t.opening.opened)
        wrong += sum(not t.right for t in trials)
        lasted = np.median([t.opening.trace.steps[-1].t_s for t in trials])
        told = ", ".join(f"{count} {name}" for name, count in failures.items()) or "none failed"
        rows.append(
            {
                "name": f"opened, {about}{', wrench from pictures' if sensor else ''}",
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"how many bottles ({SEEDS})")
    parser.add_argument("--first", type=int, default=0, help="seed of the first (0)")
    parser.add_argument("--beam", action="store_true", help="read the wrench from pictures of the rod")
    parser.add_argument(
        "--half",
        action="store_true",
        help="the same with half the resolution: a third of the time, more noise",
    )
    parser.add_argument("--sight", action="append", choices=[case[0] for case in CASES], help="only this one")
    args = parser.parse_args()
    for line in run(args.seeds, args.first, beam=args.beam, half=args.half, sights=tuple(args.sight or ())):
        print(line)
