"""Outline of an object after a push, from the shape measured by the foam and the outline measured by the laser."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...core import Primitive, PrimitiveKind, compose_2d, relative_2d
from .explore import ObstacleExploration
from .floor_outline import FloorOutline


def footprint_after_push(found: ObstacleExploration, seen: FloorOutline, *, front_m: float) -> FloorOutline:
    """Outline of the object where it was left after the push.

    A cylinder or the near side of a box is that of the foam; the depth of a box is that of the laser. Without a shape, the
    laser's outline is moved ahead to where the foam was.

    Parameters
    ----------
    found
        The exploration.
    seen
        Outline by the laser before the push, map frame.
    front_m
        Distance from the platform's centre to the origin of the foam's frame F, x ahead [m].
    """
    state, shape = found.fit_state, found.tag.primitive
    if state is None:
        return seen
    foam = compose_2d((state.x_m, state.y_m, state.heading_rad), (front_m, 0.0, 0.0))
    felt = None if shape is None else _felt(shape, seen)
    if felt is not None:
        return replace(felt, pose=compose_2d(foam, felt.pose))
    ahead = relative_2d(seen.pose, foam)[0]
    return replace(seen, pose=compose_2d(seen.pose, (max(ahead, 0.0), 0.0, 0.0)))


def _felt(shape: Primitive, seen: FloorOutline) -> FloorOutline | None:
    """Outline in frame F; ``None`` for shapes without an end."""
    values = np.asarray(shape.parameters, dtype=float)
    if shape.kind is PrimitiveKind.CIRCLE and 0.01 < values[2] < 0.4:
        x, y, radius = (float(value) for value in values[:3])
        width, sigma = 2.0 * radius, 2.0 * math.sqrt(float(shape.covariance[2, 2]))
        return FloorOutline(True, (x - radius, y, 0.0), (width, width), (sigma, sigma))
    if shape.kind is PrimitiveKind.SEGMENT:
        a, b = values[:2], values[2:4]
        width = float(np.hypot(*(b - a)))
        if not 0.01 < width < 0.8:
            return None
        along = np.concatenate([a - b, b - a]) / width
        sigma = math.sqrt(float(along @ shape.covariance @ along))
        # Into the object, away from the platform.
        x, y = (b - a)[::-1] * (-1.0, 1.0) * (-1.0 if b[1] > a[1] else 1.0)
        middle = 0.5 * (a + b)
        return FloorOutline(
            False, (float(middle[0]), float(middle[1]), math.atan2(y, x)),
            (width, seen.size_m[1]), (sigma, seen.sigma_m[1]),
        )  # fmt: skip
    return None
