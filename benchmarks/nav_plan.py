"""Plans: namosim's scenes, figure 4.6, and 50 objects added to a graph: solved scenes, cost and CPU time.

CPU time, one thread, after one warm-up run. ``python -m benchmarks nav_plan`` prints the table,
``python -m benchmarks.nav_plan scenes`` one line per third-party scene;
plans are compared with an independent optimum in ``plan_evidence oracle``.

The peer's times were measured earlier with namosim's own pinned versions on the same kind of
machine (its first plan); it cannot be installed beside this library.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.scenes import load_namosim
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import alternatives, extend_graph, make_plan
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, push_node

from .harness import cpu_seconds, median

__all__ = ["run"]

_SEED = 20261121
#: namosim's median first plan over eleven of its scenes with obstacles [s].
_NAMOSIM_S = 8.6


def _data() -> Path | None:
    from tests.conftest import data_folder

    folder = data_folder()
    return folder / "navigation" / "dev" if folder else None


def _scenes(folder: Path) -> list[tuple[str, PlanningProblem]]:
    paths = [*sorted((folder / "namo" / "namosim").glob("*.svg"))]
    paths.append(folder / "namo" / "namosim" / "citi_ing_push_only" / "namo.yaml")
    return [(path.stem, problem) for path in paths for problem in load_namosim(path).problems]


def namosim_rows(folder: Path) -> list[dict[str, Any]]:
    """All scenes: how many are solved, and the time of the whole plan."""
    solved, times = 0, []
    scenes = _scenes(folder)
    slowest = ""
    for name, problem in scenes:
        solved += make_plan(problem).reachable
        spent_s = cpu_seconds(lambda problem=problem: make_plan(problem), repeats=3, warm=0, min_s=0.0)
        if not times or spent_s > max(times):
            slowest = name
        times.append(spent_s)
    return [
        {
            "name": "namosim scenes solved",
            "ours": 100.0 * solved / len(scenes),
            "unit": "%",
            "floor": 100.0,
            "aim": 100.0,
            "higher_is_better": True,
            "note": f"{solved} of {len(scenes)} robots and goals",
        },
        {
            "name": "namosim scenes, median plan",
            "ours": median(times) * 1e3,
            "unit": "ms",
            "peer": _NAMOSIM_S * 1e3,
            "peer_name": "namosim's first plan, median, measured before",
            "floor": 1000.0,
            "aim": 50.0,
        },
        {
            "name": "namosim scenes, slowest plan",
            "ours": max(times) * 1e3,
            "unit": "ms",
            "floor": 1000.0,
            "aim": 50.0,
            "note": slowest,
        },
    ]


def office_rows() -> list[dict[str, Any]]:
    """Figure 4.6 rebuilt."""
    from tests.navigation.plan_scenes import office

    plans = alternatives(office())
    push, detour = plans["cheapest"], plans["no pushing"]
    room = make_plan(office((5.3, 3.6)))
    return [
        {
            "name": "figure 4.6, push way / detour",
            "ours": push.length_m / detour.length_m,
            "unit": "",
            "floor": 0.35,
            "note": f"{push.length_m:.2f} m of {detour.length_m:.2f} m",
        },
        {
            "name": "figure 4.6, t_mani of the stool",
            "ours": push.pushes[0].cost_s if push.pushes else float("nan"),
            "unit": "s",
            "floor": "6.9-7.1",
        },
        {
            "name": "figure 4.6, detached room reached",
            "ours": float(room.reachable),
            "unit": "",
            "floor": 1.0,
            "higher_is_better": True,
        },
    ]


def many_objects_row(folder: Path) -> dict[str, Any]:
    """50 tagged objects added to the graph of a real map."""
    from tests.navigation.plan_scenes import ROBOT, STOOL, box, with_objects

    path = folder / "maps" / "willow_garage" / "willow-full-0.05.pgm"
    grid = OccupancyMap.from_image(path, 0.05)
    rng = np.random.default_rng(_SEED)
    layers = grid_layers(grid, SpeedLimits(ROBOT.radius_m))
    places = np.argwhere(layers.distance_m > 0.4)
    objects = []
    for index in range(50):
        x, y = grid.world_from_cell(places[int(rng.integers(len(places)))])
        length_m, width_m = rng.uniform(0.2, 0.5, 2)
        outline = box(float(x), float(y), length_m, width_m, float(rng.uniform(0, 3)))
        objects.append(MovableObject(f"object {index}", outline, STOOL))
    layers = grid_layers(with_objects(grid, objects), SpeedLimits(ROBOT.radius_m))
    graph = build_graph(layers)
    regions = assign_regions(layers, graph)
    kinds = [push_node(item, ROBOT) for item in objects]
    spent_s = cpu_seconds(lambda: extend_graph(graph, regions, ROBOT, kinds))
    return {
        "name": "50 tagged objects added",
        "ours": spent_s * 1e3,
        "unit": "ms",
        "floor": 20.0,
        "aim": 5.0,
        "note": f"{graph.nodes} nodes",
    }


def run() -> list[dict[str, Any]]:
    """All rows; those that need the data are left out where it is absent."""
    rows = office_rows()
    folder = _data()
    if folder is not None:
        rows += [*namosim_rows(folder), many_objects_row(folder)]
    return rows


def main() -> None:
    """Campaigns by name."""
    if sys.argv[1:2] == ["scenes"]:
        folder = _data()
        if folder is None:
            raise SystemExit("scenes not found: set VISUOHAPTIC_DATA")
        for name, problem in _scenes(folder):
            make_plan(problem)
            started_s = time.process_time()
            plan = make_plan(problem)
            spent_ms = (time.process_time() - started_s) * 1e3
            pushed = ", ".join(task.object for task in plan.pushes) or "nothing"
            print(
                f"{name:<30}{spent_ms:8.1f} ms {plan.cost_s:8.1f} s {plan.length_m:7.2f} m  pushes {pushed}"
            )
    else:
        raise SystemExit("expected: scenes")


if __name__ == "__main__":
    main()
