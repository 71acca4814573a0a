"""Outlines from the ``d`` attribute of an SVG path (https://www.w3.org/TR/SVG11/paths.html)."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from visuohaptic.core import InputError

__all__ = ["outline_from_svg_path"]

_TOKEN = re.compile(r"[MmLlHhVvCcSsQqTtAaZz]|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[^\s,]")
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
#: Points per curve.
_STEPS = 8


def outline_from_svg_path(text: str, *, where: str = "path") -> Float[np.ndarray, "p 2"]:
    """Corners of a path's first closed piece; curves become short chords.

    Raises
    ------
    InputError
        Something that is no path, or one with fewer than three corners.
    """
    tokens = _TOKEN.findall(text)
    points: list[complex] = []
    at = start = 0j
    control: complex | None = None
    command = ""
    position = 0
    pieces = 0
    while position < len(tokens):
        token = tokens[position]
        if token.upper() in _COUNTS:
            command = token
            position += 1
        elif not command:
            raise InputError(where, f"found {token!r}, expected a path that begins with M", field="d")
        kind = command.upper()
        if kind == "Z":
            at, control = start, None
            if position < len(tokens) and tokens[position].upper() not in _COUNTS:
                raise InputError(where, "found numbers after Z, expected a command", field="d")
            continue
        try:
            numbers = [float(value) for value in tokens[position : position + _COUNTS[kind]]]
        except ValueError as error:
            raise InputError(where, f"{error}, expected numbers", field="d") from error
        if len(numbers) < _COUNTS[kind]:
            raise InputError(where, "ends in the middle of a command", field="d")
        position += _COUNTS[kind]
        origin = at if command.islower() else 0j
        if kind == "M":
            pieces += 1
            if pieces > 1:
                break  # holes and further pieces are not part of an outline
            at = start = origin + complex(numbers[0], numbers[1])
            points.append(at)
            command = "l" if command == "m" else "L"
            continue
        if kind in "LHV":
            if kind == "L":
                at = origin + complex(numbers[0], numbers[1])
            elif kind == "H":
                at = complex(origin.real + numbers[0], at.imag)
            else:
                at = complex(at.real, origin.imag + numbers[0])
            points.append(at)
            control = None
            continue
        if kind == "A":
            end = origin + complex(numbers[5], numbers[6])
            points += _arc(at, end, numbers)
            at, control = end, None
            continue
        pairs = [origin + complex(x, y) for x, y in zip(numbers[::2], numbers[1::2], strict=True)]
        mirrored = 2 * at - control if control is not None else at
        if kind in "ST":
            pairs = [mirrored, *pairs]
        points += _bezier([at, *pairs])
        control, at = pairs[-2], pairs[-1]
    outline = np.array([[point.real, point.imag] for point in points]).reshape(-1, 2)
    if len(outline):
        outline = outline[np.hypot(*(outline - np.roll(outline, 1, axis=0)).T) > 1e-9]
    if len(outline) < 3 or not np.isfinite(outline).all():
        raise InputError(where, f"found {len(outline)} distinct corners, expected at least 3", field="d")
    return outline


def _bezier(control: list[complex]) -> list[complex]:
    """Points after the first of a Bezier curve of any order, by de Casteljau."""
    found = []
    for step in range(1, _STEPS + 1):
        t = step / _STEPS
        level = control
        while len(level) > 1:
            level = [a + t * (b - a) for a, b in pairwise(level)]
        found.append(level[0])
    return found


def _arc(start: complex, end: complex, numbers: list[float]) -> list[complex]:
    """Points after the first of an elliptic arc (SVG 1.1, appendix F.6.5)."""
    rx, ry, turn_deg, large, sweep = numbers[:5]
    rx, ry = abs(rx), abs(ry)
    if rx == 0 or ry == 0 or start == end:
        return [end]
    phi = math.radians(turn_deg)
    spin = complex(math.cos(phi), math.sin(phi))
    half = (start - end) / 2 / spin
    x, y = half.real / rx, half.imag / ry
    scale = math.sqrt(max(1.0, x * x + y * y))
    rx, ry, x, y = rx * scale, ry * scale, x / scale, y / scale
    square = x * x + y * y
    factor = math.sqrt(max(0.0, (1.0 - square) / square)) * (1 if large != sweep else -1)
    cx, cy = factor * y, -factor * x
    first = math.atan2(y - cy, x - cx)
    angle = math.atan2(-y - cy, -x - cx) - first
    if sweep and angle < 0:
        angle += 2 * math.pi
    elif not sweep and angle > 0:
        angle -= 2 * math.pi
    centre = complex(rx * cx, ry * cy) * spin + (start + end) / 2
    found = []
    for step in range(1, _STEPS):
        a = first + angle * step / _STEPS
        found.append(complex(rx * math.cos(a), ry * math.sin(a)) * spin + centre)
    return [*found, end]
