"""Runs one node until it is stopped, with a ROS lifecycle or on a transport without one."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Mapping, Sequence

from ...core import InputError, check_choice
from ..transports.open_node import open_node
from ..transports.session import RosOptions
from .component import Component
from .lifecycle import LifecycleProcess
from .parameters import given
from .running import Running


def run_node(
    name: str,
    words: Sequence[str] = (),
    *,
    transport: str = "rclpy",
    options: RosOptions | None = None,
    arguments: Sequence[str] = (),
    managed: bool = False,
    stop: threading.Event | None = None,
    timeout_s: float | None = None,
) -> None:
    """Run a node until ``stop`` is set.

    Parameters
    ----------
    name
        Name of the node in the catalogue, such as ``foam``, and in the graph.
    words
        Parameters, such as ``config:=sensor.yaml``.
    transport
        ``rclpy``, ``zenoh`` or ``cyclonedds``; the latter two support topics only, and start the node immediately.
    options
        Domain, namespace, and zenoh routers.
    arguments
        ROS command line, from ``--ros-args`` on.
    managed
        Wait for a lifecycle manager instead of configuring and activating immediately.
    stop
        Event that stops the node; without it, the node ends after ``timeout_s``.
    timeout_s
        Maximum running time [s].

    Raises
    ------
    VisuohapticError
        A parameter or file is invalid, the transport is not available, or the node has failed.
    """
    kind = node_kind(name)
    stop = stop or threading.Event()
    if transport == "rclpy":
        values = given(words, kind.parameter_model, name, whole=False)
        with LifecycleProcess(name, kind, values, options, arguments) as process:
            if not managed:
                process.start()
            while not _wait(process.running, stop, timeout_s):
                if not managed and process.running.problem is not None:
                    raise process.running.problem
                process.running.failed.clear()
                process.deactivate()
        return
    if managed or arguments:
        raise InputError(
            "transport", f"{transport} has no life cycle and no arguments of ROS; use rclpy for them"
        )
    with Running(kind, lambda: open_node(name, options, transport)) as running:
        running.configure(given(words, kind.parameter_model, name))
        running.activate()
        if not _wait(running, stop, timeout_s) and running.problem is not None:
            raise running.problem


def _wait(running: Running, stop: threading.Event, timeout_s: float | None) -> bool:
    """Whether the node was stopped or the time is up; False if the component has failed."""
    left_s = float("inf") if timeout_s is None else timeout_s
    while not stop.wait(min(0.1, max(left_s, 0.0))):
        left_s -= 0.1
        if running.failed.is_set():
            return False
        if left_s <= 0:
            return True
    return True


#: Name -> module and class.
NODES: Mapping[str, tuple[str, str]] = {
    "foam": ("sensor_node", "FoamNode"),
    "beam": ("sensor_node", "BeamNode"),
    "scene": ("sensor_node", "SceneNode"),
    "template": ("sensor_node", "TemplateNode"),
    "transparency": ("transparency_node", "TransparentPartsNode"),
    "plan": ("plan_node", "PlanNode"),
    "layers": ("map_nodes", "LayersNode"),
    "travel": ("travel_node", "TravelNode"),
    "camera": ("play_node", "CameraNode"),
    "play": ("play_node", "PlayNode"),
    "classify": ("object_nodes", "ClassifyNode"),
    "grasp": ("object_nodes", "GraspNode"),
}


def node_kind(name: str) -> type[Component]:
    """The class of a node.

    Parameters
    ----------
    name
        Name of the node, such as ``foam``.

    Raises
    ------
    InputError
        There is no node of this name.
    """
    check_choice("node", NODES, name)
    module, short = NODES[name]
    found: type[Component] = getattr(importlib.import_module(f".{module}", __package__), short)
    return found
