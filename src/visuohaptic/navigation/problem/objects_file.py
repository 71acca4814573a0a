"""Readers of ``objects.yaml`` and ``robot.yaml``: strict, and clear about what they refuse."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.codec import from_dict
from ...core.errors import InputError
from ...core.files import load_yaml
from ...core.objects import HapticTag
from .planning_problem import MovableObject, RobotModel

__all__ = ["load_objects", "load_robot", "objects_from_data", "robot_from_data"]

#: More objects than this on one map are a mistake of the writer.
MAX_OBJECTS = 10_000


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """One object of the file."""

    id: int | str
    footprint_m: Float[np.ndarray, "p 2"]
    haptic_tag: HapticTag | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    objects: tuple[_Entry, ...] | None


def load_robot(path: Path | str) -> RobotModel:
    """Read ``robot.yaml``.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        Names the file, the field, what was found and what was expected.
    """
    return robot_from_data(load_yaml(path), where=str(path))


def load_objects(path: Path | str) -> tuple[MovableObject, ...]:
    """Read ``objects.yaml``: footprints with tags.

    A tag's field that is missing or null was not observed; an object without
    a ``haptic_tag`` is unknown.

    Parameters
    ----------
    path
        The file.

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
    """A robot from plain data; only ``radius_m`` has no default.

    Parameters
    ----------
    data
        Mapping of the robot's fields [m, m/s, N, s].
    where
        File that it comes from, for messages.

    Raises
    ------
    InputError
        Names the field, what was found and what was expected.
    """
    return from_dict(RobotModel, data, where=where)


def objects_from_data(data: Any, *, where: str = "objects") -> tuple[MovableObject, ...]:
    """Objects from plain data.

    Parameters
    ----------
    data
        Mapping with a list of ``objects``: of each its ``id``, ``footprint_m`` (corners x, y in the map frame [m])
        and, where it was explored, its ``haptic_tag``.
    where
        File that it comes from, for messages.

    Raises
    ------
    InputError
        Names the object, the field, what was found and what was expected.
    """
    entries = data.get("objects") if isinstance(data, dict) else None
    if isinstance(entries, list) and len(entries) > MAX_OBJECTS:
        raise InputError(where, f"found {len(entries)}, expected at most {MAX_OBJECTS}", field="objects")
    found: dict[str, MovableObject] = {}
    for index, entry in enumerate(from_dict(_File, data, where=where).objects or ()):
        name = str(entry.id)
        if not name.strip():
            raise InputError(where, f"found {name!r}, expected a name", field=f"objects[{index}].id")
        if name in found:
            first = list(found).index(name)
            raise InputError(
                where, f"found {name!r}, which objects[{first}] has already", field=f"objects[{index}].id"
            )
        try:
            found[name] = MovableObject(name, entry.footprint_m, entry.haptic_tag)
        except InputError as error:
            place = f"objects[{index}].{error.field}"
            raise InputError(where, error.problem, field=place, remedy=error.remedy) from error
    return tuple(found.values())
