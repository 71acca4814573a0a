"""Scenes on windows of real maps: movable obstacles on the path, their tags, and true properties that differ from the tags."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from visuohaptic.core import Estimate, HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import without_pushing
from visuohaptic.navigation.planning.object_cells import fill_cells
from visuohaptic.navigation.planning.search import build_search_domain, grid_from_world, world_from_grid
from visuohaptic.navigation.planning.search.drives import pull_string
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.navigation.pushing import PushModel
from visuohaptic.simulation.floor import FloorObject

ROBOT = RobotModel(0.17)
SEED = 20261122
WINDOW_M = 12.0
#: Relative standard deviation of friction between tag and truth; of the centre of mass about the centroid (m).
FRICTION_SPREAD, CENTRE_SPREAD_M = 0.15, 0.02
FLOOR_FRICTION = 0.3
#: Maximum number of movable objects.
MAX_OBJECTS = 10
#: So many scenes have no way without a push; the others may have one.
BLOCKED_SHARE = 0.75

#: Maps that have rooms and passages, and the resolution of those without YAML [m].
MAPS: tuple[tuple[str, float | None], ...] = (
    ("aws_small_house/map.yaml", None),
    ("cob_ipa_apartment/map.yaml", None),
    ("freiburg/freiburg_building101.png", 0.05),
    ("freiburg/freiburg_building52.png", 0.05),
    ("giraff_homes/Sarmis2_map_adj.yaml", None),
    ("giraff_homes/UMA_236_237.yaml", None),
    ("giraff_homes/movecare_map.yaml", None),
    ("intel_lab/intel.yaml", None),
    ("nav2/depot.yaml", None),
    ("strands_tsc_y4/tsc_1701.yaml", None),
    ("strands_umic/UMIC_FF.yaml", None),
    ("tuw_freihaus_eg", None),
    ("ut_gdc_1", None),
    ("ut_gdc_3/3.yaml", None),
    ("willow_garage/willow-full-0.05.pgm", 0.05),
    ("wpi_rail", None),
)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One problem as given to the planner, and its ground truth."""

    index: int
    name: str  #: of the map
    problem: PlanningProblem  #: tags as they were once observed
    truth: PlanningProblem  #: tags that say how it is
    walls: OccupancyMap
    items: tuple[FloorObject, ...]
    heading_rad: float


def make_scene(folder: Path, index: int) -> Scene:
    """Scene of a number; deterministic."""
    rng = np.random.default_rng([SEED, index])
    names = _maps(folder)
    blocked = bool(rng.random() < BLOCKED_SHARE)
    for _ in range(2000):
        name = names[int(rng.integers(len(names)))]
        scene = _attempt(folder, name, index, rng)
        if scene is None or (blocked and without_pushing(larger(scene.problem)).reachable):
            continue
        return scene
    raise RuntimeError(f"no scene {index} after 2000 attempts")


def larger(problem: PlanningProblem) -> PlanningProblem:
    """The problem of a disc among squares: walls begin half a cell before the centres of their cells."""
    robot = problem.robot
    return replace(problem, robot=replace(robot, radius_m=robot.radius_m + 0.5 * problem.map.resolution_m))


@cache
def _maps(folder: Path) -> tuple[str, ...]:
    found = []
    for name, _ in MAPS:
        path = folder / name
        paths = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
        found += [str(p.relative_to(folder)) for p in paths if p.exists() and "door" not in p.name]
    return tuple(found)


@cache
def _load(folder: Path, name: str) -> OccupancyMap | None:
    resolution = dict(MAPS).get(name)
    try:
        if resolution is not None:
            return OccupancyMap.from_image(folder / name, resolution)
        return OccupancyMap.load(folder / name)
    except ValueError:
        return None


def _attempt(folder: Path, name: str, index: int, rng: np.random.Generator) -> Scene | None:
    grid = _load(folder, name)
    if grid is None:
        return None
    walls = _window(grid, rng)
    if walls is None:
        return None
    ends = _ends(walls, rng)
    if ends is None:
        return None
    start, goal, way = ends
    outlines = _places(walls, start, goal, way, rng)
    if not outlines:
        return None
    objects, true_objects, items = [], [], []
    for number, (outline, round_m) in enumerate(outlines):
        item, tag, true_tag = _thing(f"thing{number}", outline, round_m, rng)
        items.append(item)
        objects.append(MovableObject(item.id, outline, tag))
        true_objects.append(MovableObject(item.id, outline, true_tag))
    told = with_things(walls, objects)
    problem = PlanningProblem(told, ROBOT, start, goal, tuple(objects))
    truth = replace(problem, objects=tuple(true_objects))
    heading = float(rng.uniform(-math.pi, math.pi))
    return Scene(index, name, problem, truth, walls, tuple(items), heading)


def with_things(walls: OccupancyMap, objects: list[MovableObject]) -> OccupancyMap:
    """The map with the objects' cells occupied."""
    filled = np.zeros(walls.shape, dtype=bool)
    for item in objects:
        fill_cells(filled, grid_from_world(walls, item.footprint_m))
    cells = walls.cells.copy()
    cells[filled] = 100
    return OccupancyMap(cells, walls.resolution_m, walls.origin)


def _window(grid: OccupancyMap, rng: np.random.Generator) -> OccupancyMap | None:
    size = round(WINDOW_M / grid.resolution_m)
    free = np.argwhere(grid.cells == 0)
    row, column = free[int(rng.integers(len(free)))]
    r0 = int(np.clip(row - size // 2, 0, max(grid.shape[0] - size, 0)))
    c0 = int(np.clip(column - size // 2, 0, max(grid.shape[1] - size, 0)))
    cells = grid.cells[r0 : r0 + size, c0 : c0 + size].copy()
    if (cells == 0).mean() < 0.1:
        return None
    # Unknown cells are obstacles for the robot; the border of the window is closed.
    cells[(cells != 0)] = 100
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    x, y, yaw = grid.origin
    c, s = math.cos(yaw), math.sin(yaw)
    dx, dy = c0 * grid.resolution_m, r0 * grid.resolution_m
    return OccupancyMap(cells, grid.resolution_m, (x + c * dx - s * dy, y + s * dx + c * dy, yaw))


def _ends(walls: OccupancyMap, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Start, goal, and the path between them without obstacles."""
    distance = grid_layers(walls, SpeedLimits(ROBOT.radius_m)).distance_m
    places = np.argwhere((distance >= 0.3) & (walls.cells == 0))
    if len(places) < 50:
        return None
    robot = replace(ROBOT, radius_m=ROBOT.radius_m + 0.05)
    for _ in range(10):
        one, other = places[rng.integers(len(places), size=2)]
        start, goal = walls.world_from_cell(one), walls.world_from_cell(other)
        if not 3.0 < np.hypot(*(goal - start)) < 10.0:
            continue
        world = build_search_domain(PlanningProblem(walls, robot, start, goal))
        path, _ = pull_string(world, np.zeros((0, 2)), world.start, world.goal)
        if len(path) < 2:
            continue
        corners = world_from_grid(walls, path)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        if along[-1] > 15.0:
            continue
        at = np.arange(0.0, along[-1], 0.05)
        way = np.column_stack([np.interp(at, along, corners[:, i]) for i in (0, 1)])
        return start, goal, way
    return None


def _places(
    walls: OccupancyMap, start: np.ndarray, goal: np.ndarray, way: np.ndarray, rng: np.random.Generator
) -> list[tuple[np.ndarray, float]]:
    """Outlines: the first at a narrow place of the path, the others on or near the path."""
    import shapely

    distance = grid_layers(walls, SpeedLimits(ROBOT.radius_m)).distance_m
    cells = walls.cell_from_world(way)
    clear = distance[cells[:, 0], cells[:, 1]]
    inside = (np.hypot(*(way - start).T) > 0.9) & (np.hypot(*(way - goal).T) > 0.9)
    if inside.sum() < 5:
        return []
    boxes = _cell_boxes(walls)
    tree = shapely.STRtree(boxes)
    placed: list[tuple[np.ndarray, float]] = []
    shapes: list[shapely.Polygon] = []
    for number in range(int(rng.integers(1, MAX_OBJECTS + 1))):
        for _ in range(60):
            candidates = np.flatnonzero(inside)
            if number == 0 or rng.random() < 0.5:  # at a narrow place
                narrow = candidates[np.argsort(clear[candidates])[: max(5, len(candidates) // 4)]]
                centre = way[rng.choice(narrow)] + rng.normal(0, 0.1, 2)
            else:
                centre = way[rng.choice(candidates)] + rng.normal(0, 0.6, 2)
            outline, round_m = _shape(rng)
            outline = outline + centre
            body = shapely.Polygon(outline)
            if any(body.distance(shapely.Point(*p)) < 0.45 for p in (start, goal)):
                continue
            if any(body.distance(other) < 0.03 for other in shapes):
                continue
            if len(tree.query(body.buffer(0.02), predicate="intersects")):
                continue
            placed.append((outline, round_m))
            shapes.append(body)
            break
    return placed


def _cell_boxes(walls: OccupancyMap) -> np.ndarray:
    import shapely

    rows, columns = np.nonzero(walls.cells >= 50)
    corners = np.stack(
        [np.column_stack([columns + u, rows + v]).astype(float) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))],
        axis=1,
    )
    return np.asarray(shapely.polygons(world_from_grid(walls, corners)))


def _shape(rng: np.random.Generator) -> tuple[Float[np.ndarray, "p 2"], float]:
    """Box, disc or convex polygon of 0.2 to 0.6 m about its centroid."""
    kind = int(rng.integers(3))
    if kind == 0:
        half = 0.5 * rng.uniform(0.2, 0.6, 2)
        outline = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        a = float(rng.uniform(-math.pi, math.pi))
        return outline @ np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]]), 0.0
    if kind == 1:
        radius = float(rng.uniform(0.1, 0.28))
        a = np.arange(16) * (2 * math.pi / 16)
        return radius * np.column_stack([np.cos(a), np.sin(a)]), radius
    corners = int(rng.integers(4, 8))
    a = (np.arange(corners) + rng.uniform(-0.25, 0.25, corners)) * (2 * math.pi / corners)
    outline = np.column_stack([np.cos(a), np.sin(a)]) * rng.uniform(0.12, 0.3, 2)
    turn = float(rng.uniform(-math.pi, math.pi))
    outline = outline @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return outline - MovableObject("shape", outline).centre_m, 0.0


def _thing(
    id: str, outline: np.ndarray, round_m: float, rng: np.random.Generator
) -> tuple[FloorObject, HapticTag | None, HapticTag]:
    """Physics, the observed tag, and the true tag."""
    kind = rng.random()
    told_N = float(rng.uniform(25.0, 45.0) if kind < 0.1 else rng.uniform(2.0, 18.0))
    true_N = max(0.5, told_N * (1.0 + FRICTION_SPREAD * float(rng.standard_normal())))
    centre = rng.normal(0.0, CENTRE_SPREAD_M, 2)
    item = FloorObject(
        id,
        outline,
        true_N / (9.81 * FLOOR_FRICTION),
        FLOOR_FRICTION,
        float(rng.uniform(0.1, 0.5)),
        (float(centre[0]), float(centre[1])),
        round_m,
    )
    fixed = true_N > ROBOT.push_force_max_N
    true_tag = HapticTag(
        static_friction_N=Estimate(true_N, 0.0),
        dynamic_friction_N=Estimate(true_N, 0.0),
        fixed=fixed,
        explored=5,
    )
    if kind > 0.9:
        return item, None, true_tag
    # Turn by H_R = b / (b^2 + c^2) of a push that passed the centre of mass by b (Sec. 4.3.1).
    beside = float(centre[1])
    lever = PushModel.patch(outline - MovableObject(id, outline).centre_m).lever_m
    turn = beside / (beside**2 + lever**2) + 0.1 * float(rng.standard_normal())
    tag = HapticTag(
        static_friction_N=Estimate(told_N, 0.03 * told_N, FRICTION_SPREAD * told_N),
        dynamic_friction_N=Estimate(0.95 * told_N, 0.03 * told_N, FRICTION_SPREAD * told_N),
        drift=Estimate(abs(float(rng.normal(0.0, 0.04))), 0.01, 0.03),
        rotation_rad_per_m=Estimate(turn, 0.1, CENTRE_SPREAD_M / lever**2),
        fixed=told_N > ROBOT.push_force_max_N,
        falls=False,
        explored=1,
    )
    return item, tag, true_tag
