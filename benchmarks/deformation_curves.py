"""Grasp curves of containers: what symmetry saves, and features i, I, II of whole objects."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from visuohaptic.deformation import (
    Contents,
    class_names,
    grasp_curve,
    load_container,
    mesh_container,
    nonlinear_features,
)

from .harness import cpu_seconds

#: Mean deformations of a curve [m], as in the quarter tube's benchmark.
TARGETS_m = (0.0005, 0.001, 0.002, 0.003, 0.0045, 0.006)
#: Classes whose features are also computed on a finer mesh.
COMPARED = ("elliptic", "cup-rim", "cien")


def run() -> list[dict[str, Any]]:
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
    return rows + _features()


def _features() -> list[dict[str, Any]]:
    rows, seconds = [], []
    for name in class_names():
        container = load_container(name).variant(0, 3)
        fine, coarse = (mesh_container(container, around=around) for around in (48, 32))
        begin = time.process_time()
        found = nonlinear_features(fine, coarse=coarse, fill_in=True).values
        seconds.append(time.process_time() - begin)
        if name not in COMPARED:
            continue
        better = nonlinear_features(fine, fill_in=True).values
        away = np.abs(found[..., :2] / better[..., :2] - 1)
        rows.append(
            {
                "name": f"i and I of {name}, curves with 32 instead of 48 round: median difference",
                "ours": 100 * float(np.nanmedian(away)),
                "unit": "%",
                "note": f"9 of 10 below {100 * float(np.nanquantile(away, 0.9)):.0f} %; II: "
                f"{float(np.nanmedian(np.abs(found[..., 2] - better[..., 2]))):.2f}, its size "
                f"{float(np.nanmedian(np.abs(better[..., 2]))):.2f}",
            }
        )
    rows.append(
        {
            "name": "features from curves of 450 objects, one state, two cores",
            "ours": 450 * float(np.mean(seconds)) / 2 / 60,
            "unit": "min",
            "note": f"from one of each class, {min(seconds):.1f} to {max(seconds):.1f} s CPU each",
        }
    )
    return rows


if __name__ == "__main__":
    for row in run():
        print(row)
