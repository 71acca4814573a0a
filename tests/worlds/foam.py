"""Sequences of a foam strip that a webcam sees: shadows without an object, presses under disturbances.

Every sequence is drawn from one seed. The images are made when they are asked for; what was true comes with
each. Even seeds are open, odd ones closed, and so are the presses: those of even and odd seeds differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from .foam_mechanics import Foam, Press, Shape, bar, cylinder, press
from .foam_optics import BAND, DISC, EDGE, WEDGE, point_spread
from .foam_scene import FRAME_S, Moment, World, shadow_row

__all__ = ["DISTURBANCES", "Sequence", "Shot", "disturbed", "shadows"]

#: What happens during a press; the first ones are a row of their own in the reports.
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
#: Frames of the strip at rest, and of a shadow sequence.
ZERO_FRAMES, SHADOW_FRAMES = 8, 18
#: Presses that are simulated for each kind and parity of the seed; further ones are scaled in stiffness.
POOL = 8
#: Depth of one step of the simulation [m]: 10 mm/s at 30 frames a second.
STEP_M = 0.01 * FRAME_S
_DEPTHS_M = STEP_M * np.arange(1, 28)


@dataclass(slots=True)
class Shot:
    """One image and what was true when it was taken."""

    image: np.ndarray
    t_s: float
    force_N: float = 0.0
    depth_m: float = 0.0
    counted: bool = True  #: whether a reading is wanted: something presses, or nothing is there but light
    disturbed: bool = True
    contact_m: tuple[float, float] = (float("nan"), float("nan"))  #: first and last place that touches


@dataclass(slots=True)
class Sequence:
    """A world, what it looks like at rest, and what comes then."""

    world: World
    about: dict
    rest: Moment = field(default_factory=Moment)
    moments: list[tuple[Shot, tuple[Moment, ...]]] = field(default_factory=list)

    def zero(self) -> Iterator[Shot]:
        """Images of the strip that nothing touches."""
        for i in range(ZERO_FRAMES):
            moment = replace(self.rest, flicker=_later(self.rest.flicker, i * FRAME_S))
            yield Shot(self.world.image(moment), i * FRAME_S)

    def shots(self) -> Iterator[Shot]:
        """Images of the sequence, in order of time."""
        for shot, moments in self.moments:
            shot.image = self.world.image(*moments)
            yield shot
            shot.image = np.empty(0)

    def add(self, i: int, *moments: Moment, **truth) -> None:
        """Append what is seen in the i-th frame after the strip at rest."""
        t_s = (ZERO_FRAMES + i) * FRAME_S
        moments = tuple(replace(m, flicker=_later(m.flicker, t_s)) for m in moments)
        self.moments.append((Shot(np.empty(0), t_s, **truth), moments))


def _later(flicker: tuple[float, float, float], t_s: float) -> tuple[float, float, float]:
    return flicker[0], flicker[1], flicker[2] + t_s


def _world(seed: int, **fixed) -> World:
    """A world; one in sixteen with its whole image, the others cut to the strip."""
    rng = np.random.default_rng([16, seed])
    scale = float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    foam = Foam(mu_Pa=tuple(scale * mu for mu in Foam().mu_Pa))
    region = bool(rng.random() > 1 / 16)
    return World(seed, region=region, **{"foam": foam} | fixed)


# -- shadows ----------------------------------------------------------------------------------------------


def shadows(seed: int) -> Sequence:
    """Shadows on the strip and the floor; nothing ever touches the strip.

    The onset is ``first`` (in the first frame after zeroing), ``creeping`` (over an edge of the strip),
    ``sudden`` or ``leaving`` (there while zeroing); directions are any, a third of them along the strip.
    """
    rng = np.random.default_rng([18, seed])
    world = _world(seed)
    onset = str(rng.choice(["first", "creeping", "sudden", "leaving"], p=[0.35, 0.4, 0.1, 0.15]))
    count = 1 if rng.random() < 0.8 else 2
    casts = [_Cast.drawn(world, rng, onset) for _ in range(count)]
    about = {"onset": onset, **casts[0].about, "count": count, "columns": world.columns}
    sequence = Sequence(world, about)
    if onset == "leaving":
        sequence.rest.shadows = [cast.row(0.0) for cast in casts]
    begin = int(rng.integers(1, 6)) if onset == "sudden" else 0
    drive = rng.uniform(-0.1, 0.1, 2) * (rng.random() < 0.3)
    for i in range(SHADOW_FRAMES):
        rows = [cast.row(i * FRAME_S) for cast in casts] if i >= begin else []
        if onset == "leaving" and casts[0].speed_m_s == 0.0 and i >= 2:
            rows = []
        floor = (float(drive[0] * i * FRAME_S), float(drive[1] * i * FRAME_S))
        sequence.add(i, Moment(shadows=rows, floor_m=floor))
    return sequence


@dataclass(slots=True)
class _Cast:
    """A shadow that moves along a line."""

    world: World
    shape: int
    at_m: np.ndarray  #: at time 0
    angle_rad: float
    speed_m_s: float  #: against its normal: the shadow advances
    half_m: float
    penumbra_m: float
    dark: float
    floor_m: tuple[float, float]
    smooth: bool
    about: dict

    @classmethod
    def drawn(cls, world: World, rng: np.random.Generator, onset: str) -> _Cast:
        foam = world.foam
        shape = int(rng.choice([EDGE, BAND, DISC, WEDGE], p=[0.5, 0.2, 0.15, 0.15]))
        along = rng.random() < 1 / 3
        angle = (
            float(rng.choice([0.0, np.pi]) + rng.normal(0, 0.06))
            if along
            else float(rng.uniform(-np.pi, np.pi))
        )
        penumbra_px = 0.0 if rng.random() < 0.3 else float(np.exp(rng.uniform(np.log(0.5), np.log(40.0))))
        dark = float(rng.uniform(0.1, 0.6))
        half = float(np.exp(rng.uniform(np.log(0.003), np.log(0.06))))
        light = float(rng.uniform(-np.pi, np.pi))
        reach = foam.height_m * float(
            rng.choice([rng.uniform(0, 1.5), rng.uniform(1.5, 5.0)], p=[0.75, 0.25])
        )
        speed = float(np.exp(rng.uniform(np.log(0.003), np.log(0.3))))
        penumbra = penumbra_px * world.px_m
        normal = np.array([np.cos(angle), np.sin(angle)])
        at = np.array([rng.uniform(0.002, foam.width_m + 0.001), rng.uniform(-0.11, 0.11)])
        if onset == "creeping":
            half_length = 0.5 * foam.length_m
            corners = np.array([[x, y] for x in (0.0, foam.width_m) for y in (-half_length, half_length)])
            # The first corner is reached within the first three frames.
            ahead = (
                ((corners - at) @ normal).max() + 0.5 * penumbra + (half if shape in (BAND, DISC) else 0.0)
            )
            at = at + normal * (ahead - speed * rng.uniform(0, 3) * FRAME_S)
        elif rng.random() < 0.5:
            speed = 0.0
        if onset == "leaving":
            speed = -speed
        if onset in ("first", "sudden"):
            speed *= 0.3
        return cls(
            world,
            shape,
            at,
            angle,
            speed,
            half,
            penumbra,
            world.darkness(dark),
            (reach * np.cos(light), reach * np.sin(light)),
            bool(rng.random() < 0.5),
            {
                "shape": shape,
                "penumbra_px": penumbra_px,
                "dark": dark,
                "angle_rad": angle,
                "speed_m_s": speed,
            },
        )

    def row(self, t_s: float) -> np.ndarray:
        """The shadow at a time."""
        normal = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)])
        at = self.at_m - normal * self.speed_m_s * t_s
        return shadow_row(
            self.shape,
            (float(at[0]), float(at[1])),
            self.angle_rad,
            penumbra_m=self.penumbra_m,
            dark=self.dark,
            half_m=self.half_m,
            floor_shift_m=self.floor_m,
            smooth=self.smooth,
        )


# -- presses ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Pushed:
    """A body pressed into the strip of the standard foam, step by step."""

    shape: Shape
    side_m: tuple[float, float]  #: first and last y of the body
    steps: tuple[Press, ...]
    about: dict

    def at(self, depth_m: float) -> Press:
        """State at a depth between the steps (monotone cubic of every place and of the force)."""
        table = _splines(self)
        first = self.steps[0]
        values = table(min(depth_m, self.max_depth_m))
        parts = np.split(values, np.cumsum([1, 2, first.y_m.size, first.y_m.size, first.end_low_m.size]))
        force, touch, y, delta, low, high = parts
        return Press(depth_m, float(force[0]), y, delta, low, high, (float(touch[0]), float(touch[1])))

    @property
    def max_depth_m(self) -> float:
        """Depth of the last step."""
        return self.steps[-1].depth_m


@cache
def _splines(pushed: Pushed) -> PchipInterpolator:
    first = pushed.steps[0]
    faces = (np.full(first.end_low_m.size, y) for y in (first.y_m[0], first.y_m[-1]))
    middle = np.full(2, np.mean(first.pressed_m))
    rest = np.concatenate([[0.0], middle, first.y_m, 0 * first.delta_m, *faces])
    rows = [
        np.concatenate([[s.force_N], s.pressed_m, s.y_m, s.delta_m, s.end_low_m, s.end_high_m])
        for s in pushed.steps
    ]
    return PchipInterpolator([0.0, *(s.depth_m for s in pushed.steps)], np.array([rest, *rows]))


@cache
def pushed(kind: str, number: int) -> Pushed:
    """A simulated press; ``number`` is even for open seeds and odd for closed ones."""
    rng = np.random.default_rng([19, number, *kind.encode()])
    foam = Foam()
    side = float(rng.choice([-1, 1]))
    if kind == "cylinder":
        radius, y = float(np.exp(rng.uniform(np.log(0.015), np.log(0.08)))), float(rng.uniform(-0.08, 0.08))
        shape, half, centres = cylinder(radius, y), 0.95 * min(radius, 0.04), [y]
        about = {"radius_m": radius}
    elif kind in ("plate", "tilted", "end"):
        half = float(rng.uniform(0.008, 0.03))
        edge = float(rng.uniform(0.002, 0.004))
        tilt = float(side * np.deg2rad(rng.uniform(1, 6))) if kind == "tilted" else 0.0
        y = float(rng.uniform(-0.07, 0.07))
        if kind == "end":
            half = 0.03 - edge if rng.random() < 0.5 else half
            # From a plate that ends 12 mm inside the strip to one that overhangs by a third.
            y = side * (0.5 * foam.length_m - (half + edge) * rng.uniform(0.4, 1.0) - rng.uniform(0, 0.012))
        shape = bar(half, edge, y, tilt)
        centres = [y - half, y + half]
        about = {"half_m": half + edge, "edge_m": edge, "tilt_rad": tilt}
        half += edge
    else:
        raise ValueError(f"found {kind}, expected cylinder, plate, tilted or end")
    depths = _DEPTHS_M
    steps = press(foam, shape, depths, centres_m=[c for c in centres if abs(c) < 0.5 * foam.length_m])
    return Pushed(shape, (y - half, y + half), tuple(steps), {"body": kind, "y_m": y, **about})


def disturbed(kind: str, seed: int) -> Sequence:
    """A press at 10 mm/s (or as the kind says) while something makes the image worse."""
    rng = np.random.default_rng([20, seed, *kind.encode()])
    world = _world(seed)
    speed = {"speed 30 mm/s": 0.03, "speed 60 mm/s": 0.06}.get(kind, 0.01)
    bodies = ("cylinder", "plate", "tilted") if speed > 0.01 else ("cylinder", "plate")
    body = "end" if kind == "plate at the end" else str(rng.choice(bodies))
    what = pushed(body, 2 * int(rng.integers(POOL)) + seed % 2)
    sequence = Sequence(world, {"kind": kind, "columns": world.columns, **what.about})
    scale = world.foam.mu_Pa[0] / Foam().mu_Pa[0]
    effect = _Effect.drawn(kind, world, rng, what)
    sequence.rest = effect.at_rest(Moment())
    exposure_s = float(rng.uniform(0.002, 0.012)) if speed > 0.01 else 0.0
    first = -4.0 * speed * FRAME_S + float(rng.uniform(0, 1)) * speed * FRAME_S
    count = 4 + int(np.ceil((what.max_depth_m - first) / (speed * FRAME_S))) - 3
    for i in range(count):
        depth = min(first + i * speed * FRAME_S, what.max_depth_m)
        if i >= count - 3:
            depth = what.max_depth_m  # held at the end
        travel_px = speed * exposure_s / world.px_m
        parts = max(1, min(6, int(np.ceil(travel_px)))) if i < count - 3 else 1
        between = (np.arange(parts) + 0.5) / parts - 0.5
        moments = []
        for part in between:
            now = min(depth + part * speed * exposure_s, what.max_depth_m)
            state = what.at(now) if now > 0 else None
            moments.append(effect.at(Moment(state, what.shape, now, what.side_m), i))
        state = what.at(depth) if depth > 0 else None
        sequence.add(
            i,
            *moments,
            force_N=scale * state.force_N if state else 0.0,
            depth_m=max(depth, 0.0),
            counted=depth > 0.3e-3,
            disturbed=effect.active(i),
            contact_m=state.pressed_m if state else (float("nan"), float("nan")),
        )
    return sequence


@dataclass(slots=True)
class _Effect:
    """What makes the images of a press worse."""

    kind: str
    world: World
    cast: _Cast | None = None
    spread: np.ndarray | None = None
    everywhere: bool = False  #: while zeroing, too
    flicker: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gains: np.ndarray = field(default_factory=lambda: np.ones(400))
    fingers: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    window: tuple[int, int] = (0, 10_000)  #: frames in which the hand is there
    entry_m: np.ndarray = field(default_factory=lambda: np.zeros(2))

    @classmethod
    def drawn(cls, kind: str, world: World, rng: np.random.Generator, what: Pushed) -> _Effect:
        effect = cls(kind, world)
        if kind in ("soft shadow", "hard shadow"):
            cast = _Cast.drawn(world, rng, "creeping")
            cast.penumbra_m = world.px_m * float(rng.uniform(12, 40) if kind[0] == "s" else rng.uniform(0, 2))
            cast.speed_m_s = float(rng.uniform(0.02, 0.15))
            effect.cast = cast
        elif kind == "flicker":
            mains = float(rng.choice([100.0, 120.0]))
            effect.flicker = (
                float(rng.uniform(0.04, 0.25)),
                mains + float(rng.normal(0, 0.05)),
                float(rng.uniform(0, 1)),
            )
            effect.everywhere = True
        elif kind == "exposure steps":
            steps = np.exp(rng.normal(0, 0.12, 80))
            effect.gains = np.clip(np.repeat(steps, rng.integers(3, 9)), 0.7, 1.25)
        elif kind == "motion blur 7 px":
            effect.spread = point_spread(world.lens_px, motion_px=7.0, angle_rad=float(rng.uniform(0, np.pi)))
        elif kind == "defocus 3 px":
            effect.spread = point_spread(world.lens_px, defocus_px=3.0, disc=bool(rng.random() < 0.5))
            effect.everywhere = bool(rng.random() < 0.5)
        elif kind == "hand":
            begin = int(rng.integers(8, 16))
            effect.window = (begin, begin + int(rng.integers(7, 12)))
            count, y = int(rng.integers(1, 4)), float(rng.uniform(-0.11, 0.11))
            radius = rng.uniform(0.006, 0.009, count)
            ys = y + 0.019 * np.arange(count)
            tips = rng.uniform(0.002, 0.024) + rng.uniform(-0.004, 0.004, count)
            lean = float(rng.uniform(-0.04, 0.04))
            effect.fingers = np.column_stack([tips, ys, tips + 0.12, ys + lean, radius])
            effect.entry_m = np.array([0.05, lean * 0.4])
        return effect

    def active(self, i: int) -> bool:
        """Whether the i-th frame shows it."""
        return self.kind != "none" and self.window[0] <= i < self.window[1]

    def at_rest(self, moment: Moment) -> Moment:
        """The strip while zeroing."""
        return replace(moment, spread=self.spread, flicker=self.flicker) if self.everywhere else moment

    def at(self, moment: Moment, i: int) -> Moment:
        """The i-th frame."""
        moment = replace(moment, spread=self.spread, flicker=self.flicker, gain=float(self.gains[i]))
        if self.cast is not None:
            moment.shadows = [self.cast.row(i * FRAME_S)]
        if len(self.fingers) and self.active(i):
            # In within two frames, out within two.
            away = max(0, 2 - (i - self.window[0]), 3 - (self.window[1] - i)) / 2
            moved = self.fingers.copy()
            moved[:, 0:2] += away * self.entry_m
            moved[:, 2:4] += away * self.entry_m
            moment.capsules = moved
            palm = shadow_row(
                BAND,
                (0.0, float(moved[:, 1].mean()) + 0.01),
                0.5 * np.pi,
                penumbra_m=0.012,
                dark=self.world.darkness(0.25),
                half_m=0.01 * len(moved),
            )
            moment.shadows = [*moment.shadows, palm]
        return moment
