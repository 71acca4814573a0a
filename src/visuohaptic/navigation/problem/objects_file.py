"""Readers of ``objects.yaml`` and ``robot.yaml``: strict, and clear about what they refuse."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError, brief
from ...core.files import load_yaml
from ...core.objects import Estimate, HapticTag
from .planning_problem import MovableObject, RobotModel

__all__ = ["load_objects", "load_robot", "objects_from_data", "robot_from_data"]

_ROBOT_FIELDS = (
    "radius_m",
    "v_max_m_s",
    "v_min_m_s",
    "v_push_m_s",
    "push_force_max_N",
    "setup_time_s",
    "push_margin_m",
)
_ESTIMATES = (
    "static_friction_N",
    "dynamic_friction_N",
    "drift",
    "rotation_rad_per_m",
    "deformability",
    "deceleration_s",
    "stiffness_N_per_m",
    "contact_offset_m",
)
#: Estimates that have no sign.
_NOT_NEGATIVE = {
    "static_friction_N",
    "dynamic_friction_N",
    "deceleration_s",
    "deformability",
    "stiffness_N_per_m",
}
_BOUNDS = ("min_static_friction_N",)
_FLAGS = ("fixed", "falls")
_COUNTERS = ("explored", "failed")
#: Written by the sensor, of no use to the planner.
_IGNORED = ("primitive", "deformation_shape_m")
_PARTS = ("value", "sigma", "spread", "samples")
#: More objects than this on one map are a mistake of the writer.
MAX_OBJECTS = 10_000


def load_robot(path: Path | str) -> RobotModel:
    """Read ``robot.yaml``.

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
    """A robot from plain data; only ``radius_m`` has no default."""
    fields = _mapping(data, where, "")
    _only(fields, _ROBOT_FIELDS, where, "")
    if fields.get("radius_m") is None:
        raise InputError(where, "is missing, expected a number > 0", field="radius_m")
    values = {name: _number(fields[name], where, name) for name in _ROBOT_FIELDS if name in fields}
    try:
        return RobotModel(**values)
    except InputError as error:
        raise InputError(where, error.problem, field=error.field) from error


def objects_from_data(data: Any, *, where: str = "objects") -> tuple[MovableObject, ...]:
    """Objects from plain data."""
    top = _mapping(data, where, "")
    _only(top, ("objects",), where, "")
    if "objects" not in top:
        raise InputError(where, "is missing, expected a list of objects", field="objects")
    entries = top["objects"]
    if entries is None:
        return ()
    if not isinstance(entries, list):
        raise InputError(where, f"found {type(entries).__name__}, expected a list", field="objects")
    if len(entries) > MAX_OBJECTS:
        raise InputError(where, f"found {len(entries)}, expected at most {MAX_OBJECTS}", field="objects")
    found: list[MovableObject] = []
    seen: dict[str, int] = {}
    for index, entry in enumerate(entries):
        item = _object(entry, where, f"objects[{index}]")
        if item.id in seen:
            raise InputError(
                where,
                f"found '{item.id}', which objects[{seen[item.id]}] has already",
                field=f"objects[{index}].id",
            )
        seen[item.id] = index
        found.append(item)
    return tuple(found)


def _object(entry: Any, where: str, place: str) -> MovableObject:
    fields = _mapping(entry, where, place)
    _only(fields, ("id", "footprint_m", "haptic_tag"), where, place)
    for name in ("id", "footprint_m"):
        if fields.get(name) is None:
            raise InputError(where, "is missing", field=f"{place}.{name}")
    name = fields["id"]
    if isinstance(name, bool) or not isinstance(name, str | int) or not str(name).strip():
        raise InputError(where, f"found {brief(name)}, expected a name", field=f"{place}.id")
    raw = fields["footprint_m"]
    if not isinstance(raw, list) or not all(isinstance(row, list) and len(row) == 2 for row in raw):
        raise InputError(where, "expected a list of [x, y] corners", field=f"{place}.footprint_m")
    corners = [[_number(value, where, f"{place}.footprint_m") for value in row] for row in raw]
    tag = fields.get("haptic_tag")
    try:
        return MovableObject(
            str(name),
            np.array(corners, dtype=np.float64).reshape(-1, 2),
            None if tag is None else _tag(tag, where, f"{place}.haptic_tag"),
        )
    except InputError as error:
        if error.where == where:
            raise
        raise InputError(where, error.problem, field=f"{place}.{error.field}", remedy=error.remedy) from error


def _tag(data: Any, where: str, place: str) -> HapticTag:
    fields = _mapping(data, where, place)
    _only(fields, (*_ESTIMATES, *_BOUNDS, *_FLAGS, *_COUNTERS, *_IGNORED), where, place)
    values: dict[str, Any] = {
        name: _estimate(fields.get(name), where, f"{place}.{name}") for name in _ESTIMATES
    }
    for name in _NOT_NEGATIVE:
        if values[name] is not None and values[name].value < 0:
            raise InputError(where, f"found {values[name].value:g}, expected >= 0", field=f"{place}.{name}")
    for name in _BOUNDS:
        bound = fields.get(name)
        values[name] = None if bound is None else _number(bound, where, f"{place}.{name}")
    for name in _FLAGS:
        flag = fields.get(name)
        if flag is not None and not isinstance(flag, bool):
            raise InputError(
                where, f"found {brief(flag)}, expected true, false or null", field=f"{place}.{name}"
            )
        values[name] = flag
    for name in _COUNTERS:
        counter = fields.get(name)
        counter = 0 if counter is None else counter
        if isinstance(counter, bool) or not isinstance(counter, int) or counter < 0:
            raise InputError(where, f"found {brief(counter)}, expected a count >= 0", field=f"{place}.{name}")
        values[name] = counter
    return HapticTag(**values)


def _estimate(entry: Any, where: str, place: str) -> Estimate | None:
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        return Estimate(_number(entry, where, place), 0.0)
    _only(entry, _PARTS, where, place)
    if entry.get("value") is None:
        raise InputError(where, "is missing", field=f"{place}.value")
    numbers = {part: _number(entry[part], where, f"{place}.{part}") for part in entry}
    sigma, spread = numbers.get("sigma", 0.0), numbers.get("spread", 0.0)
    samples = numbers.get("samples", 1.0)
    if sigma < 0 or spread < 0 or samples < 1 or samples != int(samples):
        raise InputError(
            where,
            f"found sigma {sigma:g}, spread {spread:g}, samples {samples:g}; "
            "expected sigma and spread >= 0, samples a whole number >= 1",
            field=place,
        )
    return Estimate(numbers["value"], sigma, spread, int(samples))


def _mapping(data: Any, where: str, place: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise InputError(where, f"found {type(data).__name__}, expected a mapping of fields", field=place)
    return data


def _only(fields: Mapping[str, Any], known: tuple[str, ...], where: str, place: str) -> None:
    for name in fields:
        if name not in known:
            raise InputError(
                where,
                f"is unknown, expected one of {', '.join(known)}",
                field=f"{place}.{name}" if place else str(name),
            )


def _number(value: Any, where: str, place: str) -> float:
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)  # YAML 1.1 reads 1e-3 as a text
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(where, f"found {brief(value)}, expected a finite number", field=place)
    return float(value)
