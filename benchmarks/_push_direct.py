"""Direct pushes in the floor simulation: an object at the origin, pushed along x through its centroid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from visuohaptic.core.geometry import polygon_centroid
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.pushing import (
    PushModel,
    line_path,
    push_contacts,
    simulate_push,
)
from visuohaptic.simulation.floor import FloorObject, FloorWorld
from visuohaptic.tasks.mobile import SteeredPush

RADIUS_M = 0.17
CENTRE_M = 0.02
FOOT_SHARE = 0.8  #: of the way from centroid to corner: where the floor world has its feet


@dataclass(frozen=True, slots=True, eq=False)
class DirectCase:
    """An object, and where the platform touches it."""

    outline_m: Float[np.ndarray, "p 2"]  #: about its centroid
    item: FloorObject
    away_m: float  #: of the platform's centre, when it touches


def random_direct(rng: np.random.Generator) -> DirectCase:
    """A box or a polygon with a stable contact, turned so that the push goes along x."""
    while True:
        corners = int(rng.integers(4, 7))
        angle = (np.arange(corners) + rng.uniform(-0.2, 0.2, corners)) * (2 * math.pi / corners)
        outline = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(0.15, 0.3, 2)
        outline = outline - polygon_centroid(outline)
        contacts = push_contacts(outline, np.zeros(2), RADIUS_M)
        if contacts:
            break
    push = contacts[int(rng.integers(len(contacts)))]
    c, s = push.direction
    outline = outline @ np.array([[c, -s], [s, c]])
    centre = rng.normal(0.0, CENTRE_M, 2)
    item = FloorObject(
        "thing",
        outline,
        float(rng.uniform(1.0, 5.0)),
        0.3,
        float(rng.uniform(0.1, 0.5)),
        (float(centre[0]), float(centre[1])),
    )
    return DirectCase(outline, item, float(np.hypot(*push.robot)))


def drive_direct(case: DirectCase, length_m: float, *, see: bool) -> Float[np.ndarray, "3"]:
    """Displacement and rotation of the object in MuJoCo."""
    empty = OccupancyMap(np.zeros((80, 80), dtype=np.int8), 0.05, (-2.0, -2.0, 0.0))
    stand = np.array([-case.away_m - 0.03, 0.0])
    world = FloorWorld(empty, [case.item], (*stand, 0.0))
    begin = world.object_pose_m("thing")
    lever = PushModel.patch(case.outline_m).lever_m
    run = SteeredPush(stand, 0.0, length_m, object_m=begin if see else None, lever_m=lever)
    while run.end is None:
        touch = world.touch
        force, point = (touch.force_N, touch.point_m) if touch else (0.0, None)
        seen = world.object_pose_m("thing") if see else None
        world.base.drive(*run.command(world.t_s, world.pose_m(), force, point, seen))
        world.step(0.02)
    return world.object_pose_m("thing") - begin


def predicted(case: DirectCase, length_m: float) -> Float[np.ndarray, "3"]:
    """The same by the quasi-static model with known feet, centre and friction."""
    feet = FOOT_SHARE * case.outline_m + np.array(case.item.centre_offset_m)
    model = PushModel(case.outline_m, feet, np.full(len(feet), 1 / len(feet)), case.item.contact_friction)
    begin = np.array([-case.away_m - 0.03, 0.0])
    path = line_path(begin, begin + np.array([length_m + 0.03, 0.0]))
    return simulate_push(model, (0.0, 0.0, 0.0), path, RADIUS_M).object_m[-1]
