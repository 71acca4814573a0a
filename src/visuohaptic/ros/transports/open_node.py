"""Creation of a node for a transport given by name."""

from __future__ import annotations

from typing import Literal, get_args

from ...core.errors import InputError, brief
from .session import RosOptions
from .topic_node import TopicNode

Transport = Literal["zenoh", "rclpy", "cyclonedds"]
TRANSPORTS: tuple[str, ...] = get_args(Transport)


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
    if transport == "zenoh":
        from .zenoh_node import RosNode

        return RosNode(name, options)
    if transport == "rclpy":
        from .rclpy_node import RclpyNode

        return RclpyNode(name, options)
    if transport == "cyclonedds":
        from .cyclone_node import CycloneNode

        return CycloneNode(name, options)
    raise InputError("transport", f"found {brief(transport)}, expected one of {', '.join(TRANSPORTS)}")
