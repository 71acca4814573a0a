"""Ratio of the lateral tension over foams and bodies of an independent continuum: is the prior's sigma honest?

``python -m benchmarks.foam_tension`` prints, for each foam, body and depth, the ratio that makes the force right, what a
ratio of one takes away from the force, and the error of the force with the prior, in declared sigmas of the ratio.
"""

from __future__ import annotations

import numpy as np
from tests.worlds.foam_mechanics import Foam, bar, cylinder, press

from visuohaptic.sensing.foam.material import StrainStress, Tension, calibrate_foam, contour_force

#: Foams by their parameters; beta / (1 + 2 beta) is the Poisson ratio.
FOAMS: dict[str, dict] = {
    "standard": {},
    "stiffening": {"mu_Pa": (40000.0, 200.0), "alpha": (15.0, -2.0)},
    "nearly linear": {"mu_Pa": (20000.0, 2000.0), "alpha": (6.0, -2.0)},
    "Poisson ratio 0.05": {"beta": 0.05},
    "Poisson ratio 0.12": {"beta": 0.15},
}
DEPTHS_M = np.array([0.0025, 0.005, 0.0075])
SPACING_M, PHASES = 0.003, 4


def ratios(foam: Foam) -> list[tuple[str, float, float, float]]:
    """Body, depth [m], ratio that makes the force right, and what a ratio of one takes away by the force."""
    strain = np.linspace(0.0, 0.6, 61)
    data = StrainStress(strain, foam.plate_stress_Pa(strain), np.ones(61, dtype=np.int64))
    material = calibrate_foam(data, width_m=foam.width_m, height_m=foam.height_m).material
    bodies = {
        "cylinder": (cylinder(0.03), [(-0.02, 0.02)]),
        "plate": (bar(0.017, 0.003), [(-0.024, -0.014), (0.014, 0.024)]),
    }
    rows = []
    for name, (body, spans) in bodies.items():
        for state in press(foam, body, DEPTHS_M, spans_m=spans, fine_m=1.2e-3, layers=4):
            sampled = []
            for phase in np.arange(PHASES) / PHASES:
                y = np.arange(state.y_m[0] + phase * SPACING_M, state.y_m[-1], SPACING_M)
                sampled.append(contour_force(y, np.interp(y, state.y_m, state.delta_m), material))
            enlarged, relief = np.mean(sampled, axis=0)
            rows.append(
                (
                    name,
                    state.depth_m,
                    float((enlarged - state.force_N) / relief),
                    float(relief / state.force_N),
                )
            )
    return rows


def run() -> list[dict]:
    """Error of the force with the prior, for each foam, body and depth."""
    prior, rows = Tension(), []
    for name, parameters in FOAMS.items():
        for body, depth_m, ratio, relief in ratios(Foam(length_m=0.16, **parameters)):
            sigmas = (ratio - prior.ratio) / prior.sigma
            rows.append(
                {
                    "name": f"{name}, {body}, {1e3 * depth_m:.1f} mm: force wrong by",
                    "ours": 100 * (ratio - prior.ratio) * relief,
                    "unit": "%",
                    "note": f"ratio {ratio:+.2f}, {sigmas:+.1f} sigmas of the prior",
                }
            )
    return rows


def main() -> None:
    """Print one line for each foam, body and depth."""
    for row in run():
        print(f"{row['name']} {row['ours']:+.1f} {row['unit']} ({row['note']})")


if __name__ == "__main__":
    main()
