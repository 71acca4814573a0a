"""Real robots over ROS 2, with pip alone: a node that speaks as rmw_zenoh does, and adapters to ``robots``."""

from .frames import TopicFrames
from .graph import Entity, EntityKind, Qos
from .gripper import RosGripper
from .message_type import MessageType, message_type, parse_definition
from .mobile_base import RosBase
from .node import Received, RosNode, RosOptions, RosPublisher, RosSubscription
from .probe_arm import RosArm
from .sink import RosSink

__all__ = [
    "Entity",
    "EntityKind",
    "MessageType",
    "Qos",
    "Received",
    "RosArm",
    "RosBase",
    "RosGripper",
    "RosNode",
    "RosOptions",
    "RosPublisher",
    "RosSink",
    "RosSubscription",
    "TopicFrames",
    "message_type",
    "parse_definition",
]
