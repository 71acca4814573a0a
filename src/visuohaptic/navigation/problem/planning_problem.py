"""What a plan is asked for: a map, what stands on it, who drives, from where to where."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import polygon_area, polygon_centroid
from ...core.objects import HapticTag
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ...io.maps.occupancy_map import OccupancyMap
from ..grid.cost_grid import SpeedLimits

__all__ = ["MovableObject", "PlanningProblem", "RobotModel"]

#: Vertices of one footprint; more than this is a scan, not an outline.
MAX_VERTICES = 2000
#: Corners farther from the map's origin than this are no lengths on a floor [m].
MAX_COORDINATE_M = 1e9


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A disc that drives and pushes (Alt 2016, Sec. 4.2 and 4.4).

    Examples
    --------
    >>> RobotModel(radius_m=0.17, push_force_max_N=15.0).v_max_m_s
    0.3
    """

    radius_m: float = field(metadata=POSITIVE)  #: r_rob
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


@dataclass(frozen=True, slots=True, eq=False)
class MovableObject:
    """Something with an outline on the floor. Whether it moves is what its tag says.

    Examples
    --------
    >>> box = MovableObject("box", np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.2], [0.0, 0.2]]))
    >>> np.round(box.centre_m, 9), box.known_immovable  # never touched: it may move
    (array([0.2, 0.1]), False)
    """

    id: str
    footprint_m: Float[np.ndarray, "p 2"]  #: outline in the map frame, counter-clockwise, not closed
    tag: HapticTag | None = None  #: ``None``: never touched
    where: str = field(default="MovableObject", repr=False)  #: file and place, for messages
    #: centre of friction from the footprint's centroid, map frame [m]: from former pushes (Sec. 4.3.1)
    friction_offset_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "footprint_m", _outline(self.footprint_m, self.where))

    @property
    def centre_m(self) -> Float[np.ndarray, "2"]:
        """Centroid of the footprint's area, where the centre of mass is assumed (Sec. 4.3.1)."""
        return polygon_centroid(self.footprint_m)

    @property
    def known_immovable(self) -> bool:
        """Fixed, or falls when pushed: never pushed (Sec. 4.2.1)."""
        return self.tag is not None and (self.tag.fixed is True or self.tag.falls is True)


def _outline(points: object, where: str) -> Float[np.ndarray, "p 2"]:
    try:
        outline = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, "found something else than numbers", field="footprint_m") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or not (np.abs(outline) <= MAX_COORDINATE_M).all():
        raise InputError(
            where,
            f"found shape {outline.shape}, expected finite [x, y] corners within {MAX_COORDINATE_M:g} m",
            field="footprint_m",
        )
    distinct = np.ones(len(outline), dtype=bool)
    if len(outline):
        distinct = (outline != np.roll(outline, 1, axis=0)).any(axis=1)  # a closed outline repeats its start
    outline = outline[distinct]
    if not 3 <= len(outline) <= MAX_VERTICES:
        raise InputError(
            where, f"found {len(outline)} distinct corners, expected 3 to {MAX_VERTICES}", field="footprint_m"
        )
    area = polygon_area(outline)
    extent = float(np.ptp(outline, axis=0).max())
    if abs(area) <= 1e-9 * extent**2 or extent == 0:
        raise InputError(where, "found an outline without area, expected a polygon", field="footprint_m")
    if _crosses_itself(outline - outline[0]):
        raise InputError(
            where,
            "found an outline that crosses itself, expected a simple polygon",
            field="footprint_m",
            remedy="list the corners in order around the object",
        )
    return outline if area > 0 else outline[::-1].copy()


def _crosses_itself(p: Float[np.ndarray, "p 2"]) -> bool:
    """Whether two edges that are not neighbours cross properly."""
    n = len(p)
    if n < 4:
        return False
    a, b = p, np.roll(p, -1, axis=0)

    def side(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        return np.sign(
            (v[..., 0] - u[..., 0]) * (w[..., 1] - u[..., 1])
            - (v[..., 1] - u[..., 1]) * (w[..., 0] - u[..., 0])
        )

    one = side(a[:, None], b[:, None], a[None]) * side(a[:, None], b[:, None], b[None])
    two = one.T
    crossing = (one < 0) & (two < 0)
    return bool(crossing.any())


@dataclass(frozen=True, slots=True, eq=False)
class PlanningProblem:
    """All that a plan depends on.

    Examples
    --------
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> walls = np.zeros((30, 40), dtype=bool)
    >>> walls[[0, -1]] = walls[:, [0, -1]] = True
    >>> problem = PlanningProblem(
    ...     OccupancyMap(walls, 0.05), RobotModel(0.15), np.array([0.4, 0.7]), np.array([1.6, 0.7])
    ... )
    >>> problem.objects
    ()
    """

    map: OccupancyMap
    robot: RobotModel
    start_m: Float[np.ndarray, "2"]  #: map frame
    goal_m: Float[np.ndarray, "2"]
    objects: tuple[MovableObject, ...] = ()

    def __post_init__(self) -> None:
        for name in ("start_m", "goal_m"):
            point = np.array(getattr(self, name), dtype=np.float64)
            if point.shape != (2,) or not np.isfinite(point).all():
                raise InputError("PlanningProblem", f"found {point}, expected finite x, y", field=name)
            if not self.map.inside(self.map.cell_from_world(point)):
                width, height = self.map.size_m
                raise InputError(
                    "PlanningProblem",
                    f"found ({point[0]:g}, {point[1]:g}), which is off the map "
                    f"({width:g} x {height:g} m, origin {self.map.origin})",
                    field=name,
                )
            object.__setattr__(self, name, point)
        ids = [item.id for item in self.objects]
        if len(set(ids)) != len(ids):
            twice = next(name for name in ids if ids.count(name) > 1)
            raise InputError("PlanningProblem", f"found the id '{twice}' twice, expected distinct ids")
        diagonal_m = float(np.hypot(*self.map.size_m))
        for item in self.objects:
            extent_m = float(np.ptp(item.footprint_m, axis=0).max())
            if extent_m > diagonal_m:
                raise InputError(
                    item.where,
                    f"found an object '{item.id}' {extent_m:g} m wide on a map of {diagonal_m:g} m from corner "
                    "to corner, expected metres",
                    field="footprint_m",
                )
        object.__setattr__(self, "objects", tuple(self.objects))
