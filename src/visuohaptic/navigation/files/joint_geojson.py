"""The joint graph as GeoJSON for the Nav2 route server: nodes, edges, costs, push and door operations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..planning.joint_graph import JointGraph
from .geojson import write_route
from .route_edges import route_pieces, task_pieces


def save_joint_route_graph(path: Path | str, joint: JointGraph, *, frame: str = "map") -> None:
    """Write the joint graph for the Nav2 route server: visual and added nodes, edges in both directions.

    Edges are split until their straight lines keep the robot's radius, as in
    :func:`~visuohaptic.navigation.files.geojson.save_route_graph`; those of an added node with its own object taken
    away, because its task clears them. Half of the task's time is on each piece at the node.
    An edge into an added node contains the operation of its local planner,
    triggered on entering; edges that cannot be driven are omitted.

    Parameters
    ----------
    path
        File name.
    joint
        The graph.
    frame
        Name of the coordinate frame.
    """
    grid = joint.regions.layers.map
    places = [joint.visual.node_m]
    for node in joint.added:
        inside = node.cell[0] >= 0
        place = grid.world_from_cell(np.array(node.cell)) if inside else node.kind.outline_m.mean(axis=0)
        places.append(place[None])
    route = route_pieces(joint.visual, joint.regions.layers)
    # Numbers of added nodes come before those of the cells where edges are split.
    pieces = np.where(route.ends < joint.visual.nodes, route.ends, route.ends + len(joint.added))
    tasks = task_pieces(joint, joint.visual.nodes + len(joint.added) + len(route.cells))
    points = np.concatenate([*places, *(grid.world_from_cell(part.cells) for part in (route, tasks))])
    objects = {node.number: {"object": node.kind.id, "planner": node.kind.planner} for node in joint.added}
    operations = {
        node.number: {
            node.kind.planner.replace(" ", "_"): {
                "type": node.kind.planner.title().replace(" ", ""),
                "trigger": "ON_ENTER",
                "metadata": {
                    "object": node.kind.id,
                    "seconds": float(node.task_s),
                    "failure_probability": float(node.kind.failure_probability),
                },
            }
        }
        for node in joint.added
        if node.task_s > 0
    }
    driven = np.where(np.isfinite(joint.edges()[1][route.edge]), route.measures[:, 0], np.inf)
    ends, costs = (np.concatenate(both) for both in ((pieces, tasks.ends), (driven, tasks.measures[:, 0])))
    passed = np.isfinite(costs)
    write_route(path, frame, points, ends[passed], costs[passed, None], objects, operations)
