"""State estimate of a navigation task: walls, and pose, tag and centre of friction of each object."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ....core.geometry import rotation_2d, wrap_angle
from ....core.objects import HapticTag
from ....database.tags import merge_tags
from ....io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ....navigation.planning.object_cells import clear_cells, fill_cells
from ....navigation.planning.search.search_domain import grid_from_world
from ....navigation.problem.planning_problem import MovableObject, PlanningProblem
from ....navigation.pushing.push_failure import CENTRE_FRACTION
from ....navigation.pushing.push_model import PushModel

#: Error of the centre of friction estimated from a push, across it [m]: feet of the object, creep of the rim (``benchmarks.nav_push``).
PUSH_SIGMA_M = 0.005
#: Minimum displacement [m] and rotation [rad] of an object that has moved: more than the noise of a sighting.
MOVED_M, MOVED_RAD = 0.02, 0.05
#: Maximum distance of a contact from the outline of an object to which it is assigned [m].
NEAR_M = 0.06


@dataclass(slots=True, eq=False)
class _Known:
    item: MovableObject  #: as given, with its present tag
    own_m: Float[np.ndarray, "p 2"]  #: initial outline about its centroid
    place_m: Float[np.ndarray, "3"]  #: x, y of the centroid, rotation since the start
    offset_m: Float[np.ndarray, "2"]  #: centre of friction in the object's frame
    covariance: Float[np.ndarray, "2 2"]
    learned: bool = False  #: whether a push has updated the offset
    failures: int = 0
    stalled: bool = False  #: whether it counts as fixed only by failed pushes, not by a measured force

    def outline_m(self) -> Float[np.ndarray, "p 2"]:
        return self.own_m @ rotation_2d(self.place_m[2]).T + self.place_m[:2]

    def now(self) -> MovableObject:
        turn = rotation_2d(self.place_m[2])
        (x, y), ((xx, xy), (_, yy)) = turn @ self.offset_m, turn @ self.covariance @ turn.T
        return replace(
            self.item,
            footprint_m=self.outline_m(),
            friction_offset_m=(float(x), float(y)),
            friction_covariance_m2=((float(xx), float(xy)), (float(xy), float(yy))) if self.learned else None,
        )

    def count_push(self, *, failed: bool, **changes: Any) -> None:
        """Count a push in the tag, and change its properties."""
        tag = self.item.tag or HapticTag()
        counted = tag.updated(explored=tag.explored + 1, failed=tag.failed + int(failed), **changes)
        self.item = replace(self.item, tag=counted)


class TravelMemory:
    """State estimate updated by sightings and contacts.

    Parameters
    ----------
    problem
        Map, objects and robot at the start.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self._known = {item.id: _known(item) for item in problem.objects}
        grid = problem.map
        blocked = (grid.cells >= 50) | (grid.cells < 0)
        walls = blocked.copy()
        objects, passages = (
            [grid_from_world(grid, item.footprint_m) for item in items]
            for items in (problem.objects, problem.passages)
        )
        clear_cells(walls, objects, passages)
        self._cells = grid.cells.copy()
        self._cells[blocked & ~walls] = FREE
        self._failures_reset = 0

    def problem(
        self, pose_m: Float[np.ndarray, "3"], margin_m: float = 0.0, *, push_margin_m: float = 0.0
    ) -> PlanningProblem:
        """Planning problem from the present state, with margins beside the robot and the pushed object.

        Parameters
        ----------
        pose_m
            Pose of the robot: x, y [m], heading [rad].
        margin_m
            Margin beside the robot [m].
        push_margin_m
            Margin beside a pushed object [m].
        """
        objects = tuple(known.now() for known in self._known.values())
        grid = OccupancyMap(self._cells, self._problem.map.resolution_m, self._problem.map.origin)
        robot = self._problem.robot
        return replace(
            self._problem,
            map=map_with_footprints(grid, [item.footprint_m for item in objects]),
            robot=replace(robot.grown(margin_m), push_margin_m=push_margin_m),
            start_m=np.asarray(pose_m)[:2],
            start_yaw_rad=float(pose_m[2]) if robot.footprint_m else None,
            objects=objects,
        )

    def closed(self, id: str) -> None:
        """Mark a passage that did not open as closed: it is excluded from further plans.

        Parameters
        ----------
        id
            Identifier of the passage, or of an object that was taken for a door leaf.
        """
        if known := self._known.get(id):
            known.item = replace(known.item, tag=(known.item.tag or HapticTag()).updated(fixed=True))
        passages = (
            replace(passage, tag=(passage.tag or HapticTag()).updated(fixed=True))
            if passage.id == id
            else passage
            for passage in self._problem.passages
        )
        self._problem = replace(self._problem, passages=tuple(passages))

    def item(self, id: str) -> MovableObject:
        """Present estimate of an object.

        Parameters
        ----------
        id
            Identifier of the object.
        """
        return self._known[id].now()

    def failures(self, id: str) -> int:
        """Pushes of an object that failed on this travel.

        Parameters
        ----------
        id
            Identifier of the object.
        """
        return self._known[id].failures

    def push_model(self, id: str) -> tuple[PushModel, Float[np.ndarray, "3"]]:
        """Model of an object about its centroid, with the estimated centre of friction, and its pose.

        Parameters
        ----------
        id
            Identifier of the object.

        Returns
        -------
        tuple
            Model, and x, y of the centroid [m], rotation since the start [rad], (3,).
        """
        known = self._known[id]
        return PushModel.of_footprint(known.own_m).with_centre_moved(*known.offset_m), known.place_m

    def seen(self, id: str, place_m: Float[np.ndarray, "3"]) -> bool:
        """Update the pose of a located object; returns whether it has moved.

        Parameters
        ----------
        id
            Identifier of the object.
        place_m
            x, y of its centroid [m], rotation [rad].
        """
        known = self._known[id]
        off = place_m - known.place_m
        turn = wrap_angle(float(off[2]))
        if np.hypot(off[0], off[1]) < MOVED_M and abs(turn) < MOVED_RAD:
            return False
        known.place_m = np.asarray(place_m, dtype=np.float64)
        return True

    def near(self, point_m: Float[np.ndarray, "2"]) -> bool:
        """Whether a contact belongs to an object rather than to a wall.

        Parameters
        ----------
        point_m
            Contact point in the map frame [m].
        """
        import shapely

        point = shapely.Point(*point_m)
        return any(
            shapely.Polygon(known.outline_m()).distance(point) < NEAR_M for known in self._known.values()
        )

    def touched(self, point_m: Float[np.ndarray, "2"]) -> bool:
        """Process a contact; returns whether the map has nothing near it, so that it was added as a wall.

        Parameters
        ----------
        point_m
            Contact point in the map frame [m].
        """
        if self.near(point_m):
            return False
        grid = self._problem.map
        cell = grid.cell_from_world(point_m)
        row, column = int(cell[0]), int(cell[1])
        reach = max(1, round(0.08 / grid.resolution_m))
        near = self._cells[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
        if not near.size or (near >= 50).any():
            return False
        self._cells[row, column] = OCCUPIED
        return True

    def pushed(self, id: str, *, failed: bool) -> None:
        """Count a push that has moved an object.

        Parameters
        ----------
        id
            Identifier of the object.
        failed
            Whether it did not reach its planned goal.
        """
        self._known[id].count_push(failed=failed, fixed=False, min_static_friction_N=None)

    def refused(self, id: str, *, fixed: bool) -> None:
        """Count a push that has not moved an object; with ``fixed`` it is not pushed again.

        Parameters
        ----------
        id
            Identifier of the object.
        fixed
            Whether it counts as fixed from now on.
        """
        known = self._known[id]
        known.failures += 1
        known.stalled = known.stalled or fixed
        known.count_push(failed=True, **({"fixed": True} if fixed else {}))

    def too_heavy(self, id: str) -> None:
        """Record that an object withstood the maximum push force: a lower bound that replaces the measured frictions.

        Parameters
        ----------
        id
            Identifier of the object.
        """
        known = self._known[id]
        known.failures += 1
        known.stalled = False  # a measurement, not a stall: no further attempt
        limit_N = self._problem.robot.push_force_max_N
        known.count_push(
            failed=True, fixed=True, static_friction_N=None, dynamic_friction_N=None, min_static_friction_N=limit_N
        )  # fmt: skip

    def explored(self, id: str, tag: HapticTag) -> None:
        """Merge the tag of an exploration with the present one; ``fixed`` is that of the latest exploration.

        Parameters
        ----------
        id
            Identifier of the object.
        tag
            Tag of the exploration.
        """
        known = self._known[id]
        joined = merge_tags(known.item.tag or HapticTag(), tag)
        known.item = replace(
            known.item,
            tag=joined.updated(fixed=tag.fixed, min_static_friction_N=tag.min_static_friction_N),
        )

    def reset_failures(self) -> bool:
        """Permit, once, further pushes of objects that stalled; returns whether there are any."""
        if self._failures_reset:
            return False
        self._failures_reset += 1
        found = False
        for known in self._known.values():
            if known.stalled and known.item.tag is not None and known.item.tag.fixed:
                known.item = replace(known.item, tag=known.item.tag.updated(fixed=False))
                known.stalled, known.failures = False, 0
                found = True
        return found

    def learn_centre(self, id: str, direction_rad: float, beside_m: float) -> None:
        """Kalman update of the centre of friction by its offset across a push.

        Parameters
        ----------
        id
            Identifier of the object.
        direction_rad
            Direction of the push in the map frame [rad].
        beside_m
            Offset to the left of the estimate [m].
        """
        known = self._known[id]
        across = np.array([-math.sin(direction_rad), math.cos(direction_rad)]) @ rotation_2d(known.place_m[2])
        gain = known.covariance @ across / (across @ known.covariance @ across + PUSH_SIGMA_M**2)
        known.offset_m = known.offset_m + gain * beside_m
        known.covariance = known.covariance - np.outer(gain, across @ known.covariance)
        known.learned = True


def map_with_footprints(grid: OccupancyMap, footprints_m: Iterable[Float[np.ndarray, "p 2"]]) -> OccupancyMap:
    """Map in which the cells of some objects are occupied.

    Parameters
    ----------
    grid
        Map to copy.
    footprints_m
        Corners of each object's outline, map frame [m].
    """
    filled: Bool[np.ndarray, "rows columns"] = np.zeros(grid.shape, dtype=bool)
    fill_cells(filled, *(grid_from_world(grid, outline_m) for outline_m in footprints_m))
    cells = grid.cells.copy()
    cells[filled] = OCCUPIED
    return OccupancyMap(cells, grid.resolution_m, grid.origin)


def _known(item: MovableObject) -> _Known:
    centre = item.centre_m
    own = item.footprint_m - centre
    offset = np.array(item.friction_offset_m, dtype=np.float64)
    lever_m = PushModel.of_footprint(own).lever_m
    return _Known(
        item,
        own,
        np.array([*centre, 0.0]),
        offset,
        np.eye(2) * (CENTRE_FRACTION * lever_m) ** 2
        if item.friction_covariance_m2 is None
        else np.array(item.friction_covariance_m2),
        item.friction_covariance_m2 is not None,
    )
