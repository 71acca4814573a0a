"""One small file of every format, written by this version, for later versions to read.

Run at a release, into a new folder; folders of older versions are never overwritten.

    python -m benchmarks.golden tests/golden/0.1.0
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from .hostile_files import READERS

#: Formats that the library writes, among those of the campaign of hostile files; their name in the folder.
NAMES = {
    "camera": "camera.yaml",
    "beam": "beam.yaml",
    "depth": "depth.png",
    "forces": "forces.csv",
    "forces parquet": "forces.parquet",
    "mcap": "run.mcap",
    "stiffness map": "cup.npz",
    "ply": "surface.ply",
    "scans": "scans.csv",
    "layer": "layer.yaml",
    "unfinished table": "wrenches.parquet.part",
}


def write(folder: Path) -> None:
    """Write all files into a new folder."""
    from visuohaptic.core import Estimate, Geometry, HapticTag, VisuoHapticObject
    from visuohaptic.core.camera import Camera, Pose
    from visuohaptic.database import ObjectDatabase, export_object
    from visuohaptic.io import DepthFrame, OccupancyMap
    from visuohaptic.io.depth import write_sequence

    folder.mkdir(parents=True)
    builders = {name: build for name, _, build, _ in READERS}
    for name, file in NAMES.items():
        builders[name](folder / file)
    cells = np.zeros((9, 12), np.int8)
    cells[0], cells[-1] = 100, -1
    OccupancyMap(cells, 0.05, (1.0, 2.0, 0.1)).save(folder / "map.yaml")
    camera = Camera.simple(20, 16, 30.0)
    wall = np.full((16, 20), 0.8, np.float32)
    views = [
        DepthFrame(0.1 * n, wall, None, Pose(np.eye(3), np.array([0.01 * n, 0.0, 0.0])), camera)
        for n in range(3)
    ]
    write_sequence(folder / "scan", views)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    thing = VisuoHapticObject(
        id="box",
        geometry=Geometry(vertices_m=corners, faces=faces),
        tag=HapticTag(dynamic_friction_N=Estimate(3.2, 0.1)),
    )
    export_object(thing, folder / "card", licence="CC0-1.0")
    with ObjectDatabase(folder / "db") as database:
        database.add(thing)


def main() -> None:
    """Write the given folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder)


if __name__ == "__main__":
    main()
