"""Robot model: size, speeds, force."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...core.ranges import NON_NEGATIVE, POSITIVE
from ..grid.cost_grid import SpeedLimits


@dataclass(frozen=True, slots=True)
class RobotModel(SpeedLimits):
    """A disc-shaped robot that drives and pushes (Alt 2016, Sec. 4.2 and 4.4).

    Examples
    --------
    >>> RobotModel(radius_m=0.17, push_force_max_N=15.0).v_max_m_s
    0.3
    """

    v_push_m_s: float = field(default=0.05, metadata=POSITIVE)  #: at low pushing effort
    push_force_max_N: float = field(default=20.0, metadata=POSITIVE)  #: maximum force of the platform
    setup_time_s: float = field(default=4.0, metadata=NON_NEGATIVE)  #: positioning time per push
    push_margin_m: float = field(
        default=0.0, metadata=NON_NEGATIVE
    )  #: margin between a pushed object and obstacles
