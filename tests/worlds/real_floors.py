"""Maps of real buildings as arrays, read without the library."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import shapely
import yaml

from .drive_grid import DriveGrid, blocked, grid_path
from .floor_scenes import random_body, random_rooms
from .maps import Body, World
from .plan_checks import Floor

__all__ = ["load", "names", "real_scene", "rectangles", "room_scene"]

#: Maps with rooms and passages: file, and the resolution of those that have no YAML file [m].
MAPS: dict[str, float | None] = {
    "aws_small_house/map.yaml": None,
    "cob_ipa_apartment/map.yaml": None,
    "freiburg/freiburg_building101.png": 0.05,
    "freiburg/freiburg_building52.png": 0.05,
    "giraff_homes/Sarmis2_map_adj.yaml": None,
    "giraff_homes/UMA_236_237.yaml": None,
    "giraff_homes/movecare_map.yaml": None,
    "intel_lab/intel.yaml": None,
    "nav2/depot.yaml": None,
    "strands_tsc_y4/tsc_1701.yaml": None,
    "strands_umic/UMIC_first_floor.pgm": 0.02,
    "tuw_freihaus_eg/map.yaml": None,
    "ut_gdc_1/1.yaml": None,
    "ut_gdc_3/3.yaml": None,
    "willow_garage/willow-full-0.05.pgm": 0.05,
    "wpi_rail/rail_lab.yaml": None,
}


def names(folder: Path) -> list[str]:
    """The available maps."""
    return [name for name in MAPS if (folder / name).exists()]


@cache
def load(folder: Path, name: str) -> tuple[np.ndarray, float]:
    """Cells (-1, 0, 100), row 0 at the bottom, and the cell size [m]; the origin is left at (0, 0)."""
    path, resolution_m = folder / name, MAPS[name]
    negate, occupied, free = 0, 0.65, 0.196
    if resolution_m is None:
        data = yaml.safe_load(path.read_text())
        resolution_m = float(data["resolution"])
        negate = int(data.get("negate", 0))
        occupied, free = float(data["occupied_thresh"]), float(data["free_thresh"])
        path = path.parent / Path(data["image"]).name
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    dark = image / 255.0 if negate else 1.0 - image / 255.0
    cells = np.full(image.shape, -1, np.int8)
    cells[dark > occupied] = 100
    cells[dark < free] = 0
    return cells[::-1].copy(), float(resolution_m)


WINDOW_M = 10.0
#: Bodies keep so far from occupied cells at first [m]: cells whose drawing they can't be mistaken for.
GAP_M = 0.08


def rectangles(solid: np.ndarray, cell_m: float) -> list[shapely.Polygon]:
    """Runs of cells along the rows, those that go on in the next row as one rectangle."""
    found: list[shapely.Polygon] = []
    open_runs: dict[tuple[int, int], int] = {}
    for row in range(solid.shape[0] + 1):
        runs: list[tuple[int, int]] = []
        if row < solid.shape[0]:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], solid[row].astype(np.int8), [0]])))
            runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        for run in [run for run in open_runs if run not in runs]:
            first = open_runs.pop(run)
            found.append(shapely.box(run[0] * cell_m, first * cell_m, run[1] * cell_m, row * cell_m))
        for run in runs:
            open_runs.setdefault(run, row)
    return found


#: Number of scenes in four that have no path without a push.
BLOCKED_OF_4 = 3


def room_scene(seed: int) -> World:
    """Generated rooms; three of four scenes have no path without a push."""
    needed, count = seed // 4 % 4 < BLOCKED_OF_4, 1 + seed // 4 % 10
    for attempt in range(1000):
        world = random_rooms(seed + 1_000_000 * attempt, count)
        if not needed or blocked(world):
            return world
    raise RuntimeError(f"no scene {seed} after 1000 attempts")


def real_scene(folder: Path, seed: int) -> World:
    """A window of a real floor, a drive of 5 m or more, and 1 to 10 bodies on its path and beside it.

    Three of four scenes have no way without a push.
    """
    needed, count = seed // 4 % 4 < BLOCKED_OF_4, 1 + seed // 4 % 10
    rng = np.random.default_rng([20261122, 10, seed])
    there = [name for name in names(folder) if load(folder, name)[1] <= 0.06]
    while True:
        name = there[int(rng.integers(len(there)))]
        cells, cell_m = load(folder, name)
        world = _window(cells, round(cell_m, 4), count, rng)
        if world is not None and (not needed or blocked(world)):
            return World(
                f"{name} {seed}",
                world.size_m,
                world.walls,
                world.bodies,
                world.start_m,
                world.goal_m,
                notes={"cell_m": round(cell_m, 4)},
            )


def _window(cells: np.ndarray, cell_m: float, count: int, rng: np.random.Generator) -> World | None:
    side = min(round(WINDOW_M / cell_m), *cells.shape)
    row, column = (int(rng.integers(0, n - side + 1)) for n in cells.shape)
    solid = cells[row : row + side, column : column + side] != 0
    if not 1.0 - solid.mean() > 0.2:
        return None
    solid[[0, -1]] = solid[:, [0, -1]] = True
    size = (side * cell_m, side * cell_m)
    walls = rectangles(solid, cell_m)
    bare = World("", size, tuple(walls), (), (0.0, 0.0), (0.0, 0.0))
    grid = DriveGrid(bare, 0.1, Floor(walls, {}))
    roomy = np.flatnonzero(grid.clearance > 0.3)
    if len(roomy) < 50:
        return None
    start, goal = (grid.points[int(rng.choice(roomy))] for _ in range(2))
    if np.hypot(*(goal - start)) < 4.0:
        return None
    seconds, _ = grid.field(grid.clearance, start)
    node, _ = grid.near(grid.clearance, goal)
    if not len(node) or not np.isfinite(seconds[node]).any():
        return None
    path = grid_path(grid, grid.clearance, start, goal)
    if np.hypot(*np.diff(path, axis=0).T).sum() < 5.0:
        return None
    bodies = _bodies(path, walls, (start, goal), count, rng)
    ends = [(round(float(p[0]), 4), round(float(p[1]), 4)) for p in (start, goal)]
    return World("", size, tuple(walls), bodies, *ends) if len(bodies) == count else None


def _bodies(
    path: np.ndarray,
    walls: list[shapely.Polygon],
    ends: tuple[np.ndarray, np.ndarray],
    count: int,
    rng: np.random.Generator,
) -> tuple[Body, ...]:
    """The first at a narrow place of the path, others there or beside it."""
    floor, (start, goal) = Floor(walls, {}), ends
    inside = path[(np.hypot(*(path - start).T) > 0.9) & (np.hypot(*(path - goal).T) > 0.9)]
    if len(inside) < 5:
        return ()
    narrow = inside[np.argsort(floor.distance_m(inside))[: max(5, len(inside) // 4)]]
    placed: list[Body] = []
    for number in range(count):
        for _ in range(60):
            close = not placed or rng.random() < 0.5
            middle = rng.choice(narrow if close else inside) + rng.normal(0, 0.1 if close else 0.6, 2)
            body = random_body(f"body{number}", rng)
            body = body.moved(middle)
            apart = min((body.polygon.distance(other.polygon) for other in placed), default=1.0)
            ends_m = min(body.polygon.distance(shapely.Point(*p)) for p in (start, goal))
            if apart > GAP_M and ends_m > 0.45 and floor.gap_m(body.polygon)[0] > GAP_M:
                placed.append(body)
                break
    return tuple(placed)
