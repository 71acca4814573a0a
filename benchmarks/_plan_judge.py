"""One planning call and its evaluation: answer, collisions in exact polygons, cost on exact distances."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from tests.worlds.maps import World, raster
from tests.worlds.plan_checks import Floor, check_plan, drive_seconds

from ._plan_child import Planner, described

__all__ = ["FAULT_M", "Row", "Rows", "answer_of", "asked", "bounds_row", "faults_row", "judged", "quantile"]

Row = dict[str, Any]
Rows = dict[str, Row]

#: Deeper than this a fault is one: what rounding and the written micrometres can't explain [m].
FAULT_M = 1e-3
#: A bound is refuted by a plan that is cheaper by more than this fraction: costs of drives are rounded to 0.2 %.
BOUND_TOLERANCE = 2e-3


def answer_of(reply: dict[str, Any]) -> str:
    """One word for an answer: plan, proved, not proved, or why there is none (time, memory, an error)."""
    plan = reply.get("plan")
    if plan is None:
        return str(reply["status"])
    if plan["reachable"]:
        return "plan"
    return "proved" if plan.get("proved") else "not proved"


def judged(world: World, resolution_m: float, reply: dict[str, Any]) -> Row:
    """Summary of the answer; a plan is checked in polygons and its drives are costed on exact distances."""
    row: Row = {"answer": answer_of(reply)}
    row |= {name: reply[name] for name in ("cpu_s", "wall_s", "peak_MB", "message") if name in reply}
    if row["answer"] != "plan":
        return row
    tasks = reply["plan"]["tasks"]
    cells = raster(world, resolution_m, bodies=False)
    bodies = {body.id: body.polygon for body in world.bodies}
    floor = Floor.of_cells(cells, resolution_m, bodies)
    faults = check_plan(floor, tasks, world.robot, world.start_m, world.goal_m)
    return row | {
        "cost_s": reply["plan"]["cost_s"],
        "gap": reply["plan"]["gap"],
        "pushes": sum(task["kind"] == "push" for task in tasks),
        "fault_m": max((fault.depth_m for fault in faults), default=0.0),
        "fault": next((fault.what for fault in faults if fault.depth_m > FAULT_M), ""),
        "true_cost_s": _true_cost(Floor.of_cells(cells, resolution_m, bodies), tasks, world),
    }


def _true_cost(floor: Floor, tasks: list[Row], world: World) -> float:
    """Cost of a plan [s] with its drives on exact distances; pushes as declared."""
    from shapely.affinity import translate

    total = 0.0
    for task in tasks:
        if task["kind"] == "navigate":
            total += drive_seconds(floor, np.array(task["path_m"]), world.robot)
            continue
        total += task["cost_s"]
        if task["kind"] == "push":
            body = floor.bodies[task["object"]]
            floor.bodies[task["object"]] = translate(body, *task["displacement_m"])
    return round(total, 4)


def asked(planner: Planner, world: World, cell_m: float, **options: Any) -> Row:
    """Plan a world with a given cell size, and evaluate the answer."""
    reply = planner.ask({"do": "plan", "problem": described(world, cell_m), **options})
    return judged(world, cell_m, reply)


def bounds_row(name: str, plans: list[tuple[Row, float]]) -> Row:
    """Row of the stated bounds that a known plan refutes, from plans and the true cost of a feasible one [s]."""
    stated = [(row, best_s) for row, best_s in plans if row.get("gap") is not None]
    over = [row["true_cost_s"] / (1.0 + row["gap"]) / best_s - 1.0 for row, best_s in stated]
    gap = quantile((row["gap"] for row, _ in stated), 0.5) or 0.0
    return {
        "name": f"{name}: stated bounds above the cost of a known plan",
        "ours": sum(value > BOUND_TOLERANCE for value in over) if stated else None,
        "unit": "",
        "floor": 0,
        "note": f"of {len(stated)}; highest {1 + max(over, default=0.0):.3f} of a known plan; stated median {100 * gap:.1f} %",
    }


def quantile(values: Iterable[float], part: float) -> float | None:
    """Quantile of the values without interpolation; None if there are none."""
    values = sorted(values)  # an unanswered call is infinitely slow: no interpolation
    return float(values[min(int(part * len(values)), len(values) - 1)]) if values else None


def faults_row(name: str, plans: list[Row]) -> Row:
    """Row of the deepest fault among plans; without any plan it is not judged."""
    judged_mm = [1e3 * plan["fault_m"] for plan in plans if "fault_m" in plan]
    bad = [plan for plan in plans if plan.get("fault_m", 0.0) > FAULT_M]
    note = f"{len(bad)} of {len(judged_mm)}" + (f"; {bad[0]['fault']}" if bad else "")
    worst_mm = max(judged_mm, default=None)
    return {"name": f"{name}: deepest fault", "ours": worst_mm, "unit": "mm", "floor": 1.0, "note": note}
