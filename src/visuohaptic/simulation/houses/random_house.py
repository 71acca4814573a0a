"""Randomly generated houses: a floor plan, objects that block its doorway, and clutter beside the path."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...core.measurement import GRAVITY_M_S2
from ..mobile import OdometryErrors, SimulatedObstacle, box, cylinder
from .house import House, door_row
from .plan import FloorPlan, draw_plan

#: Odometry with a scale error of 2 %, and slip.
ODOMETRY = OdometryErrors(scale=0.02, scale_turn=0.005, slip_m=0.004)
#: A gap that is too narrow for any platform of 34 cm, and one that is wide enough [m].
BLOCKED_M, OPEN_M = 0.30, 0.48
#: Force per width of a flat face that the foam bears before densification [N/m].
FOAM_N_PER_M = 33.0
#: Distance of clutter from the doorway's path, and number of attempts [m].
BESIDE_M, CLUTTER = 0.9, 3


def random_house(seed: int, visit: int = 0) -> House:
    """A house with the objects of one day.

    Walls, furniture and objects depend on the seed; the positions of the movable ones also on the visit.

    Parameters
    ----------
    seed
        Seed of all random numbers.
    visit
        Day: people put the objects back into the doorway, in another order on most days.
    """
    rng = np.random.default_rng([seed, 100])
    plan = draw_plan(rng)
    turn = rng.random(3) < 0.5
    grid, place = plan.as_map((bool(turn[0]), bool(turn[1]), bool(turn[2])))
    before, behind = (place(point) for point in plan.beside_door_m)
    heading = math.atan2(behind[1] - before[1], behind[0] - before[0])
    kinds = _door_objects(plan.door_width_m, np.random.default_rng([seed, 101]))
    today = np.random.default_rng([seed, 102, visit])
    order = [kinds[int(k)] for k in today.permutation(len(kinds))]
    blocking = door_row(order, place(plan.door_m), heading, plan.door_width_m, today)
    tour = [
        plan.home_m,
        plan.beside_door_m[0],
        plan.beside_door_m[1],
        plan.table_m,
        *_corners(plan),
        plan.beside_door_m[1],
    ]
    tour += [plan.beside_door_m[0], plan.home_m]
    corners = tuple(place(point) for point in tour)
    facing = math.atan2(before[1] - corners[-1][1], before[0] - corners[-1][0])
    clutter = _clutter(plan, corners, place, np.random.default_rng([seed, 103]))
    return House(
        grid, corners, place(plan.table_m), facing, (*blocking, *clutter), ODOMETRY
    )  # fmt: skip


def _corners(plan: FloorPlan) -> list[tuple[float, float]]:
    """Scan position of the tour in the table's room: the reachable position farthest from table and door."""
    x0, y0, x1, y1 = plan.rooms[1]
    reach = plan.reachable()
    places = [
        (float(x), float(y))
        for x in np.arange(x0 + 0.4, x1 - 0.3, 0.2)
        for y in np.arange(y0 + 0.4, y1 - 0.3, 0.2)
        if reach[plan.index((float(x), float(y)))]
    ]
    known = (plan.table_m, plan.beside_door_m[1])
    far = max(places, key=lambda p: min(math.dist(p, k) for k in known), default=None)
    return [] if far is None else [far]


def _door_objects(width_m: float, rng: np.random.Generator) -> list[SimulatedObstacle]:
    """Objects without gaps between them; removing a pushable one opens a gap."""
    while True:
        count = 3 if width_m > 1.0 else 2
        light = _light_bin("bin", rng)
        others = [_other(number, rng) for number in range(1, count)]
        kinds = [light, *others]
        total = sum(one.width_m for one in kinds)
        gap = (width_m - total) / (count + 1)
        if 0.08 < gap < BLOCKED_M and 2 * gap + light.width_m > OPEN_M:
            return kinds


def _look(rng: np.random.Generator) -> dict[str, Any]:
    colour = tuple(float(v) for v in rng.uniform(40.0, 160.0, 3))
    return {
        "grey": float(np.mean(colour)),
        "texture": float(rng.uniform(6.0, 15.0)),
        "seed": int(rng.integers(99)),
        "bgr": colour,
    }


def _light_bin(name: str, rng: np.random.Generator) -> SimulatedObstacle:
    force, friction = float(rng.uniform(1.0, 2.5)), float(rng.uniform(0.25, 0.45))
    return cylinder(
        name, 0.0, 0.0, float(rng.uniform(0.075, 0.11)), float(rng.uniform(0.22, 0.35)),
        mass_kg=force / (friction * GRAVITY_M_S2), friction=friction, static_ratio=float(rng.uniform(1.05, 1.2)),
        material=str(rng.choice(["metal", "plain"])), **_look(rng),
    )  # fmt: skip


def _other(number: int, rng: np.random.Generator) -> SimulatedObstacle:
    """A pushable box, one that is too heavy, a fixed object, or another bin."""
    draw, friction = float(rng.random()), float(rng.uniform(0.25, 0.45))
    if draw < 0.25:
        return _light_bin(f"bin {number}", rng)
    if draw < 0.45:
        side = float(rng.uniform(0.05, 0.08))
        return box(f"leg {number}", 0.0, 0.0, (side, side, 0.7), fixed=True, material="wood", **_look(rng))
    width, length = float(rng.uniform(0.13, 0.22)), float(rng.uniform(0.10, 0.20))
    heavy = draw > 0.85
    force = float(rng.uniform(22.0, 30.0) if heavy else rng.uniform(1.5, 0.85 * FOAM_N_PER_M * width))
    return box(
        f"crate {number}" if heavy else f"box {number}", 0.0, 0.0, (length, width, float(rng.uniform(0.2, 0.35))),
        mass_kg=force / (friction * GRAVITY_M_S2), friction=friction, static_ratio=float(rng.uniform(1.05, 1.2)),
        **_look(rng),
    )  # fmt: skip


def _clutter(
    plan: FloorPlan,
    tour: Sequence[tuple[float, float]],
    place: Callable[[tuple[float, float]], tuple[float, float]],
    rng: np.random.Generator,
) -> list[SimulatedObstacle]:
    """Clutter added since the tour, away from its corners and from the doorway."""
    reach, found = plan.clearance_m(), []
    for number in range(CLUTTER):
        room = plan.rooms[int(rng.integers(2))]
        x, y = float(rng.uniform(room[0], room[2])), float(rng.uniform(room[1], room[3]))
        at = place((x, y))
        legs = itertools.pairwise(tour)
        near = min(_distance(at, a, b) for a, b in legs) < 0.7
        if near or reach[plan.index((x, y))] < 0.25 or math.dist((x, y), plan.door_m) < BESIDE_M:
            continue
        found.append(_light_bin(f"thing {number}", rng).moved(at[0], at[1], 0.0))
    return found


def _distance(point: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    """Distance from a point to a segment."""
    along = np.subtract(b, a)
    length = float(along @ along)
    part = 0.0 if length == 0 else float(np.clip(np.subtract(point, a) @ along / length, 0.0, 1.0))
    return float(np.hypot(*(np.subtract(point, a) - part * along)))
