"""Campaigns of ``plan_evidence``: the run of each key, and the rows of the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tests.worlds.floor_scenes import (
    blind_corridor,
    campus,
    closed_room,
    doors_in_series,
    idle_objects,
    random_rooms,
    small_room,
)
from tests.worlds.maps import World, raster
from tests.worlds.plan_checks import Floor

from ._plan_child import Planner, described
from ._plan_drives import drives, drives_table
from ._plan_footprints import footprints, footprints_table
from ._plan_judge import FAULT_M, Row, Rows, answer_of, asked, faults_row, quantile
from ._plan_options import (
    narrow_gaps,
    narrow_gaps_table,
    off_centre_plans,
    off_centre_table,
    places,
    places_table,
)
from ._plan_physics import oracle, oracle_table, push_ends, push_ends_table, room, room_keys, rooms_table
from .nav_doors import data_folder

__all__ = ["CAMPAIGNS", "Campaign"]

CELLS_M = (0.1, 0.05, 0.02, 0.01)
#: Budgets that end a plan across the campus in its phases [s].
LIMITS_S = (0.15, 0.3, 0.6)


@dataclass(frozen=True, slots=True)
class Campaign:
    """One campaign."""

    keys: Callable[[list[int]], list[str]]
    play: Callable[[Planner, str], Row]
    table: Callable[[Rows], list[Row]]


# -- resolution ----------------------------------------------------------------------------------------------------


def _resolution_keys(seeds: list[int]) -> list[str]:
    return ["two doors", *(f"rooms {seed}" for seed in seeds)]


def _resolution(planner: Planner, key: str) -> Row:
    if key == "two doors":
        world = doors_in_series(0, 2)
        return {str(cell): asked(planner, world, cell, repeats=3) for cell in CELLS_M}
    world = random_rooms(int(key.split()[1]))
    return {str(cell): asked(planner, world, cell) for cell in CELLS_M[:3]}


def _resolution_table(rows: Rows) -> list[Row]:
    table: list[Row] = []
    two = rows["two doors"]
    for cell, row in two.items():
        table.append(
            {
                "name": f"two doors in series, cells of {100 * float(cell):g} cm",
                "ours": 1e3 * row["cpu_s"] if row["answer"] == "plan" else None,
                "unit": "ms",
                "floor": 100,
                "aim": 30,
                "note": f"{row['answer']} {row.get('cost_s', float('nan')):.1f} s",
            }
        )
    pairs, worse = 0, []
    # Each of these grids refines the other: 10 -> 5 and 10 -> 2; 5 -> 2 does not.
    for key, row in rows.items():
        for coarse, fine in (("0.1", "0.05"), ("0.1", "0.02"), ("0.1", "0.01"), ("0.02", "0.01")):
            if row.get(coarse, {}).get("answer") == "plan" == row.get(fine, {}).get("answer"):
                pairs += 1
                rise = row[fine]["cost_s"] / row[coarse]["cost_s"] - 1
                worse.append((rise, f"{key} {coarse} -> {fine}"))
    above = [rise for rise, _ in worse if rise > 0.01]
    note = f"{len(above)} of {pairs} pairs by more than 1 %; worst {max(worse, default=(0.0, ''))[1]}"
    rise = 100 * max(0.0, *(rise for rise, _ in worse)) if worse else None
    table.append(
        {
            "name": "finer map, costlier plan: worst",
            "ours": rise,
            "unit": "%",
            "floor": 1.0,
            "aim": 0,
            "note": note,
        }
    )
    lost = sum(
        row[c]["answer"] == "plan" != row[f]["answer"]
        for row in rows.values()
        for c, f in (("0.1", "0.05"), ("0.1", "0.02"))
    )
    table.append(
        {"name": "finer map, no plan where the coarse one has one", "ours": lost, "unit": "", "floor": 0}
    )
    table.append(faults_row("resolution", [one for row in rows.values() for one in row.values()]))
    return table


# -- idle objects --------------------------------------------------------------------------------------------------


def _idle(planner: Planner, key: str) -> Row:
    return {
        str(count): asked(planner, idle_objects(int(key), count), 0.05, repeats=3) for count in (0, 8, 20)
    }


def _idle_table(rows: Rows) -> list[Row]:
    table: list[Row] = []
    for count in ("0", "8", "20"):
        plans = [row[count] for row in rows.values()]
        times = [1e3 * plan.get("cpu_s", np.inf) for plan in plans]
        note = ", ".join(sorted({plan["answer"] for plan in plans}))
        table.append(
            {
                "name": f"{count} idle objects, median",
                "ours": quantile(times, 0.5),
                "unit": "ms",
                "floor": 100,
                "aim": 60,
                "note": note,
            }
        )
    table.append(faults_row("idle", [one for row in rows.values() for one in row.values()]))
    return table


# -- no plan -------------------------------------------------------------------------------------------------------


def _no_plan(planner: Planner, key: str) -> Row:
    from tests.worlds.push_truth import impossible

    world = blind_corridor() if key == "blind corridor" else closed_room(int(key))
    truth = impossible(world)
    if truth is not True:
        return {"truth": truth, "answer": "left out"}
    return {"truth": True, "bodies": len(world.bodies), **asked(planner, world, 0.05)}


def _no_plan_table(rows: Rows) -> list[Row]:
    true = [row for row in rows.values() if row["truth"] is True]
    soon = [row for row in true if row["answer"] == "proved" and row["cpu_s"] <= 2.0]
    silent = [row for row in true if row["answer"] not in ("proved", "not proved")]
    times = [row["cpu_s"] for row in true if row["answer"] == "proved"]
    return [
        {
            "name": "no plan proved in 2 s",
            "ours": 100.0 * len(soon) / max(len(true), 1),
            "unit": "%",
            "floor": 90,
            "aim": 100,
            "note": f"of {len(true)} proved by exhaustion apart; {len(rows) - len(true)} left out",
        },
        {
            "name": "no plan: neither proof nor 'not proved'",
            "ours": len(silent) if true else None,
            "unit": "",
            "floor": 0,
            "note": ", ".join(sorted({row["answer"] for row in silent})),
        },
        {
            "name": "no plan: time of the proofs, p90",
            "ours": quantile(times, 0.9),
            "unit": "s",
            "floor": 2,
            "aim": 1,
        },
    ]


# -- one cheapest plan ---------------------------------------------------------------------------------------------


def _compare(planner: Planner, key: str) -> Row:
    reply = planner.ask({"do": "compare", "problem": described(small_room(int(key)), 0.05)})
    names = ("status", "make_plan_s", "alternatives_s", "wall_s")
    return {name: reply[name] for name in names if name in reply}


def _compare_table(rows: Rows) -> list[Row]:
    done = [row for row in rows.values() if row["status"] == "answered"]
    off = [abs((row["make_plan_s"] or 0.0) - (row["alternatives_s"]["cheapest"] or 0.0)) for row in done]
    cheaper = sum(
        min(cost for cost in row["alternatives_s"].values() if cost is not None) < row["make_plan_s"] - 1e-3
        for row in done
        if row["make_plan_s"] is not None
    )
    note = f"{sum(value > 1e-3 for value in off)} of {len(done)} differ; {len(rows) - len(done)} without an answer"
    return [
        {
            "name": "make_plan against alternatives: worst difference",
            "ours": max(off, default=0.0),
            "unit": "s",
            "floor": 0,
            "note": note,
        },
        {"name": "an alternative is cheaper than the cheapest plan", "ours": cheaper, "unit": "", "floor": 0},
    ]


# -- campus --------------------------------------------------------------------------------------------------------


def _campus(planner: Planner, key: str) -> Row:
    planner.close()  # a fresh process, so that its peak memory is that of this plan
    world = campus(int(key))
    row = asked(planner, world, 0.05)
    late = [
        asked(planner, world, 0.05, limit_s=limit_s).get("cpu_s", np.inf) / limit_s for limit_s in LIMITS_S
    ]
    planner.close()
    return {**row, "over_limit": max(late)}


def _campus_table(rows: Rows) -> list[Row]:
    plans = list(rows.values())
    answers = ", ".join(sorted({plan["answer"] for plan in plans}))
    done = [plan for plan in plans if plan["answer"] == "plan"]
    return [
        {
            "name": "campus, 4000 x 4000 cells, 200 objects: plan across",
            "ours": quantile((p["cpu_s"] for p in done), 0.5),
            "unit": "s",
            "floor": 1,
            "aim": 0.15,
            "note": answers,
        },
        {
            "name": f"campus: CPU time by the limit, worst of {', '.join(f'{s:g}' for s in LIMITS_S)} s",
            "ours": max((p["over_limit"] for p in plans), default=None),
            "unit": "",
            "floor": 2,
        },
        {
            "name": "campus: peak of memory",
            "ours": max((p["peak_MB"] / 1024 for p in done), default=None),
            "unit": "GB",
            "floor": 1,
        },
        faults_row("campus", plans),
    ]


# -- route edges ---------------------------------------------------------------------------------------------------


def _route_keys(seeds: list[int]) -> list[str]:
    from tests.worlds.real_floors import names

    real = names(data_folder()) if data_folder().exists() else []
    return [*real, *(f"rooms {seed}" for seed in seeds)]


def _route(planner: Planner, key: str) -> Row:
    import shapely
    from tests.worlds.real_floors import load

    if key.startswith("rooms "):
        world, cells, cell_m = random_rooms(int(key.split()[1])), None, 0.05
    else:
        cells, cell_m = load(data_folder(), key)
        size = (cells.shape[1] * cell_m, cells.shape[0] * cell_m)
        middle = (0.5 * size[0], 0.5 * size[1])
        world = World(key, size, (), (), middle, middle)
    reply = planner.ask({"do": "route", "problem": described(world, cell_m, cells)}, 120.0)
    if reply["status"] != "answered":
        return {"answer": reply["status"], "message": reply.get("message", "")}
    cells = raster(world, cell_m) if cells is None else cells
    walls = Floor(world.walls, {})
    joined = shapely.linestrings(np.array(reply["joined"]).reshape(-1, 2, 2))
    chords = np.array(reply["chords"]).reshape(-1, 2, 2)
    lines = shapely.linestrings(chords)
    floor = Floor.of_cells(cells, cell_m, {})
    found = np.full(len(lines), np.inf)
    if len(lines):
        pairs, distance = floor.tree.query_nearest(lines, return_distance=True, all_matches=False)
        found[pairs[0]] = distance
    short = np.maximum(world.robot.radius_m - found, 0.0)
    lengths = shapely.length(lines)
    return {
        "answer": "graph",
        "edges": len(lines),
        "below": int((short > FAULT_M).sum()),
        "worst_m": float(short.max(initial=0.0)),
        "length_m": float(lengths.sum()),
        "below_m": float(lengths[short > FAULT_M].sum()),
        "joined": len(joined),
        "near_walls": sum(walls.gap_m(line)[0] < world.robot.radius_m - FAULT_M for line in joined),
        "cpu_s": reply["cpu_s"],
    }


def _route_table(rows: Rows) -> list[Row]:
    done = [row for row in rows.values() if row["answer"] == "graph"]
    below, length = sum(row["below_m"] for row in done), sum(row["length_m"] for row in done)
    note = f"{sum(row['below'] for row in done)} of {sum(row['edges'] for row in done)} edges on {len(done)} of {len(rows)} maps"
    return [
        {
            "name": "route edges below the robot's clearance, of the length",
            "ours": 100 * below / length if length else None,
            "unit": "%",
            "floor": 0,
            "aim": 0,
            "note": note,
        },
        {
            "name": "route edges to objects nearer to a wall than the robot's radius",
            "ours": sum(row["near_walls"] for row in done) if any(row["joined"] for row in done) else None,
            "unit": "",
            "floor": 0,
            "note": f"of {sum(row['joined'] for row in done)}",
        },
        {
            "name": "route edges: worst shortfall",
            "ours": 1e3 * max(row["worst_m"] for row in done) if length else None,
            "unit": "mm",
            "floor": 1.0,
        },
    ]


# -- third-party scenes ----------------------------------------------------------------------------------------------


def _scene_keys(seeds: list[int]) -> list[str]:
    folder = data_folder().parent / "namo"
    paths = [*sorted((folder / "namosim").glob("*.svg")), *sorted((folder / "namosim").glob("*/namo.yaml"))]
    paths += sorted((folder / "svg_mppi").glob("*.yaml"))
    return [str(path.relative_to(folder)) for path in paths]


def _scene(planner: Planner, key: str) -> Row:
    path = str(data_folder().parent / "namo" / key)
    asked = {"do": "scene", "path": path, "kind": key.split("/")[0]}
    reply = planner.ask(asked)
    if reply["status"] != "answered":
        return {"loaded": False, "message": reply.get("message", reply["status"]), "answers": []}
    answers = []
    for index in range(reply["problems"]):
        one = planner.ask({**asked, "index": index})
        answers.append(
            {"answer": answer_of(one), **{k: one[k] for k in ("cpu_s", "wall_s", "objects") if k in one}}
        )
    return {"loaded": True, "answers": answers}


def _scene_table(rows: Rows) -> list[Row]:
    answers = [answer for row in rows.values() for answer in row["answers"]]
    soon = [a for a in answers if a["answer"] in ("plan", "proved") and a["cpu_s"] <= 2.0]
    times = [1e3 * a.get("cpu_s", np.inf) for a in answers]
    refused = [key for key, row in rows.items() if not row["loaded"]]
    kinds = ", ".join(
        f"{sum(a['answer'] == kind for a in answers)} {kind}"
        for kind in sorted({a["answer"] for a in answers})
    )
    return [
        {
            "name": "scenes of others that load",
            "ours": 100.0 * (1 - len(refused) / max(len(rows), 1)),
            "unit": "%",
            "floor": 100,
            "note": ", ".join(refused),
        },
        {
            "name": "scenes of others answered in 2 s (plan or proof)",
            "ours": 100.0 * len(soon) / max(len(answers), 1),
            "unit": "%",
            "floor": 100,
            "note": f"{len(answers)} tasks: {kinds}",
        },
        {
            "name": "scenes of others, median",
            "ours": quantile(times, 0.5),
            "unit": "ms",
            "floor": 2000,
            "aim": 200,
        },
    ]


def _seeded(seeds: list[int]) -> list[str]:
    return [str(seed) for seed in seeds]


CAMPAIGNS: dict[str, Campaign] = {
    "resolution": Campaign(_resolution_keys, _resolution, _resolution_table),
    "idle": Campaign(_seeded, _idle, _idle_table),
    "rooms": Campaign(room_keys, room, rooms_table),
    "oracle": Campaign(_seeded, oracle, oracle_table),
    "push_ends": Campaign(_seeded, push_ends, push_ends_table),
    "no_plan": Campaign(lambda seeds: ["blind corridor", *_seeded(seeds)], _no_plan, _no_plan_table),
    "compare": Campaign(_seeded, _compare, _compare_table),
    "campus": Campaign(lambda seeds: _seeded(seeds[:2]), _campus, _campus_table),
    "route_edges": Campaign(_route_keys, _route, _route_table),
    "footprints": Campaign(_seeded, footprints, footprints_table),
    "off_centre": Campaign(_seeded, off_centre_plans, off_centre_table),
    "narrow_gaps": Campaign(_seeded, narrow_gaps, narrow_gaps_table),
    "places": Campaign(_seeded, places, places_table),
    "drives": Campaign(_seeded, drives, drives_table),
    "namosim": Campaign(_scene_keys, _scene, _scene_table),
}
