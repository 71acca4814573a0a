"""Cost of a drive as the search uses it, in each configuration of the objects: the field on its lattice."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from tests.worlds.floor_scenes import idle_objects
from tests.worlds.maps import raster

from ._plan_child import Planner, described, problem_of
from ._plan_judge import Row, Rows, quantile

__all__ = ["drives", "drives_table", "measured"]

CELL_M, OBJECTS, MOVED_M = 0.05, 20, 0.1


def drives(planner: Planner, key: str) -> Row:
    """Costs across a floor after each object was moved aside."""
    world = idle_objects(int(key), OBJECTS)
    world = replace(world, bodies=tuple(body for body in world.bodies if body.id.startswith("idle")))
    cells = raster(world, CELL_M, bodies=False)
    return planner.ask({"do": "drives", "problem": described(world, CELL_M, cells)}, 60.0)


def measured(request: dict[str, Any]) -> dict[str, Any]:
    """Cost of the drive from start to goal over the lattice and along the string-pulled path; CPU time of one configuration.

    The lattice is made before.
    """
    from visuohaptic.navigation.planning.search import build_search_domain, grid_from_world
    from visuohaptic.navigation.planning.search._travel_kernels import UNITS, travel_field
    from visuohaptic.navigation.planning.search.drives import pull_string

    problem = problem_of(request["problem"])
    domain = build_search_domain(problem)
    ends = problem.start_m, problem.goal_m
    start, goal = (grid_from_world(problem.map, point) for point in ends)
    none, nothing = np.zeros(0, np.int32), np.zeros((0, 0), np.int16)

    def on_lattice(index: int) -> float:
        shifts = np.zeros((len(domain.bodies), 2))
        shifts[index, 0] = MOVED_M / CELL_M
        layer, size = domain.lattice_with(shifts), (domain.radius, domain.slow)
        (near, costs), (last, last_costs) = (domain.seeds(layer, point) for point in (start, goal))
        field = travel_field(layer, *size, near, costs, nothing, none, none, 0, none)
        return domain.seconds(float((field[last] + last_costs).min()) * domain.block / UNITS)

    def exact(index: int) -> float:
        shifts = np.zeros((len(domain.bodies), 2))
        shifts[index, 0] = MOVED_M / CELL_M
        return domain.seconds(pull_string(domain, shifts, start, goal)[1])

    found: dict[str, Any] = {}
    for name, cost in (("exact", exact), ("lattice", on_lattice)):
        cost(0)
        began_s = time.process_time()
        found[name] = [cost(index) for index in range(len(domain.bodies))]
        found[f"{name}_cpu_s"] = (time.process_time() - began_s) / len(domain.bodies)
    return found


def drives_table(rows: Rows) -> list[Row]:
    """Errors of the costs, and their computing time."""
    pairs = [pair for row in rows.values() for pair in zip(row["lattice"], row["exact"], strict=True)]
    off = quantile((100 * abs(cost / exact - 1) for cost, exact in pairs), 0.5)
    times = quantile((1e3 * row["lattice_cpu_s"] for row in rows.values()), 0.5)
    return [
        {"name": "drive by the lattice: deviation of its cost, median", "ours": off, "unit": "%",
         "note": f"{len(pairs)} drives, against string-pulled ones"},
        {"name": "drive by the lattice: one object moved, median", "ours": times, "unit": "ms"},
    ]  # fmt: skip
