"""Map to graph to regions: time, memory, topology, edits and queries, beside the public chain.

The public chain is OpenCV's exact distance, scikit-image's thinning and SciPy's multi-source Dijkstra,
the best of what was tried; its graph step (sknw, skan) is left out. CPU time, one thread. Maps are the
real ones of the data; the mosaic lays them side by side until 4000 x 4000 cells are full.

``python -m benchmarks.nav_graph topology 10000`` and ``... edits 5000`` run the campaigns (the first goes on
where it was stopped, from ``results/nav_topology.txt``),
``... memory`` measures the peak of a fresh process.
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
    """Median of single runs after one to warm up."""
    work()
    spent = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        spent.append(1e3 * (time.process_time() - started))
    return float(np.median(spent))


def edit_times_ms(grid: Any, edits: int, seed: int = _SEED, ask: bool = True) -> np.ndarray:
    """CPU time of moves of one box of 0.4 m: every second to anywhere, the others by up to 0.5 m.

    ``ask``: with the time until graph and regions have been read, which are made on request.
    """
    from visuohaptic.navigation.graph import NavigationMap
    from visuohaptic.navigation.grid import SpeedLimits

    rng = np.random.default_rng(seed)
    live = NavigationMap(grid, SpeedLimits(_RADIUS_M))
    places = np.argwhere(live.layers.reachable)
    box_m = 0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    place_m = grid.world_from_cell(places[0])
    live.set_obstacle("box", place_m + box_m)
    spent = []
    for k in range(edits + 4):
        far = k % 2 == 0
        place_m = (
            grid.world_from_cell(places[rng.integers(len(places))])
            if far
            else place_m + rng.uniform(-0.5, 0.5, 2)
        )
        started = time.process_time()
        live.move_obstacle("box", place_m + box_m)
        if ask:
            assert live.regions.graph is live.graph
        spent.append(1e3 * (time.process_time() - started))
    return np.array(spent[4:])


def path_ratios(grid: Any, pairs: int, seed: int = _SEED) -> np.ndarray:
    """Cost of graph path, of it pulled taut, and of the plan with slack, over the grid's optimum."""
    from visuohaptic.navigation.graph import plan_on_grid, plan_path, pull_string, shortest_path

    regions = build(grid)
    graph = regions.graph
    rng = np.random.default_rng(seed)
    large = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    found = []
    for _ in range(pairs):
        a, b = (int(node) for node in rng.choice(large, 2, replace=False))
        best_s = plan_on_grid(regions.layers, graph.node_m[a], graph.node_m[b]).cost_s
        route = shortest_path(graph, a, b)
        taut_s = pull_string(regions, route.edges, graph.node_cells[a], graph.node_cells[b]).cost_s
        plan_s = plan_path(regions, graph.node_m[a], graph.node_m[b]).cost_s
        found.append((route.cost_s / best_s, taut_s / best_s, plan_s / best_s))
    return np.array(found)


def lattice_graph(side: int = 100) -> Any:
    """A graph of ``side`` x ``side`` nodes as in a town: jittered streets, some closed."""
    from visuohaptic.navigation.graph import EdgePaths, NavigationGraph

    rng = np.random.default_rng(_SEED)
    number = np.arange(side * side).reshape(side, side)
    ends = np.concatenate(
        [
            np.column_stack([number[:, :-1].ravel(), number[:, 1:].ravel()]),
            np.column_stack([number[:-1].ravel(), number[1:].ravel()]),
        ]
    ).astype(np.int32)
    ends = ends[rng.random(len(ends)) > 0.05]
    node_m = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) * 3.0
    node_m = node_m + rng.normal(0, 0.5, node_m.shape)
    length_m = np.hypot(*(node_m[ends[:, 1]] - node_m[ends[:, 0]]).T) * rng.uniform(1.0, 1.4, len(ends))
    cells = np.column_stack(np.divmod(np.arange(side * side), side)).astype(np.int32)
    paths = np.stack([cells[ends[:, 0]], cells[ends[:, 1]]], axis=1).reshape(-1, 2)
    start = np.arange(0, 2 * len(ends) + 1, 2, dtype=np.int32)
    none = np.zeros(len(cells), np.int32)
    clearance = np.full(len(ends), 1.0)
    return NavigationGraph(
        cells, node_m, ends, length_m / 0.3, length_m, clearance, EdgePaths(lambda: (start, paths)), none, 1
    )


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
    """Maps 0 to ``count`` - 1 in parts; each leaves a line in ``log`` and is not done again. Returns wrong, done."""
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

    from visuohaptic.navigation.graph import shortest_path

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
    for name, grid, edits in (("Willow", willow, 200), ("mosaic", large, 100)):
        spent = edit_times_ms(grid, edits)
        rows.append(
            {
                "name": f"{name}, one box moved, p95",
                "ours": float(np.percentile(spent, 95)),
                "unit": "ms",
                "floor": 10,
                "aim": 1,
                "note": f"median {np.median(spent):.2f}, worst {spent.max():.2f}; equality is a test",
            }
        )
    town = lattice_graph()
    rng = np.random.default_rng(_SEED)
    pairs = rng.integers(0, town.nodes, (200, 2)).tolist()
    queries = cpu_ms(lambda: [shortest_path(town, a, b) for a, b in pairs], 5) / len(pairs)
    rows.append({"name": "query, 10,000 nodes, mean", "ours": queries, "unit": "ms", "floor": 1, "aim": 0.2})
    ratios = np.concatenate(
        [path_ratios(maps[name], 100) for name in ("willow-full-0.05", "3", "stata_basement")]
    )
    note = f"median of the untaut graph path {np.median(ratios[:, 0]):.3f}"
    for column, name in ((1, "route pulled taut"), (2, "plan with slack 0.25")):
        rows += [
            {
                "name": f"{name} / grid optimum, median of 3 maps",
                "ours": float(np.median(ratios[:, column])),
                "unit": "",
                "floor": 1.05,
                "aim": 1.01,
                "note": note,
            },
            {
                "name": f"{name} / grid optimum, worst",
                "ours": float(ratios[:, column].max()),
                "unit": "",
                "aim": 1.05,
                "higher_is_better": False,
            },
        ]
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
    elif what == "edits":
        from tests.navigation.test_incremental import run_edits

        print(f"{run_edits(_SEED, count // 8)} edits equal to a rebuild")
    elif what == "memory":
        print(*(f"{value:.1f}" for value in peak_MB()))


if __name__ == "__main__":
    main()
