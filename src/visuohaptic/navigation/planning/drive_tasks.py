"""Tasks of a drive: along the path, and at each passage stop, wait or push, and continue (Alt 2016, Sec. 4.3.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..problem import Passage, PassageKind, Task
from .arrays import Path, Shifts
from .search.search_domain import SearchDomain, world_from_grid

if TYPE_CHECKING:
    import shapely


def drive_tasks(domain: SearchDomain, shifts: Shifts, path: Path, cost: float) -> list[Task]:
    """Tasks along a path, including those at passages: stop before, wait or push, continue.

    Parameters
    ----------
    domain
        Map, robot, passages.
    shifts
        Displacements of the bodies from their mapped positions [cells].
    path
        Corners in grid coordinates [cells].
    cost
        Cost of driving along it, turns on the spot included [cells at full speed].
    """
    import shapely
    from shapely.ops import substring

    if len(path) < 2:
        return []
    line, resolution_m = shapely.LineString(path), domain.map.resolution_m
    passages = _crossed(domain, line)
    straight = domain.driving_cost(shifts, path) if passages else cost

    def drive(begin: float, end: float) -> list[Task]:
        if end - begin < 1e-9:
            return []
        part = shapely.get_coordinates(substring(line, begin, end))
        spent = cost * (domain.driving_cost(shifts, part) if passages else cost) / max(straight, 1e-9)
        path_m = tuple((float(x), float(y)) for x, y in world_from_grid(domain.map, part))
        return [Task("navigate", domain.seconds(spent), (end - begin) * resolution_m, path_m)]

    tasks: list[Task] = []
    at, room = 0.0, (domain.robot.front_m + domain.robot.stand_off_m) / resolution_m
    for passage, first, last in passages:
        stop = max(first - room, at)
        opened, wing = passage.cost(domain.robot), passage.kind is PassageKind.DOOR_PUSH
        tasks += drive(at, stop)
        at = min(last + room, line.length) if wing else stop
        through = drive(stop, at) or [Task("navigate", 0.0)]
        tasks.append(
            Task(
                "door" if wing else "wait", opened.total_s, through[0].length_m, through[0].path_m, passage.id,
                failure_probability=opened.failure_probability, sigma_s=opened.sigma_s,
            )
        )  # fmt: skip
    return tasks + drive(at, line.length)


def _crossed(domain: SearchDomain, line: shapely.LineString) -> list[tuple[Passage, float, float]]:
    """Passages on a path, with the positions along it where it enters and leaves them [cells]."""
    import shapely

    found = []
    for passage, outline, _ in domain.passages:
        inside = line.intersection(shapely.Polygon(outline))
        if not inside.is_empty and inside.length > 0:
            along = [line.project(shapely.Point(point)) for point in shapely.get_coordinates(inside)]
            found.append((passage, min(along), max(along)))
    return sorted(found, key=lambda crossing: crossing[1])
