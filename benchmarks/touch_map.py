"""Rooms mapped by touch (Alt 2016, Sec. 3.6.3): 22 contacts around the circumference, with drifting odometry.

Prints the intersection over union around the contacts, and whether movable objects are separated.

    python -m benchmarks touch_map                          ten rooms
    python -m benchmarks.touch_map --rooms 20 --first 400   others, by their seeds
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any

import numpy as np

from visuohaptic.rigs import map_virtual_room

ROOMS = 10


def run(rooms: int = ROOMS, first: int = 0) -> list[dict[str, Any]]:
    """Intersection over union around the contacts, and whether movable objects are separated."""
    started_s = time.process_time()
    trials = [map_virtual_room(seed) for seed in range(first, first + rooms)]
    spent_s = (time.process_time() - started_s) / rooms
    scores = [trial.score for trial in trials]
    ended = Counter(str(trial.mapping.ending.outcome) for trial in trials)
    endings = ", ".join(f"{count} {outcome}" for outcome, count in ended.most_common())
    contacts = sum(score.contacts for score in scores)
    return [
        {
            "name": f"IoU around the contacts, worst of {rooms} rooms",
            "ours": min(score.iou for score in scores),
            "unit": "",
            "floor": 0.6,
            "aim": 0.75,
            "note": f"median {np.median([s.iou for s in scores]):.2f}; ended: {endings}; {spent_s:.0f} s CPU a room",
        },
        {
            "name": "IoU of occupied cells, median",
            "ours": float(np.median([score.occupied_iou for score in scores])),
            "unit": "",
            "floor": 0.6,
            "aim": 0.75,
            "note": f"worst {min(score.occupied_iou for score in scores):.2f}",
        },
        {
            "name": "IoU of free cells, median",
            "ours": float(np.median([score.free_iou for score in scores])),
            "unit": "",
            "floor": 0.6,
            "aim": 0.75,
            "note": f"worst {min(score.free_iou for score in scores):.2f}",
        },
        {
            "name": "contacts rightly called movable or fixed",
            "ours": 100.0 * sum(score.correct_flags for score in scores) / max(contacts, 1),
            "unit": "%",
            "floor": 95,
            "aim": 100,
            "note": f"{contacts} contacts",
        },
        {
            "name": "movable things in the layer of the fixed ones",
            "ours": sum(score.mixed for score in scores),
            "unit": "",
            "floor": 0,
            "aim": 0,
            "higher_is_better": False,
        },
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rooms", type=int, default=ROOMS, help=f"how many ({ROOMS})")
    parser.add_argument("--first", type=int, default=0, help="seed of the first (0)")
    args = parser.parse_args()
    for line in run(args.rooms, args.first):
        print(line)
