"""Coverage of the intervals of haptic tags, on pushes of independent physics with five kinds of floor.

``python -m benchmarks.tag_evidence --seeds open --count 50 --report tags.jsonl`` prints the coverage by quantity and floor.

A seed is an object, pushed twice on each kind of floor. *This push* is the declared :class:`Estimate`: value and
sigma compared with the truth of the push that was measured. *Next push* is :func:`predictive_interval` of the first tag
compared with the truth of the second push.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tests.worlds import tag_pushes

from benchmarks._journal import Journal
from visuohaptic.sensing.push import PushRecord, predictive_interval, tag_from_push

#: Name in a tag, by quantity.
FIELDS = {
    "static": "static_friction_N",
    "dynamic": "dynamic_friction_N",
    "stiffness": "stiffness_N_per_m",
}
LEVEL, NINETY = 0.9, 1.645
#: Objects that are integrated simultaneously.
CHUNK = 100


def record_of(push: tag_pushes.Push) -> PushRecord:
    """The readings of a push as input of the library."""
    nothing = np.full(len(push.t_s), np.nan)
    return PushRecord(
        t_s=push.t_s,
        force_valid=np.isfinite(push.force_N),
        force_N=push.force_N,
        force_sigma_N=push.force_sigma_N,
        force_scale_sigma=push.force_scale_sigma,
        deflection_m=push.deflection_m,
        deflection_sigma_m=push.deflection_sigma_m,
        travel_m=push.travel_m,
        lateral_m=np.zeros(len(push.t_s)),
        contact_m=nothing,
        angle_rad=nothing,
    )


def measure(first: tag_pushes.Push, second: tag_pushes.Push) -> dict:
    """Values of the first push's tag for it and for the second push; None if not observed."""
    tag = tag_from_push(record_of(first))
    row: dict = {"moved": tag.fixed is False}
    for name, field in FIELDS.items():
        true, then = (float(getattr(push, field.replace("_friction", ""))) for push in (first, second))
        found = getattr(tag, field)
        row[name] = {
            "true": true if math.isfinite(true) else None,
            "then": then if math.isfinite(then) else None,
            "found": None
            if found is None
            else [found.value, found.sigma, *predictive_interval(found, LEVEL)],
        }
    return row


def _cases(rows: Sequence[dict], name: str) -> np.ndarray:
    """Columns: value, sigma, low, high, true, then."""
    found = [row[name] for row in rows if row[name]["found"] and row[name]["true"] is not None]
    return np.array([[*one["found"], one["true"], one["then"]] for one in found]).reshape(-1, 6)


def figures(rows: Sequence[dict]) -> list[dict]:
    """Coverage of the intervals, by quantity: all floors and each."""
    return [
        _figure(name, setting, [row for row in rows if setting in ("all", row["setting"])])
        for name in FIELDS
        for setting in ("all", *tag_pushes.SETTINGS)
    ]


def _figure(name: str, setting: str, rows: Sequence[dict]) -> dict:
    value, sigma, low, high, true, then = _cases(rows, name).T
    there = sum(row[name]["true"] is not None for row in rows)
    invented = sum(bool(row[name]["found"]) and row[name]["true"] is None for row in rows)
    if not len(value):
        return {"name": f"{name}, {setting}", "ours": math.nan, "unit": "%", "note": f"0 of {there} declared"}
    pulls, relative = (value - true) / sigma, np.abs(value / true - 1.0)
    following = 100.0 * float(np.mean((low < then) & (then < high)))
    note = (
        f"next push {following:.1f} %; rms error / sigma {np.sqrt(np.mean(pulls**2)):.2f}; "
        f"error median {100 * np.median(relative):.1f} %, 90 % of them {100 * np.percentile(relative, 90):.1f} %, "
        f"sigma median {100 * np.median(sigma / true):.1f} %; {len(value)} of {there} declared"
    )
    if invented:
        note += f", {invented} where there is none"
    inside = 100.0 * float(np.mean(np.abs(pulls) < NINETY))
    return {
        "name": f"{name}, {setting}: in its 90 % interval",
        "ours": inside,
        "unit": "%",
        "floor": "85-95",
        "note": note,
    }


def campaign(*, seeds: str = "open", count: int = 50, report: Path | None = None) -> list[dict]:
    """Rows of ``count`` objects on every floor; those in ``report`` are not pushed again."""
    journal = Journal(report, {"campaign": "tag_evidence", "seeds": seeds})
    numbers = [2 * i + (seeds == "closed") for i in range(count)]
    every = [(setting, seed) for setting in tag_pushes.SETTINGS for seed in numbers]
    missing = [case for case in every if f"{case[0]}:{case[1]}" not in journal]
    for begin in range(0, len(missing), CHUNK):
        chunk = missing[begin : begin + CHUNK]
        felt = tag_pushes.pushes([(*case, number) for case in chunk for number in (0, 1)])
        for (setting, seed), first, second in zip(chunk, felt[::2], felt[1::2], strict=True):
            journal.put(f"{setting}:{seed}", {"setting": setting, **measure(first, second)})
    return [journal.rows[f"{setting}:{seed}"] for setting, seed in every]


def run() -> list[dict]:
    """Rows of the table: closed seeds."""
    return figures(campaign(seeds="closed", count=100))


def main() -> None:
    """Run the campaign and print its figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tag_evidence", description=__doc__)
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--count", type=int, default=50, help="objects on each of the five floors")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    for line in figures(campaign(**vars(parser.parse_args()))):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


if __name__ == "__main__":
    main()
