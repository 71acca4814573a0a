"""Search domain of a planning problem: static obstacles, pushable bodies and passages."""

from __future__ import annotations

import numpy as np

from ....core.geometry import rotation_2d
from ...grid.cost_grid import OBSTACLE_FROM, cell_distance
from ...problem import MovableObject, Passage, PassageKind, PlanningProblem, is_door_wing
from ...problem.push_costs import Manipulability, PushCosts, manipulability
from ..object_cells import clear_cells
from ..place_costs import place_costs
from ._push_search_kernels import largest_in_blocks
from .bodies import OUTLINE_INSET_M, Body, grid_from_world, lower_clearance
from .push_states import full_speed_clearance, needed_clearance
from .search_domain import SearchDomain

#: Approximate number of lattice nodes (blocks of cells) per robot radius.
NODES_PER_RADIUS = 2.0
#: Maximum size of the lattice; a larger one is reduced to no less than one node per radius.
MAX_NODES = 500_000


def build_search_domain(
    problem: PlanningProblem, costs: PushCosts | None = None, *, block: int | None = None
) -> SearchDomain:
    """Separate a map into static obstacles and pushable bodies.

    Parameters
    ----------
    problem
        Map, objects and robot.
    costs
        Costs of pushes, and limits that decide which objects may be pushed.
    block
        Edge length of a node of the lattice [cells]; by default chosen for the robot's radius.
    """

    costs = costs or PushCosts()
    grid, robot = problem.map, problem.robot
    radius = robot.radius_m / grid.resolution_m
    # Unknown cells are obstacles, too: as unsigned numbers they are the largest.
    occupied = grid.cells.view(np.uint8) >= OBSTACLE_FROM
    movable: list[Body] = []
    fixed: list[MovableObject | Passage] = []
    drawn, closed, passages = [], [], []
    why: dict[str, str] = {}
    # Objects that rotate like a door wing when they are pushed.
    doors = [
        Passage(obj.id, obj.footprint_m, PassageKind.DOOR_PUSH, tag=obj.tag)
        for obj in problem.objects
        if obj.tag is not None and is_door_wing(obj.tag)
    ]
    for obj in problem.objects:
        if any(door.id == obj.id for door in doors):
            continue
        body = _body(problem, obj, costs)
        drawn.append(body.outline)
        if body.allowed.possible:
            movable.append(body)
        else:
            fixed.append(obj)
            why[obj.id] = body.allowed.reason
    for passage in (*problem.passages, *doors):
        outline = grid_from_world(grid, passage.footprint_m)
        closed.append(outline)
        cost = passage.cost(robot)
        if np.isfinite(cost.total_s):
            passages.append((passage, outline, cost.total_s))
        else:
            fixed.append(passage)
            why[passage.id] = cost.reason
    clear_cells(occupied, drawn, closed)
    # The outline defines the size of an object, whether it is movable or not.
    clearance = cell_distance(occupied, full_speed_clearance(radius))
    outlines = tuple(grid_from_world(grid, obj.footprint_m) for obj in fixed)
    for outline in outlines:
        lower_clearance(clearance, outline, full_speed_clearance(radius))
    block = block or _block(occupied.size, radius)
    return SearchDomain(
        problem, costs, grid, robot, needed_clearance(radius), robot.v_max_m_s / robot.v_min_m_s, occupied, clearance,
        tuple(movable), tuple(fixed), why, block,
        clearance if block == 1 else largest_in_blocks(clearance, block), outlines, tuple(passages),
        place_costs(problem, costs.on_route_s, occupied, outlines),
    )  # fmt: skip


def _body(problem: PlanningProblem, obj: MovableObject, costs: PushCosts) -> Body:
    """An object in grid coordinates, and whether the robot may push it."""
    grid, robot = problem.map, problem.robot
    resolution_m = grid.resolution_m
    allowed = manipulability(obj.tag, robot, costs)
    if allowed.possible and not robot.flat_front:
        allowed = Manipulability(
            False, 0.0, "the robot's footprint has no edge in front, perpendicular to its x axis"
        )
    return Body(
        obj,
        grid_from_world(grid, obj.footprint_m),
        grid_from_world(grid, obj.centre_m),
        np.array(obj.friction_offset_m) @ rotation_2d(grid.origin[2]) / resolution_m,
        allowed,
        robot.front_m / resolution_m,
        robot.push_margin_m / resolution_m,
        OUTLINE_INSET_M / resolution_m,
        np.array(robot.footprint_m) / resolution_m if robot.footprint_m else None,
    )


def _block(cells: int, radius: float) -> int:
    """Edge length of a node [cells] for a map with this number of cells and a robot radius [cells]."""
    large = min(int(np.ceil(np.sqrt(cells / MAX_NODES))), int(np.ceil(radius)))
    return max(1, round(radius / NODES_PER_RADIUS), large)
