"""Random objects and paths for the sideward push, and MuJoCo's result for each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from visuohaptic.core.geometry import polygon_centroid
from visuohaptic.navigation.pushing import PushModel, arc_path, load_of_feet, patch_points
from visuohaptic.reproduce.pushes import FloorBody, FloorPush, FloorTrace

RADIUS_M = 0.17
KINDS = ("box", "disc", "polygon", "ell")


@dataclass(frozen=True, slots=True, eq=False)
class PushCase:
    """One drive of a metre against one object."""

    kind: str
    thing: FloorBody
    model: PushModel  #: what the planner is told: true outline, supports, frictions
    start_m: tuple[float, float, float]
    path_m: Float[np.ndarray, "k 3"]

    def truth(self, **options: float) -> FloorTrace:
        """Result of MuJoCo."""
        world = FloorPush(self.thing, self.start_m, self.path_m[0], RADIUS_M, **options)
        return world.drive(self.path_m)


def random_case(rng: np.random.Generator, index: int) -> PushCase:
    """A box, disc, polygon or L shape on feet or on a flat bottom, met by a line or an arc."""
    kind = KINDS[index % len(KINDS)]
    flat = bool(rng.random() < 0.4)
    round_m = 0.005
    if kind == "box":
        half = 0.5 * rng.uniform(0.15, 0.6, 2)
        outline = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    elif kind == "disc":
        outline, round_m = np.zeros((1, 2)), float(rng.uniform(0.07, 0.25))
    elif kind == "polygon":
        outline = _random_polygon(rng)
    else:
        a, b = rng.uniform(0.25, 0.5, 2)
        c, d = rng.uniform(0.08, 0.6) * a, rng.uniform(0.08, 0.6) * b
        outline = np.array([[0, 0], [a, 0], [a, d], [c, d], [c, b], [0, b]], dtype=float)
        outline = outline - polygon_centroid(outline)
    feet = _feet(rng, kind, outline, round_m, flat)
    push_height = float(rng.uniform(0.02, 0.05))
    floor = float(rng.uniform(0.2, 0.5))
    contact = float(rng.uniform(0.0, 0.4))
    thing = FloorBody(
        outline,
        feet,
        round_m,
        mass_kg=float(rng.uniform(0.5, 5.0)),
        push_height_m=push_height,
        floor_friction=floor,
        contact_friction=contact,
    )
    model = PushModel(outline, feet, load_of_feet(feet), contact, round_m, floor * push_height)
    turn = 0.0 if index % 2 == 0 else float(rng.uniform(-0.9, 0.9))
    path = arc_path(np.zeros(2), np.array([1.0, 0.0]), turn, 0.01)
    yaw = float(rng.uniform(-math.pi, math.pi))
    # Beside the first part of the path, so that contact is between centre and edge of the rim.
    width = model.reach_m
    lateral = float(rng.uniform(-1, 1)) * (0.8 * RADIUS_M + 0.5 * width)
    ahead = RADIUS_M + width + 0.03
    heading = float(path[0, 2])
    c, s = math.cos(heading), math.sin(heading)
    start = (ahead * c - lateral * s, ahead * s + lateral * c, yaw)
    return PushCase(kind, thing, model, start, path)


def _feet(
    rng: np.random.Generator, kind: str, outline: Float[np.ndarray, "m 2"], round_m: float, flat: bool
) -> Float[np.ndarray, "n 2"]:
    if kind == "disc":
        if flat:
            return PushModel.disc(round_m).support_m
        count = int(rng.integers(3, 7))
        angle = rng.uniform(0, 2 * math.pi) + np.arange(count) * (2 * math.pi / count)
        return 0.85 * round_m * np.column_stack([np.cos(angle), np.sin(angle)])
    if flat:
        points, _ = patch_points(outline, 16)
        return points
    import shapely

    inner = shapely.Polygon(outline).buffer(-0.015, join_style="mitre")
    if inner.is_empty or inner.geom_type != "Polygon":
        return patch_points(outline, 16)[0]
    corners = np.array(inner.exterior.coords)[:-1]
    try:
        load_of_feet(corners)
    except ValueError:
        return patch_points(outline, 16)[0]
    return corners


def _random_polygon(rng: np.random.Generator) -> Float[np.ndarray, "m 2"]:
    """A convex polygon of 3 to 7 corners about its centroid."""
    import shapely

    while True:
        angle = np.sort(rng.uniform(0, 2 * math.pi, int(rng.integers(3, 9))))
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(0.1, 0.3, 2)
        hull = shapely.MultiPoint(ring).convex_hull
        if hull.geom_type == "Polygon" and hull.area > 0.015 and hull.minimum_clearance > 0.05:
            corners = np.array(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]
            return corners - polygon_centroid(corners)
