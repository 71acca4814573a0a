"""Stiffness that the library computes for the meshes of ``tests/worlds/shell_meshes.py``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh
from tests.worlds.shell_meshes import KINDS, REFUSED, mesh_case, refused_mesh

from visuohaptic.core import InputError
from visuohaptic.deformation import WallProperties, load_object, nearest_value, object_map

#: Fractions of the truth within which a stiffness is right.
BANDS = (0.02, 0.01)


def mesh_row(kind: str, seed: int) -> dict[str, Any]:
    """Read a mesh file, compute its map and look up its heights as a user would."""
    case = mesh_case(kind, seed)
    row: dict[str, Any] = {"kind": kind, "faces": len(case.faces), "truth": case.stiffness_N_per_m.tolist()}
    started = time.process_time()
    with TemporaryDirectory() as folder:
        path = _written(Path(folder), case.vertices_m, case.faces)
        wall = WallProperties(
            thickness_m=case.wall_m,
            youngs_modulus_Pa=case.youngs_modulus_Pa,
            poisson_ratio=case.poisson_ratio,
        )
        try:
            thing = load_object(path, wall=wall)
            found = object_map(thing, band=False)
            values = [
                nearest_value(found.vertices_m, found.faces, found.stiffness_N_per_m, point)[0]
                for point in case.points_m
            ]
        except InputError as error:
            return row | {"refused": str(error), "cpu_s": time.process_time() - started}
    ratio = (np.array(values) / case.stiffness_N_per_m).tolist()
    return row | {"ratio": ratio, "notes": list(thing.notes), "cpu_s": time.process_time() - started}


def refused_row(kind: str, seed: int) -> dict[str, Any]:
    """Whether a mesh that is not a container is rejected, with the reason."""
    vertices, faces = refused_mesh(kind, seed)
    with TemporaryDirectory() as folder:
        try:
            thing = load_object(_written(Path(folder), vertices, faces))
        except InputError as error:
            return {"kind": kind, "refused": str(error)}
    return {"kind": kind, "notes": list(thing.notes)}


def _written(folder: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    path = folder / "mesh.ply"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def mesh_figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Heights within each band, the worst, and the result of each kind."""
    asked = [row for row in rows if row["kind"] in KINDS]
    others = [row for row in rows if row["kind"] in REFUSED]
    errors = {
        kind: np.array(
            [abs(value - 1) for row in asked if row["kind"] == kind for value in row.get("ratio", ())]
        )
        for kind in KINDS
    }
    kinds = {row["kind"] for row in asked}

    def parts(band: float) -> str:
        return "; ".join(
            f"{kind} {(some <= band).sum()}/{len(some)}"
            + (f" worst {100 * some.max():.1f} %" if len(some) else "")
            for kind, some in errors.items()
            if kind in kinds
        )

    total = sum(len(row["truth"]) for row in asked)
    every = np.concatenate(list(errors.values()))
    refused = [f"{row['kind']}: {row['refused']}" for row in asked if "refused" in row]
    figures: list[dict[str, Any]] = []
    if asked:
        slowest = max(asked, key=lambda row: row["cpu_s"])
        large = [row["cpu_s"] for row in asked if row["faces"] >= 200_000]
        figures += [
            {"name": f"meshes: heights within {100 * band:.0f} %", "ours": float((every <= band).sum() / total), "unit": "1",
             "floor": 0.95, "aim": 1.0, "note": f"of {total}; {parts(band)}" + "".join(f"; refused {one}" for one in refused)}
            for band in BANDS
        ]  # fmt: skip
        figures += [
            {"name": "meshes: worst", "ours": 100 * float(every.max()) if len(every) else float("nan"), "unit": "%",
             "floor": 2.0, "aim": 1.0, "higher_is_better": False, "note": ""},
            {"name": "meshes: taken as they are", "ours": float(np.mean([not _resampled(row) for row in asked])),
             "unit": "1", "floor": None, "aim": None, "note": "; ".join(sorted({row["kind"] for row in asked if _resampled(row)}))},
            {"name": "meshes: import to map, slowest", "ours": slowest["cpu_s"], "unit": "s", "floor": 6.0, "aim": 4.0, "higher_is_better": False,
             "note": f"{slowest['kind']}, {slowest['faces']} triangles"},
        ]  # fmt: skip
        figures += [
            {"name": "meshes: import of 200,000 triangles or more to map, slowest", "ours": max(large), "unit": "s",
             "floor": 6.1, "aim": 4.0, "higher_is_better": False, "note": ""}
        ] if large else []  # fmt: skip
    if others:
        figures.append(
            {"name": "no containers: refused", "ours": float(np.mean(["refused" in row for row in others])), "unit": "1",
             "floor": 1.0, "aim": 1.0, "note": "; ".join(sorted({f"{row['kind']} {'refused' if 'refused' in row else 'taken'}" for row in others}))}
        )  # fmt: skip
    return figures


def _resampled(row: dict[str, Any]) -> bool:
    return "refused" in row or any("sampled anew" in note for note in row["notes"])
