"""Force on several foams of an independent continuum: with the prior of tension and expansion, and calibrated with a plate.

    python -m benchmarks.foam_tension    prints the force error, absolute and in sigmas, for each foam, body and depth

Each case is printed for a material of which only the curve is known, and after a calibration with a plate.
Each kind of foam is one sample of the law's error, so that its ratio to sigma is a statistic over foams.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.worlds.foam_mechanics import Foam, Press, bar, cylinder, press

from visuohaptic.sensing.foam import FoamContour, read_profile
from visuohaptic.sensing.foam.material import (
    FoamMaterial,
    PlateRecord,
    StrainStress,
    calibrate_foam,
    calibrate_tension,
)

#: Foams by their parameters; beta / (1 + 2 beta) is the Poisson ratio.
FOAMS: dict[str, dict] = {
    "standard": {},
    "stiffening": {"mu_Pa": (40000.0, 200.0), "alpha": (15.0, -2.0)},
    "nearly linear": {"mu_Pa": (20000.0, 2000.0), "alpha": (6.0, -2.0)},
    "Poisson ratio 0.05": {"beta": 0.05},
    "Poisson ratio 0.12": {"beta": 0.15},
}
FROM_M = 0.003  #: from here on the ratio is taken: shallower, noise counts for more than the law
DEPTHS_M = np.array([0.0015, 0.003, 0.005, 0.0075])
SPACING_M, NOISE_M, PHASES = 0.003, 1e-5, 4
#: Bodies, and where their mesh is fine [m].
BODIES = {
    "cylinder of 6 cm": (cylinder(0.03), [(-0.02, 0.02)]),
    "plate of 15 cm": (bar(0.072, 0.003), [(-0.083, -0.069), (0.069, 0.083)]),
}


def errors(state: Press, material: FoamMaterial) -> tuple[float, float]:
    """Error of the force and its standard deviation, both by the force, over the phases of the points."""
    found = []
    for phase in np.arange(PHASES) / PHASES:
        s = np.arange(state.y_m[0] + phase * SPACING_M, state.y_m[-1], SPACING_M)
        noise = np.full(len(s), NOISE_M)
        contour = FoamContour(s, np.interp(s, state.y_m, state.delta_m), noise, np.ones(len(s), bool))
        reading = read_profile(contour, material)
        found.append([reading.force_N / state.force_N - 1.0, reading.budget.total_N / state.force_N])
    error, sigma = np.mean(found, axis=0)
    return float(error), float(sigma)


def run() -> list[dict]:
    """Error of the force for each foam, body and depth, before and after calibration."""
    rows: list[dict] = []
    ratios: dict[str, list[float]] = {}
    for name, parameters in FOAMS.items():
        foam = Foam(length_m=0.25, **parameters)
        strain = np.linspace(0.0, 0.6, 61)
        data = StrainStress(strain, foam.plate_stress_Pa(strain), np.ones(61, dtype=np.int64))
        only = calibrate_foam(data, width_m=foam.width_m, height_m=foam.height_m).material
        mesh = {"fine_m": 1.2e-3, "layers": 4}
        edges = [(-0.024, -0.014), (0.014, 0.024)]
        plate = press(foam, bar(0.017, 0.003), DEPTHS_M, spans_m=edges, **mesh)
        tension = calibrate_tension(
            [PlateRecord(p.depth_m, p.force_N, p.y_m, p.delta_m) for p in plate], only
        )
        for body, (shape, spans) in BODIES.items():
            for state in press(foam, shape, DEPTHS_M, spans_m=spans, **mesh):
                for how, material in (
                    ("curve only", only),
                    ("plate weighed", replace(only, tension=tension)),
                ):
                    error, sigma = errors(state, material)
                    found = ratios.setdefault(f"{body}, {how}", [])
                    found += [error / sigma] if state.depth_m >= FROM_M else []
                    rows.append(
                        {
                            "name": f"{name}, {body}, {how}, {1e3 * state.depth_m:.1f} mm: force wrong by",
                            "ours": 100 * error,
                            "unit": "%",
                            "note": f"{error / sigma:+.1f} of its standard deviations of {100 * sigma:.2f} %",
                        }
                    )
    for how, found in ratios.items():
        ratio = float(np.sqrt(np.mean(np.square(found))))
        rows.append(
            {
                "name": f"{how}, from {1e3 * FROM_M:g} mm on, over {len(FOAMS)} foams: rms error / sigma",
                "ours": ratio,
                "unit": "",
                "note": f"largest {max(map(abs, found)):.1f}",
            }
        )
    return rows


def main() -> None:
    """Print one line for each foam, depth and calibration."""
    for row in run():
        print(f"{row['name']} {row['ours']:+.1f} {row['unit']} ({row['note']})")


if __name__ == "__main__":
    main()
