"""Who drives and pushes: size, speeds, force."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...core.errors import InputError
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ..grid.cost_grid import SpeedLimits

__all__ = ["RobotModel"]


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A disc that drives and pushes (Alt 2016, Sec. 4.2 and 4.4).

    Examples
    --------
    >>> RobotModel(radius_m=0.17, push_force_max_N=15.0).v_max_m_s
    0.3
    """

    radius_m: float = field(metadata=POSITIVE)  #: of the disc that drives, r_rob
    v_max_m_s: float = field(default=0.3, metadata=POSITIVE)  #: far from obstacles, Eq. (4.1)
    v_min_m_s: float = field(default=0.05, metadata=POSITIVE)  #: where the clearance is the robot's radius
    v_push_m_s: float = field(default=0.05, metadata=POSITIVE)  #: while pushing what is easily pushed
    push_force_max_N: float = field(default=20.0, metadata=POSITIVE)  #: the platform's capability
    setup_time_s: float = field(default=4.0, metadata=NON_NEGATIVE)  #: to come into position, once per push
    push_margin_m: float = field(
        default=0.0, metadata=NON_NEGATIVE
    )  #: room that what is pushed keeps from what does not move with it

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.v_min_m_s > self.v_max_m_s:
            raise InputError(
                "RobotModel",
                f"found {self.v_min_m_s}, expected at most v_max_m_s ({self.v_max_m_s})",
                field="v_min_m_s",
            )
        SpeedLimits(self.radius_m, self.v_max_m_s, self.v_min_m_s)
