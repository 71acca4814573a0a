"""A plan with one sideward push: drive to the object and past it, and continue from there (Alt 2016, Sec. 4.3.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ...core.geometry import rotation_2d
from ..problem import Plan, PlanningProblem, Task
from ..pushing.push_model import PushModel
from ..pushing.quasi_static import remaining_m
from .arrays import Path, Point
from .drive_tasks import drive_tasks
from .off_centre_rollouts import OffCentreScene, fits, has_room, scene_of
from .replanning import after_push
from .search.domain_builder import build_search_domain
from .search.drives import pull_string
from .search.push_states import Deadline
from .search.search_domain import SearchDomain, world_from_grid
from .sideward_push import SLIDE_M, SidewardPush, sideward_pushes

#: Displacement that moves a body off any map [cells].
AWAY = 1e7
#: A path whose heading changes by less than this is stored as its end points [rad].
STRAIGHT_RAD = 1e-6


def via_sideward(
    domain: SearchDomain,
    index: int,
    rest: Callable[[PlanningProblem], Plan],
    max_cost_s: float = float("inf"),
    deadline: Deadline | None = None,
) -> Plan:
    """The cheapest plan that starts with a sideward push of an object; the drive to it pushes nothing.

    Parameters
    ----------
    domain
        Map, objects, robot, start and goal.
    index
        Index of the body.
    rest
        Planner for the remaining problem after the push.
    max_cost_s
        Upper limit of the useful cost: if no such plan can be cheaper, none is searched [s].
    deadline
        Time limit.
    """
    body, robot, problem = domain.bodies[index], domain.robot, domain.problem
    robot.check_disc("sideward pushes are planned")
    nothing = Plan(False, reason=f"{body.obj.id} cannot be pushed aside on the path")
    shifts = np.zeros((len(domain.bodies), 2))
    gone = shifts.copy()
    gone[index] = AWAY
    path, cost = pull_string(domain, gone, domain.start, domain.goal)
    if not len(path):  # others are obstacles, too: they may be pushed afterwards
        gone[:] = AWAY
        path, cost = pull_string(domain, gone, domain.start, domain.goal)
    if not len(path) or domain.seconds(cost) + robot.setup_time_s >= max_cost_s:
        return nothing
    ends = _past(domain, index, path)
    if ends is None:
        return nothing
    scene = scene_of(domain, index)
    found = nothing
    for push in sideward_pushes(scene, *ends, deadline):
        begin, end = push.path_m[[0, -1], :2] / problem.map.resolution_m + body.centre
        drive, drive_cost = pull_string(domain, shifts, domain.start, begin)
        if not len(drive) or domain.seconds(drive_cost) + push.cost_s >= min(max_cost_s, found.cost_s):
            continue
        turn = rotation_2d(problem.map.origin[2])
        moved_m = turn @ push.trace.object_m[-1, :2]
        end_m = world_from_grid(problem.map, end)
        onward = rest(
            after_push(problem, body.obj.id, moved_m, end_m, turn_rad=float(push.trace.object_m[-1, 2]))
        )
        tasks = (*drive_tasks(domain, shifts, drive, drive_cost), _task(scene, push), *onward.tasks)
        plan = replace(onward, tasks=tasks, gap=float("inf"))
        if plan.reachable and plan.cost_s < found.cost_s:
            found = plan
    return found


def _past(domain: SearchDomain, index: int, path: Path) -> tuple[Point, Point] | None:
    """Part of a path that passes near a body, relative to its centre [m]; none if the path keeps clear of it."""
    import shapely

    body, resolution_m = domain.bodies[index], domain.map.resolution_m
    line = shapely.LineString(path if len(path) > 1 else np.repeat(path, 2, axis=0))
    near = line.intersection(shapely.Polygon(body.outline).buffer(domain.radius))
    if near.is_empty:
        return None
    along = [line.project(shapely.Point(point)) for point in shapely.get_coordinates(near)]
    slide = SLIDE_M / resolution_m
    ends = line.interpolate([max(min(along) - slide, 0.0), min(max(along) + slide, line.length)])
    enter, leave = (shapely.get_coordinates(ends) - body.centre) * resolution_m
    return (enter, leave) if (enter != leave).any() else None


def _task(scene: OffCentreScene, push: SidewardPush) -> Task:
    domain, body, trace = scene.domain, scene.body, push.trace
    resolution_m, turn = domain.map.resolution_m, rotation_2d(domain.map.origin[2])

    def points(places_m: Path) -> tuple[tuple[float, float], ...]:
        world = world_from_grid(domain.map, places_m / resolution_m + body.centre)
        return tuple((float(x), float(y)) for x, y in world)

    straight = abs(push.path_m[-1, 2] - push.path_m[0, 2]) < STRAIGHT_RAD
    path = push.path_m[[0, -1], :2] if straight else push.path_m[:, :2]
    touched = trace.contact_m[np.isfinite(trace.contact_m[:, 0])][:1]
    dx, dy = turn @ trace.object_m[-1, :2]
    covariance = np.zeros((3, 3)) if push.end_covariance is None else push.end_covariance
    spin = np.eye(3)
    spin[:2, :2] = turn
    return Task(
        "sideward", push.cost_s, remaining_m(push.path_m, 0), points(path), body.obj.id, points(touched)[0],
        points(trace.object_m[-1:, :2])[0], (float(dx), float(dy)), float(trace.object_m[-1, 2]),
        push.failure_probability, tuple(map(tuple, (spin @ covariance @ spin.T).tolist())),
    )  # fmt: skip


class SidewardCheck:
    """Model and collision check for a robot during a sideward push; map frame.

    Parameters
    ----------
    problem
        Problem before the drive; its robot is the one used for planning.
    id
        Id of the object.
    """

    def __init__(self, problem: PlanningProblem, id: str) -> None:
        domain = build_search_domain(problem)
        index = next(k for k, body in enumerate(domain.bodies) if body.obj.id == id)
        self._scene = scene_of(domain, index)
        obj = domain.bodies[index].obj
        #: outline and supports about the centroid, along the map's axes
        self.model = PushModel.of_footprint(obj.footprint_m - obj.centre_m).with_centre_moved(
            *obj.friction_offset_m
        )
        #: pose of the object: x, y [m], rotation relative to now [rad]
        self.place_m = (float(obj.centre_m[0]), float(obj.centre_m[1]), 0.0)

    def free(self, path_m: Float[np.ndarray, "k 3"], object_m: Float[np.ndarray, "n 3"]) -> bool:
        """Whether the robot is collision-free on a path, and the object at all its poses.

        Parameters
        ----------
        path_m
            Path of the robot: x, y [m], heading [rad].
        object_m
            Poses of the object: x, y [m], rotation relative to its initial pose [rad].
        """
        turn = rotation_2d(self._scene.domain.map.origin[2])
        poses = object_m.copy()
        poses[:, :2] = (object_m[:, :2] - self.place_m[:2]) @ turn
        room: Bool[np.ndarray, "k"] = has_room(self._scene, (path_m[:, :2] - self.place_m[:2]) @ turn)
        return bool(room.all() and fits(self._scene, poses).all())
