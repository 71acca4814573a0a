"""Registry of the nodes by name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from ...core.errors import InputError, brief
from .component import Component

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
    if name not in NODES:
        raise InputError("node", f"found {brief(name)}, expected one of {', '.join(NODES)}")
    module, short = NODES[name]
    found: type[Component] = getattr(importlib.import_module(f".{module}", __package__), short)
    return found
