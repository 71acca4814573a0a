"""Task and result of grasp planning: settings shared by scores, feasibility and plans; and a grasp."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..core.ranges import POSITIVE, Ranged, within
from .approach import GripperApproach
from .confirm import Confirmation
from .force import GripperModel, Handling, Load
from .score import ScoreParameters


@dataclass(frozen=True, slots=True)
class GraspTask(Ranged):
    """Task and gripper.

    Examples
    --------
    >>> GraspTask(force_N=20.0, closed=True).fill  # of an empty container whose air cannot escape
    0.0
    """

    #: F_G of each finger; None: the force that the load requires at each location
    force_N: float | None = field(default=None, metadata=POSITIVE)
    closed: bool = False  #: the contents cannot escape
    fill: float = field(default=0.0, metadata=within(0, 1))  #: fraction of the volume that is liquid
    liquid_kg_per_m3: float = field(default=1000.0, metadata=POSITIVE)  #: density of the liquid
    gripper: GripperModel = field(default_factory=GripperModel)
    handling: Handling = field(default_factory=Handling)
    parameters: ScoreParameters = field(default_factory=ScoreParameters)
    min_score: float = field(default=0.5, metadata=within(0, 1))  #: minimum S_G of a goal for the arm
    #: Probability with which the deformation stays below its bound; at 0.5 the map's best estimate is used.
    confidence: float = field(default=0.95, metadata=within(0.5, 1 - 1e-9))
    load: Load | None = None  #: overrides the one from wall and fill
    #: Pairs of contacts: along the wall's normal, or through the height axis (Alt 2016).
    pairs: Literal["antipodal", "axis"] = "antipodal"


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """One goal for the arm, in the object's frame."""

    vertex: int  #: of the first finger
    first_m: Float[np.ndarray, "3"]
    second_m: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]  #: unit vector of the first finger's force
    score: float  #: S_G of both fingers
    parts: dict[str, float]  #: contact, curvature, height, deformation of the first finger
    force_N: float
    needed_N: float  #: required to hold the load
    deformation_limit_N: float
    spill_limit_N: float
    deformation_m: float  #: expected, of one side
    deformation_sigma_m: float  #: log-normal, with the relative standard deviation of the stiffness
    width_m: float  #: distance of the fingers
    steadiness: float  #: smallest S_G within the neighbourhood, for a misaligned arm
    success: float  #: probability that it neither slips nor deforms too much; NaN if no load is known
    work_J: float  #: minimum work of both fingers to hold the load (Xu et al. 2020), by the linear stiffness
    rim: bool = False  #: the wall itself is pinched at the mouth, one finger inside
    arm_cost: float = 0.0
    approach: GripperApproach | None = None  #: collision-free approach
    confirmation: Confirmation | None = None
