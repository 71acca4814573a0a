"""Pushes in the simulated world, observed by the scene tracker: does it detect falls?"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from tests.sensing import scenes

from visuohaptic.core import Contact, ErrorBudget, EventKind, ForceProfile, Reason
from visuohaptic.core.camera import Frame
from visuohaptic.sensing.scene import SceneTracker
from visuohaptic.simulation.mobile import FoamPushWorld, box, cylinder
from visuohaptic.simulation.rendering import Look, Surface

FRAME_S = 1 / 30


@dataclass(frozen=True)
class Watched:
    name: str
    true_fall_s: float  # nan: it did not
    told_fall_s: float
    turn_error_rad: float  # at the end of the push, nan if fallen or not tracked
    max_tilt_rad: float
    tracked: float  # share of frames in contact with a valid motion


def profile_of(truth) -> ForceProfile:
    """What an ideal foam would read: the truth with its deflection as contact."""
    strip = truth.strip
    delta = strip.delta_m
    pressed = np.flatnonzero(delta > 2e-4)
    contacts = ()
    if len(pressed) and truth.load_N > 0.02:
        k = slice(pressed[0], pressed[-1] + 1)
        contacts = (
            Contact(
                float(strip.s_m[k][0]), float(strip.s_m[k][-1]), float(truth.load_N), ErrorBudget(), True,
                Reason.OK, strip.front_m[k], np.full(len(delta[k]), 2e-5), delta[k],
            ),
        )  # fmt: skip
    n = len(delta)
    return ForceProfile(
        truth.t_s, True, Reason.OK, float(truth.load_N), ErrorBudget(), strip.s_m, delta, np.full(n, 2e-5),
        np.zeros(n), np.zeros(n), np.ones(n, bool), contacts,
    )  # fmt: skip


def random_thing(rng: np.random.Generator, falls: bool):
    """Thin and high on a rough floor, or broad and low enough to slide; round ones among both."""
    look = {
        "texture": float(rng.uniform(12, 30)), "grey": float(rng.choice([60.0, 75.0, 150.0, 180.0])),
        "seed": int(rng.integers(100)),
    }  # fmt: skip
    y, yaw = float(rng.uniform(-0.05, 0.05)), float(rng.normal(0, 0.08))
    x = 0.17 + scenes.FRONT_M + 0.012
    if falls:
        depth, width = float(rng.uniform(0.025, 0.045)), float(rng.uniform(0.08, 0.22))
        size = (depth, width, float(rng.uniform(0.2, 0.35)))
        mu = float(rng.uniform(0.75, 0.95))
    else:
        size = tuple(float(v) for v in rng.uniform([0.12, 0.1, 0.12], [0.25, 0.25, 0.3]))
        mu = float(rng.uniform(0.2, 0.5))
    mass = float(rng.uniform(0.3, 1.0))
    if not falls and rng.random() < 0.25:
        radius = float(rng.uniform(0.05, 0.09))
        return cylinder("thing", x + radius, y, radius, 0.25, mass_kg=mass, friction=mu, **look)
    reach = 0.5 * size[0] + 0.5 * size[1] * abs(np.sin(yaw))
    return box("thing", x + reach, y, size, yaw_rad=yaw, mass_kg=mass, friction=mu, **look)


def watch(seed: int, *, frames: int = 0, verbose: bool = False) -> Watched:
    rng = np.random.default_rng([20160505, seed])
    frames = frames or (45 if seed % 2 else 75)
    thing = random_thing(rng, falls=seed % 2 == 0)
    world = FoamPushWorld([thing], seed=seed)
    floor = str(rng.choice(["planks", "concrete", "carpet"]))
    look = Look(
        floor=Surface(112.0, 10.0, floor), body=Surface(52.0, 3.0, "metal"), foam=Surface(175.0, 3.5, "foam"),
        face_contrast=0.35, shadow=0.5,
    )  # fmt: skip
    render = scenes.renderer(scenes.RIG, look, noise=2.5)
    tracker = SceneTracker(scenes.RIG.camera, scenes.RIG.T_camera_foam, scenes.BELOW_M)
    world.base.drive(float(rng.uniform(0.03, 0.08)), 0.0)
    told, tilt, valid, seen, after, turn, start_yaw = np.nan, 0.0, 0, 0, 0, np.nan, np.nan
    for index in range(frames):
        truth = world.step(FRAME_S)
        image = render.render(world.scene(), rng=rng)
        reading = tracker.update(Frame(image, truth.t_s, index), profile_of(truth), world.base.state())
        body = truth.body("thing")
        tilt = max(tilt, body.tilt_rad)
        if truth.load_N > 0.02 and body.tilt_rad < 0.5:
            if np.isnan(start_yaw):
                start_yaw = body.yaw_rad
            seen += 1
            valid += reading.object_motion.valid
            if reading.object_motion.valid:
                turn = reading.object_angle_rad - (body.yaw_rad - start_yaw)
        if verbose:
            m = reading.object_motion
            print(
                index, f"tilt {body.tilt_rad:.3f} told {m.tilt_rad:.3f} turn {body.yaw_rad - start_yaw:.3f} "
                f"told {reading.object_angle_rad:.3f} +- {m.turn_sigma_rad:.3f}", reading.object_points, m.points,
                m.reason.value, reading.floor_points, reading.floor_motion.valid,
                [e.kind.value for e in reading.events], round(reading.proximity_m, 3),
            )  # fmt: skip
        told = next((e.t_s for e in reading.events if e.kind is EventKind.FALL and np.isnan(told)), told)
        true = next((e.t_s for _, e in world.events if e.kind is EventKind.FALL), np.nan)
        after += np.isfinite(true)
        if after > 8:
            break
    fallen = np.isfinite(true) or tilt > 0.05
    return Watched(floor, true, told, np.nan if fallen else turn, tilt, valid / max(seen, 1))


def score(found: list[Watched], frames: float = 2.0) -> dict[str, float]:
    """Right: told within so many frames of the truth."""
    near = [abs(w.told_fall_s - w.true_fall_s) <= frames * FRAME_S + 0.5 * FRAME_S for w in found]
    told = sum(np.isfinite(w.told_fall_s) for w in found)
    true = sum(np.isfinite(w.true_fall_s) for w in found)
    right = sum(near)
    return {
        "true": true, "told": told, "right": right,
        "precision": right / max(told, 1), "recall": right / max(true, 1),
    }  # fmt: skip


if __name__ == "__main__":
    first, last = int(sys.argv[1]), int(sys.argv[2])
    every = []
    for number in range(first, last):
        every.append(watch(number, verbose=last - first == 1))
        print(number, every[-1], flush=True)
    print(score(every))
