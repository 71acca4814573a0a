"""``visuohaptic example task``: run a robot task in its simulated world.

cap    an arm opens a crown cap with force feedback (Alt 2016, Table 3.1)
room   a platform maps a room by touch and separates fixed from movable objects (Fig. 3.11)

reads
  nothing
writes, into --out
  trace.jsonl                settings, every observation, command and state transition, and the result
  map.yaml, map.pgm          room: the haptic map, to plan on

example
  visuohaptic example task cap --out cap
  visuohaptic example task room --contacts 8 --out room
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import rigs


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("task", str, "task to run", choices=("cap", "room"))
    add("--out", Path, "folder to write to", required=True)
    add("--contacts", 22, "room: number of contacts after which it ends (22)")
    add("--seed", 0, "seed of the world and its noise (0)")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    truth: dict[str, Any]
    if args.task == "cap":
        bottle = rigs.open_virtual_cap(args.seed, "tracked")
        trace, truth = bottle.opening.trace, {"truly_open": bottle.truly_open}
    else:
        room = rigs.map_virtual_room(args.seed, args.contacts)
        trace, score = room.mapping.trace, room.score
        truth = {"contacts": score.contacts, "correct_flags": score.correct_flags, "iou": score.iou}
    args.out.mkdir(parents=True, exist_ok=True)
    trace.save(args.out / "trace.jsonl")
    if args.task == "room":
        room.mapping.haptic_map.occupancy().save(args.out / "map.yaml")
    for line in (*trace.story(), *(f"{name}: {value}" for name, value in truth.items())):
        args.report(line)
    return {"trace": str(args.out / "trace.jsonl"), "outcome": trace.ending and trace.ending.outcome} | truth
