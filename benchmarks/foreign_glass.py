"""Clear glass in the images of another renderer, whose optics and camera the library does not know: detection and false alarms.

    python -m benchmarks.foreign_glass --seeds open --count 12 --views 24 12 8 --report out.jsonl
                                      prints the fraction found, false regions and errors of the axis for each number of views

The scenes (``tests/worlds/mujoco_glass.py``) are cast by a physics engine: drop-outs, a displaced background, a stereo camera
that is named nowhere, so that its noise is measured from the sequence. Two of six kinds of scenes are opaque, where every region is false.
The odd half of the seeds is closed: for the reported figures, not for tuning. An interrupted campaign is continued.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tests.worlds.mujoco_glass import VIEWS, ray_scene

from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.pipeline import measured_noise

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from .glass_evidence import detect, frames_of
from .harness import use_one_thread

#: Where a user would look: the middle of the table, voxels of 5 mm.
SPACE = SpaceGrid.around((-0.3, -0.3, -0.02), (0.3, 0.3, 0.25), 0.005)


def campaign(
    chosen: Sequence[int],
    views: Sequence[int] = (24, 12, 8),
    journal: Path | None = None,
    *,
    space: SpaceGrid = SPACE,
    **options: Any,
) -> list[dict[str, Any]]:
    """Detections in every scene and number of views; ``options`` are those of ``ray_scene``."""
    done = Journal(journal, {"campaign": "foreign glass"})
    for seed in chosen:
        scene = None
        for count in views:
            if (key := f"{seed} {count}") not in done:
                scene = scene or ray_scene(seed, **options)
                seen = scene.views(count)
                row = detect(seen, noise=measured_noise(frames_of(seen)), grid=space)
                done.put(key, {"views": count, **row})
                print(f"{key} {row['kind']}: {row['error_m']}, {row['false']} false", flush=True)
    return [done.rows[f"{seed} {count}"] for seed in chosen for count in views]


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Vessels found, false regions, and errors of the axis, for each number of views."""
    figures = []
    for count in sorted({row["views"] for row in rows}, reverse=True):
        chosen = [row for row in rows if row["views"] == count]
        errors = [error for row in chosen for error in row["error_m"]]
        hits = [1e3 * error for error in errors if error is not None]
        off = [deviate for row in chosen for deviate in row["deviates"]]
        missed = [row["kind"] for row in chosen for error in row["error_m"] if error is None]
        name, false = f"other renderer, {count} views", sum(row["false"] for row in chosen)
        if errors:
            figures.append(
                {"name": f"{name}: vessels found", "unit": "1", "ours": len(hits) / len(errors),
                 "note": f"{len(hits)} of {len(errors)}; missed: {', '.join(missed) or 'none'}"}
            )  # fmt: skip
        if hits:
            figures.append(
                {"name": f"{name}: error of the axis, p90", "unit": "mm", "ours": float(np.quantile(hits, 0.9)),
                 "note": f"median {np.median(hits):.1f} mm, largest {max(hits):.1f} mm"}
            )  # fmt: skip
        if off:
            figures.append(
                {"name": f"{name}: axis error / declared, rms", "unit": "1", "ours": float(np.sqrt(np.mean(np.square(off)))),
                 "note": f"largest {max(off):.1f}"}
            )  # fmt: skip
        figures.append(
            {"name": f"{name}: false regions per scene", "unit": "1", "ours": false / len(chosen), "higher_is_better": False,
             "note": f"{false} in {len(chosen)} scenes, {sum(not row['vessels'] for row in chosen)} of them opaque"}
        )  # fmt: skip
    return figures


def run() -> list[dict[str, Any]]:
    """A slice: six open scenes of 12 and 8 views."""
    return summary(campaign(seeds_of("open", 6), (12, 8)))


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 12, "scenes", resumes=True)
    parser.add_argument(
        "--views", type=int, nargs="+", default=[24, 12, 8], help=f"numbers of views, at most {VIEWS}"
    )
    arguments = parser.parse_args()
    use_one_thread()
    rows = campaign(
        seeds_of(arguments.seeds, arguments.count, arguments.first), arguments.views, arguments.report
    )
    for row in summary(rows):
        print(f"{row['name']:52s} {row['ours']:7.3f} {row['unit']:3s} {row['note']}")


if __name__ == "__main__":
    main()
