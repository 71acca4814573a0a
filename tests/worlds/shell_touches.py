"""Gripper readings of containers outside the training set: curves of both tips at 16 heights along x and y.

All touches of one exploration share the errors of its gripper: assumed position of the object, tilt, the gain
and the zeros of its sensors. Walls are those of :mod:`.shells`, solids have closed forms. Even seeds are open.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .shell_bodies import CLASSES, FRUSTUM_M, OTHERS, Description, draw, knots_m, wall_of
from .shells import Pinch, Revolution, side_stiffness

__all__ = [
    "CONDITIONS",
    "HEIGHTS",
    "KINDS",
    "Condition",
    "TouchedObject",
    "felt",
    "known_object",
    "member",
    "squeezed_objects",
    "unknown_object",
]

HEIGHTS, SIDES = 16, ("x+", "x-", "y+", "y-")
#: Closing: speed [m/s], rate [Hz], largest force [N] and deformation [m]; noise of a sample of each.
SPEED_m_per_s, RATE_Hz, MAX_N, MAX_m = 0.005, 30.0, 20.0, 0.003
NOISE_N, NOISE_m = 0.1, 1e-4
#: Harmonics of the walls: the tail of the series is summed.
HARMONICS = 32


@dataclass(frozen=True, slots=True)
class Condition:
    """Errors of the gripper in an exploration."""

    outside: float = 0.0  #: fraction of its width by which every second range is left
    lateral_m: float = 0.002  #: standard deviation of the gripper's place across the axis
    height_m: float = 0.002  #: and along it
    tilt_rad: float = 0.0524  #: standard deviation about each axis
    modulus: float = 0.0  #: largest relative change
    gain: float = 0.0  #: the force is read too high or too low by this fraction
    zero_N: float = 0.0  #: standard deviation of the zero of the force
    zero_m: float = 0.0  #: and of the contact
    heavy: bool = (
        False  #: samples have tails as Student's t with three degrees of freedom, at the same deviation
    )


CONDITIONS = {
    "in range": Condition(),
    "outside": Condition(outside=0.3),
    "nuisances": Condition(
        outside=0.3, height_m=0.005, modulus=0.12, gain=0.05, zero_N=0.1, zero_m=1e-4, heavy=True
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class TouchedObject:
    """One object under one gripper."""

    name: str  #: class, or kind of an unknown object
    stiffness_N_per_m: np.ndarray  #: (16, 4), at each place, of the first part of the curve
    stiffening_per_m: np.ndarray  #: (16, 4), a of F = k d (1 + a d)
    width_m: np.ndarray  #: (16, 2), opening at contact along x and y
    height_m: float  #: as seen: as wrong as the place of the gripper along it
    condition: Condition
    gain: float
    zero_N: float
    zero_m: float

    def curve(self, height: int, side: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Deformation [m] and force [N] as read, at a height of 1 to 16 and a side 0 to 3."""
        k = float(self.stiffness_N_per_m[height - 1, side])
        a = float(self.stiffening_per_m[height - 1, side])
        step = min(SPEED_m_per_s / RATE_Hz, MAX_N / k / 6)
        # The gripper stops at its limits: sooner where the object stiffens.
        depth = np.arange(1, int(MAX_m / step + 1e-9) + 1) * step
        depth = depth[(k * depth * (1 + a * depth) <= MAX_N * (1 + 1e-9)) | (np.arange(len(depth)) < 6)]
        force = self.gain * k * depth * (1 + a * depth) + self.zero_N
        return (
            depth + self.zero_m + NOISE_m * self._noise(len(depth), rng),
            force + NOISE_N * self._noise(len(depth), rng),
        )

    def width(self, height: int, axis: int, rng: np.random.Generator) -> float:
        """Opening at contact as read [m]."""
        return float(self.width_m[height - 1, axis]) + np.sqrt(2) * NOISE_m * float(self._noise(1, rng)[0])

    def _noise(self, count: int, rng: np.random.Generator) -> np.ndarray:
        out: np.ndarray = (
            rng.standard_t(3, count) / np.sqrt(3) if self.condition.heavy else rng.standard_normal(count)
        )
        return out


#: Solids: stiffness [N/m] at a relative height, stiffening [1/m], widths along x and y and height [m], all with random parts.
_SOLIDS: dict[str, Callable[[np.random.Generator, np.ndarray], tuple[Any, ...]]] = {
    # Rigid: only the gripper deforms.
    "wooden block": lambda rng, z: (np.full((len(z), 2), 3e5), 0 * z, rng.uniform(0.04, 0.08, 2) + 0 * z[:, None], 0.1),
    "book": lambda rng, z: (np.tile([2e5, 6e3], (len(z), 1)), 0 * z, np.array([0.09, 0.03]) + 0 * z[:, None], 0.2),
    # A flat punch of radius a on a half-space: 2 E a / (1 - nu^2), a = 8 mm.
    "foam block": lambda rng, z: (
        np.full((len(z), 2), 0.016 * rng.uniform(4e4, 2e5)), 20 + 0 * z, rng.uniform(0.05, 0.08, 2) + 0 * z[:, None], 0.1
    ),
    # Soft balls: flatter towards their poles, where the tips slide into a smaller chord.
    "rubber ball": lambda rng, z: _ball(rng.uniform(0.028, 0.036), 1.3e4, 60.0, z),
    "apple": lambda rng, z: _ball(rng.uniform(0.034, 0.042), 3.5e4, 0.0, z),
    "lemon": lambda rng, z: _ball(rng.uniform(0.024, 0.03), 4.5e3, 40.0, z),
    "plush toy": lambda rng, z: (
        180 * np.exp(0.3 * rng.standard_normal((len(z), 2))), 300 + 0 * z, 0.07 + 0.02 * np.sin(np.outer(5 * z, [1, 1.3])), 0.15
    ),
}  # fmt: skip
KINDS = (*OTHERS, *_SOLIDS)


def _ball(radius: float, stiffness: float, stiffening: float, z: np.ndarray) -> tuple[Any, ...]:
    chord = 2 * radius * np.sqrt(np.maximum(1 - (2 * z - 1) ** 2, 0.04))
    along = np.sqrt(chord / (2 * radius)) * stiffness
    return np.stack([along, along], 1), stiffening + 0 * z, np.stack([chord, chord], 1), 2 * radius


def known_object(seed: int, condition: str = "in range", cache: Path | None = None) -> TouchedObject:
    """A member of alternating classes; the errors of its gripper depend on the condition only."""
    name = list(CLASSES)[seed // 2 % len(CLASSES)]
    return _touched(name, CLASSES[name], [seed, 20], condition, cache=cache)


def unknown_object(seed: int, condition: str = "in range", cache: Path | None = None) -> TouchedObject:
    """An object of an unknown class, alternating between the twenty kinds."""
    name = KINDS[seed // 2 % len(KINDS)]
    if name in OTHERS:
        return _touched(name, OTHERS[name], [seed, 21], condition, cache=cache)
    rng = np.random.default_rng([seed, 22])
    shift = rng.normal(0, CONDITIONS[condition].height_m) / 0.1
    k, a, width, height = _SOLIDS[name](
        rng, np.clip((np.arange(HEIGHTS) + 0.5) / HEIGHTS + shift, 0.03, 0.97)
    )
    sensors, seen = _sensors(condition, rng), _seen(height, [seed, 22], condition)
    return TouchedObject(
        name, np.repeat(k, 2, axis=1), np.repeat(a[:, None], 4, axis=1), width, seen, *sensors
    )


def member(name: str, seed: int, condition: str = "in range", cache: Path | None = None) -> TouchedObject:
    """One of many members of a class or of another kind of container, its frusta twice as long: 1 % in tight rings."""
    return _touched(
        name, (CLASSES | OTHERS)[name], [seed, 25], condition, cache=cache and cache / name.replace(" ", "_"),
        step_m=2 * FRUSTUM_M,
    )  # fmt: skip


def squeezed_objects(
    seed: int, count: int, curves: int, cache: Path | None = None
) -> list[tuple[TouchedObject, list[tuple[int, int]]]]:
    """An afternoon of squeezing: so many objects, twice each, and the places (height, side) of their curves.

    The first half are the objects as they are learned, the second half the same ones as they come again, put down
    anew and squeezed at other places.
    """
    rng = np.random.default_rng([seed, 23])
    every = CLASSES | OTHERS
    names = rng.choice(sorted(every), count, replace=False)
    out = []
    for session in range(2):
        for number, name in enumerate(map(str, names)):
            places = [
                (int(h), int(s))
                for h, s in zip(rng.integers(2, 16, curves), rng.integers(0, 4, curves), strict=True)
            ]
            own = [seed, 24, number]
            found = _touched(name, every[name], own, "in range", session=session, places=places, cache=cache)
            out.append((found, places))
    return out


def _sensors(condition: str, rng: np.random.Generator) -> tuple[Condition, float, float, float]:
    wrong = CONDITIONS[condition]
    gain = 1 + wrong.gain * (1 if rng.uniform() < 0.5 else -1)
    return wrong, gain, wrong.zero_N * rng.standard_normal(), wrong.zero_m * rng.standard_normal()


def _seen(height_m: float, seed: list[int], condition: str, session: int = 0) -> float:
    """Height as measured."""
    rng = np.random.default_rng([*seed, 2, session])
    return height_m + CONDITIONS[condition].height_m * float(rng.standard_normal())


def _touched(
    name: str,
    description: Description,
    seed: list[int],
    condition: str,
    *,
    session: int = 0,
    places: list[tuple[int, int]] | None = None,
    cache: Path | None = None,
    step_m: float = FRUSTUM_M,
) -> TouchedObject:
    wrong = CONDITIONS[condition]
    shape, pose = np.random.default_rng([*seed, 0]), np.random.default_rng([*seed, 1, session])
    sensors = _sensors(condition, pose)
    modulus = 1 + shape.uniform(-wrong.modulus, wrong.modulus)
    shaped = draw(description, shape, outside=wrong.outside)
    seen = _seen(float(knots_m(shaped)[0][-1]), seed, condition, session)
    path = cache and cache / f"{'-'.join(map(str, [*seed, session]))}-{condition.replace(' ', '-')}.json"
    if path and path.exists():
        rows = json.loads(path.read_text(encoding="utf-8"))
        stiffness, width = (np.array(part, dtype=float) for part in rows)
    else:
        body = wall_of(shaped, modulus=modulus, step_m=step_m, ring_step_m=0.5 * step_m)
        offset = pose.normal(0, 1, 3) * [wrong.lateral_m, wrong.lateral_m, wrong.height_m]
        turn = Rotation.from_rotvec(pose.normal(0, wrong.tilt_rad, 3)).as_matrix()
        touches = None if places is None else sorted({(height - 1, side // 2) for height, side in places})
        stiffness, width = felt(body, offset, turn, touches)
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps([stiffness.tolist(), width.tolist()]), encoding="utf-8")
    return TouchedObject(name, stiffness, np.zeros_like(stiffness), width, seen, *sensors)


def felt(
    body: Revolution, offset_m: np.ndarray, turn: np.ndarray, touches: list[tuple[int, int]] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (16, 4) and width (16, 2) of a wall for a gripper that is ``offset_m`` off and turned by ``turn``.

    The gripper goes to the middles of 16 equal parts of the height; both tips stay on one line through its middle
    and centre themselves along it. Where it is not asked for, in (level, axis), the answer is NaN.
    """
    height = float(body.meridian_m[:, 1].max())
    touches = [(level, axis) for level in range(HEIGHTS) for axis in range(2)] if touches is None else touches
    pinches, width = [], np.full((HEIGHTS, 2), np.nan)
    for level, axis in touches:
        along = turn[:, axis]
        centre = offset_m + np.array([0.0, 0.0, (level + 0.5) / HEIGHTS * height])
        places = [_contact(body, centre, sign * along, height) for sign in (1.0, -1.0)]
        width[level, axis] = np.linalg.norm(places[0] - places[1])
        angles = [float(np.arctan2(p[1], p[0])) for p in places]
        force = []
        for sign, angle in zip((-1.0, 1.0), angles, strict=True):
            radial = np.array([np.cos(angle), np.sin(angle), 0.0])
            around = np.array([-np.sin(angle), np.cos(angle), 0.0])
            push = sign * along
            force.append((float(push @ radial), float(push @ around), float(push[2])))
        pinches.append(Pinch((angles[0], angles[1]), (places[0][2], places[1][2]), (force[0], force[1])))
    stiffness = np.full((HEIGHTS, 2, 2), np.nan)
    level_of, axis_of = np.array(touches).T
    stiffness[level_of, axis_of] = side_stiffness(body.compliance(pinches, harmonics=HARMONICS))
    return stiffness.reshape(HEIGHTS, 4), width


def _contact(body: Revolution, centre: np.ndarray, along: np.ndarray, height_m: float) -> np.ndarray:
    """Where a line from near the axis leaves the wall; at a mouth that it misses, the mouth."""
    across = centre[:2] - (centre[:2] @ along[:2]) * along[:2] / (along[:2] @ along[:2])
    z = float(np.clip(centre[2], 1e-3, height_m - 1e-4))
    for _ in range(8):
        radius = body.radius_m(z)
        miss = min(float(np.linalg.norm(across)), 0.95 * radius)
        across = across * (miss / max(float(np.linalg.norm(across)), 1e-12))
        flat = np.sqrt(radius**2 - miss**2)
        reach = flat - (centre[:2] @ along[:2]) / np.linalg.norm(along[:2])
        z = float(np.clip(centre[2] + reach * along[2] / np.linalg.norm(along[:2]), 1e-3, height_m - 1e-4))
    place = across + flat * along[:2] / np.linalg.norm(along[:2])
    return np.array([*place, z])
