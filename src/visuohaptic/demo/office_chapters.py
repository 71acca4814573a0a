"""The office of the mission: its first round with the laser, and the door that is blocked today."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
from jaxtyping import Float

from ..core.robots import BaseState
from ..io.maps.occupancy_map import OccupancyMap
from ..navigation.mapping.map_changes import map_agreement, mark_points, new_objects, scan_fit
from ..navigation.mapping.mapper import OccupancyMapper
from ..navigation.planning.policies import without_pushing
from ..navigation.planning.search.domain_builder import build_search_domain
from ..navigation.planning.search.drives import pull_string
from ..navigation.planning.search.search_domain import grid_from_world, world_from_grid
from ..navigation.problem.planning_problem import MovableObject, PlanningProblem, RobotModel
from ..simulation.faults import FaultKind, wrong_map
from ..simulation.mobile.laser import SimulatedLaser
from ..simulation.mobile.obstacles import SimulatedObstacle
from ..simulation.mobile.odometry import DriftingBase
from ..simulation.mobile.office import ApproachPath, furnished_office
from ..tasks.mobile.travel.travel_memory import map_with_footprints
from .story import ChapterResult, Illustration, Measure, Mission, done, failed

__all__ = [
    "GOAL",
    "LOOK",
    "ROBOT",
    "find_the_door_blocked",
    "map_the_way",
    "office_map",
    "world_map",
]

ROBOT = RobotModel(0.17)
#: Where the first round goes, where the door is looked at from, and where the table is served from [m].
ROUND = (
    (1.2, 1.8),
    (4.2, 1.4),
    (4.2, 2.95),
    (6.2, 2.9),
    (7.0, 1.8),
    (6.0, 2.9),
    (4.2, 3.2),
    (3.2, 4.6),
    (3.6, 2.95),
)
LOOK = (3.6, 2.95, 0.0)
GOAL = (6.6, 2.9)
#: Edges of the doorway [m].
DOOR_X, DOOR_Y = (4.95, 5.05), (2.4, 3.5)
STEP_M = 0.1
#: The laser looks at cells this many times finer than those of the drawn office.
FINER = 4
#: Fraction of a scan's beams that must end where the map says. From 120 poses about the goal at least 0.96 fit
#: the maps that the laser made, and from 40 at most 0.92 a map that is shifted or has objects too many.
MIN_FIT = 0.94


class _Pulled:
    """A base that is where a person has pushed it on the first round."""

    def __init__(self, pose: Float[np.ndarray, "3"]) -> None:
        self.t_s, self.pose = 0.0, pose

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """It does not drive."""

    def stop(self) -> None:
        """It stands."""

    def state(self) -> BaseState:
        """Where it is."""
        x, y, heading = (float(value) for value in self.pose)
        return BaseState(self.t_s, x, y, heading, 0.0, 0.0)


@cache
def office_map() -> OccupancyMap:
    """The office as it truly is, without the objects in the door."""
    office = furnished_office()
    return OccupancyMap(office.cells, office.resolution_m, office.origin)


def door_obstacles(mission: Mission) -> tuple[ApproachPath, ...]:
    """Light bin, heavy box and fixed leg side by side in the doorway, in an order that the seed draws."""
    rng = mission.rng(1)
    kinds = [path.obstacle for path in furnished_office().paths]
    order = [kinds[int(k)] for k in rng.permutation(len(kinds))]
    widths = [min(one.width_m, one.length_m) if one.fixed else one.width_m for one in order]
    gap = (DOOR_Y[1] - DOOR_Y[0] - sum(widths)) / (len(order) + 1)
    y, found = DOOR_Y[0], []
    for one, width in zip(order, widths, strict=True):
        y += gap + 0.5 * width
        x = 0.5 * sum(DOOR_X) + float(rng.uniform(-0.01, 0.01))
        placed = one.moved(x, y, 0.0)
        found.append(approach_to(placed, x - 0.5 * one.length_m, y))
        y += 0.5 * width
    return tuple(found)


def approach_to(obstacle: SimulatedObstacle, front_x_m: float, y_m: float) -> ApproachPath:
    """Straight at it along x, with the foam so far before it that the camera sees it come."""
    before = ROBOT.radius_m + 0.03 + 0.17
    return ApproachPath(obstacle, (front_x_m - before, y_m, 0.0), before)


def world_map(mission: Mission) -> OccupancyMap:
    """The true office with the objects in the door, for the laser.

    Parameters
    ----------
    mission
        With the objects and where they truly are.
    """
    coarse = office_map()
    # The office is drawn in cells of 5 cm; what stands in the door is finer than that.
    fine = np.kron(coarse.cells, np.ones((FINER, FINER), dtype=np.int8))
    grid = OccupancyMap(fine, coarse.resolution_m / FINER, coarse.origin)
    outlines = [
        path.obstacle.outlines[0].moved(*mission.placed[path.obstacle.name]).polygon_m()
        for path in mission.paths
    ]
    return map_with_footprints(grid, outlines)


def _round() -> Float[np.ndarray, "n 3"]:
    """Poses of the first round, every ten centimetres."""
    grid = office_map()
    problem = PlanningProblem(grid, RobotModel(0.25), np.array(ROUND[0]), np.array(ROUND[-1]))
    world = build_search_domain(problem)
    still = np.zeros((0, 2))
    parts = []
    for start, end in itertools.pairwise(ROUND):
        path, _ = pull_string(
            world, still, grid_from_world(grid, np.array(start)), grid_from_world(grid, np.array(end))
        )
        parts.append(world_from_grid(grid, path))
    path_m = np.concatenate(parts)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    keep = np.concatenate([[True], np.diff(along) > 1e-9])
    at = np.arange(0.0, along[-1], STEP_M)
    points = np.column_stack([np.interp(at, along[keep], path_m[keep, axis]) for axis in (0, 1)])
    heading = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
    # The laser looks ahead only: turns are as smooth as a person makes them.
    smooth = np.convolve(np.pad(heading, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")
    return np.column_stack([points, smooth])


def map_the_way(mission: Mission) -> ChapterResult:
    """The first round: laser scans are laid on each other, odometry only helps.

    Parameters
    ----------
    mission
        Receives map and pose.
    """
    truth, poses = office_map(), _round()
    base = _Pulled(poses[0])
    odometry = DriftingBase(base, mission.rng(2))
    laser = SimulatedLaser(truth, None, mission.rng(3))
    mapper = OccupancyMapper()
    for number, pose in enumerate(poses):
        base.t_s, base.pose = 0.33 * number, pose
        measured = odometry.state()
        x, y, heading = (float(value) for value in pose)
        mapper.add(laser.scan((x, y, heading), base.t_s), (measured.x_m, measured.y_m, measured.heading_rad))
    found = mapper.map()
    off_m = float(np.hypot(*(np.array(mapper.pose[:2]) - poses[-1, :2])))
    measured = odometry.state()
    drift_m = math.hypot(measured.x_m - poses[-1, 0], measured.y_m - poses[-1, 1])
    lost = sum(not match.valid for match in mapper.matches)
    right, wrong = map_agreement(found, truth)
    if mission.fault is FaultKind.WRONG_MAP:
        found = OccupancyMap(wrong_map(found.cells, mission.rng(4)), found.resolution_m, found.origin)
        mission.log("  fault: the map is shifted, and has objects that are not there")
    mission.known.map = mission.known.map_now = found
    mission.known.pose = mapper.pose
    if lost > 0.2 * len(poses):
        return failed(f"{lost} of {len(poses)} scans do not fit the map that was made")
    length = STEP_M * len(poses)
    return done(
        f"{len(poses)} scans along {length:.0f} m make a map of {found.size_m[0]:.1f} m x {found.size_m[1]:.1f} m",
        off_m < 0.1,
        Measure("position error after the round, by the map [m]", off_m, None),
        Measure("position error after the round, by odometry alone [m]", drift_m, None),
        Measure("free cells that are truly free [%]", 100 * right, None),
        Measure("occupied cells with nothing within 10 cm [%]", 100 * wrong, None),
    )


def find_the_door_blocked(mission: Mission) -> ChapterResult:
    """Today the path to the table is blocked: what is new in the scans is separated and remembered.

    Parameters
    ----------
    mission
        With the map of the first round; receives the laser points of each object.
    """
    known, grid = mission.known, mission.known.map
    assert grid is not None
    if not mission.paths:
        set_the_door(mission)
    plan = without_pushing(_problem(grid, LOOK[:2], ()))
    if not plan.reachable:
        return failed(f"on the map of the first round there is no path to the table: {plan.reason}")
    mission.log(f"  on the map the path to the table is free: {plan.length_m:.1f} m, {plan.cost_s:.0f} s")
    laser = SimulatedLaser(world_map(mission), None, mission.rng(5))
    points = []
    for y in np.linspace(-0.45, 0.45, 7):
        pose = (LOOK[0] + 0.5, LOOK[1] + float(y), 0.0)
        scan = laser.scan(pose, 0.0)
        points.append(scan.points_m + pose[:2])
    if fit_fraction(mission, grid, LOOK, LOOK) < MIN_FIT:
        return failed("what the laser sees does not fit the map: the platform does not know where it is")
    groups = new_objects(grid, np.concatenate(points))
    groups = [one for one in groups if _in_the_way(one)]
    known.pose = LOOK
    if not groups:
        return failed("nothing new stands in the door, and yet it was to be blocked")
    known.obstacle_points_m = tuple(groups)
    for one in groups:
        x, y = one.mean(axis=0)
        mission.log(f"  something new at ({x:.2f}, {y:.2f}) m, {100 * np.ptp(one[:, 1]):.0f} cm wide as seen")
    known.map_now = mark_points(grid, groups)
    blocked = without_pushing(_problem(known.map_now, LOOK[:2], ()))
    true = [path.obstacle for path in mission.paths]
    near = [min(abs(one.y_m - float(group[:, 1].mean())) for one in true) for group in groups]
    right = len(groups) == len(true) and max(near) < 0.1
    parts = (
        Measure("objects in the door", len(groups), len(true)),
        Measure("largest sideways error of a place [m]", max(near), None),
        _door_picture(mission),
    )
    if blocked.reachable:
        return done(f"{len(groups)} objects in the door, and still a path beside them", right, *parts)
    return done(f"{len(groups)} objects stand in the door and leave no path: {blocked.reason}", right, *parts)


def set_the_door(mission: Mission) -> None:
    """Put the objects into the simulated door."""
    mission.paths = door_obstacles(mission)
    mission.placed = {
        path.obstacle.name: (path.obstacle.x_m, path.obstacle.y_m, path.obstacle.yaw_rad)
        for path in mission.paths
    }


def fit_fraction(
    mission: Mission,
    grid: OccupancyMap,
    true_pose: tuple[float, float, float],
    estimated_pose: tuple[float, float, float],
) -> float:
    """Fraction of a scan's hits that have something on the map near; objects in the door aside.

    Parameters
    ----------
    mission
        For the noise of the laser.
    grid
        The robot's map.
    true_pose
        Where the platform is: x, y [m], heading [rad].
    estimated_pose
        Estimated.
    """
    scan = SimulatedLaser(office_map(), None, mission.rng(6)).scan(true_pose, 0.0)
    c, s = math.cos(estimated_pose[2]), math.sin(estimated_pose[2])
    return scan_fit(grid, scan.points_m @ np.array([[c, s], [-s, c]]) + estimated_pose[:2])


def _in_the_way(group: Float[np.ndarray, "k 2"]) -> bool:
    x, y = group.mean(axis=0)
    return bool(abs(x - np.mean(DOOR_X)) < 0.5 and DOOR_Y[0] - 0.2 < y < DOOR_Y[1] + 0.2)


def _problem(
    grid: OccupancyMap, start_m: tuple[float, ...], objects: tuple[MovableObject, ...]
) -> PlanningProblem:
    return PlanningProblem(grid, ROBOT, np.array(start_m[:2]), np.array(GOAL), objects)


def _door_picture(mission: Mission) -> Illustration:
    from ..report.floor_chart import MapObject, floor_map

    grid = mission.known.map_now
    assert grid is not None
    objects = [MapObject(f"new {k + 1}", _box(one)) for k, one in enumerate(mission.known.obstacle_points_m)]
    x, y, _ = grid.origin
    figure = floor_map(
        grid.cells, grid.resolution_m, (x, y), path_world_m=_round()[:, :2], objects=objects,
        robot_radius_m=ROBOT.radius_m,
    )  # fmt: skip
    return Illustration(
        figure,
        "The map that the laser made on the first round (its path in blue), and what is new in the door",
    )


def _box(points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "4 2"]:
    (x0, y0), (x1, y1) = points.min(axis=0) - 0.01, points.max(axis=0) + 0.01
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def default_map(mission: Mission) -> None:
    """The drawn office instead of a measured map, and the door as the laser would see it."""
    mission.known.map = office_map()
    if mission.fault is FaultKind.WRONG_MAP:
        grid = office_map()
        mission.known.map = OccupancyMap(
            wrong_map(grid.cells, mission.rng(4)), grid.resolution_m, grid.origin
        )
    mission.known.map_now, mission.known.pose = mission.known.map, LOOK
    set_the_door(mission)


def default_door(mission: Mission) -> None:
    """Places of the objects as drawn."""
    if not mission.paths:
        set_the_door(mission)
    mission.known.obstacle_points_m = tuple(
        path.obstacle.outlines[0].moved(*mission.placed[path.obstacle.name]).polygon_m()
        for path in mission.paths
    )
    mission.known.pose = LOOK
