"""Who drives and pushes: size, speeds, force."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...core.ranges import NON_NEGATIVE, POSITIVE
from ..grid.cost_grid import SpeedLimits

__all__ = ["RobotModel"]


@dataclass(frozen=True, slots=True)
class RobotModel(SpeedLimits):
    """A disc that drives and pushes (Alt 2016, Sec. 4.2 and 4.4).

    Examples
    --------
    >>> RobotModel(radius_m=0.17, push_force_max_N=15.0).v_max_m_s
    0.3
    """

    v_push_m_s: float = field(default=0.05, metadata=POSITIVE)  #: while pushing what is easily pushed
    push_force_max_N: float = field(default=20.0, metadata=POSITIVE)  #: the platform's capability
    setup_time_s: float = field(default=4.0, metadata=NON_NEGATIVE)  #: to come into position, once per push
    push_margin_m: float = field(
        default=0.0, metadata=NON_NEGATIVE
    )  #: room that what is pushed keeps from what does not move with it
