"""Robot model: size, speeds, force."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.ranges import NON_NEGATIVE, POSITIVE
from ..grid.cost_grid import SpeedLimits
from .outlines import outline_of

#: Distance between robot and object before and after a push, and that within which it may turn on the spot [m].
STAND_OFF_M = 0.03
#: Tolerance for the corners of a front edge that is perpendicular to the x axis, and for a radius read from a file [m].
_EDGE_M = 1e-6


@dataclass(frozen=True, slots=True)
class RobotModel(SpeedLimits):
    """A robot that drives and pushes (Alt 2016, Sec. 4.2 and 4.4): a disc, or a convex footprint that drives forwards.

    Examples
    --------
    >>> RobotModel(radius_m=0.17, push_force_max_N=15.0).v_max_m_s
    0.3
    >>> robot = RobotModel.of_footprint([[0.45, 0.25], [-0.45, 0.25], [-0.45, -0.25], [0.45, -0.25]])
    >>> robot.radius_m, robot.front_m, round(robot.reach_m, 3)
    (0.25, 0.45, 0.515)
    """

    v_push_m_s: float = field(default=0.05, metadata=POSITIVE)  #: at low pushing effort
    push_force_max_N: float = field(default=20.0, metadata=POSITIVE)  #: maximum force of the platform
    setup_time_s: float = field(default=4.0, metadata=NON_NEGATIVE)  #: positioning time per push
    #: margin between a pushed object and obstacles
    push_margin_m: float = field(default=0.0, metadata=NON_NEGATIVE)
    #: corners x, y in the robot's frame, x forwards [m]; empty: a disc. In a file write ``footprint`` instead of ``radius_m``,
    #: which is then the radius of the inscribed circle
    footprint_m: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        # Not super(): a dataclass with slots is a new class.
        SpeedLimits.__post_init__(self)
        if self.footprint_m and abs(_inscribed_m(np.array(self.footprint_m)) - self.radius_m) > _EDGE_M:
            raise InputError(
                "RobotModel",
                f"found {self.radius_m:g} m with a footprint whose inscribed circle has "
                f"{_inscribed_m(np.array(self.footprint_m)):g} m",
                field="radius_m",
                remedy="give either a radius or a footprint",
            )

    @classmethod
    def of_footprint(cls, corners_m: Any, **others: float) -> RobotModel:
        """A robot with the convex hull of a footprint.

        Parameters
        ----------
        corners_m
            x, y of the corners in the robot's frame, x forwards [m], around the centre of its turns on the spot.
        others
            Fields other than the radius.

        Raises
        ------
        InputError
            The corners form no polygon, or it does not contain the origin.
        """
        import shapely

        hull = shapely.MultiPoint(outline_of(corners_m, "footprint")).convex_hull
        ring = outline_of(shapely.get_coordinates(hull), "footprint")
        radius_m = _inscribed_m(ring)
        if not radius_m > 0:
            raise InputError(
                "footprint", "found none around (0, 0)", remedy="the robot turns about its origin"
            )
        return cls(radius_m, footprint_m=tuple((float(x), float(y)) for x, y in ring), **others)

    def grown(self, margin_m: float) -> RobotModel:
        """The robot with a margin: a larger radius, or the edges of the footprint moved outwards.

        Parameters
        ----------
        margin_m
            Margin on every side [m].
        """
        if not self.footprint_m:
            return replace(self, radius_m=self.radius_m + margin_m)
        import shapely

        ring = shapely.Polygon(self.footprint_m).buffer(margin_m, join_style="mitre").exterior
        shape = RobotModel.of_footprint(shapely.get_coordinates(ring)[:-1])
        return replace(self, radius_m=shape.radius_m, footprint_m=shape.footprint_m)

    def check_disc(self, what: str) -> None:
        """Refuse a footprint.

        Parameters
        ----------
        what
            What is planned for a disc only, for the message.

        Raises
        ------
        InputError
            The robot has a footprint.
        """
        if self.footprint_m:
            raise InputError(
                "robot", f"found one, but {what} for a disc only", field="footprint",
                remedy=f"use `radius_m: {self.reach_m:.3f}`, the circle around it",
            )  # fmt: skip

    @property
    def reach_m(self) -> float:
        """Radius of the circle about the centre that contains the robot [m]."""
        return max((math.hypot(x, y) for x, y in self.footprint_m), default=self.radius_m)

    @property
    def front_m(self) -> float:
        """Distance of the front from the centre, where an object is pushed [m]."""
        return max((x for x, _ in self.footprint_m), default=self.radius_m)

    @property
    def stand_off_m(self) -> float:
        """Distance between front and object before and after a push, so that the robot can turn on the spot [m]."""
        return STAND_OFF_M + (self.reach_m - self.front_m)

    @property
    def flat_front(self) -> bool:
        """Whether it can push: a disc, or an edge across the x axis and perpendicular to it is in front."""
        across = [y for x, y in self.footprint_m if x > self.front_m - _EDGE_M]
        return not self.footprint_m or min(across) < 0.0 < max(across)


def _inscribed_m(ring_m: Float[np.ndarray, "p 2"]) -> float:
    """Distance of the origin from the edges of a counter-clockwise convex polygon; negative outside [m]."""
    (x, y), (dx, dy) = ring_m.T, (np.roll(ring_m, -1, axis=0) - ring_m).T
    return float(np.min((dx * -y - dy * -x) / np.hypot(dx, dy)))
