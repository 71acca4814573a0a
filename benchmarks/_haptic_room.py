"""A small room mapped by touch: ground truth and contacts generated independently of the haptic map."""

from __future__ import annotations

import numpy as np
from shapely import LineString, Point, Polygon, contains_xy, prepare
from shapely.geometry import box

from visuohaptic.core import Primitive, PrimitiveKind
from visuohaptic.navigation.mapping import HapticContact, HapticMap

STRIP_M = 0.2  #: width of the foam that touches
NOISE_M = 0.0005
POSE_NOISE = (0.005, 0.005)  #: of odometry and IMU [m, rad]


def room(rng: np.random.Generator) -> tuple[Polygon, list[tuple[Point, bool]]]:
    """Free space inside the walls (with a pillar in a corner), and round objects (shape, movable)."""
    wide, deep = rng.uniform(2.6, 3.4), rng.uniform(2.2, 2.8)
    pillar = rng.uniform(0.3, 0.5)
    inner = box(0, 0, wide, deep).difference(box(wide - pillar, deep - pillar, wide, deep))
    things = [
        (Point(rng.uniform(0.15, 0.2) + 0.25, deep * 0.5).buffer(rng.uniform(0.08, 0.14)), True),
        (Point(wide * 0.55, 0.35).buffer(rng.uniform(0.1, 0.16)), True),
    ]
    return inner, things


def touch(
    inner: Polygon, things: list[tuple[Point, bool]], place: np.ndarray, yaw: float, rng: np.random.Generator
) -> HapticContact | None:
    """Drive straight until contact; return the primitive fitted to the contact."""
    solid = [(inner.exterior, False), *((thing.exterior, movable) for thing, movable in things)]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    side = np.array([-ahead[1], ahead[0]])
    offsets = np.linspace(-STRIP_M / 2, STRIP_M / 2, 21)
    reach = np.full(len(offsets), np.inf)
    which = np.full(len(offsets), -1)
    for number, offset in enumerate(offsets):
        start = place + offset * side
        ray = LineString([start, start + 8 * ahead])
        for index, (edge, _) in enumerate(solid):
            hit = ray.intersection(edge)
            if not hit.is_empty and (far := hit.distance(Point(start))) < reach[number]:
                reach[number], which[number] = far, index
    front = reach.min()
    # The foam deflects by 1.5 cm: surfaces farther back are not touched.
    felt = (reach < front + 0.015) & (which == which[int(np.argmin(reach))])
    if not np.isfinite(front) or felt.sum() < 5:
        return None
    points = np.column_stack([reach[felt] - front, offsets[felt]])
    points += np.array([NOISE_M, 0]) * rng.standard_normal((len(points), 1))
    index = int(which[int(np.argmin(reach))])
    if index == 0:
        slope, level = np.polyfit(points[:, 1], points[:, 0], 1)
        parameters = np.array([level, 0.0, np.arctan2(1.0, slope)])
        primitive = Primitive(PrimitiveKind.LINE, parameters, np.eye(3), 0.9)
    else:
        # Radius to 5 %, the centre behind the tip.
        radius = np.sqrt(things[index - 1][0].area / np.pi) * (1 + 0.05 * rng.standard_normal())
        tip = points[int(np.argmin(points[:, 0]))]
        primitive = Primitive(
            PrimitiveKind.CIRCLE, np.array([tip[0] + radius, points[:, 1].mean(), radius]), np.eye(3), 0.9
        )
    at = place + front * ahead
    drift = rng.standard_normal(3) * [POSE_NOISE[0], POSE_NOISE[0], POSE_NOISE[1]]
    pose = (float(at[0] + drift[0]), float(at[1] + drift[1]), float(yaw + drift[2]))
    return HapticContact(primitive, points, pose, confidence=0.9, movable=index > 0)


def explore(
    rng: np.random.Generator, contacts: int = 22, resolution_m: float = 0.025
) -> tuple[HapticMap, Polygon, list[tuple[Point, bool]]]:
    """Contacts at regular intervals along the circumference, perpendicular to the wall within a few degrees."""
    inner, things = room(rng)
    left, low, right, high = inner.bounds
    haptic = HapticMap.empty((left - 0.5, low - 0.5), (right - left + 1.0, high - low + 1.0), resolution_m)
    ring = inner.exterior
    free = inner.buffer(-0.3)
    for thing, _ in things:
        free = free.difference(thing.buffer(0.2))
    for number in range(contacts):
        along = (number + 0.5) / contacts * ring.length
        near = ring.interpolate(along)
        step = ring.interpolate(along + 0.01)
        forward = np.array([step.x - near.x, step.y - near.y])
        forward /= np.hypot(*forward)
        normal = np.array([forward[1], -forward[0]]) * (1 if ring.is_ccw else -1)
        place = np.array([near.x, near.y]) - 0.75 * normal
        yaw = float(np.arctan2(normal[1], normal[0]) + 0.05 * rng.standard_normal())
        found = touch(inner, things, place, yaw, rng)
        if found is not None:
            haptic.add(found)
    return haptic, inner, things


def iou(haptic: HapticMap, inner: Polygon, things: list[tuple[Point, bool]], wall_m: float = 0.1) -> float:
    """IoU of occupied space: walls of thickness ``wall_m`` and the objects; space outside the walls is ignored."""
    rows, columns = haptic.static.shape
    x = haptic.origin_m[0] + (np.arange(columns) + 0.5) * haptic.resolution_m
    y = haptic.origin_m[1] + (np.arange(rows) + 0.5) * haptic.resolution_m
    gx, gy = np.meshgrid(x, y)
    outer = inner.buffer(wall_m, join_style="mitre")
    for shape in (inner, outer):
        prepare(shape)
    looked_at = contains_xy(outer, gx, gy)
    truth = looked_at & ~contains_xy(inner, gx, gy)
    for thing, _ in things:
        truth |= contains_xy(thing, gx, gy)
    told = haptic.occupancy().occupied & looked_at
    return float((told & truth).sum() / (told | truth).sum())


__all__ = ["explore", "iou", "room", "touch"]
