"""Readers of ``objects.yaml`` and ``robot.yaml`` with strict validation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Float

from ...core import Estimate, HapticTag, InputError, from_dict, load_yaml, parse_yaml
from .outlines import outline_of
from .passages import Passage, PassageKind
from .place_area import PlaceArea
from .planning_problem import MovableObject, PushMode, RobotModel

T = TypeVar("T")

#: Maximum number of objects on one map; more indicate an error in the file.
MAX_OBJECTS = 10_000
#: Types of an entry besides the kinds of passages. Glass that was never pushed is avoided.
GLASS, PASSAGES, AREAS = "glass", tuple(PassageKind), ("avoid", "prefer")
Kind = Literal["object", "glass", "door_push", "door_sliding", "elevator", "avoid", "prefer"]
#: Fields without meaning for entries of these types, which were probably meant as another type.
_FOREIGN: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("object", GLASS), ("open_s", "cost_s")),
    **dict.fromkeys(PASSAGES, ("cost_s",)),
    **dict.fromkeys(AREAS, ("open_s", "haptic_tag")),
}
#: Margin around glass, because depth cameras measure it with an error of several centimetres [m].
GLASS_SAFETY_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """One object of the file."""

    id: int | str
    footprint_m: Float[np.ndarray, "p 2"]
    haptic_tag: HapticTag | None = None
    type: Kind = "object"
    open_s: Estimate | None = None
    push: PushMode = PushMode.DIRECT
    pose_sigma: tuple[float, float] = (0.01, 0.05)
    cost_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    objects: tuple[_Entry, ...] | None


def load_robot(path: Path | str) -> RobotModel:
    """Read ``robot.yaml``.

    Parameters
    ----------
    path
        ``robot.yaml``.

    Raises
    ------
    InputError
        Names the file, the field, what was found and what was expected.
    """
    return robot_from_data(load_yaml(path), where=str(path))


def load_objects(path: Path | str) -> tuple[MovableObject, ...]:
    """Read ``objects.yaml``: footprints with tags.

    Missing or null fields of a tag were not observed; an object without
    a ``haptic_tag`` is unknown.

    Parameters
    ----------
    path
        ``objects.yaml``.

    Raises
    ------
    InputError
        Names the file, the object, the field, what was found and what was expected.

    Examples
    --------
    >>> from pathlib import Path
    >>> lines = "objects: [{id: box, footprint_m: [[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4]], "
    >>> _ = Path("objects.yaml").write_text(lines + "haptic_tag: {static_friction_N: 8.1}}]")
    >>> (box,) = load_objects("objects.yaml")
    >>> box.id, box.tag.static_friction_N.value, box.tag.drift  # the drift was not observed
    ('box', 8.1, None)
    """
    return objects_from_data(load_yaml(path), where=str(path))


def robot_from_data(data: Any, *, where: str = "robot") -> RobotModel:
    """A robot from plain data; only its size has no default: ``radius_m``, or ``footprint``.

    Parameters
    ----------
    data
        Mapping of the robot's fields [m, m/s, N, s]. ``footprint`` lists the corners [x, y] as Nav2 does, also as text.
    where
        Name of the source file, for messages.

    Raises
    ------
    InputError
        Names the field, what was found and what was expected.
    """
    if not isinstance(data, dict) or "footprint" not in data:
        return from_dict(RobotModel, data, where=where)
    others = {name: value for name, value in data.items() if name != "footprint"}
    if "radius_m" in others:
        raise InputError(where, "found a footprint as well", field="radius_m", remedy="leave one of them out")
    corners = data["footprint"]
    if isinstance(corners, str):
        corners = parse_yaml(corners, where=f"{where}: footprint")
    try:
        shape = RobotModel.of_footprint(corners)
    except InputError as error:
        raise InputError(where, error.problem, field="footprint", remedy=error.remedy) from error
    size = {"radius_m": shape.radius_m, "footprint_m": shape.footprint_m}
    return from_dict(RobotModel, {**others, **size}, where=where)


def objects_from_data(data: Any, *, where: str = "objects") -> tuple[MovableObject, ...]:
    """Objects from plain data.

    Parameters
    ----------
    data
        Mapping with a list of ``objects``, each with its ``id``, ``footprint_m`` (corners x, y in the map frame [m]),
        its ``haptic_tag`` if it was explored, ``push: sideward`` for sideward pushes, and
        ``pose_sigma``, the standard deviations of its position [m] and rotation [rad].
    where
        Name of the source file, for messages.

    Raises
    ------
    InputError
        Names the object, the field, what was found and what was expected.
    """

    def made(entry: _Entry) -> MovableObject:
        tag, footprint_m = entry.haptic_tag, entry.footprint_m
        if entry.type == GLASS and tag is None:
            tag, footprint_m = HapticTag(fixed=True), _wider(outline_of(footprint_m, where), GLASS_SAFETY_M)
        return MovableObject(str(entry.id), footprint_m, tag, push=entry.push, pose_sigma=entry.pose_sigma)

    return _made(data, where, made, ("object", GLASS))


def load_passages(path: Path | str) -> tuple[Passage, ...]:
    """Read the doors and elevators of ``objects.yaml``: entries with a ``type``.

    Parameters
    ----------
    path
        File name, see :func:`load_objects`; entries without a type are ignored.

    Raises
    ------
    InputError
        Names the file, the entry, the field, what was found and what was expected.

    Examples
    --------
    >>> from pathlib import Path
    >>> entry = "{id: door, type: door_sliding, open_s: 5, footprint_m: [[2, 0], [2.1, 0], [2.1, 0.9], [2, 0.9]]}"
    >>> _ = Path("objects.yaml").write_text(f"objects: [{entry}]")
    >>> [(passage.id, passage.open_s.value) for passage in load_passages("objects.yaml")]
    [('door', 5.0)]
    """
    return passages_from_data(load_yaml(path), where=str(path))


def passages_from_data(data: Any, *, where: str = "objects") -> tuple[Passage, ...]:
    """Doors and elevators from plain data.

    Parameters
    ----------
    data, where
        See :func:`objects_from_data`; each entry has its ``type``, and ``open_s``, the seconds until it is open.

    Raises
    ------
    InputError
        Names the entry, the field, what was found and what was expected.
    """

    def made(entry: _Entry) -> Passage:
        kind = PassageKind(entry.type)
        return Passage(str(entry.id), entry.footprint_m, kind, entry.open_s, entry.haptic_tag)

    return _made(data, where, made, PASSAGES)


def load_areas(path: Path | str) -> tuple[PlaceArea, ...]:
    """Read the areas of ``objects.yaml`` where pushed objects should end, or should not.

    Parameters
    ----------
    path
        File name, see :func:`load_objects`; entries of other types are ignored.

    Raises
    ------
    InputError
        Names the file, the entry, the field, what was found and what was expected.
    """
    return areas_from_data(load_yaml(path), where=str(path))


def areas_from_data(data: Any, *, where: str = "objects") -> tuple[PlaceArea, ...]:
    """Areas from plain data.

    Parameters
    ----------
    data, where
        See :func:`objects_from_data`; each entry has the type ``avoid`` or ``prefer``, and ``cost_s``, the seconds that a
        better place is worth.

    Raises
    ------
    InputError
        Names the entry, the field, what was found and what was expected.
    """

    def made(entry: _Entry) -> PlaceArea:
        if entry.cost_s is None:
            raise InputError(
                where, "is missing", field="cost_s", remedy="give the seconds a better place is worth"
            )
        return PlaceArea(str(entry.id), entry.footprint_m, entry.cost_s, entry.type == "prefer")

    return _made(data, where, made, AREAS)


def glass_objects(hulls_m: Iterable[Float[np.ndarray, "n 3"]]) -> tuple[MovableObject, ...]:
    """Transparent parts as objects to avoid: each with its safety region, like an entry of the type ``glass``.

    Parameters
    ----------
    hulls_m
        Points (n, 3) around each part, in the map frame [m], as the hulls of a reconstruction.

    Raises
    ------
    InputError
        A part has no area seen from above.
    """
    import shapely

    seen = (shapely.MultiPoint(np.asarray(points_m)[:, :2]).convex_hull for points_m in hulls_m)
    outlines = [shapely.get_coordinates(hull)[:-1].tolist() for hull in seen]
    entries = [
        {"id": f"{GLASS}-{number}", "type": GLASS, "footprint_m": outline}
        for number, outline in enumerate(outlines, 1)
    ]
    return objects_from_data({"objects": entries}, where=GLASS)


def _made(data: Any, where: str, make: Callable[[_Entry], T], kinds: Iterable[str]) -> tuple[T, ...]:
    """Convert the entries of some types with a function."""
    found = []
    for index, entry in enumerate(_entries(data, where)):
        if entry.type in kinds:
            try:
                found.append(make(entry))
            except InputError as error:
                place = f"objects[{index}].{error.field}"
                raise InputError(where, error.problem, field=place, remedy=error.remedy) from error
    return tuple(found)


def _entries(data: Any, where: str) -> tuple[_Entry, ...]:
    """Entries with distinct names and known types."""
    listed = data.get("objects") if isinstance(data, dict) else None
    if isinstance(listed, list) and len(listed) > MAX_OBJECTS:
        raise InputError(where, f"found {len(listed)}, expected at most {MAX_OBJECTS}", field="objects")
    entries = from_dict(_File, data, where=where).objects or ()
    names: list[str] = []
    for index, entry in enumerate(entries):
        name, field = str(entry.id), f"objects[{index}].id"
        if not name.strip():
            raise InputError(where, f"found {name!r}, expected a name", field=field)
        for foreign in _FOREIGN[entry.type]:
            if getattr(entry, foreign) is not None:
                place = f"objects[{index}].{foreign}"
                raise InputError(where, f"has no meaning for the type {entry.type}", field=place)
        if name in names:
            known = f"objects[{names.index(name)}]"
            raise InputError(where, f"found {name!r}, which {known} has already", field=field)
        names.append(name)
    return entries


def _wider(outline_m: Float[np.ndarray, "p 2"], room_m: float) -> Float[np.ndarray, "q 2"]:
    """An outline with a margin around it."""
    import shapely

    return np.array(shapely.Polygon(outline_m).buffer(room_m, join_style="mitre").exterior.coords)[:-1]
