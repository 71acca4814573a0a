"""Data sets of containers: time for 1000 objects with linear maps and features, and uniformity of a map.

python -m benchmarks deformation_maps
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from visuohaptic.deformation.maps import BuildJob, object_map, save_map
from visuohaptic.deformation.maps.class_build import compute
from visuohaptic.deformation.shapes import (
    class_names,
    draw_variant,
    import_container,
    load_container,
    mesh_container,
)

from .harness import cpu_seconds

#: Objects that are measured.
OBJECTS = 40


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    names = class_names()
    seconds, size = [], []
    for number in range(OBJECTS + len(names)):
        container = draw_variant(load_container(names[number % len(names)]), number // len(names), 7)
        job = BuildJob(
            container.name,
            number,
            7,
            container.model_dump_json(exclude_none=True),
            48,
            False,
            ((False, 0.0),),
        )
        begin = time.process_time()
        data, reason = compute(job)
        if reason or not data:
            raise RuntimeError(reason)
        if number >= len(names):  # the first of each class only warms up
            seconds.append(time.process_time() - begin)
            size.append(len(mesh_container(container, around=48).mesh.vertices_m))
    two_cores_min = 1000 * float(np.mean(seconds)) / 2 / 60
    cleaner = load_container("cleaner").middle()
    rows: list[dict[str, Any]] = [
        {
            "name": "1000 objects, linear maps and features, two cores",
            "ours": two_cores_min,
            "unit": "min",
            "floor": 15.0,
            "aim": 5.0,
            "note": f"from {OBJECTS} of {len(names)} classes, {np.mean(size):.0f} vertices, "
            f"{np.mean(seconds):.2f} s CPU each",
        },
        {
            "name": "structured mesh of a container, 64 round",
            "ours": 1e3 * cpu_seconds(lambda: mesh_container(cleaner), repeats=5),
            "unit": "ms CPU",
            "note": f"{len(mesh_container(cleaner).mesh.vertices_m)} vertices",
        },
    ]
    rows += _import_to_file()
    return rows


def _import_to_file() -> list[dict[str, Any]]:
    import trimesh

    from visuohaptic.deformation.shapes import tube_mesh

    rows = []
    with TemporaryDirectory() as folder:
        for around, along, floor, aim in ((72, 66, 3.0, 1.0), (144, 132, 15.0, 5.0)):
            found = tube_mesh(0.035, 0.2, 0.0005, around=around, along=along, crossed=False)
            path = Path(folder) / "tube.stl"
            trimesh.Trimesh(found.vertices_m, found.faces, process=False).export(path)

            def whole(path: Path = path, folder: str = folder) -> None:
                save_map(Path(folder) / "map.npz", object_map(import_container(path), band=False))

            rows.append(
                {
                    "name": f"full linear map, {len(found.vertices_m)} vertices, STL to NPZ",
                    "ours": cpu_seconds(whole, repeats=2),
                    "unit": "s CPU",
                    "floor": floor,
                    "aim": aim,
                    "note": "one core, without the sigma band",
                }
            )
    return rows
