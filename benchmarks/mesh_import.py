"""Third-party container meshes: each has to give a map, or an error that names the defect and its location.

python -m benchmarks mesh_import    meshes with a map or a reason, time of the slowest mesh; needs third-party meshes
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import object_map, save_map
from visuohaptic.deformation.shapes import import_container

ROOT = Path(__file__).resolve().parents[1]


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    import tempfile

    folder = (
        Path(os.environ.get("VISUOHAPTIC_DATA", ROOT.parent / "shared" / "data")) / "deformation" / "meshes"
    )
    if not folder.is_dir():
        return [{"name": "mesh import", "ours": float("nan"), "unit": "", "note": "the meshes are not here"}]
    mapped, refused, seconds, size = 0, [], [], []
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in {".stl", ".ply", ".obj", ".glb", ".dae"}:
            continue
        begin = time.process_time()
        try:
            thing = import_container(path)
            found = object_map(thing, band=False)
            with tempfile.TemporaryDirectory() as scratch:
                save_map(Path(scratch) / "map.npz", found)
        except InputError as error:
            refused.append(f"{path.name}: {error.problem}")
            continue
        seconds.append(time.process_time() - begin)
        size.append(len(found.vertices_m))
        mapped += bool(np.isfinite(found.stiffness_N_per_m[~thing.fixed]).mean() > 0.9)
    total = mapped + len(refused)
    return [
        {
            "name": "meshes with a map or a reasoned refusal",
            "ours": float(total),
            "unit": f"of {len(seconds) + len(refused)}",
            "floor": float(len(seconds) + len(refused)),
            "higher_is_better": True,
            "note": f"{mapped} mapped; refused: {'; '.join(refused) or 'none'}",
        },
        {
            "name": "import, map and file, slowest mesh",
            "ours": max(seconds),
            "unit": "s CPU",
            "floor": 3.0,
            "aim": 1.0,
            "note": f"{size[int(np.argmax(seconds))]} vertices; median {np.median(seconds):.2f} s",
        },
    ]
