"""Planned touches on clear vessels of the ray caster, and on scanned objects with a hidden part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from tests.worlds.ray_meshes import HIDDEN, PartlySeen, distance_to_mesh, probe_mesh
from tests.worlds.ray_objects import PLAIN, Vessel
from tests.worlds.ray_optics import cast, compile_scene

from visuohaptic.core import VisuohapticError
from visuohaptic.reconstruction import Reconstruction, SurfaceMesh
from visuohaptic.reconstruction.body_completion import BodyCompletion
from visuohaptic.reconstruction.completion import Completion, HoleRegion, Touch

__all__ = ["object_figures", "touch_object", "touch_vessel", "vessel_figures"]

TOUCHES = 6
#: Noise of a contact along the probe's line [m].
SIGMA_M = 0.0003

Probe = Callable[[np.ndarray, np.ndarray], np.ndarray | None]


def _explore(
    completion: Completion | BodyCompletion, probe: Probe, truth_m: np.ndarray, rng: np.random.Generator
) -> dict[str, Any]:
    """Error of the surface at true points and declared standard deviation there, before and after planned touches."""
    rows: dict[str, Any] = {"rms_m": [], "declared_m": [], "met": 0, "planned": 0, "problem": ""}

    def measured() -> None:
        surface = completion.completed()
        error = distance_to_mesh(truth_m, surface.vertices_m, surface.faces)
        near = _nearest_vertices(truth_m, surface.vertices_m)
        declared = completion.sigma_m(near)
        rows["rms_m"].append(float(np.sqrt(np.mean(error**2))))
        rows["declared_m"].append(float(np.sqrt(np.nanmean(declared**2))))

    measured()
    for _ in range(TOUCHES):
        try:
            plan = completion.next_touch()
        except VisuohapticError as error:
            rows["problem"] = str(error)
            break
        rows["planned"] += 1
        contact = probe(plan.start_m, plan.end_m)
        if contact is not None:
            rows["met"] += 1
            contact = contact + SIGMA_M * rng.standard_normal() * plan.direction
        completion.add(Touch(contact, plan.start_m, plan.end_m, sigma_m=SIGMA_M))
    measured()
    return rows


def _nearest_vertices(points_m: np.ndarray, vertices_m: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    return vertices_m[cKDTree(vertices_m).query(points_m)[1]]


def touch_vessel(found: Reconstruction, vessel: Vessel, seed: int) -> dict[str, Any]:
    """Six planned touches on a fully clear vessel, in the detected region or, if there is none, a given one."""
    rng = np.random.default_rng([seed, 11])
    truth = vessel.surface(rng, 1500)
    truth = truth[truth[:, 2] > 0.004]
    scene = compile_scene([vessel.solid(PLAIN)], [])
    low, high = vessel.bounds_m
    inside = [
        k
        for k, region in enumerate(found.regions)
        if ((region.centroid_m > low) & (region.centroid_m < high)).all()
    ]
    row: dict[str, Any] = {"kind": vessel.kind, "region": "found" if inside else "given"}

    def probe(start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray | None:
        way = end_m - start_m
        length = np.linalg.norm(way)
        hit = cast(scene, start_m, way[None] / length)
        return hit.point_m[0] if hit.owner[0] >= 0 and hit.first_m[0] <= length else None

    try:
        if inside:
            completion: Completion | BodyCompletion = found.body_completion(inside[0])
        else:
            middle = truth.mean(axis=0)
            completion = Completion(found.surface, HoleRegion.of_points(middle + 0.9 * (truth - middle)))
        row |= _explore(completion, probe, truth, rng)
    except VisuohapticError as error:
        row["problem"] = str(error)
    return row


def touch_object(seen: PartlySeen, seed: int) -> dict[str, Any]:
    """Six planned touches on the hidden part of an object; the region is nine tenths of the hidden part."""
    rng = np.random.default_rng([seed, 12])
    middle = seen.hidden_m.mean(axis=0)
    row: dict[str, Any] = {"object": seen.name}
    try:
        region = HoleRegion.of_points(middle + 0.9 * (seen.hidden_m - middle))
        completion = Completion(SurfaceMesh(seen.vertices_m, seen.faces), region)
        row |= _explore(completion, lambda a, b: probe_mesh(seen.mesh, a, b), seen.hidden_m, rng)
    except VisuohapticError as error:
        row["problem"] = str(error)
    return row


def _done(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if len(row.get("rms_m", [])) == 2]


def vessel_figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Figures of clear vessels after six touches."""
    done = _done(rows)
    figures: list[dict[str, Any]] = [
        {"name": "clear_touch: vessels completed at all", "ours": len(done) / len(rows), "unit": "1", "floor": None,
         "aim": None, "note": f"{len(rows)} vessels, region found {sum(r['region'] == 'found' for r in rows)}"}
    ]  # fmt: skip
    if done:
        rms = 1e3 * np.array([row["rms_m"] for row in done])
        told = 1e3 * np.array([row["declared_m"][1] for row in done])
        ratio = told / rms[:, 1]
        together = float(np.sqrt(np.mean(told**2) / np.mean(rms[:, 1] ** 2)))
        figures += [
            {"name": "clear_touch: rms after six touches, median", "ours": float(np.median(rms[:, 1])), "unit": "mm",
             "floor": 3.0, "aim": 2.0, "higher_is_better": False,
             "note": f"before {np.median(rms[:, 0]):.1f}, p90 after {np.quantile(rms[:, 1], 0.9):.1f}"},
            {"name": "clear_touch: declared over true, median", "ours": float(np.median(ratio)), "unit": "1",
             "floor": (0.6, 1.6), "aim": (0.8, 1.25), "note": f"{ratio.min():.2f} to {ratio.max():.2f}; root mean squares of all vessels {together:.2f}"},
            {"name": "clear_touch: planned touches that meet", "ours": sum(row["met"] for row in done) / sum(row["planned"] for row in done),
             "unit": "1", "floor": 0.85, "aim": 0.95, "note": f"of {sum(row['planned'] for row in done)}"},
        ]  # fmt: skip
    return figures


def object_figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Figures of objects by their hidden part."""
    parts = [[row for row in rows if row["hidden"] == hidden] for hidden in HIDDEN]
    return [figure for part in parts if part for figure in _object_figures(part)]


def _object_figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Figures of objects with the same hidden part."""
    what = f"objects, {rows[0]['hidden']} hidden"
    done = _done(rows)
    before, after = (np.array([row["rms_m"][k] for row in done]) for k in (0, 1))
    count = max(len(rows), 1)
    # A touch is no more exact than its noise and that of the visible surface.
    worse = [row["object"] for row, a, b in zip(done, before, after, strict=True) if b > a + SIGMA_M]
    note = f"{len(rows)} objects, {len(rows) - len(done)} refused; worse: {', '.join(worse) or 'none'}"
    met, planned = (sum(row.get(key, 0) for row in rows) for key in ("met", "planned"))
    return [
        {"name": f"{what}: never worse than before", "ours": (len(done) - len(worse)) / count, "unit": "1", "floor": 1.0,
         "aim": 1.0, "note": note},
        {"name": f"{what}: error to a third", "ours": float((after <= before / 3).sum()) / count, "unit": "1",
         "floor": 0.5, "aim": 0.8,
         "note": f"rms {1e3 * np.median(before):.1f} to {1e3 * np.median(after):.1f} mm" if len(done) else ""},
        {"name": f"{what}: planned touches that meet", "ours": met / max(planned, 1), "unit": "1", "floor": 0.85,
         "aim": 0.95, "note": f"{met} of {planned}"},
    ]  # fmt: skip
