"""``visuohaptic map graph``: compute costmap layers, graph and regions of a map.

reads   a map_server YAML file with its image
writes  into the folder: distance_m, cost_s_per_m, reachable, regions, potential_s (PNG with YAML),
        graph.geojson (nodes and the path of every edge), route_graph.geojson (for the Nav2 route server:
        edges are split until every straight segment keeps the radius away from the walls), with --objects
        joint_graph.geojson (adds nodes for objects, doors and elevators) and two masks for Nav2 (map_server files):
        keepout.yaml (objects that cannot be pushed), felt_obstacles.yaml (1 to 99 by the failure probability of a
        push, 100 where none succeeds), and with --plot navigation.png

example: visuohaptic map graph office.yaml --radius 0.17 --out office_graph --plot
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .... import io
from ....core.errors import InputError
from ....io import maps
from ....navigation import files, planning, plots, problem

if TYPE_CHECKING:
    from ....navigation.grid.cost_grid import SpeedLimits


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("map", Path, "map_server YAML file")
    add("--radius", float, "radius of the robot [m]", required=True, dest="radius_m")
    add("--out", Path, "folder to write to, created if necessary", required=True)
    add("--v-max", 0.3, "speed far from obstacles [m/s]", dest="v_max_m_s")
    add("--v-min", 0.05, "speed at obstacles [m/s]", dest="v_min_m_s")
    add("--spacing", float, "keep connection nodes at this spacing [m]", dest="spacing_m")
    add("--stub", float, "remove dead ends shorter than this [m]", dest="stub_length_m")
    add("--objects", Path, "objects.yaml: movable objects, passages and glass")
    add("--route", float, "also compute the path from one point to another [m]", metavar="X Y X Y")
    add("--frame", "map", "name of the map frame in the files")
    add("--plot", bool, "also write a plot like figure 4.1")
    add("--unknown-is-free", bool, "treat unknown cells as free")


def run(args: Any) -> dict[str, Any]:
    """Build and write; returns the mapping that ``--json`` prints."""
    from ....navigation.graph import assign_regions, build_graph
    from ....navigation.grid.cost_grid import SpeedLimits, grid_layers
    from .map_inspect import describe

    grid = io.OccupancyMap.load(args.map)
    limits = SpeedLimits(args.radius_m, args.v_max_m_s, args.v_min_m_s)
    layers = grid_layers(grid, limits, unknown_is_free=args.unknown_is_free)
    graph = build_graph(layers, stub_length_m=args.stub_length_m, spacing_m=args.spacing_m)
    regions = assign_regions(layers, graph)
    folder: Path = args.out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be created ({error.strerror})") from error
    written = []
    for name, values, unit in (
        ("distance_m", layers.distance_m, "m"),
        ("cost_s_per_m", layers.cost_s_per_m, "s/m"),
        ("reachable", layers.reachable, "1"),
        ("regions", regions.node, "1"),
        ("potential_s", regions.potential_s, "s"),
    ):
        files.save_layer(folder / f"{name}.yaml", values, grid, name=name, unit=unit)
        written.append(f"{name}.yaml")
    files.save_graph(folder / "graph.geojson", graph, grid, frame=args.frame)
    files.save_route_graph(folder / "route_graph.geojson", graph, layers, frame=args.frame)
    written += ["graph.geojson", "route_graph.geojson"]
    if args.objects is not None:
        import numpy as np

        robot = problem.RobotModel(args.radius_m, args.v_max_m_s, args.v_min_m_s)
        objects = problem.load_objects(args.objects)
        nodes = problem.nodes_of(objects, problem.load_passages(args.objects), robot)
        joint = planning.extend_graph(graph, regions, robot, nodes)
        files.save_joint_route_graph(folder / "joint_graph.geojson", joint, frame=args.frame)
        written.append("joint_graph.geojson")
        felt = files.felt_obstacles(grid, objects, robot)
        for name, cells in (
            ("felt_obstacles", felt),
            ("keepout", np.where(felt == maps.OCCUPIED, felt, maps.FREE)),
        ):
            io.OccupancyMap(cells.astype(np.int8), grid.resolution_m, grid.origin).save(
                folder / f"{name}.yaml"
            )
            written.append(f"{name}.yaml")
    result = {"map": str(args.map), **describe(layers, graph), "folder": str(folder), "written": written}
    if args.route is not None:
        result["route"] = _route(grid, limits, args.route, args.unknown_is_free)
    if args.plot:
        from ....core.files import save_figure

        save_figure(folder / "navigation.png", plots.plot_navigation(regions), dpi=130)
        written.append("navigation.png")
    return result


def _route(
    grid: io.OccupancyMap, limits: SpeedLimits, ends_m: list[float], unknown_is_free: bool
) -> dict[str, Any]:
    """The path of the planner from one point to another."""
    import numpy as np

    if unknown_is_free:
        cells = np.where(grid.cells < 0, maps.FREE, grid.cells).astype(np.int8)
        grid = io.OccupancyMap(cells, grid.resolution_m, grid.origin)
    robot = problem.RobotModel(limits.radius_m, limits.v_max_m_s, limits.v_min_m_s)
    plan = planning.without_pushing(
        problem.PlanningProblem(grid, robot, np.array(ends_m[:2]), np.array(ends_m[2:]))
    )
    if not plan.reachable:
        return {"reachable": False, "reason": plan.reason}
    path = [[round(x, 3), round(y, 3)] for task in plan.tasks for x, y in task.path_m]
    return {"reachable": True, "cost_s": plan.cost_s, "length_m": plan.length_m, "path_m": path}
