"""What a grasp is for, and with what hand: the settings that scores, feasibility and plans share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ..core.ranges import POSITIVE, check_ranges, within
from .force import GripperModel, Handling, Load
from .score import ScoreParameters

__all__ = ["GraspTask"]


@dataclass(frozen=True, slots=True)
class GraspTask:
    """What is to be done, with what hand.

    Examples
    --------
    >>> GraspTask(force_N=20.0, closed=True).fill  # of an empty container whose air cannot escape
    0.0
    """

    #: F_G of each finger; None: what the load needs at each place
    force_N: float | None = field(default=None, metadata=POSITIVE)
    closed: bool = False  #: the contents cannot escape
    fill: float = field(default=0.0, metadata=within(0, 1))  #: fraction of the volume that is liquid
    liquid_kg_per_m3: float = field(default=1000.0, metadata=POSITIVE)  #: density of the liquid
    gripper: GripperModel = field(default_factory=GripperModel)
    handling: Handling = field(default_factory=Handling)
    parameters: ScoreParameters = field(default_factory=ScoreParameters)
    min_score: float = field(default=0.5, metadata=within(0, 1))  #: S_G of a goal for the arm
    #: Probability with which the deformation stays below its bound; at 0.5 the map's best value counts.
    confidence: float = field(default=0.95, metadata=within(0.5, 1 - 1e-9))
    load: Load | None = None  #: instead of the one from wall and fill
    #: Pairs of contacts: along the wall's normal wherever that leads, or through the height axis (Alt 2016).
    pairs: Literal["antipodal", "axis"] = "antipodal"

    def __post_init__(self) -> None:
        check_ranges(self)
