"""Mapping with drifting odometry on a loop, maps by touch, and footprints in third-party maps: errors against the truth.

python -m benchmarks nav_maps     errors of pose and map, CPU time per scan, IoU of a haptic map, bins found
"""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.grid import find_footprints
from visuohaptic.navigation.mapping import OccupancyMapper
from visuohaptic.simulation.mobile import LaserConfig, SimulatedLaser

from . import _haptic_room
from ._nav_walks import agreement, drifted, smooth_way
from .nav_doors import data_folder

#: Corners of loops through real maps [m]: an apartment, and the long corridors of an office floor.
LOOPS: dict[str, tuple[str, list[tuple[float, float]]]] = {
    "apartment": ("cob_ipa_apartment/map.yaml", []),
    "corridors": (
        "ut_gdc_3/3.yaml",
        [(-25, -5), (-11, -5), (-11, -12), (-40, -12), (-41.5, -5), (-25, -5), (-15, -5)],
    ),
}


def _loop(grid: OccupancyMap, corners: list[tuple[float, float]]) -> np.ndarray:
    if not corners:
        rows, columns = np.nonzero(grid.free)
        fractions = ((0.2, 0.2), (0.2, 0.8), (0.5, 0.5), (0.8, 0.8), (0.8, 0.2), (0.2, 0.2))
        cells = np.array([[np.quantile(rows, a), np.quantile(columns, b)] for a, b in fractions])
        corners = [(float(x), float(y)) for x, y in grid.world_from_cell(cells)]
    return smooth_way(grid, corners)


def mapping(name: str, seed: int = 0) -> dict[str, float]:
    """One loop: errors against the truth, compared with odometry alone."""
    path, corners = LOOPS[name]
    grid = OccupancyMap.load(data_folder() / path)
    truth = _loop(grid, corners)
    rng = np.random.default_rng(seed)
    odometry = drifted(truth, rng)
    laser = SimulatedLaser(grid, LaserConfig(), rng)
    mapper = OccupancyMapper()
    seconds = []
    for number, (pose, wheels) in enumerate(zip(truth, odometry, strict=True)):
        scan = laser.scan(tuple(pose), 0.1 * number)
        started = time.process_time()
        mapper.add(scan, tuple(wheels))
        seconds.append(time.process_time() - started)
    error = np.hypot(*(mapper.trajectory - truth)[:, :2].T)
    return {
        "path_length_m": float(np.hypot(*np.diff(truth[:, :2], axis=0).T).sum()),
        "median_m": float(np.median(error)),
        "worst_m": float(error.max()),
        "end_m": float(error[-1]),
        "wheels_end_m": float(np.hypot(*(odometry[-1] - truth[-1])[:2])),
        "scan_ms": float(np.median(seconds) * 1e3),
        **agreement(mapper.map(), grid),
    }


def run() -> list[dict[str, Any]]:
    """All rows."""
    logging.getLogger("visuohaptic").setLevel(logging.ERROR)
    rows: list[dict[str, Any]] = []
    for name in LOOPS:
        found = [mapping(name, seed) for seed in (0, 1)]
        worst = {key: max(one[key] for one in found) for key in found[0]}
        note = f"{found[0]['path_length_m']:.0f} m, two seeds, the worse; wheels alone end {worst['wheels_end_m']:.1f} m off"
        for key, text in (
            ("median_m", "median error"),
            ("worst_m", "largest error"),
            ("end_m", "error at the end"),
        ):
            rows.append({"name": f"mapping, {name}: {text}", "ours": worst[key], "unit": "m", "note": note})
        for key, text in (("free_iou", "IoU of free space"), ("wall_precision", "walls within a cell")):
            lowest = min(one[key] for one in found)
            rows.append({"name": f"mapping, {name}: {text}", "ours": lowest, "unit": "1"})
        rows.append({"name": f"mapping, {name}: CPU per scan", "ours": worst["scan_ms"], "unit": "ms"})
    fractions = [_haptic_room.iou(*_haptic_room.explore(np.random.default_rng(seed))) for seed in range(20)]
    rows.append(
        {
            "name": "haptic map of a room, 22 contacts, IoU of occupied space",
            "ours": float(np.median(fractions)),
            "unit": "1",
            "floor": 0.6,
            "aim": 0.75,
            "note": f"median of 20 rooms, least {min(fractions):.2f}; walls of 0.1 m",
        }
    )
    folder = data_folder() / "freiburg"
    before = OccupancyMap.from_image(folder / "freiburg_building52.png", 0.1)
    after = OccupancyMap.from_image(folder / "freiburg_building52_trashbins.png", 0.1)
    bins = np.argwhere(before.cells != after.cells)
    cells = {tuple(cell) for footprint in find_footprints(after) for cell in footprint.cells.tolist()}
    hits = sum(tuple(cell) in cells for cell in bins.tolist())
    rows.append(
        {
            "name": "footprints: trash bins of Freiburg 52 among the candidates",
            "ours": hits / len(bins),
            "unit": "1",
            "note": f"{len(bins)} bins, drawn as one cell each; 0.1 m per cell assumed",
        }
    )
    return rows
