"""The floor of the mission: the mapping tour with the laser, and the path to the table that is blocked today."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

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
from ..report.floor_chart import MapObject
from ..rigs.virtual_office import ROBOT
from ..simulation.faults import FaultKind, wrong_map
from ..simulation.houses.guided_platform import GuidedPlatform
from ..simulation.mobile.laser import with_outlines
from ..simulation.mobile.obstacles import ObstacleKind, SimulatedObstacle
from ..tasks.manipulation.hand import as_vector
from ..tasks.memory import RememberedMap
from ..tasks.mobile.doorway_objects import doorways, heading_across, join_sides
from ..tasks.mobile.floor_outline import SIDE_M, FloorOutline, fit_outlines
from ..tasks.mobile.travel import expected_duration_s, map_with_footprints
from .judge import Claim
from .results import ChapterResult, Illustration, Measure, counted, done, failed
from .story import Mission

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
    outlines_m = [outline_m(mission, one) for one in mission.house.obstacles]
    return with_outlines(mission.house.fine_grid(), outlines_m)


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
        first, last = (grid_from_world(grid, np.array(one)) for one in (start, end))
        path, _ = pull_string(world, still, first, last)
        parts.append(world_from_grid(grid, path))
    path_m = np.concatenate(parts)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    keep = np.concatenate([[True], np.diff(along) > 1e-9])
    at = np.arange(0.0, along[-1], STEP_M)
    points = np.column_stack([np.interp(at, along[keep], one) for one in path_m[keep].T])
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
    platform = GuidedPlatform(house, as_vector(poses[0]), mission.rng(2), mission.rng(3))
    mapper = OccupancyMapper()
    served = int(np.hypot(*(poses[:, :2] - house.table_m).T).argmin())
    path_m = []
    for number, pose in enumerate([*poses, house.start]):
        platform.go(relative_2d(platform.pose, as_vector(pose)))
        mapper.add(platform.scan(), platform.odometry())
        path_m.append(mapper.pose[:2])
        if number == served:
            mission.known.goal_m = mapper.pose[:2]
    found = mapper.map()
    off_m, drift_m = (math.dist(one[:2], platform.pose[:2]) for one in (mapper.pose, platform.odometry()))
    lost = sum(not match.valid for match in mapper.matches)
    right, wrong = map_agreement(found, house.grid)
    if mission.fault is FaultKind.WRONG_MAP:
        found = OccupancyMap(wrong_map(found.cells, mission.rng(4)), found.resolution_m, found.origin)
        mission.log("  fault: the map is shifted, and has objects that are not there")
    known = mission.known
    known.map = known.map_now = found
    known.pose, mission.mapper, mission.platform = mapper.pose, mapper, platform
    mission.record_cost(platform.t_s)
    if lost > 0.2 * len(poses):
        return failed(f"{lost} of {len(poses)} scans do not fit the map built from them")
    if mission.memory is not None:
        mission.memory.store_map(RememberedMap(found, known.goal_m, mapper.pose, mapper.mean_hits_m()))
    sigma_m = max(math.sqrt(float(np.max(np.diag(mapper.matches[-1].covariance)[:2]))), SEEN_SIGMA_M)
    return done(
        f"{len(poses)} scans along {STEP_M * len(poses):.0f} m make a map of "
        f"{found.size_m[0]:.1f} m x {found.size_m[1]:.1f} m",
        Claim("place", "table", known.goal_m, house.table_m, sigma=sigma_m),
        Claim("place", "platform", mapper.pose[:2], platform.pose[:2], sigma=sigma_m),
        Measure("position error after the round, by the map [m]", off_m),
        Measure("position error after the round, by odometry alone [m]", drift_m),
        Measure("free cells that are truly free [%]", 100 * right),
        Measure("occupied cells with nothing within 10 cm [%]", 100 * wrong),
        map_picture(
            found,
            np.array(path_m),
            (),
            "The map made by the laser, and the path of the tour by scan matching: to the table and back",
        ),
    )


def _recall_the_map(mission: Mission, recalled: RememberedMap) -> ChapterResult:
    """The map of an earlier visit, if it matches the laser scan at the start."""
    _start_with(mission, recalled)
    return done(
        "the map of an earlier visit fits the laser scan",
        Claim("place", "table", recalled.goal_m, mission.house.table_m, sigma=SEEN_SIGMA_M),
    )


def _start_with(mission: Mission, given: RememberedMap) -> None:
    """Map, goal and pose that are known before the start."""
    known, house = mission.known, mission.house
    known.map = known.map_now = given.grid
    known.goal_m, known.pose = given.goal_m, given.home
    mission.platform = GuidedPlatform(house, house.start, mission.rng(2), mission.rng(3))
    mission.mapper = OccupancyMapper.from_map(
        given.grid, given.home, mission.platform.odometry(), hits_m=given.hits_m
    )


def find_the_door_blocked(mission: Mission) -> ChapterResult:
    """Drive towards the table until a new obstacle blocks the path, and observe it from several positions.

    Parameters
    ----------
    mission
        Mission with the map of the tour; receives the laser points of each object.
    """
    known, grid = mission.known, mission.known.map
    mission.platform.see(world_map(mission))
    problem = route_problem(mission, grid)
    plan = without_pushing(problem)
    if not plan.reachable:
        return failed(f"on the map of the first round there is no path to the table: {plan.reason}")
    seconds = expected_duration_s(plan, problem, known.pose[2])
    mission.log(f"  on the map the path to the table is free: {plan.length_m:.1f} m, {seconds:.0f} s")
    for turn in (0.5, -0.5, 0.0) if mission.attempt else ():
        _look_from(mission, compose_2d(known.pose, (0.0, 0.0, turn * math.pi)))
    if fit_fraction(mission, grid, mission.platform.pose, known.pose) < MIN_FIT:
        return failed("the laser scan does not fit the map: the pose of the platform is unknown")
    path = _path(grid, [known.pose[:2], known.goal_m], ROBOT.radius_m)
    since_s = mission.platform.t_s
    groups, views_m = _drive_until_blocked(mission, path)
    mission.record_cost(mission.platform.t_s - since_s)
    near, known.obstacles = [one for one in groups if _distance(one, path) < BESIDE_M], ()
    known.map_now = mark_points(grid, groups)
    blocked = without_pushing(route_problem(mission, known.map_now))
    if blocked.reachable:
        return done(f"no new object blocks the path, {len(groups)} near it")
    for row in doorways(near, 2 * ROBOT.radius_m):
        ahead_rad = heading_across(row, path)
        for points_m in join_sides(row, ahead_rad):
            one, other = fit_outlines(points_m, views_m, ahead_rad)
            known.obstacles += ((one, other),)
            (x, y), turned = one.centre_m, math.degrees(one.pose[2] - ahead_rad)
            shape = "round" if one.round else f"a box turned by {round(turned)}°"
            mission.log(f"  new object at ({x:.2f}, {y:.2f}) m, {100 * one.size_m[0]:.0f} cm wide, {shape}")
    claims = [_place_claim(mission, one) for one, _ in known.obstacles]
    return done(
        f"{counted(len(known.obstacles), 'object blocks', 'objects block')} every path to the table",
        *claims,
        Measure("new objects that block the path", len(known.obstacles)),
        map_picture(
            known.map_now,
            path[:, :2],
            [
                MapObject(its.what, one.corners_m)
                for its, (one, _) in zip(claims, known.obstacles, strict=True)
            ],
            "The planned path to the table on the map, and the new objects that block it",
        ),
    )


def _drive_until_blocked(
    mission: Mission, path: Float[np.ndarray, "n 3"]
) -> tuple[list[Float[np.ndarray, "k 2"]], Float[np.ndarray, "v 2"]]:
    """Groups of new points along the path, up to the first one that blocks it, and the positions of the scans."""
    grid = mission.known.map
    seen: list[Float[np.ndarray, "k 2"]] = []
    views: list[tuple[float, float]] = []
    groups: list[Float[np.ndarray, "k 2"]] = []
    for pose in path:
        seen.append(_look_from(mission, as_vector(pose)))
        views.append(mission.known.pose[:2])
        groups = new_objects(grid, np.concatenate(seen[-10:]))
        ahead = [one for one in groups if _distance(one, path) < BESIDE_M]
        gap = min((float(np.hypot(*(one - pose[:2]).T).min()) for one in ahead), default=math.inf)
        if gap < LOOK_M:
            break
    else:
        return groups, np.array(views)
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
        views.append(mission.known.pose[:2])
    _look_from(mission, here)
    return new_objects(grid, np.concatenate(seen)), np.array(views)


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


def _place_claim(mission: Mission, outline: FloorOutline) -> Claim:
    """Centre of an object, compared with the nearest true one."""
    true, (x, y) = mission.nearest_obstacle(outline.centre_m), outline.centre_m
    # Half of the error of the depth, along one of two axes.
    sigma = math.hypot(SEEN_SIGMA_M, 0.5 * outline.sigma_m[1] / math.sqrt(2.0))
    return Claim("place", true.name, (float(x), float(y)), mission.placed[true.name][:2], sigma=sigma)


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
    true_pose, estimated_pose
        True and estimated pose of the platform: x, y [m], heading [rad].
    """
    scan = GuidedPlatform(mission.house, true_pose, mission.rng(5), mission.rng(6)).scan()
    return scan_fit(grid, scan.points_m @ rotation_2d(estimated_pose[2]).T + estimated_pose[:2])


def route_problem(
    mission: Mission, grid: OccupancyMap, objects: Sequence[MovableObject] = ()
) -> PlanningProblem:
    """The way from the platform to the table.

    Parameters
    ----------
    mission
        Mission with pose and goal.
    grid, objects
        Map, to which the footprints of the objects are added.
    """
    known, occupied = mission.known, map_with_footprints(grid, [item.footprint_m for item in objects])
    return PlanningProblem(occupied, ROBOT, np.array(known.pose[:2]), np.array(known.goal_m), tuple(objects))


def map_picture(
    grid: OccupancyMap, path_m: Float[np.ndarray, "n 2"], objects: Sequence[MapObject], caption: str
) -> Illustration:
    """A map with a path that ends at the platform, and objects.

    Parameters
    ----------
    grid
        The map.
    path_m
        The path [m].
    objects
        Objects with their outlines.
    caption
        Of the illustration.
    """
    from ..report.floor_chart import floor_map

    figure = floor_map(
        grid.cells, grid.resolution_m, grid.origin[:2], path_world_m=path_m, objects=objects,
        robot_radius_m=ROBOT.radius_m,
    )  # fmt: skip
    return Illustration(figure, caption)


def default_map(mission: Mission) -> None:
    """The true floor instead of a measured map.

    Parameters
    ----------
    mission
        State of the mission; what the chapter would have found is set.
    """
    house, grid = mission.house, mission.house.grid
    if mission.fault is FaultKind.WRONG_MAP:
        grid = OccupancyMap(wrong_map(grid.cells, mission.rng(4)), grid.resolution_m, grid.origin)
    _start_with(mission, RememberedMap(grid, house.table_m, house.start))


def default_door(mission: Mission) -> None:
    """True positions of the obstacles.

    Parameters
    ----------
    mission
        State of the mission; what the chapter would have found is set.
    """
    house, obstacles = mission.house, []
    path = _path(house.grid, [house.start[:2], house.table_m], ROBOT.radius_m)
    for one in house.obstacles:
        if _distance(outline_m(mission, one), path) < BESIDE_M:
            pose = compose_2d(mission.placed[one.name], (-0.5 * one.length_m, 0.0, 0.0))
            size_m, is_round = (one.width_m, one.length_m), one.kind is ObstacleKind.CYLINDER
            outline = FloorOutline(is_round, pose, size_m, (SIDE_M, SIDE_M))
            obstacles.append((outline, outline))
    mission.known.obstacles = tuple(obstacles)
