"""Grasp curves of containers: the speed-up by symmetry, and features i, I, II of whole objects.

    python -m benchmarks deformation_curves                 a slice
    python -m benchmarks.deformation_curves --report out.jsonl    the campaign; an existing report is continued

Prints the time of a curve, the change of the features on a finer mesh, and the time of 450 objects.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core.objects import HEIGHTS, NOMINAL_N, NOMINAL_m
from visuohaptic.deformation.maps import (
    DEFORMATIONS_m,
    grasp_curve,
    linear_features,
    nonlinear_features,
)
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import class_names, draw_variant, load_container, mesh_container

from ._journal import Journal
from .harness import cpu_seconds

#: Of the objects whose features are computed.
SEED = 20261121

#: Mean deformations of a curve [m], as in the quarter tube's benchmark.
TARGETS_m = (0.0005, 0.001, 0.002, 0.003, 0.0045, 0.006)
#: Classes whose features are also computed on a finer mesh.
COMPARED = ("elliptic", "cup-rim", "cien", "bottle")


def run(report: Path | None = None) -> list[dict[str, Any]]:
    """Rows of the table."""
    rows: list[dict[str, Any]] = []
    for name, side in (("elliptic", "y+"), ("bottle", "x+"), ("cleaner", "y+")):
        thing = mesh_container(load_container(name).middle(), around=32)
        for contents in (None, Contents(fill=0.5)):
            found = grasp_curve(thing, side=side, deformation_m=TARGETS_m, contents=contents)
            whole = grasp_curve(thing, side=side, deformation_m=TARGETS_m, contents=contents, symmetric=False)
            begin = time.process_time()
            grasp_curve(thing, side=side, deformation_m=TARGETS_m, contents=contents, symmetric=False)
            whole_s = time.process_time() - begin

            def curve(thing: Any = thing, side: str = side, contents: Contents | None = contents) -> None:
                grasp_curve(thing, side=side, deformation_m=TARGETS_m, contents=contents)

            rows.append(
                {
                    "name": f"grasp curve of {name}, {'open' if contents is None else 'half full, closed'}",
                    "ours": cpu_seconds(curve, repeats=3),
                    "unit": "s CPU",
                    "peer": whole_s,
                    "peer_name": "the whole object",
                    "floor": 3.0,
                    "aim": 0.3,
                    "note": f"1/{found.copies}: {found.nodes} vertices, {found.iterations} iterations, largest "
                    f"difference {np.abs(found.force_N / whole.force_N - 1).max():.0e}",
                }
            )
    return rows + _features(report)


def _features(report: Path | None) -> list[dict[str, Any]]:
    named = os.environ.get("DEFORMATION_CURVES_JOURNAL")
    done = Journal(
        report or (Path(named) if named else None), {"campaign": "deformation_curves", "seed": SEED}
    )
    for name in class_names():
        if name not in done:
            done.put(name, _one(name))
    rows: list[dict[str, Any]] = []
    for name in COMPARED:
        found = done.rows[name]
        rows += [
            {
                "name": f"i and I of {name}, curves with 32 instead of 48 round: median difference",
                "ours": 100 * float(np.median(found["linear"])),
                "unit": "%",
                "note": f"9 of 10 below {100 * float(np.quantile(found['linear'], 0.9)):.0f} %",
            },
            {
                "name": f"II of {name} where it is called valid: 9 of 10 differ by less than",
                "ours": 100 * float(np.quantile(found["valid"], 0.9)) if found["valid"] else float("nan"),
                "unit": "% of the linear force",
                "note": f"at full deformation; largest {100 * max(found['valid'], default=0):.0f} %, "
                f"{len(found['valid'])} valid, {len(found['flagged'])} flagged: "
                f"{', '.join(f'{count} {why}' for why, count in found['reasons'].items()) or 'none'}",
            },
        ]
    seconds = [found["seconds"] for found in done.rows.values()]
    rows.append(
        {
            "name": "features from curves of 450 objects, one state, two cores",
            "ours": 450 * float(np.mean(seconds)) / 2 / 60,
            "unit": "min",
            "note": f"from one of each class, {min(seconds):.1f} to {max(seconds):.1f} s CPU each",
        }
    )
    return rows


def _one(name: str) -> dict[str, Any]:
    """Features of one object on the build's mesh, and by how much a finer mesh changes them."""
    container = draw_variant(load_container(name), 0, SEED)
    fine, coarse = mesh_container(container, around=48), mesh_container(container, around=32, levels=HEIGHTS)
    begin = time.process_time()
    found = nonlinear_features(fine, coarse=coarse, fill_in=True)
    seconds = time.process_time() - begin
    if name not in COMPARED:
        return {"seconds": seconds}
    finer = mesh_container(container, around=48, levels=HEIGHTS)
    better = nonlinear_features(fine, coarse=finer, fill_in=True)
    away = np.abs(found.values[..., :2] / better.values[..., :2] - 1)
    linear = linear_features(fine).values[..., 0]
    # Contribution of the quadratic term to the force at 8 mm, relative to linear elasticity.
    term = NOMINAL_N / NOMINAL_m**2 * DEFORMATIONS_m[-1] / linear
    quadratic = np.abs(found.values[..., 2] - better.values[..., 2]) * term
    known = np.isfinite(quadratic)
    trusted = known & found.valid[..., 2]
    reasons: dict[str, int] = {}
    for text in found.reason[known & ~trusted]:
        short = (
            "ends early"
            if "ends at" in text
            else "snaps"
            if "snaps" in text
            else "near an end"
            if "cells" in text
            else "no parabola"
        )
        reasons[short] = reasons.get(short, 0) + 1
    return {
        "seconds": seconds,
        "linear": away[np.isfinite(away)].tolist(),
        "valid": quadratic[trusted].tolist(),
        "flagged": quadratic[known & ~trusted].tolist(),
        "reasons": reasons,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    for row in run(parser.parse_args().report):
        print(row)
