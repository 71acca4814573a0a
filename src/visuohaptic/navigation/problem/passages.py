"""Passages that can be opened: pushed door wings, sliding doors, elevators (Alt 2016, Sec. 4.3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from ...core import Estimate, HapticTag, InputError, PrimitiveKind
from .outlines import outline_of
from .push_costs import failure_probability
from .robot_model import RobotModel

#: Expected opening time of a passage without observations, from the trigger on [s].
SLIDING_S = Estimate(4.0, spread=2.0)
#: Waiting time for a person who operates it, with one random arrival per minute: exponential, deviation equals mean.
ARRIVALS_S = Estimate(60.0, spread=60.0)
#: Probability that a sliding door does not open.
SLIDING_FAILURE = 0.05
#: Maximum waiting time for an elevator [s].
PATIENCE_S = 300.0
#: Maximum relative variation of a wing's rotation, and thus of the time to push it open.
WING_SPREAD = 0.35
#: Minimum rotation of a wing about its hinge per pushed metre: 0.5 m from the contact to the hinge gives 2.
WING_RAD_PER_M = 0.7
#: Width that a robot needs next to an open wing [relative to its diameter].
WING_ROOM = 1.1


class PassageKind(StrEnum):
    """How a passage is opened."""

    DOOR_PUSH = "door_push"  #: a wing that the robot pushes open
    DOOR_SLIDING = "door_sliding"  #: after a trigger: a motion detector, a command
    ELEVATOR = "elevator"  #: when a person or a car arrives


@dataclass(frozen=True, slots=True)
class PassageCost:
    """Cost of traversing a passage."""

    total_s: float  #: expected, with retries; infinite if the robot can never pass
    sigma_s: float = 0.0  #: standard deviation of one pass
    failure_probability: float = 0.0
    reason: str = ""  #: why the robot can never pass


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A place that is closed on the map and can be opened.

    Examples
    --------
    >>> door = Passage("door", np.array([[2.0, 1.0], [2.1, 1.0], [2.1, 1.9], [2.0, 1.9]]), PassageKind.DOOR_SLIDING)
    >>> cost = door.cost(RobotModel(0.17))
    >>> round(cost.total_s, 2), cost.sigma_s
    (4.21, 2.0)
    """

    id: str
    footprint_m: Float[np.ndarray, "p 2"]  #: of the closed wing or the threshold, map frame
    kind: PassageKind
    open_s: Estimate | None = None  #: from the trigger, or the start of waiting, until it is open
    tag: HapticTag | None = None  #: from earlier passes; ``fixed`` means locked

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", PassageKind(self.kind))
        object.__setattr__(self, "footprint_m", outline_of(self.footprint_m, f"Passage '{self.id}'"))
        if self.open_s is not None and self.open_s.value < 0:
            raise InputError("Passage", f"found {self.open_s.value} s, expected at least 0", field="open_s")

    @property
    def width_m(self) -> float:
        """Distance from the hinge to the edge of the wing: the longest side of the footprint [m]."""
        return float(np.hypot(*(self.footprint_m - np.roll(self.footprint_m, 1, axis=0)).T).max())

    def cost(self, robot: RobotModel) -> PassageCost:
        """Time to pass, its standard deviation and the failure probability.

        Parameters
        ----------
        robot
            Model of the platform.
        """
        if self.tag is not None and self.tag.fixed:
            return PassageCost(math.inf, reason="it is locked")
        if self.kind is PassageKind.DOOR_PUSH:
            return self._wing(robot)
        expected = self.open_s or (SLIDING_S if self.kind is PassageKind.DOOR_SLIDING else ARRIVALS_S)
        if self.kind is PassageKind.DOOR_SLIDING:
            return _with_retries(expected.value, expected.predictive_sigma, SLIDING_FAILURE)
        # Random arrivals, up to the maximum waiting time.
        failure = math.exp(-PATIENCE_S / max(expected.value, 1e-9))
        return PassageCost(expected.value * (1.0 - failure), expected.predictive_sigma, failure)

    def _wing(self, robot: RobotModel) -> PassageCost:
        """Setup, and the path of the contact at the middle of the wing until the robot fits through.

        Opened by an angle a, a wing leaves width (1 - cos a) free.
        """
        needed = WING_ROOM * 2.0 * robot.radius_m / self.width_m
        if needed > 1.0:
            return PassageCost(math.inf, reason=f"{self.width_m:.2f} m is too narrow for the robot")
        push_s = 0.5 * self.width_m * math.acos(1.0 - needed) / robot.v_push_m_s
        sigma_s = WING_SPREAD * push_s
        if self.open_s is not None:
            push_s, sigma_s = self.open_s.value, self.open_s.predictive_sigma
        failure = failure_probability(self.tag or HapticTag(explored=1), 0.0, robot)
        return _with_retries(robot.setup_time_s + push_s, sigma_s, failure)


def is_door_wing(tag: HapticTag) -> bool:
    """Whether a tag has the pattern of a door wing (Sec. 4.3.4).

    A constant rotation and a planar primitive; a wing also keeps moving after
    the platform stops, or has almost no friction, if that was observed.

    Parameters
    ----------
    tag
        Tag from pushes of the object.
    """
    rotation = tag.rotation_rad_per_m
    if rotation is None or tag.fixed or tag.falls or abs(rotation.value) < WING_RAD_PER_M:
        return False
    planar = tag.primitive is not None and tag.primitive.kind in {PrimitiveKind.LINE, PrimitiveKind.SEGMENT}
    constant = rotation.predictive_sigma <= WING_SPREAD * abs(rotation.value)
    return planar and constant


def _with_retries(attempt_s: float, sigma_s: float, failure: float) -> PassageCost:
    """Expected cost with retries of attempts that fail with probability ``failure``."""
    return PassageCost(attempt_s / (1.0 - min(failure, 0.99)), sigma_s, failure)
