"""Options of the planner: off-centre pushes in physics, places of objects, and gaps as wide as the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from tests.worlds.floor_scenes import narrow_gap, plank, random_rooms
from tests.worlds.maps import Body, World

from ._plan_child import Planner, described
from ._plan_judge import Row, Rows, answer_of, asked, bounds_row, faults_row, quantile
from ._plan_physics import execute

__all__ = [
    "narrow_gaps",
    "narrow_gaps_table",
    "off_centre_plans",
    "off_centre_table",
    "places",
    "places_table",
]

CELL_M, ON_ROUTE_S = 0.05, 60.0
#: Each of these grids refines the one before it [m].
GAP_CELLS_M = (0.05, 0.025, 0.005)
#: Half the width of a person or a larger robot; doors are at least 0.75 m wide [m].
PERSON_M = 0.35


def off_centre_plans(planner: Planner, key: str) -> Row:
    """A plank across a door: the answer for straight pushes, and the execution with off-centre pushes."""
    world = plank(int(key))
    straight = planner.ask({"do": "plan", "problem": described(replace(world, notes={}), CELL_M)})
    return {"straight": answer_of(straight), **execute(planner, world, CELL_M)}


def off_centre_table(rows: Rows) -> list[Row]:
    """How many scenes without a straight plan are solved in physics."""
    without = [row for row in rows.values() if row["straight"] != "plan"]
    planned = sum(row["plans"][0]["answer"] == "plan" for row in without)
    reached = sum(row["reached"] for row in without)
    times = [1e3 * row["plans"][0]["cpu_s"] for row in without if row["plans"][0]["cpu_s"] is not None]
    return [
        {"name": "plank in a door: goal reached with off-centre pushes", "ours": 100.0 * reached / max(len(without), 1),
         "unit": "%", "note": f"{reached} of {len(without)} without a straight plan; {planned} planned; {len(rows)} scenes"},
        {"name": "plank in a door: first plan, median", "ours": quantile(times, 0.5), "unit": "ms"},
    ]  # fmt: skip


def narrow_gaps(planner: Planner, key: str) -> Row:
    """Plans through a gap that is hardly wider than the robot, by size of the cells."""
    world = narrow_gap(int(key))
    return {str(cell): asked(planner, world, cell) for cell in GAP_CELLS_M}


def narrow_gaps_table(rows: Rows) -> list[Row]:
    """Bounds and costs on each size of cells, against the cheapest plan on any of them."""
    pairs: dict[str, list[tuple[Row, float]]] = {str(cell): [] for cell in GAP_CELLS_M}
    for row in rows.values():
        best_s = min((plan.get("true_cost_s", np.inf) for plan in row.values()), default=np.inf)
        for cell, plan in row.items():
            if plan["answer"] == "plan":
                pairs[cell].append((plan, best_s))
    table: list[Row] = []
    for cell, plans in pairs.items():
        name = f"narrow gaps, cells of {100 * float(cell):g} cm"
        ratios = [plan["true_cost_s"] / best_s for plan, best_s in plans]
        found = sum(ratio < 1.05 for ratio in ratios)
        times = [plan["cpu_s"] for plan, _ in plans]
        note = f"median {quantile(ratios, 0.5) or np.nan:.3f}, worst {max(ratios, default=np.nan):.2f}; CPU {quantile(times, 0.5) or np.nan:.2f} s, p90 {quantile(times, 0.9) or np.nan:.2f}"
        table += [
            bounds_row(name, plans),
            {"name": f"{name}: within 5 % of the cheapest known plan", "ours": 100.0 * found / max(len(rows), 1), "unit": "%", "note": note},
        ]  # fmt: skip
    return [*table, faults_row("narrow gaps", [plan for row in rows.values() for plan in row.values()])]


def places(planner: Planner, key: str) -> Row:
    """Plans without and with a cost of objects on routes: floor that remains reachable, cost and CPU time."""
    world = random_rooms(int(key))
    row: Row = {}
    for name, on_route_s in (("without", 0.0), ("with", ON_ROUTE_S)):
        reply = planner.ask({"do": "plan", "problem": described(world, CELL_M), "on_route_s": on_route_s})
        row[name] = {"answer": answer_of(reply), "cpu_s": reply.get("cpu_s")}
        if row[name]["answer"] == "plan":
            plan = reply["plan"]
            row[name] |= {
                "cost_s": plan["cost_s"],
                "pushes": sum(task["kind"] == "push" for task in plan["tasks"]),
            }
            row[name]["open"] = _open(world, plan["tasks"])
    return row


def _open(world: World, tasks: list[Row]) -> float:
    """Floor that a person reaches from the goal after a plan, as a fraction of that without the pushed bodies."""
    shifts = {body.id: np.zeros(2) for body in world.bodies}
    for task in tasks:
        if task["kind"] == "push":
            shifts[task["object"]] = shifts[task["object"]] + task["displacement_m"]
    kept = [body for body in world.bodies if not shifts[body.id].any()]
    moved = [body.moved(shifts[body.id].tolist()) for body in world.bodies if shifts[body.id].any()]
    return round(_reached_m2(world, [*kept, *moved]) / max(_reached_m2(world, kept), 1e-9), 4)


def _reached_m2(world: World, bodies: list[Body]) -> float:
    shapes = [world.solid, *(body.polygon for body in bodies)]
    free = shapely.box(0, 0, *world.size_m) - shapely.union_all(shapes).buffer(PERSON_M)
    goal = shapely.Point(world.goal_m)
    parts = getattr(free, "geoms", [free])
    return float(sum(part.area for part in parts if part.distance(goal) < PERSON_M))


def places_table(rows: Rows) -> list[Row]:
    """What a cost of objects on routes changes."""
    pairs = [
        (row["without"], row["with"])
        for row in rows.values()
        if row["with"].get("pushes") and row["without"].get("pushes")
    ]
    closed = (
        [sum(plan["open"] < 0.9 for plan in plans) for plans in zip(*pairs, strict=True)] if pairs else [0, 0]
    )
    reached = [quantile((plan["open"] for plan in plans), 0.0) for plans in zip(*pairs, strict=True)]
    dearer = quantile((100 * (b["cost_s"] / a["cost_s"] - 1) for a, b in pairs), 0.5)
    lost = sum(r["with"]["answer"] != "plan" == r["without"]["answer"] for r in rows.values())
    return [
        {"name": "places: plans that close a tenth of the floor", "ours": closed[1], "unit": "", "floor": closed[0],
         "note": f"{closed[0]} without; {len(pairs)} plans with pushes; least open {reached}"},
        {"name": "places: cost of the plan, median", "ours": dearer, "unit": "%", "note": "more"},
        {"name": "places: plans lost", "ours": lost, "unit": "", "floor": 0},
        {"name": "places: CPU time, median", "ours": quantile((1e3 * b["cpu_s"] for _, b in pairs), 0.5), "unit": "ms",
         "note": f"without {quantile((1e3 * a['cpu_s'] for a, _ in pairs), 0.5)}"},
    ]  # fmt: skip
