"""``visuohaptic ros node``: run one ROS 2 node with parameters, a life cycle and diagnostics.

reads   topics, and the files that its parameters name (sensor.yaml, objects.yaml, ...)
writes  topics, services and /diagnostics; no file

Without a name, the nodes are listed; with a name and --list, the parameters of that node.

Parameters are given with --param name:=value, or as for any ROS node with --ros-args -p name:=value,
--params-file and -r (remapping). The node configures and activates itself; with --managed it waits for a lifecycle
manager (ros2 lifecycle set /foam configure). Its diagnostics are on /diagnostics.

over
  --transport rclpy       ROS 2 itself: sourced, or pip install 'visuohaptic[ros-jazzy]'
  --transport zenoh       robots with rmw_zenoh_cpp, without a local ROS; topics only
  --transport cyclonedds  DDS without a local ROS: pip install 'visuohaptic[dds]'; topics only

Runs until Ctrl-C or SIGTERM, with exit code 0.

example: visuohaptic ros node
"""

from __future__ import annotations

import argparse
import threading
from typing import Any

from .... import ros
from ....core.resources import reuse_memory
from ....ros import nodes
from ..._stop import signals


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("name", str, "name of the node, such as foam", nargs="?")
    add("--param", list, "set a parameter; may be repeated", metavar="NAME:=VALUE")
    add("--list", bool, "list the node's parameters")
    add_transport(add)
    add("--managed", bool, "wait for a lifecycle manager")
    add("--duration", float, "stop after S seconds", metavar="S", low=0, above=True)
    add("--ros-args", str, "as for any node of ROS", default=[], nargs=argparse.REMAINDER, metavar="...")


def add_transport(add: Any) -> None:
    """Arguments that select the transport and the place in the graph.

    Parameters
    ----------
    add
        Function that adds an argument to the verb.
    """
    add("--transport", "rclpy", "middleware (rclpy)", choices=("rclpy", "zenoh", "cyclonedds"))
    add("--domain", int, "by default that of ROS_DOMAIN_ID", metavar="N")
    add("--namespace", "/", "namespace of the node's topics", metavar="NAME")
    add(
        "--connect",
        str,
        "router or peer of zenoh, as tcp/127.0.0.1:7447; may be repeated; none: wait for others",
        action="append",
        metavar="PLACE",
    )
    add(
        "--listen",
        str,
        "where peers of zenoh may connect; tcp/127.0.0.1:7447 takes the place of a router",
        action="append",
        metavar="PLACE",
    )


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    if args.name is None:
        for name in nodes.NODES:
            args.report(f"{name:<12} {nodes.node_kind(name).summary}")
        return {"nodes": {name: nodes.node_kind(name).summary for name in nodes.NODES}}
    if args.list:
        parameters = list(nodes.declared(nodes.node_kind(args.name).parameter_model))
        for one in parameters:
            bounds = "" if one.low is None and one.high is None else f" [{_end(one.low)} to {_end(one.high)}]"
            default = "required" if one.required else repr(one.default)
            args.report(f"{one.name} = {default}{bounds}  {one.description}")
        return {"parameters": {one.name: one.default for one in parameters}}
    reuse_memory()
    stop = threading.Event()
    with signals(stop.set):
        nodes.run_node(
            args.name,
            args.param,
            transport=args.transport,
            options=options_of(args),
            arguments=("--ros-args", *args.ros_args) if args.ros_args else (),
            managed=args.managed,
            stop=stop,
            timeout_s=args.duration,
        )
    return {"node": args.name}


def _end(bound: float | None) -> str:
    return "..." if bound is None else f"{bound:g}"


def options_of(args: Any) -> Any:
    """Options of the node from the arguments of :func:`add_transport`.

    Parameters
    ----------
    args
        Parsed arguments.
    """

    places: dict[str, Any] = {}
    if args.connect is not None:
        places["connect"] = () if args.connect == ["none"] else tuple(args.connect)
    if args.listen is not None:
        places["listen"] = tuple(args.listen)
    return ros.RosOptions(args.domain, args.namespace, **places)
