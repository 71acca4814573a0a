"""Checks a plan with shapely, independently of the planner, and reports its faults."""

from __future__ import annotations

import numpy as np
from shapely import LineString, Point, Polygon, covers, points, polygons, prepare, union_all
from shapely.affinity import translate

from visuohaptic.navigation.problem import Plan, PlanningProblem


def faults(problem: PlanningProblem, plan: Plan) -> list[str]:
    """Everything that a robot of flesh would complain about; empty for a good plan.

    Walls are the squares of occupied cells outside all outlines: driven
    clearance is the distance to these and to the outlines of objects,
    wherever they are by then.
    """
    grid, radius = problem.map, problem.robot.radius_m
    cell = grid.resolution_m
    bodies = {item.id: Polygon(item.footprint_m) for item in problem.objects}
    blocked = np.argwhere((grid.cells >= 50) | (grid.cells < 0))
    centres = grid.world_from_cell(blocked)
    near = np.zeros(len(centres), dtype=bool)
    for body in bodies.values():
        grown = body.buffer(1.3 * cell)
        prepare(grown)
        x0, y0, x1, y1 = grown.bounds
        inside = (centres > (x0, y0)).all(axis=1) & (centres < (x1, y1)).all(axis=1)
        near[inside] |= covers(grown, points(centres[inside]))
    square = 0.5 * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)])
    walls = union_all(polygons(grid.world_from_cell(blocked[~near][:, None] + square)))
    slack = 2e-6  # coordinates are written in micrometres
    found: list[str] = []
    at = np.array(problem.start_m)
    for number, task in enumerate(plan.tasks):
        where = f"task {number} ({task.kind} {task.object})"
        if task.path_m:
            if np.hypot(*(np.array(task.path_m[0]) - at)) > 1e-6:
                found.append(f"{where} starts at {task.path_m[0]}, the robot is at {at}")
            at = np.array(task.path_m[-1])
        if task.kind == "navigate":
            way = LineString(task.path_m)
            length = way.length
            if abs(length - task.length_m) > 1e-5:
                found.append(f"{where} says {task.length_m} m of {length} m")
            if task.cost_s < length / problem.robot.v_max_m_s - 1e-6:
                found.append(f"{where} is faster than the robot")
            if task.cost_s > length / problem.robot.v_min_m_s + 1e-3:
                found.append(f"{where} is slower than the slowest speed")
            for name, body in bodies.items():
                if way.distance(body) < radius - slack:
                    found.append(f"{where} touches {name}: {way.distance(body):.4f} m")
            if not walls.is_empty and way.distance(walls) < radius - slack:
                found.append(f"{where} touches a wall: {way.distance(walls):.4f} m")
        elif task.kind == "push":
            item = next(item for item in problem.objects if item.id == task.object)
            if item.known_immovable:
                found.append(f"{where} pushes what must not be pushed")
            body = bodies[task.object]
            assert task.contact_m is not None
            assert task.goal_m is not None
            if body.exterior.distance(Point(*task.contact_m)) > 1e-6:
                found.append(f"{where}: the contact is not on the outline")
            centre = np.array(body.centroid.coords[0])
            moved = np.array(task.goal_m) - centre
            length = float(np.hypot(*moved))
            direction = moved / length
            if np.dot(np.array(task.contact_m) - centre, direction) >= 0:
                found.append(f"{where}: the contact is on the far side")
            speed = problem.robot.v_push_m_s
            if task.cost_s < problem.robot.setup_time_s + length / speed - 1e-6:
                found.append(f"{where} is faster than a push can be")
            tag = item.tag
            if tag is not None and tag.drift is not None and abs(tag.drift.value) * length > 0.1 + 1e-9:
                found.append(f"{where}: drifts {tag.drift.value * length} m")
            behind = LineString(task.path_m)
            for name, other in bodies.items():
                if name != task.object and behind.distance(other) < radius - slack:
                    found.append(f"{where}: the robot touches {name}")
            if not walls.is_empty and behind.distance(walls) < radius - slack:
                found.append(f"{where}: the robot touches a wall")
            for t in np.linspace(0, 1, max(2, int(length / (0.5 * cell)) + 1)):
                here = translate(body, *(t * moved))
                shrunk = here.buffer(-slack)
                for name, other in bodies.items():
                    if name != task.object and shrunk.intersects(other):
                        found.append(f"{where}: {task.object} runs into {name}")
                if t > 0 and shrunk.intersects(walls):
                    found.append(f"{where}: {task.object} runs into a wall")
                    break
            bodies[task.object] = translate(body, *moved)
            if bodies[task.object].distance(Point(*at)) < radius - slack:
                found.append(f"{where}: the robot ends inside {task.object}")
    if np.hypot(*(at - problem.goal_m)) > 1e-6:
        found.append(f"ends at {at}, not at the goal")
    return found
