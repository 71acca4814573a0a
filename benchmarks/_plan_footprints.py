"""Plans of a robot of 0.9 x 0.5 m in rooms with doors of 0.75 to 1 m, checked by polygons at poses a centimetre apart.

The check knows occupied cells, outlines of bodies and the tasks: paths are driven forwards along their tangents with turns
the shorter way at their corners, a push goes from its approach pose forwards to the end of the push, and back.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from tests.worlds.floor_scenes import random_rooms
from tests.worlds.maps import World, raster

from ._plan_child import Planner, described
from ._plan_judge import Row, Rows, answer_of, quantile

__all__ = ["collisions", "footprints", "footprints_table"]

CELL_M = 0.05
OUTLINE_M = np.array([[0.45, 0.25], [-0.45, 0.25], [-0.45, -0.25], [0.45, -0.25]])
STEP_M, TURN_RAD = 0.01, np.deg2rad(1.0)
#: Overlap that counts as a collision: half the diagonal of a sample's motion, and the rounding of written coordinates [m].
OVERLAP_M = 1e-3


def footprints(planner: Planner, key: str) -> Row:
    """A plan with the footprint, with the circle around it, and with the circle inside."""
    world = random_rooms(int(key))
    row: Row = {}
    for name, radius_m in (("footprint", None), ("outside", float(np.hypot(0.45, 0.25))), ("inside", 0.25)):
        described_world = described(world, CELL_M)
        robot = described_world["robot"]
        if radius_m is None:
            del robot["radius_m"]
            robot["footprint"] = OUTLINE_M.tolist()
        else:
            robot["radius_m"] = radius_m
        reply = planner.ask({"do": "plan", "problem": described_world})
        row[name] = {
            "answer": answer_of(reply),
            "cpu_s": reply.get("cpu_s"),
            "message": reply.get("message", ""),
        }
        if row[name]["answer"] == "plan":
            plan = reply["plan"]
            row[name] |= {
                "cost_s": plan["cost_s"],
                "pushes": sum(task["kind"] == "push" for task in plan["tasks"]),
            }
            if radius_m is None:
                row[name]["collisions"] = collisions(world, CELL_M, plan["tasks"], OUTLINE_M)
        else:
            row[name]["message"] = row[name]["message"] or reply.get("plan", {}).get("reason", "")
    return row


def collisions(world: World, cell_m: float, tasks: list[dict[str, Any]], outline_m: np.ndarray) -> list[str]:
    """Where the robot's polygon overlaps an occupied cell or a body; the first heading is that of the first drive."""
    inner = np.array(shapely.Polygon(outline_m).buffer(-OVERLAP_M, join_style="mitre").exterior.coords)[:-1]
    rows, columns = np.nonzero(raster(world, cell_m, bodies=False))
    cells = shapely.STRtree(
        shapely.box(columns * cell_m, rows * cell_m, (columns + 1) * cell_m, (rows + 1) * cell_m)
    )
    bodies = {body.id: body for body in world.bodies}
    heading, found = None, []
    for task in tasks:
        path = np.array(task.get("path_m", []))
        pushed = task["kind"] == "push"
        if pushed:
            step = path[1] - path[0]
            ahead = float(np.arctan2(step[1], step[0]))
            poses = [*_turning(path[0], heading, ahead), *_straight(path[0], path[1], ahead)]
            heading = ahead
        else:
            poses = []
            for a, b in pairwise(path):
                ahead = float(np.arctan2(*(b - a)[::-1]))
                poses += [*_turning(a, heading, ahead), *_straight(a, b, ahead)]
                heading = ahead
        if not poses:
            continue
        robot = _placed(inner, np.array(poses))
        hit = cells.query(robot, predicate="intersects")[0]
        found += [f"{task['kind']}: cell at {np.round(poses[k], 3).tolist()}" for k in np.unique(hit)[:1]]
        for body in bodies.values():
            moving = pushed and body.id == task["object"]
            polygons = _carried(body, np.array(poses), path, task) if moving else body.polygon
            hit = np.flatnonzero(shapely.intersects(robot, polygons))
            found += [f"{task['kind']}: {body.id} at {np.round(poses[k], 3).tolist()}" for k in hit[:1]]
        if pushed:
            bodies[task["object"]] = bodies[task["object"]].moved(task["displacement_m"])
    return found


def _carried(body: Any, poses: np.ndarray, path: np.ndarray, task: dict[str, Any]) -> np.ndarray:
    """The pushed body at each pose: moved by what the robot has driven beyond the contact."""
    shift = np.array(task["displacement_m"])
    length = np.hypot(*shift)
    along = (poses[:, :2] - path[1]) @ (shift / length)
    return np.array([body.moved((max(length + back, 0.0)) * shift / length).polygon for back in along])


def _straight(a: np.ndarray, b: np.ndarray, heading: float) -> list[tuple[float, float, float]]:
    count = max(1, int(np.ceil(np.hypot(*(b - a)) / STEP_M)))
    return [(*(a + part * (b - a)), heading) for part in np.arange(count + 1) / count]


def _turning(at: np.ndarray, begin: float | None, end: float) -> list[tuple[float, float, float]]:
    if begin is None:
        return []
    turn = (end - begin + np.pi) % (2 * np.pi) - np.pi
    count = max(1, int(np.ceil(abs(turn) / TURN_RAD)))
    return [(*at, begin + part * turn) for part in np.arange(count + 1) / count]


def _placed(outline_m: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Polygons of an outline at poses x, y, heading."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = outline_m.T
    return shapely.polygons(np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], axis=-1))


def footprints_table(rows: Rows) -> list[Row]:
    """Collisions, plans that only the footprint has, and CPU time."""
    shaped = [row["footprint"] for row in rows.values()]
    found = [row for row in shaped if row["answer"] == "plan"]
    hits = sum(len(row["collisions"]) for row in found)
    more = sum(r["footprint"]["answer"] == "plan" != r["outside"]["answer"] for r in rows.values())
    less = sum(r["footprint"]["answer"] != "plan" == r["inside"]["answer"] for r in rows.values())
    lost = sum(r["footprint"]["answer"] != "plan" == r["outside"]["answer"] for r in rows.values())
    times = [1e3 * row["cpu_s"] for row in shaped if row["cpu_s"] is not None]
    return [
        {"name": "robot of 0.9 x 0.5 m: collisions of its plans", "ours": hits, "unit": "", "floor": 0,
         "note": f"{len(found)} plans of {len(rows)} rooms, {sum(row['pushes'] for row in found)} pushes"},
        {"name": "no plan for it, but for the circle around it", "ours": lost, "unit": "", "floor": 0,
         "note": f"{more} plans that this circle does not have; {less} rooms with a plan for the circle inside only"},
        {"name": "plan for it, CPU time, median", "ours": quantile(times, 0.5), "unit": "ms",
         "note": f"{max(times, default=0.0):.0f} at most"},
    ]  # fmt: skip
