"""Tasks of a drive: along the path, and at each passage stop, wait or push, and continue (Alt 2016, Sec. 4.3.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..problem import Passage, PassageKind, Task
from .arrays import Path
from .search.search_domain import SearchDomain, world_from_grid

if TYPE_CHECKING:
    import shapely


def drive_tasks(domain: SearchDomain, path: Path, cost: float) -> list[Task]:
    """Tasks along a path, including those at passages: stop before, wait or push, continue.

    Parameters
    ----------
    domain
        Map, robot, passages.
    path
        Corners in grid coordinates [cells].
    cost
        Cost of driving along it [cells at full speed].
    """
    import shapely

    if len(path) < 2:
        return []
    line = shapely.LineString(world_from_grid(domain.map, path))
    speed = line.length / max(domain.seconds(cost), 1e-9)
    tasks: list[Task] = []
    at = 0.0
    for passage, first, last in _crossed(domain, line):
        room_m = domain.robot.front_m + domain.robot.stand_off_m
        stop = max(first - room_m, at)
        opened = passage.cost(domain.robot)
        tasks += _navigate(line, at, stop, speed)
        wing = passage.kind is PassageKind.DOOR_PUSH
        at = min(last + room_m, line.length) if wing else stop
        through = _navigate(line, stop, at, speed)
        tasks.append(
            Task(
                "door" if wing else "wait",
                opened.total_s,
                through[0].length_m if through else 0.0,
                through[0].path_m if through else (),
                passage.id,
                failure_probability=opened.failure_probability,
                sigma_s=opened.sigma_s,
            )
        )
    return tasks + _navigate(line, at, line.length, speed)


def _crossed(domain: SearchDomain, line: shapely.LineString) -> list[tuple[Passage, float, float]]:
    """Passages on a path, with the positions along it where it enters and leaves them [m]."""
    import shapely

    found = []
    for passage, _, _ in domain.passages:
        inside = line.intersection(shapely.Polygon(passage.footprint_m))
        if not inside.is_empty and inside.length > 0:
            along = [line.project(shapely.Point(point)) for point in shapely.get_coordinates(inside)]
            found.append((passage, min(along), max(along)))
    return sorted(found, key=lambda crossing: crossing[1])


def _navigate(line: shapely.LineString, begin_m: float, end_m: float, speed_m_s: float) -> list[Task]:
    from shapely.ops import substring

    if end_m - begin_m < 1e-9:
        return []
    path = tuple((float(x), float(y)) for x, y in substring(line, begin_m, end_m).coords)
    return [Task("navigate", (end_m - begin_m) / speed_m_s, end_m - begin_m, path)]
