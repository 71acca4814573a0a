"""Outlines that the probe completes in the demonstration beside the true ones, at the heights that the classifier reads.

One row for each bottle: declared standard deviation, distance of two heights, then the radii of both outlines [m]. A test of
recognition holds eleven of them, from which the correlation length of the errors is derived. About half a minute each.

    python -m benchmarks._completed_outlines --seeds open --first 1 --count 11 --out outlines.csv
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float

from benchmarks._seeds import add_seeds, seeds_of
from visuohaptic.demo import run_mission
from visuohaptic.demo.bottle import HEIGHTS

#: The heights of :func:`visuohaptic.recognition.touch.with_outline`, as fractions of the whole height.
AT = (np.arange(1, HEIGHTS - 1) + 0.5) / HEIGHTS


def radii(outline_m: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "14"]:
    """Radius at the classifier's heights [m]."""
    return np.interp(AT * outline_m[-1, 1], outline_m[:, 1], outline_m[:, 0])


def main() -> None:
    """Completes the bottles and writes the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 11, "bottles")
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write")
    args = parser.parse_args()
    with args.out.open("w", newline="", encoding="utf-8") as file, TemporaryDirectory() as folder:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(
            ["seed", "sigma_m", "step_m", *(f"{name}{k}" for name in "rt" for k in range(len(AT)))]
        )
        for seed in seeds_of(args.seeds, args.count, args.first):
            mission = run_mission(folder, part=("beam", "glass", "probe"), seed=seed).mission
            known = mission.known
            assert mission.bottle is not None
            values = [known.outline_sigma_m, known.outline_m[-1, 1] / HEIGHTS]
            both = np.concatenate([values, radii(known.outline_m), radii(mission.bottle.outline_m)])
            table.writerow([seed, *(f"{value:.5f}" for value in both)])


if __name__ == "__main__":
    main()
