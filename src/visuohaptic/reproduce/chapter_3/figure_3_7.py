"""Accuracy of the foam sensor (Fig. 3.7).

Force read from camera frames against the true force, for two cylinders (A), a large plate (B) and a plate
of 4 cm (C), with a polynomial of order three through each; crosses: four runs with shape C (simulated foam
and camera). Right: the front contour under shape C is smoothed beyond the plate's edges.
"""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np

from ...core import ForceProfile, Frame
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_sensor import VirtualSensor
from ...simulation.foam import PressShape, SensorRig, press, press_path
from ..output import Columns, Output

NAMES = {
    "A4": "A, cylinder of 4 cm",
    "A12": "A, cylinder of 12 cm",
    "B": "B, large plate",
    "C": "C, plate of 4 cm",
}
DEEPEST_m = 0.010
FRAMES = 4  #: at each depth, to separate noise from bias


def run(out: Output) -> None:
    """Press every shape, measure the force from rendered frames, compare.

    Parameters
    ----------
    out
        Receives the tables ``forces`` and ``contour_c``, picture ``accuracy``, and the comparisons; its seed and size are used.
    """
    data, body = _pressed(out)
    out.table("forces", data)
    out.table("contour_c", {"s_m": body.s_m, "delta_m": body.delta_m, "pressure_Pa": body.pressure_Pa})
    out.picture(
        "accuracy", draw_axes(1, 3, lambda *axes: _draw(*axes, data=data, body=body), size=(13.0, 4.2))
    )
    error = np.abs(data["measured_N"] - data["true_N"])
    out.compare(
        "standard deviation of the force, largest of all shapes and depths", float(data["noise_N"].max()), "N",
        dissertation=0.075, note="along the entire range; its reference had 0.15 N",
    )  # fmt: skip
    relative = error / np.maximum(data["true_N"], 0.1 / 0.03)
    out.compare(
        "largest error, of reading or of 3.3 N", 100 * float(relative.max()), "%",
        note='printed: "a small systematic error", in a plot',
    )  # fmt: skip
    small = data["shape"] == PressShape.PLATE_4CM.value
    out.compare("largest error with shape C", float(error[small].max()), "N")


def _pressed(out: Output) -> tuple[dict[str, np.ndarray], ForceProfile]:
    """Columns of all presses, and the profile at maximum depth under shape C."""
    rig = SensorRig()
    virtual = VirtualSensor(rig=rig.half_size() if out.quick else rig)
    steps, runs = (4, 1) if out.quick else (12, 4)
    rows = Columns("shape run true_N measured_N sigma_N noise_N")
    with tempfile.TemporaryDirectory() as folder:
        rng = out.rng()
        sensor = virtual.build(folder, rng)
        renderer = virtual.renderer()
        index = 0
        body: ForceProfile | None = None
        for shape in PressShape:
            for number in range(runs if shape is PressShape.PLATE_4CM else 1):
                sensor.reset()
                path = press_path(DEEPEST_m, steps, unload=False)
                for sample in press(shape, path, geometry=virtual.geometry):
                    forces = []
                    for image in renderer.repeated(sample.scene, FRAMES, rng=rng):
                        profile = sensor.read(Frame(image, index / 30.0, index))
                        index += 1
                        forces.append(profile.force_N)
                    noise_N = float(np.std(forces, ddof=1))
                    rows.add(shape.value, number, sample.force_N, forces[0], profile.force_sigma_N, noise_N)
                    small = shape is PressShape.PLATE_4CM
                    if small and (body is None or profile.force_N > body.force_N):
                        body = profile
    assert body is not None
    return {key: np.array(values) for key, values in rows.items()}, body


def _draw(left: Any, middle: Any, right: Any, *, data: dict[str, np.ndarray], body: ForceProfile) -> None:
    """Measured against true force, the error, and the deflection under shape C."""
    largest = float(data["true_N"].max())
    left.plot([0, largest], [0, largest], "--", color=COLOURS["ink"], lw=1.0)
    for shape, colour in zip(PressShape, ("blue", "orange", "green", "pink"), strict=False):
        here = data["shape"] == shape.value
        true, measured = data["true_N"][here], data["measured_N"][here]
        fit = np.polynomial.Polynomial.fit(true, measured, min(3, len(np.unique(true)) - 1))
        line = np.linspace(0, true.max(), 100)
        left.plot(line, fit(line), color=COLOURS[colour], label=NAMES[shape.value])
        middle.plot(line, 1e3 * (fit(line) - line), color=COLOURS[colour])
        if shape is PressShape.PLATE_4CM:
            marks = {"marker": "x", "c": data["run"][here], "cmap": "viridis", "s": 18, "zorder": 3}
            left.scatter(true, measured, **marks)
            middle.scatter(true, 1e3 * (measured - true), **marks)
    left.set(xlabel="true force [N]", ylabel="measured force [N]")
    middle.set(xlabel="true force [N]", ylabel="error [mN]")
    left.legend()
    right.plot(1e3 * body.s_m, 1e3 * body.delta_m, color=COLOURS["orange"])
    right.axvspan(-20, 20, color="#f1ede2", lw=0, zorder=0)
    right.set(xlabel="position along the strip [mm]", ylabel="deflection [mm]", title="shape C, 4 cm wide")
