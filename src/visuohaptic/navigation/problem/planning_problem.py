"""The input of a planner: map, objects, passages, robot, start and goal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from ...core import FINITE, NON_NEGATIVE, HapticTag, InputError, check_numbers, finite_array, within
from ...core.geometry import polygon_centroid
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from .outlines import outline_of
from .passages import Passage
from .place_area import PlaceArea
from .robot_model import RobotModel as RobotModel

#: Standard deviation of a heading of which nothing is known: uniform from -pi to pi [rad].
ANY_HEADING_rad = math.pi / math.sqrt(3.0)


class PushMode(StrEnum):
    """How an object is pushed once it has been explored."""

    DIRECT = "direct"  #: straight through its centre of friction (Sec. 4.3.1)
    SIDEWARD = "sideward"  #: displaced by a drive past it (Sec. 4.3.2)
    OFF_CENTRE = "off_centre"  #: as ``DIRECT``, and rotated by a push beside its centre where no straight push clears a path


@dataclass(frozen=True, slots=True, eq=False)
class MovableObject:
    """An object with an outline on the floor. Its tag determines whether it is movable.

    Examples
    --------
    >>> box = MovableObject("box", np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.2], [0.0, 0.2]]))
    >>> np.round(box.centre_m, 9), box.known_immovable  # never touched: it may move
    (array([0.2, 0.1]), False)
    """

    id: str
    footprint_m: Float[np.ndarray, "p 2"]  #: outline in the map frame, counter-clockwise, not closed
    tag: HapticTag | None = None  #: ``None``: never touched
    #: centre of friction from the footprint's centroid, map frame [m]: from earlier pushes (Sec. 4.3.1)
    friction_offset_m: tuple[float, float] = (0.0, 0.0)
    #: its covariance [m^2]; ``None``: no push was observed
    friction_covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None = None
    push: PushMode = PushMode.DIRECT
    #: standard deviations of its position along each axis [m] and of its rotation [rad]: 1.4 cm for a map of 5 cm cells
    pose_sigma: tuple[float, float] = (0.01, 0.05)

    def __post_init__(self) -> None:
        check_numbers("MovableObject", NON_NEGATIVE, pose_sigma=self.pose_sigma)
        check_numbers("MovableObject", within(0, ANY_HEADING_rad), **{"pose_sigma[1]": self.pose_sigma[1]})
        object.__setattr__(self, "footprint_m", outline_of(self.footprint_m, "MovableObject"))

    @property
    def centre_m(self) -> Float[np.ndarray, "2"]:
        """Centroid of the footprint's area, where the centre of mass is assumed (Sec. 4.3.1)."""
        return polygon_centroid(self.footprint_m)

    @property
    def known_immovable(self) -> bool:
        """Whether it is fixed or tips when pushed, and is therefore never pushed (Sec. 4.2.1)."""
        return self.tag is not None and (self.tag.fixed is True or self.tag.falls is True)


@dataclass(frozen=True, slots=True, eq=False)
class PlanningProblem:
    """All inputs of a plan.

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
    passages: tuple[Passage, ...] = ()  #: doors and elevators: closed on the map, but they open
    start_yaw_rad: float | None = None  #: heading at the start, if the robot has a footprint; ``None``: any
    areas: tuple[PlaceArea, ...] = ()  #: where pushed objects should end, or should not

    def __post_init__(self) -> None:
        import shapely

        check_numbers("PlanningProblem", FINITE, start_yaw_rad=self.start_yaw_rad)
        for name in ("start_m", "goal_m"):
            point = finite_array("PlanningProblem", getattr(self, name), 2, field=name).copy()
            if not self.map.inside(self.map.cell_from_world(point)):
                width, height = self.map.size_m
                raise InputError(
                    "PlanningProblem",
                    f"found ({point[0]:g}, {point[1]:g}), which is off the map "
                    f"({width:g} x {height:g} m, origin {self.map.origin})",
                    field=name,
                )
            object.__setattr__(self, name, point)
        ids = [item.id for item in self.objects] + [passage.id for passage in self.passages]
        ids += [area.id for area in self.areas]
        if len(set(ids)) != len(ids):
            twice = next(name for name in ids if ids.count(name) > 1)
            raise InputError("PlanningProblem", f"found the id '{twice}' twice, expected distinct ids")
        diagonal_m = float(np.hypot(*self.map.size_m))
        for item in self.objects:
            extent_m = float(np.ptp(item.footprint_m, axis=0).max())
            if extent_m > diagonal_m:
                raise InputError(
                    "MovableObject",
                    f"found an object '{item.id}' {extent_m:g} m wide on a map of {diagonal_m:g} m from corner "
                    "to corner, expected metres",
                    field="footprint_m",
                )
        cell_m = self.map.resolution_m
        for passage in self.passages:
            beside = (
                shapely.Polygon(passage.footprint_m).buffer(1.5 * cell_m).exterior.segmentize(0.5 * cell_m)
            )
            if (self.map.value_at(shapely.get_coordinates(beside)) == OCCUPIED).all():
                found = f"found '{passage.id}' with walls all around, expected a way through"
                raise InputError("Passage", found, field="footprint_m")
        object.__setattr__(self, "objects", tuple(self.objects))
