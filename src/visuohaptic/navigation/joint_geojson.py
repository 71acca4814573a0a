"""The joint graph as GeoJSON for the Nav2 route server: nodes, edges, costs, push and door operations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..files import write_text
from .geojson import _feature
from .joint_graph import JointGraph

__all__ = ["save_joint_route_graph"]


def save_joint_route_graph(path: Path | str, joint: JointGraph, *, frame: str = "map") -> None:
    """Write visual and added nodes with edges in both directions.

    An edge into an added node carries the operation of its local planner,
    triggered on entering; edges that cannot be driven are left out.
    """
    grid = joint.regions.layers.map
    features: list[dict[str, Any]] = []
    places = [joint.visual.node_m]
    for node in joint.added:
        centre = (
            node.kind.outline_m.mean(axis=0)[None]
            if node.cell[0] < 0
            else grid.world_from_cell(np.array([node.cell]))
        )
        places.append(centre)
    points = np.concatenate(places)
    by_number = {node.number: node for node in joint.added}
    for number, (x, y) in enumerate(points):
        properties: dict[str, Any] = {"id": number, "frame": frame}
        if number in by_number:
            kind = by_number[number].kind
            properties["metadata"] = {"object": kind.id, "planner": kind.planner}
        features.append(_feature("Point", [float(x), float(y)], properties))
    number = len(points)
    ends, costs = joint.edges()
    for (a, b), cost in zip(ends.tolist(), costs.tolist(), strict=True):
        if a == b or not np.isfinite(cost):
            continue
        for start, end in ((a, b), (b, a)):
            properties = {"id": number, "startid": start, "endid": end, "cost": cost, "overridable": True}
            if end in by_number and by_number[end].task_s > 0:
                node = by_number[end]
                properties["operations"] = {
                    node.kind.planner.replace(" ", "_"): {
                        "type": node.kind.planner.title().replace(" ", ""),
                        "trigger": "ON_ENTER",
                        "metadata": {
                            "object": node.kind.id,
                            "seconds": float(node.task_s),
                            "failure_probability": float(node.kind.failure_probability(joint.robot)),
                        },
                    }
                }
            line = [[float(v) for v in points[start]], [float(v) for v in points[end]]]
            features.append(_feature("MultiLineString", [line], properties))
            number += 1
    data = {"type": "FeatureCollection", "name": Path(path).stem, "features": features}
    write_text(path, json.dumps(data, allow_nan=False) + "\n")
