"""Primitives fitted to 500 random contacts: correct kind, radius, time; peer: the score as printed (3.11).

python -m benchmarks primitives
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from tests.sensing import contacts

from visuohaptic.sensing.push import PrimitiveSettings, fit_circle_algebraic, fit_primitive

SEED = 20160421


def run(count: int = 500, seed: int = SEED, *, verbose: bool = False) -> list[dict[str, object]]:
    """The campaign; every row has name, ours, peer, ratio, unit, floor, aim."""
    rng = np.random.default_rng(seed)
    printed = PrimitiveSettings(choice="score")
    right = right_clear = clear = right_printed = 0
    radius, radius_peer, deviation, seconds = [], [], [], []
    confusion: Counter[tuple[str, str]] = Counter()
    for number in range(count):
        truth = contacts.random_contact(rng)
        begin = time.process_time()
        fit = fit_primitive(truth.points_m, truth.sigma_m, delta_m=truth.delta_m)
        seconds.append(time.process_time() - begin)
        kind = str(fit.best.kind) if fit.best is not None else "none"
        confusion[truth.kind, kind] += 1
        right += kind == truth.kind
        clear += truth.clear
        right_clear += truth.clear and kind == truth.kind
        peer = fit_primitive(truth.points_m, truth.sigma_m, delta_m=truth.delta_m, settings=printed).best
        right_printed += peer is not None and peer.kind == truth.kind
        if truth.kind == "circle":
            true = truth.truth["radius_m"]
            # Algebraic circle fit to the whole deformation set, including flanks.
            radius_peer.append(abs(fit_circle_algebraic(truth.points_m)[2] / true - 1))
            if fit.best is not None and kind == "circle":
                found = fit.best.parameters[2]
                radius.append(abs(found / true - 1))
                deviation.append((found - true) / np.sqrt(fit.best.covariance[2, 2]))
        if verbose and kind != truth.kind:
            print(number, truth.scene, truth.kind, "read as", kind, "" if truth.clear else "(not clear)")
    if verbose:
        print(dict(confusion), f"not clear by the rule: {count - clear}")

    def row(
        name: str, ours: float, peer: float, unit: str, floor: float | None, aim: float | None
    ) -> dict[str, object]:
        ratio = ours / peer if peer else float("nan")
        return {
            "name": name,
            "ours": ours,
            "peer": peer,
            "ratio": ratio,
            "unit": unit,
            "floor": floor,
            "aim": aim,
        }

    robust = float(np.median(np.abs(deviation)) / 0.6745)
    printed_fraction = right_printed / count
    error, error_peer = float(np.median(radius)), float(np.median(radius_peer))
    cpu_ms = float(np.median(seconds)) * 1e3
    return [
        row("primitives: right kind, all contacts", right / count, printed_fraction, "1", 0.95, 0.98),
        row("primitives: right kind, clear ones", right_clear / clear, printed_fraction, "1", 0.95, 0.98),
        row("primitives: circle radius error, median", error, error_peer, "1", 0.05, 0.03),
        row("primitives: true / declared sigma of the radius", robust, 1.0, "1", None, None),
        row("primitives: CPU time per contact, median", cpu_ms, float("nan"), "ms", None, None),
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    for line in run(arguments.count, arguments.seed, verbose=True):
        print(line)
