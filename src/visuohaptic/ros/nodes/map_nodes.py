"""Nodes that use a map: common base, and the node that serves the map's graph and masks."""

from __future__ import annotations

import json
import threading
from abc import abstractmethod
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import Field

from ...core import DeviceError, InputError, VisuohapticError, parse_yaml, to_dict
from ...core.files.plain_json import dumps
from ...io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ...navigation.files import felt_obstacles, save_joint_route_graph
from ...navigation.graph import assign_regions, build_graph
from ...navigation.grid.cost_grid import SpeedLimits, grid_layers
from ...navigation.planning.joint_builder import extend_graph
from ...navigation.problem import MovableObject, load_objects, load_passages, load_robot, objects_from_data
from ...navigation.problem.node_types import nodes_of
from ..markers import LINES, POINTS, points_marker
from ..transports.topic_node import Received
from ..wire.graph import LATCHED
from .component import Status, Worker
from .parameters import NodeParameters

_GRID, _MARKERS = "nav_msgs/msg/OccupancyGrid", "visualization_msgs/msg/MarkerArray"


class MapParameters(NodeParameters):
    """Parameters of all nodes that use a map."""

    robot: str = Field("", min_length=1, description="robot.yaml: radius, speeds, pushing force")
    objects: str = Field("", description="objects.yaml: movable objects and passages; empty for none")
    map: str = Field("map", description="topic of nav_msgs/OccupancyGrid, latched")


class MapNode(Worker):
    """Loads robot and objects, keeps the latest map, and works in a separate thread on request."""

    def configure(self) -> None:
        parameters = self.parameters
        self._robot = load_robot(Path(parameters.robot))
        path = Path(parameters.objects) if parameters.objects else None
        self._objects = () if path is None else load_objects(path)
        self._passages = () if path is None else load_passages(path)
        self._map: Any = None
        self._told = Status(True, "nothing asked yet")
        self._due, self._end = threading.Event(), threading.Event()
        self.host.node.subscribe(parameters.map, _GRID, self._charted, LATCHED)

    def _charted(self, received: Received) -> None:
        self._map = received.message

    def _grid(self) -> OccupancyMap:
        return OccupancyMap.from_message(self._map, self.parameters.map)

    def in_map(self, stamped: Any, topic: str) -> Any:
        """A stamped pose whose coordinate frame is that of the map, or not stated.

        Parameters
        ----------
        stamped
            Message with a header.
        topic
            Where it comes from, for the message.

        Raises
        ------
        InputError
            It is in another frame, as a goal from RViz with the fixed frame ``odom``: the robot would go elsewhere.
        """
        found, own = (str(one.header.frame_id).lstrip("/") for one in (stamped, self._map))
        if found and own and found != own:
            raise InputError(
                topic, f"found {found!r}, expected {own!r}, the frame of the map", field="frame_id"
            )
        return stamped

    @abstractmethod
    def work(self) -> None:
        """Execute the work requested by setting ``_due``; an error of this library becomes the node's state."""

    def run(self, end: threading.Event) -> None:
        while not end.is_set():
            if self._due.wait(0.1):
                self._due.clear()
                try:
                    self.work()
                except VisuohapticError as error:
                    self._told = Status(False, str(error))

    def still(self, end: threading.Event) -> None:
        """Reject a result from an earlier activation.

        Parameters
        ----------
        end
            ``_end`` at the start of the work.

        Raises
        ------
        DeviceError
            The node was deactivated in the meantime.
        """
        if end.is_set():
            raise DeviceError(f"the node {self.host.node.name} was deactivated in the meantime")


class LayersParameters(MapParameters):
    """Parameters of the node layers."""

    felt: str = Field("objects", description="topic of std_msgs/String: objects as touched since, JSON")
    spacing_m: float = Field(
        0.0, ge=0.0, le=100.0, description="between nodes of the graph [m]; 0: at junctions"
    )


class LayersNode(MapNode):
    """Serves map layers for Nav2, updated with each map and after objects were touched."""

    summary = "a map for Nav2: OccupancyGrid in, route graph (GeoJSON, markers), keep-out mask, measured obstacles out"
    parameter_model = LayersParameters

    def configure(self) -> None:
        super().configure()
        node = self.host.node
        self._graph = node.advertise("route_graph", "std_msgs/msg/String", LATCHED)
        self._drawn = node.advertise("route_graph/markers", _MARKERS, LATCHED)
        self._mask = node.advertise("keepout_mask", _GRID, LATCHED)
        self._felt = node.advertise("felt_obstacles", _GRID, LATCHED)
        node.subscribe(self.parameters.felt, "std_msgs/msg/String", self._touched, LATCHED)

    def _charted(self, received: Received) -> None:
        super()._charted(received)
        self._due.set()

    def _touched(self, received: Received) -> None:
        where = self.parameters.felt
        self._objects = objects_from_data(parse_yaml(received.message.data, where), where=where)
        if self._map is not None:
            self._due.set()

    def work(self) -> None:
        """Build and publish the four layers; raises InputError if the map has no free space for the robot."""
        end, grid, objects, robot = self._end, self._grid(), self._objects, self._robot
        layers = grid_layers(grid, SpeedLimits(robot.radius_m, robot.v_max_m_s, robot.v_min_m_s))
        graph = build_graph(layers, spacing_m=self.parameters.spacing_m or None)
        joint = extend_graph(
            graph, assign_regions(layers, graph), robot, nodes_of(objects, self._passages, robot)
        )
        frame = self._map.header.frame_id
        with TemporaryDirectory() as folder:
            path = Path(folder) / "route_graph.geojson"
            save_joint_route_graph(path, joint, frame=frame)
            text = path.read_text(encoding="utf-8")
        felt = felt_obstacles(grid, objects, robot)
        self.still(end)
        t_s = self.host.node.now_s()
        self._graph.publish({"data": text})
        self._drawn.publish({"markers": _drawn(t_s, frame, json.loads(text)["features"], grid.resolution_m)})
        for outlet, cells in ((self._felt, felt), (self._mask, np.where(felt == OCCUPIED, OCCUPIED, FREE))):
            layer = OccupancyMap(cells.astype(np.int8), grid.resolution_m, grid.origin)
            outlet.publish(layer.to_message(t_s, frame))
        self._told = Status(True, "ok", {"nodes": graph.nodes, "objects": len(objects)})


def objects_text(objects: Iterable[MovableObject]) -> str:
    """Objects as JSON with the fields of ``objects.yaml``.

    Parameters
    ----------
    objects
        Objects, as updated by a travel task.
    """
    entries = []
    for item in objects:
        entry: dict[str, Any] = {"id": item.id, "footprint_m": item.footprint_m.tolist()}
        entries.append(entry if item.tag is None else entry | {"haptic_tag": to_dict(item.tag)})
    return dumps({"objects": entries})


def _drawn(t_s: float, frame: str, features: list[Any], size_m: float) -> list[dict[str, Any]]:
    """The nodes of a route graph, and its edges, each once."""
    nodes = [[*f["geometry"]["coordinates"], 0.0] for f in features if "startid" not in f["properties"]]
    edges = [f for f in features if f["properties"].get("startid", 1) < f["properties"].get("endid", 0)]
    ends = [[*point, 0.0] for edge in edges for line in edge["geometry"]["coordinates"] for point in line]
    return [
        points_marker(t_s, frame, "nodes", POINTS, nodes, size_m=size_m),
        points_marker(t_s, frame, "edges", LINES, ends, size_m=0.4 * size_m),
    ]
