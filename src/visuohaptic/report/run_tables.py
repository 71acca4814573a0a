"""Haptic tags as rows and lines for people: value with its uncertainty, or "not observed"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.objects import Estimate, HapticTag, Primitive, PrimitiveKind

__all__ = ["estimate_text", "primitive_text", "tag_rows", "tag_text"]

#: Heading (with unit) -> field of the tag.
_COLUMNS = {
    "static friction [N]": "static_friction_N",
    "dynamic friction [N]": "dynamic_friction_N",
    "deceleration [s]": "deceleration_s",
    "drift [m/m]": "drift",
    "deformability [m/m]": "deformability",
    "stiffness [N/m]": "stiffness_N_per_m",
    "rotation [rad/m]": "rotation_rad_per_m",
    "contact offset [m]": "contact_offset_m",
}


def estimate_text(estimate: Estimate | None) -> str | None:
    """``1.23 ± 0.05``, and ``(spread 0.2)`` when it varies over contacts; ``None`` if not observed.

    Sigma keeps one digit, or two when it begins with 1 or 2.

    Parameters
    ----------
    estimate
        Value, sigma and spread.
    """
    if estimate is None:
        return None
    decimals = 3 if estimate.sigma <= 0 else int(np.clip(np.ceil(-np.log10(estimate.sigma) + 0.48), 0, 6))
    text = f"{estimate.value:.{decimals}f} ± {estimate.sigma:.{decimals}f}"
    return f"{text} (spread {estimate.spread:.{decimals}f})" if estimate.spread > 0 else text


def primitive_text(primitive: Primitive | None) -> str | None:
    """The kind of a primitive and its size, in millimetres and degrees.

    Parameters
    ----------
    primitive
        Fitted shape; ``None``: no shape.
    """
    if primitive is None:
        return None
    values = np.asarray(primitive.parameters, dtype=np.float64)
    if primitive.kind is PrimitiveKind.CIRCLE:
        sigma_mm = 1e3 * float(np.sqrt(max(primitive.covariance[2, 2], 0.0)))
        return f"circle, radius {1e3 * values[2]:.1f} ± {sigma_mm:.1f} mm"
    if primitive.kind is PrimitiveKind.SEGMENT:
        return f"segment, {1e3 * float(np.hypot(*(values[2:4] - values[:2]))):.1f} mm long"
    if primitive.kind is PrimitiveKind.CORNER:
        opening = np.degrees(np.abs(np.angle(np.exp(1j * (values[3] - values[2])))))
        return f"corner of {opening:.0f}°"
    return f"{primitive.kind}, {np.degrees(values[2]):.0f}°"


def tag_rows(tags: Mapping[str, HapticTag]) -> list[dict[str, Any]]:
    """One row per object; properties that no object showed have no column.

    Parameters
    ----------
    tags
        Tag of each object by name.
    """
    rows = []
    shown = {
        heading: field
        for heading, field in _COLUMNS.items()
        if any(getattr(tag, field) is not None for tag in tags.values())
    }
    for name, tag in tags.items():
        row: dict[str, Any] = {"object": name, "fixed": tag.fixed, "falls": tag.falls}
        row |= {heading: estimate_text(getattr(tag, field)) for heading, field in shown.items()}
        row |= {"shape": primitive_text(tag.primitive), "explored": tag.explored, "failed": tag.failed}
        rows.append(row)
    return rows


def tag_text(tag: HapticTag) -> str:
    """The most telling property of a tag, in a few words.

    Parameters
    ----------
    tag
        Of one object.
    """
    if tag.fixed:
        return "fixed"
    parts = []
    if tag.dynamic_friction_N is not None:
        friction = replace(tag.dynamic_friction_N, spread=0.0)
        parts.append(f"friction {estimate_text(friction)} N")
    elif tag.fixed is not None:
        parts.append("movable")
    elif tag.min_static_friction_N is not None:
        parts.append(f"needs more than {tag.min_static_friction_N:.1f} N")
    if tag.falls:
        parts.append("falls")
    return ", ".join(parts) or "nothing observed"
