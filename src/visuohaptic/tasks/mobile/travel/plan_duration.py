"""Expected duration of a plan as :class:`~.travel_task.TravelTask` drives it.

The planner weighs paths by the speed that their clearance allows (Alt 2016, Eq. (4.1)). A drive takes longer: the platform
turns on the spot, brakes before corners, and takes the lower of the speeds here and ahead. Here, the same control law
follows the paths on ideal wheels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ....core.geometry import wrap_angle
from ....core.robots import BaseState
from ....navigation.grid.cost_grid import SpeedLimits, grid_layers
from ....navigation.planning.path_follower import FollowLimits, PathFollower
from ....navigation.problem.path_plan import Plan, Task
from ....navigation.problem.planning_problem import PlanningProblem
from ....navigation.problem.robot_model import RobotModel
from ..steered_push import PushSettings
from .travel_memory import TravelMemory
from .travel_motion import ON_HEADING_RAD, RETREAT_M_S, turn_rate
from .travel_types import TravelSettings

#: Step of the control law [s]; its time constant is a third of a second.
STEP_S = 0.05

Clearance = Callable[[Float[np.ndarray, "2"]], float]


def expected_duration_s(
    plan: Plan, problem: PlanningProblem, heading_rad: float | None = None, margin_m: float = 0.0
) -> float:
    """Expected duration of a plan, with the retries of its pushes [s]; infinite without a plan.

    Parameters
    ----------
    plan
        Plan of the problem.
    problem
        Map and objects, and the robot with the margin of the plan.
    heading_rad
        Heading of the robot at the start [rad]; that of the first path by default.
    margin_m
        Margin of the plan, by which the rim is farther from a pushed object [m].
    """
    robot, memory, total_s = problem.robot, TravelMemory(problem), 0.0 if plan.reachable else math.inf
    clearance, at_m = clearance_of(problem), np.asarray(problem.start_m)
    push_m_s = min(robot.v_push_m_s, robot.v_max_m_s)
    for task in plan.tasks:
        path_m = np.array(task.path_m).reshape(-1, 2)
        if task.kind in ("wait", "explore") or len(path_m) < 2:
            total_s += task.cost_s
            continue
        if heading_rad is None:
            heading_rad = math.atan2(*(path_m[1] - path_m[0])[::-1])
        if task.kind == "navigate":
            seconds, heading_rad = _follow_s(
                np.vstack([at_m, path_m]), follow_limits(robot), heading_rad, clearance
            )
            total_s, at_m = total_s + seconds, path_m[-1]
        elif task.kind == "push":
            seconds, at_m, heading_rad = _push_s(task, robot, heading_rad, margin_m)
            total_s += seconds / max(1.0 - task.failure_probability, 0.01)
            x, y = memory.item(task.object).centre_m + task.displacement_m
            memory.seen(task.object, np.array([x, y, task.turn_rad]))
            clearance = clearance_of(memory.problem(np.array([*at_m, heading_rad])))
        else:
            ahead_rad = math.atan2(*(path_m[1] - path_m[0])[::-1])
            total_s += _turn_s(wrap_angle(ahead_rad - heading_rad)) + task.length_m / push_m_s
            heading_rad, at_m = ahead_rad, path_m[-1]
    return total_s


def _push_s(
    task: Task, robot: RobotModel, heading_rad: float, margin_m: float
) -> tuple[float, Float[np.ndarray, "2"], float]:
    """Duration of one push [s], and the position [m] and heading [rad] after the retreat from the object."""
    stand_m, pushed_m, retreat_m = np.array(task.path_m)
    moved_m = np.array(task.displacement_m)
    direction_rad, length_m = math.atan2(*moved_m[::-1]), float(np.hypot(*moved_m))
    push_m_s = min(robot.v_push_m_s, robot.v_max_m_s)
    near_m = float(np.hypot(*(pushed_m - stand_m))) - length_m + margin_m
    total_s = _turn_s(wrap_angle(direction_rad - heading_rad))
    total_s += near_m / max(PushSettings().approach_m_s, push_m_s) + length_m / push_m_s
    back_m = max(TravelSettings().back_off_m - margin_m, float(np.hypot(*(retreat_m - pushed_m))))
    at_m = pushed_m - back_m * moved_m / length_m
    return total_s + (back_m + margin_m) / RETREAT_M_S, at_m, direction_rad


def _turn_s(angle_rad: float) -> float:
    """Duration of a turn on the spot, before a push [s]."""
    left_rad, total_s = abs(angle_rad), 0.0
    while left_rad > ON_HEADING_RAD:
        left_rad, total_s = left_rad - turn_rate(left_rad) * STEP_S, total_s + STEP_S
    return total_s


def _follow_s(
    path_m: Float[np.ndarray, "k 2"],
    limits: FollowLimits,
    heading_rad: float,
    clearance: Clearance,
) -> tuple[float, float]:
    """Duration of a drive along a path [s], and the heading at its end [rad]."""
    follower = PathFollower(path_m, limits, clearance=clearance)
    x, y = (float(value) for value in path_m[0])
    t_s, speed, length_m = 0.0, 0.0, sum(math.dist(*pair) for pair in pairwise(path_m))
    # At its lowest speed, and turning once around at each corner.
    latest_s = length_m / limits.v_min_m_s + len(path_m) * 2.0 * math.pi / limits.turn_max_rad_s + 10.0
    while t_s < latest_s:
        allowed, turn = follower.command(BaseState(t_s, x, y, heading_rad, 0.0, 0.0))
        speed = min(allowed, speed + limits.acceleration_m_s2 * STEP_S)
        if follower.done:
            break
        heading_rad += 0.5 * turn * STEP_S
        x += speed * STEP_S * math.cos(heading_rad)
        y += speed * STEP_S * math.sin(heading_rad)
        heading_rad += 0.5 * turn * STEP_S
        t_s += STEP_S
    return t_s, heading_rad


def follow_limits(robot: RobotModel) -> FollowLimits:
    """Speeds and distances with which a robot follows a planned path.

    Parameters
    ----------
    robot
        Robot with the margin of the plan.
    """
    limits = FollowLimits(robot.radius_m, robot.v_max_m_s, min(robot.v_min_m_s, robot.v_max_m_s))
    # Planned to turn on the spot at every corner.
    return replace(limits, corner_rad=0.0) if robot.footprint_m else limits


def clearance_of(problem: PlanningProblem) -> Clearance:
    """Function that returns the distance to the nearest obstacle [m], from the map used for planning.

    Parameters
    ----------
    problem
        Its map and robot.
    """
    robot = problem.robot
    layers = grid_layers(problem.map, SpeedLimits(robot.radius_m, robot.v_max_m_s, robot.v_min_m_s))
    distance, grid = layers.distance_m, problem.map
    x, y, yaw = grid.origin
    c, s, scale = math.cos(yaw), math.sin(yaw), 1.0 / grid.resolution_m
    rows, columns = grid.shape

    def clearance(point: Float[np.ndarray, "2"]) -> float:
        dx, dy = float(point[0]) - x, float(point[1]) - y
        column, row = int((c * dx + s * dy) * scale), int((c * dy - s * dx) * scale)
        return float(distance[row, column]) if 0 <= row < rows and 0 <= column < columns else 0.0

    return clearance
