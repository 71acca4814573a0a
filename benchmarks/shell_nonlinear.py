"""Large deformation: the problems of Sze, Liu and Lo, and the pinched tube compared with other codes.

python -m benchmarks shell_nonlinear    errors of the equilibrium paths, indentation of the tube, CPU time of a curve
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from visuohaptic.deformation.nonlinear import follow_displacement
from visuohaptic.deformation.shells import CorotationalShell, ShellModel

from ._shell_problems import NONLINEAR, RX, RY, RZ, X, Y, grid_mesh, held, near
from .harness import cpu_seconds
from .shell_course import PET

#: Indentation of one tip [mm] by force [N]: CalculiX S8R; 20 N between CalculiX and Kratos.
PINCH = {2.0: 0.346, 4.0: 0.766, 6.0: 1.339, 8.0: 2.160, 10.0: 2.965, 14.0: 4.286, 20.0: 5.99}


def quarter_tube(around: int, along: int) -> tuple[ShellModel, np.ndarray]:
    """A quarter of the tube with its load: a pinch of 1 N is half a newton on it."""
    mesh = grid_mesh(
        lambda u, v: (0.035 * np.cos(u * np.pi / 2), 0.035 * np.sin(u * np.pi / 2), 0.2 * v),
        around, along, 0.0005, crossed=True,
    )  # fmt: skip
    x, y, z = mesh.vertices_m.T
    fixed = held(
        mesh,
        (near(z, 0), tuple(range(6))),
        (np.abs(y) < 1e-9, (Y, RX, RZ)),
        (np.abs(x) < 1e-9, (X, RY, RZ)),
    )
    model = ShellModel(mesh, PET, fixed)
    load = np.zeros((model.nodes, 6))
    load[(along // 2) * (around + 1), X] = -0.5
    return model, load


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    rows: list[dict[str, Any]] = []
    for name, problem in NONLINEAR.items():
        started_s = time.process_time()
        walked = problem()
        spent_s = time.process_time() - started_s
        rows.append(
            {
                "name": f"{name}: largest distance from the tabulated curve",
                "ours": 100 * walked.distance,
                "unit": "% of its size",
                "floor": 2.0,
                "aim": 2.0,
                "note": f"at the last load {100 * walked.final:.2f} %, {walked.iterations} iterations, "
                f"{spent_s:.1f} s CPU{'' if walked.complete else ', NOT COMPLETE'}",
            }
        )
    model, load = quarter_tube(24, 88)
    depth = np.r_[np.linspace(0.0002, 0.006, 30), 0.007, 0.008, 0.009, 0.010]
    path = follow_displacement(CorotationalShell(model), load, list(depth))
    for force, reference in PINCH.items():
        found = 1e3 * float(np.interp(force, path.load, path.control_m))
        rows.append(
            {
                "name": f"pinched tube at {force:g} N: indentation against CalculiX and Kratos",
                "ours": 100 * abs(found / reference - 1),
                "unit": "%",
                "floor": 3.0,
                "aim": 2.0,
                "note": f"{found:.3f} mm, there {reference:.3f} mm",
            }
        )
    rows.append({"name": "the same at 10 mm", "ours": float(path.load[-1]), "unit": "N"})
    targets = [0.0005, 0.001, 0.002, 0.003, 0.0045, 0.006]
    for around, along in ((12, 44), (18, 66)):
        model, load = quarter_tube(around, along)
        shell = CorotationalShell(model)
        path = follow_displacement(shell, load, targets)
        rows.append(
            {
                "name": f"one grasp curve, quarter model of {model.nodes} vertices, 6 points",
                "ours": cpu_seconds(
                    lambda shell=shell, load=load: follow_displacement(shell, load, targets), repeats=3
                ),
                "unit": "s CPU",
                "floor": 3.0,
                "aim": 0.3,
                "note": f"{path.iterations} iterations, {path.load[-1]:.2f} N at 6 mm",
            }
        )
    return rows
