"""Surface fusion at 5 mm in 1 m^3: CPU time to integrate a view of 640 x 480, and to extract the mesh.

python -m benchmarks fusion
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from . import harness


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    from tests.reconstruction.scenes import ring

    from visuohaptic.core.camera import Camera
    from visuohaptic.reconstruction.fusion import TsdfVolume

    frames = ring(Camera.simple(640, 480, 525.0))
    low_m, high_m = np.array([0.0, 0.0, -0.1]), np.array([0.995, 0.995, 0.895])
    spent_s = []
    for _ in range(3):
        volume = TsdfVolume.around(low_m, high_m, 0.005, color=False)
        started_s = time.process_time()
        volume.integrate_all(frames)
        spent_s.append((time.process_time() - started_s) / len(frames))
    mesh_s = harness.cpu_seconds(volume.mesh)
    sparse = TsdfVolume(0.005, color=False)
    sparse_s = []
    for frame in frames * 2:
        started_s = time.process_time()
        sparse.integrate(frame)
        sparse_s.append(time.process_time() - started_s)
    note = "8 views of a table with spheres; Open3D's block grid: 40 and 223 ms on another machine"
    return [
        {"name": "integrate, 200^3", "ours": 1e3 * float(np.median(spent_s)), "unit": "ms CPU",
         "floor": 40.0, "aim": 20.0, "note": note},
        {"name": "mesh, 200^3", "ours": 1e3 * mesh_s, "unit": "ms CPU", "floor": 100.0, "aim": 60.0,
         "note": f"{volume.bricks} bricks"},
        {"name": "integrate, without a box", "ours": 1e3 * float(np.median(sparse_s)), "unit": "ms CPU",
         "note": f"{sparse.bricks} bricks"},
    ]  # fmt: skip
