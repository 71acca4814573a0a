"""Sideward pushes of boxes with wrong prior parameters, open loop and with feedback."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from visuohaptic.navigation.pushing import PushModel, PushMonitor, line_path, simulate_push
from visuohaptic.navigation.pushing.quasi_static import remaining_m
from visuohaptic.reproduce.pushes import FloorBody, FloorPush

RADIUS_M = 0.17
#: Noise of the tracked contact point (m).
NOISE_M = 0.004


@dataclass(frozen=True, slots=True)
class LoopTrial:
    """One box, pushed open loop and with feedback."""

    plain: bool  #: dropped when the plan is driven as it is
    corrected: bool  #: dropped when the path is corrected on the way
    gave_up: bool  #: a correction found no path at some time
    place_error_m: float  #: of the object at the end, by the monitor
    believed_error_m: float  #: by the model of the plan


def closed_loop(seed: int) -> LoopTrial | None:
    """Prior: flat, mass in the middle, friction 0.15. Truth: random feet, mass and friction.

    ``None`` where no drive with a drop 5 to 20 cm before its end was found.
    """
    rng = np.random.default_rng(seed)
    half = 0.5 * rng.uniform(0.2, 0.45, 2)
    outline = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    centre = rng.uniform(-0.5, 0.5, 2) * half
    thing = FloorBody(
        outline,
        0.85 * outline,
        0.005,
        centre_m=(float(centre[0]), float(centre[1])),
        contact_friction=float(rng.uniform(0.05, 0.4)),
    )
    estimated = PushModel.patch(outline, 0.15, round_m=0.005)
    plan = _plan(estimated, rng)
    if plan is None:
        return None
    start, path = plan
    plain = FloorPush(thing, start, path[0], RADIUS_M).drive(path).dropped
    world = FloorPush(thing, start, path[0], RADIUS_M)
    monitor = PushMonitor(estimated, start, RADIUS_M)
    monitor.update(path[0], None)
    driven, touched, gave_up = [path[0]], [False], False
    rest = list(path[1:])
    while rest:
        pose = rest.pop(0)
        world.move(pose)
        driven.append(pose)
        touching = bool(np.isfinite(world.contact_m[0]))
        touched.append(touching)
        seen = world.contact_m + NOISE_M * rng.standard_normal(2) if touching else None
        if monitor.update(pose, seen) and touching and len(rest) > 5:
            bent = monitor.corrected(np.array([pose, *rest]), rng)
            if bent is None:
                gave_up = True
            else:
                rest = list(bent[1:])
    whole = np.array(driven)
    last = np.flatnonzero(touched)
    dropped = bool(len(last)) and remaining_m(whole, int(last[-1])) > 0.01
    place = monitor.estimate().object_m
    told = simulate_push(estimated, start, whole, RADIUS_M).object_m[-1]
    return LoopTrial(
        plain,
        dropped,
        gave_up,
        float(np.hypot(*(place - world.object_m)[:2])),
        float(np.hypot(*(told - world.object_m)[:2])),
    )


def _plan(
    model: PushModel, rng: np.random.Generator
) -> tuple[tuple[float, float, float], Float[np.ndarray, "k 3"]] | None:
    yaw = float(rng.uniform(-np.pi, np.pi))
    for _ in range(200):
        start = (RADIUS_M + model.reach_m + 0.02, float(rng.uniform(-0.12, 0.12)), yaw)
        path = line_path(np.zeros(2), np.array([start[0] + float(rng.uniform(0.4, 0.9)), 0.0]))
        trace = simulate_push(model, start, path, RADIUS_M)
        if trace.released and 0.05 < remaining_m(path, trace.last_contact) < 0.2 and trace.moved_m > 0.15:
            return start, path
    return None
