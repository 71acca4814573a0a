"""Kinds of nodes of the joint graph: objects, glass, doors, elevators (Alt 2016, Sec. 4.2.1, 4.3.3, 4.3.4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

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
class ManipulationNode:
    """An object that may be pushed aside."""

    item: MovableObject
    push_length_m: float = 0.5  #: assumed until a local planner has computed it
    costs: PushCosts = field(default_factory=PushCosts)
    planner: str = "direct push"
    in_map: bool = True

    @property
    def id(self) -> str:
        """Id of the object."""
        return self.item.id

    @property
    def outline_m(self) -> Float[np.ndarray, "p 2"]:
        """Footprint."""
        return self.item.footprint_m

    def task_s(self, robot: RobotModel) -> float:
        """Time of the assumed push, ``t_mani`` [s].

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return push_cost(self.item.tag, self.push_length_m, robot, self.costs).total_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that one push fails.

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return failure_probability(self.item.tag, self.push_length_m, robot, self.costs)


@dataclass(frozen=True, slots=True, eq=False)
class TransparencyNode:
    """An obstacle that is invisible to the laser: a safety region on apparently free cells, which is not entered."""

    id: str
    outline_m: Float[np.ndarray, "p 2"]
    planner: str = "keep out"
    in_map: bool = False

    def task_s(self, robot: RobotModel) -> float:
        """Infinite, because the region is not entered [s].

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return float("inf")

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability of a failure when driving through: 1.

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PassageNode:
    """A door or an elevator."""

    passage: Passage
    in_map: bool = True

    @property
    def id(self) -> str:
        """Id of the passage."""
        return self.passage.id

    @property
    def outline_m(self) -> Float[np.ndarray, "p 2"]:
        """Outline of the closed wing or of the threshold."""
        return self.passage.footprint_m

    @property
    def planner(self) -> str:
        """Local planner for the passage."""
        return PLANNERS[self.passage.kind]

    def task_s(self, robot: RobotModel) -> float:
        """Expected time to pass; infinite if it cannot be passed [s].

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return self.passage.cost(robot).total_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that it stays closed.

        Parameters
        ----------
        robot
            Model of the platform.
        """
        return self.passage.cost(robot).failure_probability


def nodes_of(
    objects: Iterable[MovableObject], passages: Iterable[Passage]
) -> list[ManipulationNode | TransparencyNode | PassageNode]:
    """Nodes for the entries of ``objects.yaml``; fixed objects and glass become safety regions.

    Parameters
    ----------
    objects, passages
        From :func:`~visuohaptic.navigation.problem.objects_file.load_objects` and ``load_passages``.
    """
    return [
        *(
            TransparencyNode(o.id, o.footprint_m)
            if o.known_immovable
            else ManipulationNode(o, planner=f"{o.push} push")
            for o in objects
        ),
        *(PassageNode(passage) for passage in passages),
    ]
