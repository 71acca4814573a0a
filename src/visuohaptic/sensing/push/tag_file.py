"""A haptic tag as plain data, for YAML files and messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...core.errors import InputError, brief
from ...core.objects import Estimate, HapticTag, Primitive, PrimitiveKind

__all__ = ["tag_from_dict", "tag_to_dict"]

_ESTIMATES = (
    "static_friction_N",
    "dynamic_friction_N",
    "deceleration_s",
    "drift",
    "deformability",
    "stiffness_N_per_m",
    "rotation_rad_per_m",
    "contact_offset_m",
)
_BOUNDS = ("min_static_friction_N",)
_FLAGS = ("fixed", "falls")
_COUNTERS = {"explored": "explored", "failed": "failed"}
_SHAPES = ("primitive", "deformation_shape_m")
_PARTS = ("value", "sigma", "spread", "samples")
_PARAMETER_COUNT = {"line": 3, "segment": 4, "corner": 4, "circle": 3}


def tag_to_dict(tag: HapticTag) -> dict[str, Any]:
    """A tag as numbers, lists and texts; what was not observed is None.

    Parameters
    ----------
    tag
        Haptic tag of one object.
    """
    data: dict[str, Any] = {}
    for name in _ESTIMATES:
        estimate = getattr(tag, name)
        data[name] = None if estimate is None else {part: getattr(estimate, part) for part in _PARTS}
    for name in (*_BOUNDS, *_FLAGS, *_COUNTERS):
        data[name] = getattr(tag, name)
    if tag.primitive is not None:
        data["primitive"] = {
            "kind": str(tag.primitive.kind),
            "parameters": [float(value) for value in tag.primitive.parameters],
            "covariance": [[float(value) for value in row] for row in tag.primitive.covariance],
            "score": float(tag.primitive.score),
        }
    if tag.deformation_shape_m is not None:
        data["deformation_shape_m"] = [[float(x), float(y)] for x, y in tag.deformation_shape_m]
    return data


def tag_from_dict(data: Mapping[str, Any], *, where: str = "haptic_tag") -> HapticTag:
    """Read a tag; plain numbers are accepted for estimates (sigma 0: not stated).

    Parameters
    ----------
    data
        Fields by name, as of :func:`tag_to_dict`.
    where
        What error messages name.

    Raises
    ------
    InputError
        Unknown fields, or values of the wrong kind, with the field's name.
    """
    if not isinstance(data, Mapping):
        raise InputError(where, f"found {type(data).__name__}, expected a mapping of fields")
    known = (*_ESTIMATES, *_BOUNDS, *_FLAGS, *_COUNTERS, *_SHAPES)
    for name in data:
        if name not in known:
            raise InputError(where, f"is unknown, expected one of {', '.join(known)}", field=str(name))
    values: dict[str, Any] = {}
    for name in _ESTIMATES:
        values[name] = _estimate(data.get(name), where, name)
    for name in _BOUNDS:
        values[name] = None if data.get(name) is None else _number(data[name], where, name)
    for name in _FLAGS:
        flag = data.get(name)
        if flag is not None and not isinstance(flag, bool):
            raise InputError(where, f"found {brief(flag)}, expected true, false or null", field=name)
        values[name] = flag
    for name in _COUNTERS:
        counter = data.get(name, 0)
        if isinstance(counter, bool) or not isinstance(counter, int) or counter < 0:
            raise InputError(where, f"found {brief(counter)}, expected a count >= 0", field=name)
        values[name] = counter
    if data.get("primitive") is not None:
        values["primitive"] = _primitive(data["primitive"], where)
    if data.get("deformation_shape_m") is not None:
        values["deformation_shape_m"] = _array(
            data["deformation_shape_m"], where, "deformation_shape_m", (2,)
        )
    return HapticTag(**values)


def _number(value: Any, where: str, field: str) -> float:
    if isinstance(value, str):
        try:
            value = float(value)  # YAML 1.1 reads 1e-3 as a text
        except ValueError:
            value = None
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(where, f"found {brief(value)}, expected a finite number", field=field)
    return float(value)


def _estimate(entry: Any, where: str, name: str) -> Estimate | None:
    if entry is None:
        return None
    if not isinstance(entry, Mapping):
        return Estimate(_number(entry, where, name), 0.0)
    for part in entry:
        if part not in _PARTS:
            raise InputError(where, f"is unknown, expected {', '.join(_PARTS)}", field=f"{name}.{part}")
    if "value" not in entry:
        raise InputError(where, "is missing", field=f"{name}.value")
    numbers = {part: _number(entry[part], where, f"{name}.{part}") for part in entry}
    samples = numbers.get("samples", 1.0)
    if samples != int(samples) or samples < 1:
        raise InputError(where, f"found {samples}, expected a whole number >= 1", field=f"{name}.samples")
    sigma, spread = numbers.get("sigma", 0.0), numbers.get("spread", 0.0)
    if sigma < 0 or spread < 0:
        raise InputError(where, f"found sigma {sigma}, spread {spread}, expected >= 0", field=name)
    return Estimate(numbers["value"], sigma, spread, int(samples))


def _array(entry: Any, where: str, field: str, row: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(entry, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(where, "found something else than numbers", field=field) from error
    if array.shape[1:] != row or not np.all(np.isfinite(array)):
        raise InputError(where, f"found shape {array.shape}, expected rows of shape {row}", field=field)
    return array


def _primitive(entry: Any, where: str) -> Primitive:
    if not isinstance(entry, Mapping) or entry.get("kind") not in _PARAMETER_COUNT:
        expected = ", ".join(_PARAMETER_COUNT)
        raise InputError(where, f"expected a mapping with kind one of {expected}", field="primitive")
    count = _PARAMETER_COUNT[entry["kind"]]
    parameters = _array(entry.get("parameters"), where, "primitive.parameters", ())
    covariance = _array(
        entry.get("covariance", np.zeros((count, count))), where, "primitive.covariance", (count,)
    )
    if len(parameters) != count or len(covariance) != count:
        raise InputError(where, f"found {len(parameters)} parameters, expected {count}", field="primitive")
    score = _number(entry.get("score", 0.0), where, "primitive.score")
    return Primitive(PrimitiveKind(entry["kind"]), parameters, covariance, score)
