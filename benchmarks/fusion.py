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
    from skimage.measure import marching_cubes
    from tests.reconstruction.scenes import ring

    from visuohaptic.core.camera import Camera
    from visuohaptic.reconstruction.fusion import SparseTsdfVolume, TsdfVolume

    frames = ring(Camera.simple(640, 480, 525.0))
    volume = TsdfVolume(np.array([0.0, 0.0, -0.1]), (200, 200, 200), 0.005, color=False)
    for frame in frames:
        volume.integrate(frame)
    spent_s = []
    for frame in frames * 2:
        started_s = time.process_time()
        volume.integrate(frame)
        spent_s.append(time.process_time() - started_s)
    mesh_s = harness.cpu_seconds(volume.mesh)
    whole_s = harness.cpu_seconds(lambda: marching_cubes(volume.distance, 0.0, mask=volume.weight > 0))
    sparse = SparseTsdfVolume(0.005, color=False)
    sparse_s = []
    for frame in frames * 2:
        started_s = time.process_time()
        sparse.integrate(frame)
        sparse_s.append(time.process_time() - started_s)
    note = "8 views of a table with spheres; Open3D's block grid: 40 and 223 ms on another machine"
    return [
        {"name": "integrate, 200^3", "ours": 1e3 * float(np.median(spent_s)), "unit": "ms CPU",
         "floor": 40.0, "aim": 20.0, "note": note},
        {"name": "mesh, 200^3", "ours": 1e3 * mesh_s, "unit": "ms CPU", "peer": 1e3 * whole_s,
         "peer_name": "scikit-image on the whole grid", "floor": 100.0, "aim": 60.0},
        {"name": "integrate, sparse", "ours": 1e3 * float(np.median(sparse_s)), "unit": "ms CPU",
         "note": f"{sparse.bricks} bricks"},
    ]  # fmt: skip
