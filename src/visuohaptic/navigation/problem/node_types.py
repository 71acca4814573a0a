"""Nodes of the joint graph: objects, glass, doors, elevators (Alt 2016, Sec. 4.2.1, 4.3.3, 4.3.4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .outlines import outline_of
from .passages import Passage, PassageKind
from .planning_problem import MovableObject
from .push_costs import PushCosts, failure_probability, push_cost
from .robot_model import RobotModel

#: Local planner of each kind of passage.
PLANNERS = {
    PassageKind.DOOR_PUSH: "push door",
    PassageKind.DOOR_SLIDING: "trigger and wait",
    PassageKind.ELEVATOR: "wait",
}


@dataclass(frozen=True, slots=True, eq=False)
class NodeType:
    """A node of any kind; a further kind is a further function that makes one.

    By default the values are those of glass, which the robot never passes.
    """

    id: str  #: name on the map
    outline_m: Float[np.ndarray, "p 2"]  #: on the floor, map frame
    planner: str = "keep out"  #: local planner that is started when the robot enters the node's region
    task_s: float = float("inf")  #: time of its task for one robot; infinite if it cannot be passed
    failure_probability: float = 1.0  #: of the task, for the same robot
    in_map: bool = False  #: whether the map contains it as occupied cells (an object) or not (glass)

    def __post_init__(self) -> None:
        outline_m = outline_of(self.outline_m, f"NodeType {self.id!r}", "outline_m")
        object.__setattr__(self, "outline_m", outline_m)


def push_node(
    item: MovableObject, robot: RobotModel, push_length_m: float = 0.5, costs: PushCosts | None = None
) -> NodeType:
    """Node of an object that may be pushed aside.

    Parameters
    ----------
    item
        The object.
    robot
        Model of the platform.
    push_length_m
        Length of the push [m], assumed until a local planner has computed it.
    costs
        Weights of the cost; by default those of :class:`PushCosts`.
    """
    seconds = push_cost(item.tag, push_length_m, robot, costs).total_s
    risk = failure_probability(item.tag, push_length_m, robot, costs)
    return NodeType(item.id, item.footprint_m, f"{item.push} push", seconds, risk, True)


def passage_node(passage: Passage, robot: RobotModel) -> NodeType:
    """Node of a door or an elevator.

    Parameters
    ----------
    passage
        The passage.
    robot
        Model of the platform.
    """
    cost, planner = passage.cost(robot), PLANNERS[passage.kind]
    return NodeType(passage.id, passage.footprint_m, planner, cost.total_s, cost.failure_probability, True)


def nodes_of(
    objects: Iterable[MovableObject], passages: Iterable[Passage], robot: RobotModel
) -> list[NodeType]:
    """Nodes of a map's objects, passages and glass, for ``extend_graph``.

    Parameters
    ----------
    objects
        Objects of the file; immovable ones are kept clear of, like glass.
    passages
        Doors and elevators of the file.
    robot
        Model of the platform.
    """
    return [
        *(NodeType(o.id, o.footprint_m) if o.known_immovable else push_node(o, robot) for o in objects),
        *(passage_node(passage, robot) for passage in passages),
    ]
