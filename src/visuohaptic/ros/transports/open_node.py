"""Creation of a node for a transport given by name."""

from __future__ import annotations

from importlib import import_module
from typing import Literal

from ...core.ranges import check_choice
from .session import RosOptions
from .topic_node import TopicNode

Transport = Literal["zenoh", "rclpy", "cyclonedds"]
#: Module and class of their nodes, imported when one is opened.
TRANSPORTS = {
    "zenoh": ("zenoh_node", "RosNode"), "rclpy": ("rclpy_node", "RclpyNode"), "cyclonedds": ("cyclone_node", "CycloneNode")
}  # fmt: skip


def open_node(name: str, options: RosOptions | None = None, transport: str = "zenoh") -> TopicNode:
    """Join the ROS graph of the robot.

    Parameters
    ----------
    name
        Name of the node.
    options
        Domain, namespace, and zenoh routers.
    transport
        ``zenoh`` for robots with ``rmw_zenoh_cpp``, ``rclpy`` for ROS 2 itself over DDS, ``cyclonedds`` for DDS
        without ROS.

    Raises
    ------
    InputError
        The transport does not exist.
    MissingExtraError
        Its library is not installed.
    DeviceError
        No router responds.
    """
    check_choice("transport", TRANSPORTS, transport)
    module, kind = TRANSPORTS[transport]
    make: type[TopicNode] = getattr(import_module(f".{module}", __package__), kind)
    return make(name, options)
