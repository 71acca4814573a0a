"""The floor of the mission: the mapping tour with the laser, and the path to the table that is blocked today."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ..core.geometry import compose_2d, relative_2d, rotation_2d
from ..io.maps.occupancy_map import OccupancyMap
from ..navigation.mapping.map_changes import map_agreement, mark_points, new_objects, scan_fit
from ..navigation.mapping.mapper import OccupancyMapper
from ..navigation.planning.policies import without_pushing
from ..navigation.planning.search.domain_builder import build_search_domain
from ..navigation.planning.search.drives import pull_string
from ..navigation.planning.search.search_domain import grid_from_world, world_from_grid
from ..navigation.problem.planning_problem import MovableObject, PlanningProblem, RobotModel
from ..simulation.faults import FaultKind, wrong_map
from ..simulation.houses.guided_platform import GuidedPlatform
from ..simulation.mobile.obstacles import SimulatedObstacle
from ..tasks.mobile.doorway_objects import heading_across, join_sides, near_side
from ..tasks.mobile.travel.travel_memory import map_with_footprints
from .judge import Claim
from .memory import RememberedMap
from .story import ChapterResult, Illustration, Measure, Mission, done, failed

__all__ = ["ROBOT", "find_the_door_blocked", "map_route", "world_map"]

ROBOT = RobotModel(0.17)
#: Distance between two scans [m].
STEP_M = 0.1
#: Minimum fraction of a scan's beams that end at occupied cells of the map. From 120 poses around the goal at least 0.96 match
#: the laser's own maps, and from 40 at most 0.92 a map that is shifted or has additional objects.
MIN_FIT = 0.94
#: Beyond this distance from the path, the platform can pass [m].
BESIDE_M = 2 * ROBOT.radius_m + 0.2
#: Distance of the observation point from the first obstacle, and of the views to either side [m].
LOOK_M, ASIDE_M = 0.9, 0.45
#: Standard deviation of a position measured by the laser, from the errors of map and laser [m].
SEEN_SIGMA_M = 0.03


def world_map(mission: Mission) -> OccupancyMap:
    """The true floor with all objects, as seen by the laser.

    Parameters
    ----------
    mission
        Mission with the house, and the true poses of its objects.
    """
    outlines = [outline_m(mission, one) for one in mission.house.obstacles]
    return map_with_footprints(mission.house.fine_grid(), outlines)


def outline_m(
    mission: Mission, obstacle: SimulatedObstacle, step_rad: float = math.pi / 16
) -> Float[np.ndarray, "k 2"]:
    """Current true outline of an obstacle [m].

    Parameters
    ----------
    mission
        Mission with the poses of all obstacles.
    obstacle
        One of the house.
    step_rad
        Angular step of a round outline.
    """
    return obstacle.outlines[0].moved(*mission.placed[obstacle.name]).polygon_m(step_rad)


def _path(
    grid: OccupancyMap, corners: Sequence[tuple[float, float]], radius_m: float
) -> Float[np.ndarray, "n 3"]:
    """Poses every ten centimetres along the shortest path through corners."""
    problem = PlanningProblem(grid, RobotModel(radius_m), np.array(corners[0]), np.array(corners[-1]))
    world = build_search_domain(problem)
    still = np.zeros((0, 2))
    parts = []
    for start, end in itertools.pairwise(corners):
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
    # The laser looks ahead only: the path turns as smoothly as that of a person.
    smooth = np.convolve(np.pad(heading, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")
    return np.column_stack([points, smooth])


def map_route(mission: Mission) -> ChapterResult:
    """The mapping tour: scan matching, with odometry as initial guess.

    A person leads the platform, stops where the table is reached, and leads it to the start of its tasks.

    Parameters
    ----------
    mission
        Receives map, pose, and the position of the table.
    """
    house = mission.house
    recalled = mission.memory.map() if mission.memory is not None else None
    if recalled is not None and fit_fraction(mission, recalled.grid, house.start, recalled.home) >= MIN_FIT:
        return _recall_the_map(mission, recalled)
    poses = _path(house.grid, house.tour_m[:: -1 if mission.attempt else 1], 0.25)
    platform = GuidedPlatform(house, _pose(poses[0]), mission.rng(2), mission.rng(3))
    mapper = OccupancyMapper()
    served = int(np.hypot(*(poses[:, :2] - house.table_m).T).argmin())
    path_m = []
    for number, pose in enumerate([*poses, house.start]):
        platform.go(relative_2d(platform.pose, _pose(pose)))
        mapper.add(platform.scan(), platform.odometry())
        path_m.append(mapper.pose[:2])
        if number == served:
            mission.known.goal_m = mapper.pose[:2]
    found = mapper.map()
    off_m = math.dist(mapper.pose[:2], platform.pose[:2])
    drift_m = math.dist(platform.odometry()[:2], platform.pose[:2])
    lost = sum(not match.valid for match in mapper.matches)
    right, wrong = map_agreement(found, house.grid)
    if mission.fault is FaultKind.WRONG_MAP:
        found = OccupancyMap(wrong_map(found.cells, mission.rng(4)), found.resolution_m, found.origin)
        mission.log("  fault: the map is shifted, and has objects that are not there")
    known = mission.known
    known.map = known.map_now = found
    known.pose, mission.mapper, mission.platform = mapper.pose, mapper, platform
    mission.spent(platform.t_s)
    if lost > 0.2 * len(poses):
        return failed(f"{lost} of {len(poses)} scans do not fit the map built from them")
    if mission.memory is not None:
        mission.memory.store_map(RememberedMap(found, known.goal_m, mapper.pose, mapper.mean_hits_m()))
    sigma_m = math.sqrt(float(np.max(np.diag(mapper.matches[-1].covariance)[:2])))
    table = Claim("place", "table", known.goal_m, house.table_m, sigma=max(sigma_m, SEEN_SIGMA_M))
    return done(
        f"{len(poses)} scans along {STEP_M * len(poses):.0f} m make a map of "
        f"{found.size_m[0]:.1f} m x {found.size_m[1]:.1f} m",
        table,
        Claim("place", "platform", mapper.pose[:2], platform.pose[:2], sigma=max(sigma_m, SEEN_SIGMA_M)),
        Measure("position error after the round, by the map [m]", off_m),
        Measure("position error after the round, by odometry alone [m]", drift_m),
        Measure("free cells that are truly free [%]", 100 * right),
        Measure("occupied cells with nothing within 10 cm [%]", 100 * wrong),
        _map_picture(
            found,
            np.array(path_m),
            {},
            "The map made by the laser, and the path of the tour by scan matching: to the table and back",
        ),
    )


def _recall_the_map(mission: Mission, recalled: RememberedMap) -> ChapterResult:
    """The map of an earlier visit, if it matches the laser scan at the start."""
    known, house = mission.known, mission.house
    known.map = known.map_now = recalled.grid
    known.goal_m, known.pose = recalled.goal_m, recalled.home
    mission.platform = GuidedPlatform(house, house.start, mission.rng(2), mission.rng(3))
    mission.mapper = OccupancyMapper.from_map(
        recalled.grid, recalled.home, mission.platform.odometry(), hits_m=recalled.hits_m
    )
    return done(
        "the map of an earlier visit fits the laser scan",
        Claim("place", "table", known.goal_m, house.table_m, sigma=SEEN_SIGMA_M),
    )


def _pose(values: Sequence[float]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def find_the_door_blocked(mission: Mission) -> ChapterResult:
    """Drive towards the table until a new obstacle blocks the path, and observe it from several positions.

    Parameters
    ----------
    mission
        Mission with the map of the tour; receives the laser points of each object.
    """
    known, grid = mission.known, mission.known.map
    mission.platform.see(world_map(mission))
    plan = without_pushing(_problem(mission, grid))
    if not plan.reachable:
        return failed(f"on the map of the first round there is no path to the table: {plan.reason}")
    mission.log(f"  on the map the path to the table is free: {plan.length_m:.1f} m, {plan.cost_s:.0f} s")
    for turn in (0.5, -0.5, 0.0) if mission.attempt else ():
        _look_from(mission, compose_2d(known.pose, (0.0, 0.0, turn * math.pi)))
    if fit_fraction(mission, grid, mission.platform.pose, known.pose) < MIN_FIT:
        return failed("the laser scan does not fit the map: the pose of the platform is unknown")
    path = _path(grid, [known.pose[:2], known.goal_m], ROBOT.radius_m)
    since_s = mission.platform.t_s
    groups = _drive_until_blocked(mission, path)
    mission.spent(mission.platform.t_s - since_s)
    near = [one for one in groups if _distance(one, path) < BESIDE_M]
    known.map_now = mark_points(grid, groups)
    blocked = without_pushing(_problem(mission, known.map_now))
    if blocked.reachable:
        return done(f"no new object blocks the path, {len(groups)} near it")
    known.ahead_rad = heading_across(near, path, grid)
    near = join_sides(near, known.ahead_rad)
    known.obstacle_points_m = tuple(near)
    for one in near:
        (x, y), wide = near_side(one, known.ahead_rad)
        mission.log(f"  new object at ({x:.2f}, {y:.2f}) m, {100 * wide:.0f} cm wide as observed")
    return done(
        f"{len(near)} objects block every path to the table",
        *(_place_claim(mission, one) for one in near),
        Measure("new objects that block the path", len(near)),
        _map_picture(
            known.map_now,
            path[:, :2],
            {f"new {k + 1}": _box(one) for k, one in enumerate(near)},
            "The planned path to the table on the map, and the new objects that block it",
        ),
    )


def _drive_until_blocked(mission: Mission, path: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, "k 2"]]:
    """Groups of new points along the path; the platform stops before the first that blocks it."""
    grid = mission.known.map
    seen: list[Float[np.ndarray, "k 2"]] = []
    groups: list[Float[np.ndarray, "k 2"]] = []
    for pose in path:
        seen.append(_look_from(mission, _pose(pose)))
        groups = new_objects(grid, np.concatenate(seen[-10:]))
        ahead = [one for one in groups if _distance(one, path) < BESIDE_M]
        gap = min((float(np.hypot(*(one - pose[:2]).T).min()) for one in ahead), default=math.inf)
        if gap < LOOK_M:
            break
    else:
        return groups
    marked = mark_points(grid, groups)
    here = mission.known.pose
    for aside in np.linspace(-ASIDE_M, ASIDE_M, 7):
        place = compose_2d(here, (0.0, float(aside), 0.0))
        # A metre of the map is sufficient to check the clearance.
        if not without_pushing(
            PlanningProblem(marked, ROBOT, np.array(here[:2]), np.array(place[:2]))
        ).reachable:
            continue
        seen.append(_look_from(mission, place))
    _look_from(mission, here)
    return new_objects(grid, np.concatenate(seen))


def _look_from(mission: Mission, pose: tuple[float, float, float]) -> Float[np.ndarray, "k 2"]:
    """Drive to a pose of the map, compute the true pose, and scan: hits in the map frame."""
    platform, mapper = mission.platform, mission.mapper
    platform.go(relative_2d(mission.known.pose, pose))
    scan = platform.scan()
    mapper.locate(scan, platform.odometry())
    mission.known.pose = mapper.pose
    x, y, heading = mapper.pose
    return scan.points_m @ rotation_2d(heading).T + (x, y)


def _distance(group: Float[np.ndarray, "k 2"], path: Float[np.ndarray, "n 3"]) -> float:
    return float(np.hypot(*(group[:, None] - path[None, :, :2]).transpose(2, 0, 1)).min())


def _place_claim(mission: Mission, group: Float[np.ndarray, "k 2"]) -> Claim:
    """Centre of an object from its laser points, compared with the nearest true one."""
    true = nearest_obstacle(mission, group.mean(axis=0))
    x, y, _ = mission.placed[true.name]
    front, width = near_side(group, mission.known.ahead_rad)
    # Only the near side is visible: an object is assumed to be as deep as it is wide, +- half of that. Its centre
    # has an error of half of the depth's deviation, 1 / sqrt(12) of the width, along one of two axes.
    value = front + 0.5 * width * rotation_2d(mission.known.ahead_rad)[:, 0]
    sigma = math.hypot(SEEN_SIGMA_M, 0.5 * width / math.sqrt(12.0) / math.sqrt(2.0))
    return Claim("place", true.name, (float(value[0]), float(value[1])), (x, y), sigma=sigma)


def nearest_obstacle(mission: Mission, point_m: Float[np.ndarray, "2"]) -> SimulatedObstacle:
    """The true obstacle at a point of the map, from the simulated world.

    Parameters
    ----------
    mission
        Mission with the poses of all obstacles.
    point_m
        Observed point [m].
    """
    return min(
        mission.house.obstacles, key=lambda one: math.dist(mission.placed[one.name][:2], tuple(point_m))
    )


def fit_fraction(
    mission: Mission,
    grid: OccupancyMap,
    true_pose: tuple[float, float, float],
    estimated_pose: tuple[float, float, float],
) -> float:
    """Fraction of a scan's hits that are close to occupied cells of the map, without objects in the door.

    Parameters
    ----------
    mission
        For the noise of the laser.
    grid
        The robot's map.
    true_pose
        True pose of the platform: x, y [m], heading [rad].
    estimated_pose
        Estimated pose.
    """
    scan = GuidedPlatform(mission.house, true_pose, mission.rng(5), mission.rng(6)).scan()
    return scan_fit(grid, scan.points_m @ rotation_2d(estimated_pose[2]).T + estimated_pose[:2])


def _problem(
    mission: Mission, grid: OccupancyMap, objects: tuple[MovableObject, ...] = ()
) -> PlanningProblem:
    known = mission.known
    return PlanningProblem(grid, ROBOT, np.array(known.pose[:2]), np.array(known.goal_m), objects)


def _map_picture(
    grid: OccupancyMap, path_m: Float[np.ndarray, "n 2"], outlines_m: Mapping[str, np.ndarray], caption: str
) -> Illustration:
    """A map with a path that ends at the platform, and the named outlines of objects."""
    from ..report.floor_chart import MapObject, floor_map

    objects = [MapObject(name, outline) for name, outline in outlines_m.items()]
    x, y, _ = grid.origin
    figure = floor_map(
        grid.cells, grid.resolution_m, (x, y), path_world_m=path_m, objects=objects,
        robot_radius_m=ROBOT.radius_m,
    )  # fmt: skip
    return Illustration(figure, caption)


def _box(points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "4 2"]:
    (x0, y0), (x1, y1) = points.min(axis=0) - 0.01, points.max(axis=0) + 0.01
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def default_map(mission: Mission) -> None:
    """The true floor instead of a measured map."""
    house, known = mission.house, mission.known
    grid = house.grid
    if mission.fault is FaultKind.WRONG_MAP:
        grid = OccupancyMap(wrong_map(grid.cells, mission.rng(4)), grid.resolution_m, grid.origin)
    known.map = known.map_now = grid
    known.goal_m, known.pose = house.table_m, house.start
    mission.platform = GuidedPlatform(house, house.start, mission.rng(2), mission.rng(3))
    mission.mapper = OccupancyMapper.from_map(grid, house.start, mission.platform.odometry())


def default_door(mission: Mission) -> None:
    """True positions of the obstacles."""
    known, house = mission.known, mission.house
    path = _path(house.grid, [house.start[:2], house.table_m], ROBOT.radius_m)
    outlines = [outline_m(mission, one) for one in house.obstacles]
    near = [one for one in outlines if _distance(one, path) < BESIDE_M]
    known.obstacle_points_m, known.ahead_rad = tuple(near), heading_across(near, path, house.grid)
