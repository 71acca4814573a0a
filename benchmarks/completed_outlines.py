"""Bottles that the demonstration completes by touch: errors of the outlines beside the declared ones, and squeezes for the class.

    python -m benchmarks.completed_outlines --seeds open --count 11 --report outlines.jsonl
                                      errors of outlines (15 CPU-s each)
    python -m benchmarks.completed_outlines --seeds open --count 11 --squeeze --report squeezed.jsonl
                                      with the squeezes that recognise the bottle (25 CPU-s each)

Prints for each bottle the root mean square error of its radius and the declared one, and the chi-square of the 14 widths that the
classifier reads, per value and with the errors that its model adds (.8 mm of a width, .5 %, and the error of the height). A
finished bottle is a line of the report; the same command continues after the last one.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks._journal import Journal
from benchmarks._seeds import add_seeds, seeds_of
from visuohaptic.core.objects import HEIGHTS
from visuohaptic.demo import run_mission
from visuohaptic.demo.bottle import mission_classes
from visuohaptic.demo.story import Known, Mission

#: The heights of :func:`visuohaptic.recognition.touch.with_outline`, as fractions of the whole height.
AT = (np.arange(1, HEIGHTS - 1) + 0.5) / HEIGHTS


def chi_square(known: Known, true_m: np.ndarray) -> float:
    """Chi-square of the widths at the classifier's heights, per value; NaN without a declared covariance."""
    if known.outline_errors is None:
        return float("nan")
    settings, outline_m = mission_classes().settings, known.outline_m
    z = AT * outline_m[-1, 1]
    share = np.array([np.interp(z, outline_m[:, 1], row) for row in np.eye(len(outline_m))])
    logs = np.log(outline_m[:, 0]) @ share
    lower = settings.pose_m * np.gradient(logs, z)
    own = (0.5 * settings.width_m * np.exp(-logs)) ** 2 + settings.width_discrepancy**2
    errors = share.T @ known.outline_errors @ share + np.outer(lower, lower) + np.diag(own)
    off = logs - np.log(np.interp(AT * true_m[-1, 1], true_m[:, 1], true_m[:, 0]))
    return float(off @ np.linalg.solve(errors, off)) / len(AT)


def completed(seed: int, *, squeeze: bool) -> dict[str, Any]:
    """One bottle."""
    chapters = ("beam", "glass", "probe", *["squeeze"] * squeeze)
    with TemporaryDirectory() as folder:
        story = run_mission(folder, part=chapters, seed=seed, on_message=lambda _: None)
        mission: Mission = story.mission
        done = {one.name: one for one in story.chapters if one.done}
        if "probe" not in done:
            return {"seed": seed, "ended": story.summary()}
        assert mission.bottle is not None
        known, true_m = mission.known, mission.bottle.outline_m
        claims = {claim.kind: claim for one in done.values() for claim in one.claims}
        row = {
            "seed": seed,
            "ended": story.summary(),
            "error_mm": 1e3 * claims["shape"].error,
            "declared_mm": 1e3 * known.outline_sigma_m,
            "higher_mm": 1e3 * (claims["height"].value - claims["height"].truth),
            "chi_square": chi_square(known, true_m),
        }
        if squeeze:
            named = claims.get("class")
            row |= {
                "squeezes": len(known.curves),
                "class": "" if named is None else named.value,
                "right": named is not None and named.correct,
            }
        return row


def figures(rows: list[dict[str, Any]]) -> list[str]:
    """Summary lines."""
    ended = [row for row in rows if "error_mm" in row]
    square = float(np.mean([row["chi_square"] for row in ended]))
    lines = [
        f"{len(ended)} of {len(rows)} outlines; error / declared, median "
        f"{median(row['error_mm'] / row['declared_mm'] for row in ended):.2f}; chi-square per width, mean {square:.2f}",
        f"height, mean error {np.mean([row['higher_mm'] for row in ended]):+.2f} mm, root mean square "
        f"{np.sqrt(np.mean([row['higher_mm'] ** 2 for row in ended])):.2f} mm",
    ]
    if squeezed := [row for row in ended if "squeezes" in row]:
        claimed = [row for row in squeezed if row["class"]]
        lines.append(
            f"squeezes, median {median(row['squeezes'] for row in squeezed):.0f}, "
            f"largest {max(row['squeezes'] for row in squeezed)}; right {sum(row['right'] for row in claimed)}, "
            f"wrong {sum(not row['right'] for row in claimed)}, undecided {len(squeezed) - len(claimed)}"
        )
    return lines


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 11, "bottles")
    parser.add_argument("--squeeze", action="store_true", help="recognise the bottles, too")
    parser.add_argument("--report", type=Path, help="file with a line for every bottle; goes on from there")
    args = parser.parse_args()
    kept = Journal(args.report, {"campaign": "completed outlines", "squeeze": args.squeeze})
    rows = []
    for seed in seeds_of(args.seeds, args.count, args.first):
        if str(seed) not in kept:
            kept.put(str(seed), completed(seed, squeeze=args.squeeze))
        rows.append(kept.rows[str(seed)])
        print("  ".join(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in rows[-1].items()), flush=True)  # fmt: skip
    print("\n".join(figures(rows)))


if __name__ == "__main__":
    main()
