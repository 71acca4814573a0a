"""Presses into a foam strip while a disturbance degrades the images or is misleading."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .foam import Cast, Sequence, draw_world
from .foam_mechanics import Foam, Press, bar
from .foam_optics import BAND, BODY, DISC, FLOOR, FOAM, SKIN, point_spread
from .foam_presses import BODIES, POOL, STEP_M, Pushed, pushed
from .foam_scene import FRAME_S, Moment, World, shadow_row

__all__ = ["COVERS", "DISTURBANCES", "FAULTS", "covered", "disturbed", "faulty", "forces", "segments"]

#: What happens during a press.
DISTURBANCES = (
    "none",
    "soft shadow",
    "hard shadow",
    "flicker",
    "exposure steps",
    "motion blur 7 px",
    "defocus 3 px",
    "hand",
    "plate at the end",
    "speed 30 mm/s",
    "speed 60 mm/s",
)
#: What misleads: a sensor may refuse all of it, and must not be wrong.
FAULTS = (
    "soft shadow",
    "hard shadow",
    "flicker",
    "exposure steps",
    "motion blur",
    "defocus",
    "hand",
    "cable",
    "cover",
    "bump",
    "hot spot",
    "body as grey as foam",
    "too fast",
    "dropped frames",
    "repeated frames",
    "noise",
    "vanishing body",
)
#: What covers the whole front: straight occluders by their surface, or a plate that presses.
COVERS = ("dark", "bright", "skin", "as grey as foam", "as grey as the floor", "plate")
_SPEEDS_M_S = {"speed 30 mm/s": 0.03, "speed 60 mm/s": 0.06}
#: Frames before the body touches, and frames for which it is held at the end.
_BEFORE, _HELD = 4, 3


@dataclass(slots=True)
class _Effect:
    """One disturbance of the images of a press, in a window of its frames."""

    kind: str
    cast: Cast | None = None
    spread: np.ndarray | None = None
    everywhere: bool = False  #: while zeroing, too
    flicker: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gains: np.ndarray | None = None
    fingers: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    entry_m: np.ndarray = field(
        default_factory=lambda: np.zeros(2)
    )  #: where fingers come from, half a frame's way
    palm: np.ndarray | None = None  #: the hand's own shadow
    camera: tuple[float, float, float] = (0.0, 0.0, 0.0)
    window: tuple[int, int] = (0, 10_000)

    def active(self, i: int) -> bool:
        """Whether the i-th frame shows it."""
        return self.kind != "none" and self.window[0] <= i < self.window[1]

    def at_rest(self, moment: Moment) -> Moment:
        """The strip while zeroing."""
        return replace(moment, spread=self.spread, flicker=self.flicker) if self.everywhere else moment

    def at(self, moment: Moment, i: int) -> Moment:
        """The i-th frame with the disturbance."""
        if not self.active(i):
            return self.at_rest(moment)
        moment = replace(moment)
        if self.spread is not None:
            moment.spread = self.spread
        if self.flicker[0]:
            moment.flicker = self.flicker
        if self.gains is not None:
            moment.gain = float(self.gains[i % len(self.gains)])
        if self.camera != (0.0, 0.0, 0.0):
            moment.camera = self.camera
        if self.cast is not None:
            moment.shadows = [*moment.shadows, self.cast.row((i - self.window[0]) * FRAME_S)]
        if len(self.fingers):
            # Appears within two frames, disappears within two.
            away = max(0, 2 - (i - self.window[0]), 3 - (self.window[1] - i)) / 2
            moved = self.fingers + away * np.concatenate([self.entry_m, self.entry_m, [0.0]])
            moment.capsules = np.vstack([moment.capsules, moved])
        if self.palm is not None:
            moment.shadows = [*moment.shadows, self.palm]
        return moment


def _shadow(kind: str, world: World, rng: np.random.Generator) -> _Effect:
    cast = Cast.drawn(world, rng, "creeping")
    cast.penumbra_m = world.px_m * float(rng.uniform(12, 40) if kind == "soft shadow" else rng.uniform(0, 2))
    cast.speed_m_s = float(rng.uniform(0.02, 0.15))
    return _Effect(kind, cast=cast)


def _light(kind: str, rng: np.random.Generator) -> _Effect:
    if kind == "flicker":
        mains = float(rng.choice([100.0, 120.0])) + float(rng.normal(0, 0.05))
        return _Effect(
            kind, flicker=(float(rng.uniform(0.04, 0.25)), mains, float(rng.uniform(0, 1))), everywhere=True
        )
    steps = np.exp(rng.normal(0, 0.12, 80))
    return _Effect(kind, gains=np.clip(np.repeat(steps, rng.integers(3, 9)), 0.7, 1.25))


def _hand(world: World, rng: np.random.Generator) -> _Effect:
    """One to three fingers from ahead, over the front edge of the foam, for a third of the frames."""
    begin = int(rng.integers(8, 16))
    count, y = int(rng.integers(1, 4)), float(rng.uniform(-0.11, 0.11))
    ys = y + 0.019 * np.arange(count)
    tips = rng.uniform(0.002, 0.024) + rng.uniform(-0.004, 0.004, count)
    lean = float(rng.uniform(-0.04, 0.04))
    fingers = np.column_stack([tips, ys, tips + 0.12, ys + lean, rng.uniform(0.006, 0.009, count)])
    palm = shadow_row(
        BAND,
        (0.0, float(ys.mean()) + 0.01),
        0.5 * np.pi,
        penumbra_m=0.012,
        dark=world.darkness(0.25),
        half_m=0.01 * count,
    )
    window = (begin, begin + int(rng.integers(7, 12)))
    return _Effect("hand", fingers=fingers, entry_m=np.array([0.05, 0.4 * lean]), palm=palm, window=window)


def _effect(
    kind: str, world: World, rng: np.random.Generator, window: tuple[int, int] = (0, 10_000)
) -> _Effect:
    """The disturbance of a name; those that only faults have are limited to a window."""
    if kind in ("soft shadow", "hard shadow"):
        effect = _shadow(kind, world, rng)
    elif kind in ("flicker", "exposure steps"):
        effect = _light(kind, rng)
    elif kind.startswith("motion blur"):
        length = 7.0 if kind.endswith("px") else float(rng.uniform(3, 14))
        spread = point_spread(world.lens_px, motion_px=length, angle_rad=float(rng.uniform(0, np.pi)))
        effect = _Effect(kind, spread=spread)
    elif kind.startswith("defocus"):
        radius = 3.0 if kind.endswith("px") else float(rng.uniform(1.5, 6))
        spread = point_spread(world.lens_px, defocus_px=radius, disc=bool(rng.random() < 0.5))
        effect = _Effect(kind, spread=spread, everywhere=kind.endswith("px") and bool(rng.random() < 0.5))
    elif kind == "hand":
        effect = _hand(world, rng)
    else:
        effect = _misleading(kind, world, rng)
    if window[1] < 10_000 and not effect.everywhere:
        effect.window = window
    return effect


def _misleading(kind: str, world: World, rng: np.random.Generator) -> _Effect:
    """Disturbances that only faults have."""
    y = float(rng.uniform(-0.1, 0.1))
    if kind == "cable":
        turn, radius = float(rng.uniform(0, np.pi)), float(rng.uniform(0.001, 0.004))
        way = 0.3 * np.array([np.cos(turn), np.sin(turn)])
        at = np.array([rng.uniform(0.005, 0.025), y])
        return _Effect(kind, fingers=np.array([[*(at - way), *(at + way), radius]]))
    if kind == "cover":
        # A sheet above the front edge, parallel to it, that advances no faster than a contact may.
        radius, half = 0.05, float(rng.uniform(0.005, 0.04))
        tip = 0.02 - float(rng.uniform(0.001, 0.008)) + radius
        fingers = np.array([[tip, y - half, tip, y + half, radius]])
        return _Effect(kind, fingers=fingers, entry_m=np.array([float(rng.uniform(0.002, 0.02)), 0.0]))
    if kind == "bump":
        shift = rng.standard_normal(2) * np.exp(rng.uniform(np.log(0.3), np.log(6.0)))
        return _Effect(kind, camera=(float(shift[0]), float(shift[1]), float(rng.normal(0, 2e-3))))
    if kind == "hot spot":
        cast = Cast.drawn(world, rng, "first")
        cast.shape, cast.dark, cast.floor_m = DISC, -float(rng.uniform(0.3, 3.0)), (0.0, 0.0)
        return _Effect(kind, cast=cast)
    return _Effect(kind)


# -- presses ----------------------------------------------------------------------------------------------


def _pressed(
    sequence: Sequence,
    what: Pushed,
    effects: list[_Effect],
    speed_m_s: float,
    exposure_s: float,
    first_m: float,
) -> Sequence:
    """Append a press that begins ``first_m`` before the body touches (negative), and is held at the end."""
    world = sequence.world
    scale = world.foam.mu_Pa[0] / Foam().mu_Pa[0]
    step = speed_m_s * FRAME_S
    for effect in effects:
        sequence.rest = effect.at_rest(sequence.rest)
    count = int(np.ceil((what.max_depth_m - first_m) / step)) + 1
    for i in range(count + _HELD - 1):
        depth = min(first_m + i * step, what.max_depth_m)
        parts = max(1, min(6, int(np.ceil(speed_m_s * exposure_s / world.px_m)))) if i < count - 1 else 1
        moments = []
        for part in (np.arange(parts) + 0.5) / parts - 0.5:
            now = min(depth + part * speed_m_s * exposure_s, what.max_depth_m)
            moment = Moment(what.at(now) if now > 0 else None, what.shape, now, what.side_m)
            for effect in effects:
                moment = effect.at(moment, i)
            moments.append(moment)
        state = what.at(depth) if depth > 1e-9 else None
        sequence.add(
            i,
            *moments,
            force_N=scale * state.force_N if state else 0.0,
            depth_m=max(depth, 0.0),
            counted=depth > 0.3e-3,
            disturbed=any(effect.active(i) for effect in effects),
            contact_m=state.pressed_m if state else (float("nan"), float("nan")),
        )
    return sequence


def _pooled(body: str, rng: np.random.Generator, seed: int) -> Pushed:
    return pushed(body, 2 * int(rng.integers(POOL)) + seed % 2)


def disturbed(kind: str, seed: int) -> Sequence:
    """A press at 10 mm/s (or as the kind specifies) during a disturbance of the image."""
    rng = np.random.default_rng([20, seed, *kind.encode()])
    world = draw_world(seed)
    speed = _SPEEDS_M_S.get(kind, 0.01)
    bodies = ("cylinder", "plate", "tilted") if speed > 0.01 else ("cylinder", "plate")
    what = _pooled("end" if kind == "plate at the end" else str(rng.choice(bodies)), rng, seed)
    sequence = Sequence(world, {"kind": kind, "columns": world.columns, **what.about})
    exposure_s = float(rng.uniform(0.002, 0.012)) if speed > 0.01 else 0.0
    first = (float(rng.uniform(0, 1)) - _BEFORE) * speed * FRAME_S
    return _pressed(sequence, what, [_effect(kind, world, rng)], speed, exposure_s, first)


def forces(seed: int) -> Sequence:
    """A press at exactly the simulated depths in ordinary light; the kind of body cycles with the seed."""
    rng = np.random.default_rng([21, seed])
    return _plain(seed, _pooled(BODIES[(seed // 2) % 5], rng, seed))


def segments(seed: int) -> Sequence:
    """A press of a plate with sharp edges, whose ends are to be detected."""
    return _plain(seed, _pooled("box", np.random.default_rng([23, seed]), seed))


def _plain(seed: int, what: Pushed) -> Sequence:
    world = draw_world(seed)
    sequence = Sequence(world, {"columns": world.columns, **what.about})
    return _pressed(sequence, what, [], STEP_M / FRAME_S, 0.0, -_BEFORE * STEP_M)


def faulty(seed: int) -> Sequence:
    """A press with one or two faults of :data:`FAULTS` in a window of its frames, stronger than disturbances."""
    rng = np.random.default_rng([22, seed])
    world = draw_world(seed)
    kinds = [FAULTS[(seed // 2) % len(FAULTS)]]
    if rng.random() < 0.35:
        kinds.append(str(rng.choice(FAULTS)))
    speed = float(np.exp(rng.uniform(np.log(0.12), np.log(0.6)))) if "too fast" in kinds else 0.012
    what = _pooled(str(rng.choice(BODIES[:5])), rng, seed)
    begin = int(rng.integers(0, 14))
    window = (begin, begin + int(rng.integers(2, 16)))
    if "body as grey as foam" in kinds:
        world.albedo[BODY] = world.albedo[FOAM] * rng.uniform(0.85, 1.1)
    if rng.random() < 0.3:
        world.albedo[SKIN] = world.albedo[FOAM] * rng.uniform(
            0.8, 1.1
        )  # a sheet of paper, a cable in foam's grey
    sequence = Sequence(world, {"kind": " + ".join(kinds), "columns": world.columns, **what.about})
    effects = [_effect(kind, world, rng, window) for kind in kinds]
    _pressed(sequence, what, effects, speed, 0.005, -_BEFORE * STEP_M)
    for kind in kinds:
        _spoil(kind, sequence, window, rng)
    return sequence


def covered(seed: int) -> Sequence:
    """A straight occluder hides the whole front; or a plate presses all of it at 30 or 60 mm/s, which is to be read.

    The occluder appears within one frame and rests, over a press or, in a third of the seeds, over the bare strip. Its edge is
    parallel to the front, or nearly so, and up to 3.3 mm behind it, as far as a contact may move from one frame to the next.
    Half of them have no texture.
    """
    rng = np.random.default_rng([24, seed])
    world = draw_world(seed)
    kind, bare = COVERS[(seed // 2) % len(COVERS)], bool(rng.random() < 1 / 3)
    about = {"kind": kind, "columns": world.columns}
    if kind == "plate":
        speed = float(rng.choice(list(_SPEEDS_M_S.values())))
        first = (float(rng.uniform(0, 1)) - _BEFORE) * speed * FRAME_S
        sequence = Sequence(world, about | {"speed_m_s": speed})
        return _pressed(sequence, _whole_plate(), [], speed, float(rng.uniform(0.002, 0.012)), first)
    what = _pooled(str(rng.choice(("cylinder", "plate"))), rng, seed)
    foam, floor = world.albedo[FOAM], world.albedo[FLOOR]
    world.albedo[SKIN] = {
        "dark": 0.2 * foam,
        "bright": 1.2 * foam,
        "as grey as foam": foam * rng.uniform(0.9, 1.05),
        "as grey as the floor": floor * rng.uniform(0.9, 1.1),
    }.get(kind, world.albedo[SKIN])
    if rng.random() < 0.5:
        world.textures[SKIN] = 1.0
    begin = int(rng.integers(1, 14))
    effect = _Effect("cover", window=(begin, begin + int(rng.integers(2, 7))))
    behind, turned = float(rng.uniform(0.0005, 0.0033)), float(rng.normal(0, 0.005) * (rng.random() < 0.5))
    # The far side of a wide capsule is a straight line.
    tip, half = world.foam.width_m - behind + 0.05, 0.2
    effect.fingers = np.array([[tip - half * turned, -half, tip + half * turned, half, 0.05]])
    sequence = Sequence(world, about | {"behind_m": behind, "turned_rad": turned, "bare": bare})
    _pressed(sequence, what, [effect], STEP_M / FRAME_S, 0.0, -_BEFORE * STEP_M)
    del sequence.moments[effect.window[1] + 4 :]
    if bare:
        _removed(sequence, 0)
    return sequence


def _whole_plate() -> Pushed:
    """A plate along the whole front: the foam has no lateral strain, so that every column obeys the law."""
    foam, half = Foam(), 0.5 * Foam().length_m
    area, faces = foam.length_m * foam.height_m, np.full(45, half)
    steps = [
        Press(
            float(depth),
            float(foam.plate_stress_Pa(depth / foam.width_m)) * area,
            np.array([-half, half]),
            np.full(2, depth),
            -faces,
            faces,
            (-half, half),
        )
        for depth in STEP_M * np.arange(1, 28)
    ]
    return Pushed(bar(half + 0.015, 0.003), (-half - 0.02, half + 0.02), tuple(steps), {"body": "whole"})


def _removed(sequence: Sequence, begin: int) -> None:
    """Remove the body from the frames that follow."""
    for i in range(begin, len(sequence.moments)):
        shot, moments = sequence.moments[i]
        shot.force_N, shot.depth_m, shot.counted = 0.0, 0.0, False
        away = tuple(replace(m, press=None, body=None, body_low_m=0.0) for m in moments)
        sequence.moments[i] = (shot, away)


def _spoil(kind: str, sequence: Sequence, window: tuple[int, int], rng: np.random.Generator) -> None:
    """Faults of the camera and the moment when the body is removed."""
    frames, (begin, end) = sequence.moments, window
    if kind == "dropped frames":
        del frames[begin:end]
    elif kind == "repeated frames":
        for i in range(begin + 1, min(end, len(frames))):
            frames[i] = (frames[i][0], ())  # repeat the previous image
    elif kind == "noise":
        sequence.world.sensor.read_noise *= float(rng.uniform(3, 10))
    elif kind == "vanishing body":
        _removed(sequence, end)
