"""Force of the test shapes of figure 3.7, read from rendered frames, compared with the true force of the simulated foam.

python -m benchmarks foam_force     error of each shape while loading, noise, declared over true sigma, hysteresis
"""

from __future__ import annotations

import tempfile

import numpy as np

from visuohaptic.core.camera import Frame
from visuohaptic.rigs import VirtualSensor
from visuohaptic.simulation.foam import PressShape, press, press_path

#: Depths of the path, up and back; frames per depth, with noise of their own: they know it to 8 %.
DEEPEST_M, STEPS, REPEATS = 0.010, 10, 80


def run() -> list[dict]:
    """Rows of the table: image noise, error of reading per shape, declared sigma, unloading."""
    virtual = VirtualSensor()
    rows = []
    noise, declared, pulls = [], [], []
    unloading, uncorrected = [], []
    with tempfile.TemporaryDirectory() as folder:
        rng = np.random.default_rng(37)
        sensor = virtual.build(folder, rng)
        renderer = virtual.renderer()
        row_times_s = np.zeros(renderer.camera.height)
        index = 0
        for shape in PressShape:
            sensor.reset()
            worst = worst_fraction = 0.0
            for sample in press(shape, press_path(DEEPEST_M, STEPS), geometry=virtual.geometry):
                forces, sigmas = [], []
                exact = renderer.render_exact(sample.scene)[..., None]
                for _ in range(REPEATS if sample.direction == "loading" else 1):
                    image = renderer.effects.developed(exact, row_times_s, rng)[..., 0]
                    frame = Frame(image, index / 30.0, index)
                    index += 1
                    profile = sensor.read(frame)
                    forces.append(profile.force_N)
                    sigmas.append(profile.budget.image_N)
                error = float(np.mean(forces)) - sample.force_N
                if sample.direction == "unloading":
                    if sample.force_N > 0.1:
                        unloading.append(abs(error))
                        strain = np.maximum(profile.delta_m, 0) / virtual.geometry.width_m
                        material = sensor.setup.material
                        loading = material.height_m * np.trapezoid(material.stress(strain), profile.s_m)
                        uncorrected.append(abs(float(loading) - sample.force_N))
                    continue
                if sample.force_N < 0.02:
                    continue
                noise.append(float(np.std(forces, ddof=1)))
                declared.append(float(np.mean(sigmas)))
                pulls.append(error / profile.force_sigma_N)
                # The floor allows 3 % of the reading or 0.1 N, whichever is larger.
                worst = max(worst, abs(error) / max(sample.force_N, 0.1 / 0.03))
                worst_fraction = max(worst_fraction, abs(error) / sample.force_N)
            rows.append(
                {
                    "name": f"shape {shape.value}: worst error, of reading or of 3.3 N",
                    "ours": 100 * worst,
                    "unit": "%",
                    "floor": 3.0,
                    "aim": 1.0,
                    "note": f"worst error of reading alone {100 * worst_fraction:.1f} %, 1 to 10 mm deep",
                }
            )
    ratio = np.divide(declared, noise)
    rows += [
        {
            "name": "noise of the force from the image, median",
            "ours": 1e3 * float(np.median(noise)),
            "unit": "mN",
            "floor": 5.0,
            "note": f"largest {1e3 * max(noise):.1f} mN (4 cm plate's edge)",
        },
        {
            "name": "declared by true sigma of the force, image term, median",
            "ours": float(np.median(ratio)),
            "unit": "",
            "floor": "0.8-1.25",
            "aim": "0.9-1.1",
            "note": f"{REPEATS} frames know one to {100 / np.sqrt(2 * REPEATS - 2):.0f} %",
        },
        {
            "name": "the same, depths and shapes within 0.8 to 1.25",
            "ours": 100.0 * float(np.mean((ratio >= 0.8) & (ratio <= 1.25))),
            "unit": "%",
            "aim": 100.0,
            "higher_is_better": True,
            "note": f"{len(ratio)}, from {ratio.min():.2f} to {ratio.max():.2f}",
        },
        {
            "name": "the same, root mean square over all",
            "ours": float(np.sqrt(np.mean(np.square(declared)) / np.mean(np.square(noise)))),
            "unit": "",
            "floor": "0.8-1.25",
            "aim": "0.9-1.1",
            "note": "ruled by the kinks of the 4 cm plate beyond 8 mm",
        },
        {
            "name": "error by declared total sigma, root mean square",
            "ours": float(np.sqrt(np.mean(np.square(pulls)))),
            "unit": "",
            "note": "systematic: below 1 means that the budget is on the safe side",
        },
        {
            "name": "unloading error with the hysteresis model, by that without",
            "ours": float(np.mean(unloading) / np.mean(uncorrected)),
            "unit": "",
            "peer": 1.0,
            "peer_name": "the loading curve alone",
            "floor": 1.0,
            "aim": 0.5,
        },
    ]
    return rows
