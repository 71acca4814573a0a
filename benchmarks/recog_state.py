"""Classification of open and closed containers at the best place, with wall and modulus known to 10 %.

    python -m benchmarks recog_state            a slice
    python -m benchmarks.recog_state --variants 12 --objects elliptic,isana,cien,palmo,smoothie    the campaign

Prints the fraction classified correctly. Test curves are of other walls and moduli and of a finer mesh, with
the noise of both sensors.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from visuohaptic.core import InputError
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import draw_variant, load_container
from visuohaptic.recognition.data import TouchReading, fit_curve
from visuohaptic.recognition.touch import (
    StateCurve,
    fit_state_model,
    simulate_state_curves,
    state_probability,
)

STATES: dict[str, Contents | None] = {"open": None, "closed": Contents(), "half full": Contents(fill=0.5)}
PLACES = ("y+4", "y+6", "y+8", "y+10")
NOISE_N, NOISE_m, STEP_m = 0.1, 1e-4, 1 / 6000


def run() -> list[dict[str, Any]]:
    """A slice: two objects, few variants."""
    return campaign(("elliptic", "isana"), variants=4, tests=2)


def campaign(names: tuple[str, ...], *, variants: int, tests: int, seed: int = 0) -> list[dict[str, Any]]:
    """Fraction correct at the best place, for two and three states."""
    rows = []
    for count in (2, 3):
        states = dict(list(STATES.items())[:count])
        right, places = [], []
        for name in names:
            thing = draw_variant(load_container(name), 0, 2016)
            rng = np.random.default_rng(seed)
            curves = simulate_state_curves(thing, states, PLACES, variants=variants, seed=seed)
            model = fit_state_model(curves, rng)
            best = model.places[0]
            unseen = simulate_state_curves(thing, states, (best,), variants=tests, seed=seed + 1, around=40)
            hits = [_hit(model, curve, rng) for curve in unseen for _ in range(20)]
            right.append(float(np.mean(hits)))
            places.append(f"{name} {best} {right[-1]:.2f}")
        rows.append(
            {
                "name": f"{', '.join(states)}: right at the best place",
                "ours": float(np.mean(right)),
                "unit": "1",
                "floor": 0.9 if count == 2 else None,
                "aim": 0.97 if count == 2 else None,
                "higher_is_better": True,
                "note": "; ".join(places),
            }
        )
    return rows


def _hit(model: Any, curve: StateCurve, rng: np.random.Generator) -> bool:
    d = np.arange(1, int(curve.deformation_m[-1] / STEP_m) + 1) * STEP_m
    f = np.interp(d, np.r_[0.0, curve.deformation_m], np.r_[0.0, curve.force_N])
    try:
        fit = fit_curve(d + rng.normal(0, NOISE_m, len(d)), f + rng.normal(0, NOISE_N, len(d)))
    except InputError:
        return False
    reading = TouchReading(int(curve.place[2:]), curve.place[0], (fit, None))
    return bool(state_probability(model, (reading,))["state"] == curve.state)


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recog_state", description=__doc__)
    parser.add_argument("--variants", type=int, default=12)
    parser.add_argument("--tests", type=int, default=6)
    parser.add_argument("--objects", default="elliptic,isana,cien,palmo,smoothie")
    args = parser.parse_args()
    for row in campaign(tuple(args.objects.split(",")), variants=args.variants, tests=args.tests):
        print(f"{row['name']:45s} {row['ours']:.3f}  floor {row['floor']}  aim {row['aim']}  {row['note']}")


if __name__ == "__main__":
    main()
