"""Kinds of nodes that the joint graph knows: objects, glass, doors, elevators (Alt 2016, Sec. 4.2.1, 4.3.3, 4.3.4)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ...core.objects import HapticTag, PrimitiveKind
from .planning_problem import MovableObject, RobotModel
from .push_costs import PushCosts, failure_probability, push_cost

__all__ = [
    "DoorNode",
    "ManipulationNode",
    "SlidingDoorNode",
    "TransparencyNode",
    "WaitingNode",
    "is_door_wing",
]

#: A wing turns about its hinge by at least this much per pushed metre: 0.5 m from the contact to the hinge is 2.
WING_RAD_PER_M = 0.7
#: ... and constantly so: its standard deviation over the push is this small a fraction of it.
WING_SPREAD = 0.35


def is_door_wing(tag: HapticTag) -> bool:
    """Whether a tag shows the pattern of a door's wing (Sec. 4.3.4).

    A constant rotation and a planar primitive; a wing also keeps moving after
    the platform stops, or shows nearly no friction, where that was observed.

    Parameters
    ----------
    tag
        From pushes of the object.
    """
    rotation = tag.rotation_rad_per_m
    if rotation is None or tag.fixed or tag.falls or abs(rotation.value) < WING_RAD_PER_M:
        return False
    planar = tag.primitive is not None and tag.primitive.kind in {PrimitiveKind.LINE, PrimitiveKind.SEGMENT}
    constant = rotation.predictive_sigma <= WING_SPREAD * abs(rotation.value)
    return planar and constant


@dataclass(frozen=True, slots=True, eq=False)
class ManipulationNode:
    """An object that may be pushed away."""

    item: MovableObject
    push_length_m: float = 0.5  #: assumed before a local planner has looked
    costs: PushCosts = field(default_factory=PushCosts)
    planner: str = "direct push"
    in_map: bool = True

    @property
    def id(self) -> str:
        """Of the object."""
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
            The platform.
        """
        return push_cost(self.item.tag, self.push_length_m, robot, self.costs).total_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that one push fails.

        Parameters
        ----------
        robot
            The platform.
        """
        return failure_probability(self.item.tag, self.push_length_m, robot, self.costs)


@dataclass(frozen=True, slots=True, eq=False)
class TransparencyNode:
    """Something that the laser does not see: a safety region on cells that look free.

    It comes with a touch or with a detection and goes when exploration, or a
    negative result of the detector that made it, does not confirm it. With a
    tag it is one of manipulation.
    """

    id: str
    outline_m: Float[np.ndarray, "p 2"]
    source: str = "detector"  #: "detector" or "touch"
    tag: HapticTag | None = None
    evidence: float = 1.0  #: log-odds of being there
    push_length_m: float = 0.5
    planner: str = "keep out"
    in_map: bool = False

    def seen(self, positive: bool, *, weight: float = 0.8) -> TransparencyNode | None:
        """The node after one more observation; ``None`` when it is removed.

        A node that was touched is not removed by a detector alone.

        Parameters
        ----------
        positive
            Whether the detector reports a transparent region.
        weight
            Log-odds of the observation.
        """
        evidence = min(self.evidence + (weight if positive else -weight), 4.0)
        if evidence <= 0 and self.source == "detector":
            return None
        return replace(self, evidence=max(evidence, 0.2) if self.source == "touch" else evidence)

    def touched(self, found: bool, tag: HapticTag | None = None) -> TransparencyNode | None:
        """The node after exploration by touch: confirmed with the tag, or ``None`` where nothing was found.

        Parameters
        ----------
        found
            Whether something was touched.
        tag
            What was measured of it.
        """
        return replace(self, source="touch", tag=tag, evidence=4.0) if found else None

    def task_s(self, robot: RobotModel) -> float:
        """Infinite, because the region is not entered; with a tag the time of a push [s].

        Parameters
        ----------
        robot
            The platform.
        """
        if self.tag is None:
            return float("inf")
        return push_cost(self.tag, self.push_length_m, robot).total_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that a push fails, where there is a tag.

        Parameters
        ----------
        robot
            The platform.
        """
        return failure_probability(self.tag, self.push_length_m, robot) if self.tag else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class DoorNode:
    """A wing that can be pushed open, but not pulled; not snapped."""

    id: str
    outline_m: Float[np.ndarray, "p 2"]  #: the closed wing
    width_m: float  #: from the hinge to the edge
    tag: HapticTag | None = None
    closed: bool = True
    in_map: bool = True
    planner: str = "push door"

    def task_s(self, robot: RobotModel) -> float:
        """Setup time, and the path of the contact until the robot fits through [s].

        The robot, of width 2 r, pushes at the middle of the wing; opened by
        an angle a the wing leaves width (1 - cos a) free.

        Parameters
        ----------
        robot
            The platform.
        """
        if not self.closed:
            return 0.0
        if self.tag is not None and self.tag.fixed:
            return float("inf")
        needed = 2.2 * robot.radius_m / self.width_m
        if needed > 1.0:
            return float("inf")
        angle = float(np.arccos(1.0 - needed))
        return robot.setup_time_s + 0.5 * self.width_m * angle / robot.v_push_m_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that the door is blocked or latched, from the counters.

        Parameters
        ----------
        robot
            The platform.
        """
        return failure_probability(self.tag or HapticTag(explored=1), 0.0, robot)


@dataclass(frozen=True, slots=True, eq=False)
class SlidingDoorNode:
    """Opens by itself after a trigger: a motion detector, a button, a command."""

    id: str
    outline_m: Float[np.ndarray, "p 2"]
    trigger: str = "motion"  #: "motion", "button" or "wireless"
    open_s: float = 4.0  #: from the trigger until it is open
    probability_open: float = 0.0  #: that it is found open
    has_arm: bool = False
    in_map: bool = True
    planner: str = "trigger and wait"

    def task_s(self, robot: RobotModel) -> float:
        """Expected wait [s]; infinite for a button without an arm.

        Parameters
        ----------
        robot
            The platform.
        """
        del robot
        if self.trigger == "button" and not self.has_arm:
            return float("inf")
        return (1.0 - self.probability_open) * self.open_s

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that the door does not open.

        Parameters
        ----------
        robot
            The platform.
        """
        del robot
        return 0.05


@dataclass(frozen=True, slots=True, eq=False)
class WaitingNode:
    """An elevator, or a door that somebody else has to open: wait in front of it."""

    id: str
    outline_m: Float[np.ndarray, "p 2"]
    arrivals_per_s: float = 1.0 / 60.0  #: how often somebody enters or exits
    patience_s: float = 300.0  #: given up after so long
    in_map: bool = True
    planner: str = "wait"

    def task_s(self, robot: RobotModel) -> float:
        """Expected waiting time [s] for random arrivals, up to the patience.

        Parameters
        ----------
        robot
            The platform.
        """
        del robot
        missed = np.exp(-self.arrivals_per_s * self.patience_s)
        return float((1.0 - missed) / self.arrivals_per_s)

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that nobody comes in time.

        Parameters
        ----------
        robot
            The platform.
        """
        del robot
        return float(np.exp(-self.arrivals_per_s * self.patience_s))
