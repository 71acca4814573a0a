"""Force from the contours of a continuum simulation that is independent of the library, through the camera.

    python -m benchmarks foam_continuum    worst and mean force error of each body and boundary law, also from images

Needs ``foam_continuum`` of the third-party data (``VISUOHAPTIC_DATA`` or ``../shared/data``).
"""

from __future__ import annotations

import csv
import os
import tempfile
from pathlib import Path

import numpy as np

from visuohaptic.core.camera import Frame
from visuohaptic.rigs.virtual_sensor import WEBCAM
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.foam.material import (
    calibrate_foam,
    calibrate_tension,
    read_plate,
    read_strain_stress,
)
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import FoamScene, Look, SceneRenderer

from .harness import ROOT

WIDTH_M, HEIGHT_M, LENGTH_M = 0.02, 0.01, 0.25


def data_folder() -> Path | None:
    """Folder of the records, if it exists."""
    named = os.environ.get("VISUOHAPTIC_DATA")
    folder = (Path(named) if named else ROOT.parent / "shared" / "data") / "foam_continuum"
    return folder if folder.is_dir() else None


def read_records(path: Path) -> dict[float, tuple[float, np.ndarray, np.ndarray]]:
    """Force, s and deflection by depth."""
    table: dict[float, tuple[float, list[float], list[float]]] = {}
    with path.open(newline="") as stream:
        for row in csv.DictReader(stream):
            entry = table.setdefault(float(row["depth_m"]), (float(row["force_N"]), [], []))
            entry[1].append(float(row["s_m"]))
            entry[2].append(float(row["delta_m"]))
    return {depth: (force, np.array(s), np.array(d)) for depth, (force, s, d) in table.items()}


def scene(s_m: np.ndarray, delta_m: np.ndarray) -> FoamScene:
    """The strip with a given contour, its middle at y = 0."""
    y = np.concatenate([[0.0], s_m, [LENGTH_M]]) - 0.5 * LENGTH_M
    delta = np.concatenate([delta_m[:1], delta_m, delta_m[-1:]])
    return FoamScene(0.0, np.column_stack([np.zeros_like(y), y]), np.column_stack([WIDTH_M - delta, y]))


def run() -> list[dict]:
    """Worst error beyond 1 mm for each body, with each boundary law, with and without calibrated tension."""
    folder = data_folder()
    if folder is None:
        return [
            {
                "name": "continuum records",
                "ours": float("nan"),
                "unit": "%",
                "note": "absent: set VISUOHAPTIC_DATA",
            }
        ]
    bodies = {"plate_4cm": "4 cm plate", "cylinder_12cm": "12 cm cylinder"}
    rows = []
    data = read_strain_stress(folder / "strain_stress.csv")
    for law in ("tension", "tension, calibrated on the other body", "enlarged", "local"):
        for body, name in bodies.items():
            material = calibrate_foam(data, width_m=WIDTH_M, height_m=HEIGHT_M).material
            if "calibrated" in law:
                other = next(one for one in bodies if one != body)
                tension = calibrate_tension(read_plate(folder / f"{other}.csv"), material)
                material = calibrate_foam(data, width_m=WIDTH_M, height_m=HEIGHT_M, tension=tension).material
            errors = through_camera(material, read_records(folder / f"{body}.csv"), law.split(",")[0])
            beyond = {depth: error for depth, error in errors.items() if depth > 0.00101}
            worst = max(beyond, key=lambda depth: abs(beyond[depth]))
            limits = {"floor": 2.5, "aim": 1.0} if law.startswith("tension") else {}
            rows.append(
                {
                    "name": f"{name}, {law}",
                    "ours": 100 * abs(beyond[worst]),
                    "unit": "%",
                    **limits,
                    "note": f"worst at {1e3 * worst:.0f} mm, mean {100 * np.mean(list(beyond.values())):+.2f} %, "
                    f"at 6 mm {100 * errors[0.006]:+.2f} %",
                }
            )
    return rows


def through_camera(material, records, boundary: str) -> dict[float, float]:
    """Relative error of the force by depth, read from rendered frames."""
    rig = SensorRig()
    rng = np.random.default_rng(5)
    renderer = SceneRenderer(rig.camera, rig.T_camera_foam, Look.photo(), WEBCAM)
    errors = {}
    with tempfile.TemporaryDirectory() as folder:
        material.save(Path(folder) / "foam.yaml")
        sensor = FoamSensor.load(rig.write(folder, length_m=LENGTH_M, boundary=boundary))
        s = next(iter(records.values()))[1]
        rest = scene(s, np.zeros_like(s))
        sensor.zero([Frame(renderer.render(rest, rng=rng), i / 30, i) for i in range(20)])
        for index, (depth, (force, s, delta)) in enumerate(sorted(records.items()), start=20):
            profile = sensor.read(Frame(renderer.render(scene(s, delta), rng=rng), index / 30, index))
            errors[depth] = profile.force_N / force - 1.0
    return errors
