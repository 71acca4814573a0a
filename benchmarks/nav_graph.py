"""Map to graph to regions: time, memory, topology and edits, compared with a chain of public libraries.

The public chain is OpenCV's exact distance, scikit-image's thinning and SciPy's multi-source Dijkstra,
the best of those tried; its graph step (sknw, skan) is left out. CPU time, one thread. Maps are the
real ones of the data; the mosaic repeats them side by side to fill 4000 x 4000 cells.

    python -m benchmarks nav_graph                    the table
    python -m benchmarks.nav_graph topology 10000     random maps with a wrong graph; resumed from ``results/nav_topology.txt``
    python -m benchmarks.nav_graph memory             peak memory of a fresh process
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["build", "edit_times_ms", "mosaic", "run"]

_RADIUS_M = 0.2
_SEED = 20261121


def data_maps() -> Path:
    """Folder of the real maps."""
    from tests.conftest import data_folder

    folder = data_folder()
    if folder is None:
        raise FileNotFoundError("real maps not found: set VISUOHAPTIC_DATA")
    return folder / "navigation" / "dev" / "maps"


def real_maps() -> dict[str, Any]:
    """All real maps of the data by name."""
    from tests.navigation.random_maps import real_maps as found

    return found(data_maps().parents[2])


def mosaic(side: int = 4000) -> Any:
    """Real maps in rows, large ones first, again and again until the square is full; cells of 0.05 m."""
    from visuohaptic.io.maps import OccupancyMap

    parts = sorted(real_maps().items(), key=lambda item: (-item[1].cells.size, item[0]))
    cells = np.full((side, side), -1, np.int8)
    row, k = 0, 0
    while row < side:
        column, height = 0, 0
        while column < side:
            part = parts[k % len(parts)][1].cells
            k += 1
            part = part[: side - row, : side - column]
            cells[row : row + part.shape[0], column : column + part.shape[1]] = part
            column += part.shape[1]
            height = max(height, part.shape[0])
        row += height
    return OccupancyMap(cells, 0.05)


def build(grid: Any) -> Any:
    """Distance, cost, skeleton, graph, regions."""
    from visuohaptic.navigation.graph import assign_regions, build_graph
    from visuohaptic.navigation.grid import SpeedLimits, grid_layers

    layers = grid_layers(grid, SpeedLimits(_RADIUS_M))
    return assign_regions(layers, build_graph(layers))


def public_chain(grid: Any, seeds: np.ndarray) -> None:
    """The same stages, graph tracing apart, from public libraries."""
    import cv2
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra
    from skimage.morphology import skeletonize

    free = (grid.cells >= 0) & (grid.cells < 50)
    distance = cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * 0.05
    cost = np.interp(distance, [_RADIUS_M, 3 * _RADIUS_M], [20.0, 10 / 3]).astype(np.float32)
    reachable = distance >= _RADIUS_M
    skeletonize(reachable)
    number = np.full(reachable.shape, -1, np.int32)
    number[reachable] = np.arange(int(reachable.sum()))
    starts, ends, weights = [], [], []
    for down, across in ((0, 1), (1, -1), (1, 0), (1, 1)):
        rows, columns = reachable.shape
        a = number[: rows - down, max(0, -across) : columns - max(0, across)]
        b = number[down:, max(0, across) : columns - max(0, -across)]
        both = (a >= 0) & (b >= 0)
        length = 0.05 * np.hypot(down, across)
        for start, end in ((a[both], b[both]), (b[both], a[both])):
            starts.append(start)
            ends.append(end)
        weights.append(cost[down:, max(0, across) : columns - max(0, -across)][both] * length)
        weights.append(cost[: rows - down, max(0, -across) : columns - max(0, across)][both] * length)
    count = int(reachable.sum())
    graph = csr_matrix(
        (np.concatenate(weights), (np.concatenate(starts), np.concatenate(ends))), (count, count)
    )
    dijkstra(graph, indices=number[seeds[:, 0], seeds[:, 1]], min_only=True, return_predecessors=True)


def cpu_ms(work: Any, repeats: int) -> float:
    """Median of single runs after one warm-up run."""
    work()
    spent = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        spent.append(1e3 * (time.process_time() - started))
    return float(np.median(spent))


def edit_times_ms(grid: Any, edits: int, seed: int = _SEED) -> np.ndarray:
    """CPU time after a box of 0.4 m has moved, anywhere or by up to 0.5 m: clearance of the planner's lattice, and
    with it the any-angle cost from a place to all others, (edits, 2) [ms]."""
    from visuohaptic.core.objects import HapticTag
    from visuohaptic.navigation.planning.search import build_search_domain
    from visuohaptic.navigation.planning.search._travel_kernels import travel_field
    from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel

    rng = np.random.default_rng(seed)
    free = np.argwhere(grid.cells == 0)
    place_m = grid.world_from_cell(free[0])
    box = MovableObject("box", place_m + 0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), HapticTag())
    domain = build_search_domain(PlanningProblem(grid, RobotModel(_RADIUS_M), place_m, place_m, (box,)))
    begin = int(domain.lattice.argmax())
    none, nothing = np.zeros(0, np.int32), np.zeros((0, 0), np.int16)
    spent = []
    for k in range(edits + 4):
        far = grid.world_from_cell(free[rng.integers(len(free))])
        place_m = far if k % 2 == 0 else place_m + rng.uniform(-0.5, 0.5, 2)
        shift = ((place_m - box.centre_m) / grid.resolution_m)[None]
        started = time.process_time()
        lattice = domain.lattice_with(shift)
        moved = time.process_time()
        travel_field(
            lattice, domain.radius, domain.slow, np.array([begin], np.int32), np.zeros(1, np.int32),
            nothing, none, none, 0, none,
        )  # fmt: skip
        spent.append((1e3 * (moved - started), 1e3 * (time.process_time() - started)))
    return np.array(spent[4:])


def topology_errors(count: int, seed: int = _SEED, first: int = 0) -> int:
    """Random maps whose graph has not exactly the components and loops of the reachable cells.

    Map k is drawn from (seed, k), so that ``first`` goes on where another run has stopped.
    """
    from tests.navigation.random_maps import RADII_M, random_map, topology

    from visuohaptic.navigation.graph import build_graph
    from visuohaptic.navigation.grid import SpeedLimits, grid_layers

    wrong = 0
    for number in range(first, first + count):
        rng = np.random.default_rng((seed, number))
        layers = grid_layers(random_map(rng), SpeedLimits(float(rng.choice(RADII_M))))
        graph = build_graph(layers)
        wrong += (graph.components, graph.loops) != topology(layers.reachable)
    return wrong


def topology_campaign(count: int, log: Path, part: int = 500) -> tuple[int, int]:
    """Maps 0 to ``count`` - 1 in parts; each writes a line to ``log`` and is not repeated. Returns wrong, done."""
    done = {}
    if log.exists():
        for line in log.read_text().splitlines():
            first, maps, wrong = (int(word) for word in line.split())
            done[first] = (maps, wrong)
    for first in range(0, count, part):
        maps = min(part, count - first)
        if done.get(first, (0, 0))[0] >= maps:
            continue
        done[first] = (maps, topology_errors(maps, first=first))
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("a") as stream:
            stream.write(f"{first} {maps} {done[first][1]}\n")
    return sum(wrong for _, wrong in done.values()), sum(maps for maps, _ in done.values())


def peak_MB(side: int = 4000) -> tuple[float, float]:
    """Peak of a fresh process, whole and above what it had before the build [MB]; the map is in the first."""
    grid = mosaic(side)
    small = type(grid)(grid.cells[:300, :300].copy(), grid.resolution_m)
    build(small)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    with open("/proc/self/statm") as stream:
        now = int(stream.read().split()[1]) * resource.getpagesize() / 2**20
    regions = build(grid)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    assert regions.graph.nodes > 0
    return after, after - min(before, now)


def _fresh_peak() -> tuple[float, float]:
    import subprocess

    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.nav_graph", "memory"], capture_output=True, text=True, check=True
    )
    whole, above = done.stdout.split()[:2]
    return float(whole), float(above)


def run() -> list[dict[str, Any]]:
    """Rows of the issue's table."""
    from tests.navigation.random_maps import topology

    maps = real_maps()
    willow = maps["willow-full-0.05"]
    regions = build(willow)
    seeds = regions.graph.node_cells
    rows: list[dict[str, Any]] = [
        {
            "name": "Willow 1165 x 945, map to regions",
            "ours": cpu_ms(lambda: build(willow), 7),
            "unit": "ms",
            "peer": cpu_ms(lambda: public_chain(willow, seeds), 3),
            "peer_name": "cv2 + skimage + scipy, no graph step",
            "floor": 120,
            "aim": 25,
        }
    ]
    large = mosaic()
    rows.append(
        {
            "name": "mosaic 4000 x 4000, map to regions",
            "ours": cpu_ms(lambda: build(large), 3),
            "unit": "ms",
            "floor": 1800,
            "aim": 400,
            "note": "CPU, one thread",
        }
    )
    whole, above = _fresh_peak()
    rows.append(
        {
            "name": "mosaic, memory above the start",
            "ours": above,
            "unit": "MB",
            "floor": 600,
            "aim": 350,
            "note": f"whole process {whole:.0f} MB",
        }
    )
    for name, grid, edits in (("Willow", willow, 100), ("mosaic", large, 60)):
        moved, driven = np.percentile(edit_times_ms(grid, edits), 95, axis=0)
        rows.append(
            {
                "name": f"{name}, one box moved, p95",
                "ours": float(moved),
                "unit": "ms",
                "floor": 5,
                "aim": 1,
                "note": f"{driven:.1f} with the cost of driving to every place",
            }
        )
    wrong = 0
    for grid in maps.values():
        found = build(grid)
        wrong += (found.graph.components, found.graph.loops) != topology(found.layers.reachable)
    rows.append(
        {
            "name": f"real maps with wrong topology, of {len(maps)}",
            "ours": float(wrong),
            "unit": "",
            "floor": 0,
            "aim": 0,
        }
    )
    rows.append(
        {
            "name": "random maps with wrong topology, of 2000",
            "ours": float(topology_errors(2000)),
            "unit": "",
            "floor": 0,
            "aim": 0,
            "note": "python -m benchmarks.nav_graph topology 10000",
        }
    )
    return rows


def main() -> None:
    """A campaign."""
    what, count = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 0
    if what == "topology":
        wrong, done = topology_campaign(count, Path("results") / "nav_topology.txt")
        print(f"{wrong} of {done} random maps wrong")
    elif what == "memory":
        print(*(f"{value:.1f}" for value in peak_MB()))


if __name__ == "__main__":
    main()
