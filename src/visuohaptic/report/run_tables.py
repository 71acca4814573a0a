"""Haptic tags as text: value with its uncertainty, or "not observed"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..core.objects import Estimate, HapticTag, Primitive, PrimitiveKind


def estimate_text(estimate: Estimate | None) -> str | None:
    """``1.23 ± 0.05``, with ``(spread 0.2)`` if it varies over contacts; ``None`` if not observed.

    Sigma is rounded to one digit, or two if it starts with 1 or 2.

    Parameters
    ----------
    estimate
        Value, sigma and spread.
    """
    if estimate is None:
        return None
    decimals = 3
    if 0 < estimate.sigma < np.inf:
        lead, exponent = f"{estimate.sigma:.1e}".split("e")
        decimals = int(np.clip((lead < "3") - int(exponent), 0, 6))
    text = f"{estimate.value:.{decimals}f} ± {estimate.sigma:.{decimals}f}"
    return f"{text} (spread {estimate.spread:.{decimals}f})" if estimate.spread > 0 else text


def primitive_text(primitive: Primitive | None) -> str | None:
    """Type and size of a primitive, in millimetres and degrees.

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


def tag_text(tag: HapticTag) -> str:
    """Short text with the most informative property of a tag.

    Parameters
    ----------
    tag
        Tag of one object.
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
        parts.append("topples")
    return ", ".join(parts) or "nothing observed"
