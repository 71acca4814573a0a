"""Image sequences of a foam strip, with presses or with changing light only.

Every sequence is generated from one seed. Images are rendered on demand, each with its ground
truth. Even seeds are open, odd ones closed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from .foam_mechanics import Foam
from .foam_optics import BAND, DISC, EDGE, WEDGE
from .foam_scene import FRAME_S, Moment, World, shadow_row

__all__ = ["SHADOW_FRAMES", "ZERO_FRAMES", "Cast", "Sequence", "Shot", "draw_world", "pincers", "shadows"]

#: Frames of the strip at rest, and of a shadow sequence.
ZERO_FRAMES, SHADOW_FRAMES = 8, 18


@dataclass(slots=True)
class Shot:
    """One image and its ground truth."""

    image: np.ndarray
    t_s: float
    force_N: float = 0.0
    depth_m: float = 0.0
    counted: bool = True  #: whether a reading is wanted: something presses, or nothing is there but light
    disturbed: bool = True
    contact_m: tuple[float, float] = (float("nan"), float("nan"))  #: first and last place that touches


@dataclass(slots=True)
class Sequence:
    """A world, its images at rest, and the sequence after them."""

    world: World
    about: dict
    rest: Moment = field(default_factory=Moment)
    moments: list[tuple[Shot, tuple[Moment, ...]]] = field(default_factory=list)

    def zero(self) -> Iterator[Shot]:
        """Images of the untouched strip."""
        for i in range(ZERO_FRAMES):
            moment = replace(self.rest, flicker=_later(self.rest.flicker, i * FRAME_S))
            yield Shot(self.world.image(moment), i * FRAME_S)

    def shots(self) -> Iterator[Shot]:
        """Images of the sequence, in order of time."""
        image = np.empty(0)
        for shot, moments in self.moments:
            image = self.world.image(*moments) if moments else image  # no change: repeat the image
            yield replace(shot, image=image)

    def add(self, i: int, *moments: Moment, **truth) -> None:
        """Append the contents of the i-th frame after the strip at rest."""
        t_s = (ZERO_FRAMES + i) * FRAME_S
        moments = tuple(replace(m, flicker=_later(m.flicker, t_s)) for m in moments)
        self.moments.append((Shot(np.empty(0), t_s, **truth), moments))


def _later(flicker: tuple[float, float, float], t_s: float) -> tuple[float, float, float]:
    return flicker[0], flicker[1], flicker[2] + t_s


def draw_world(seed: int, **fixed) -> World:
    """The world of a seed; one in sixteen with its whole image, the others cut to the strip."""
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
    world = draw_world(seed)
    onset = str(rng.choice(["first", "creeping", "sudden", "leaving"], p=[0.35, 0.45, 0.1, 0.1]))
    count = 1 if rng.random() < 0.8 else 2
    casts = [Cast.drawn(world, rng, onset) for _ in range(count)]
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


def pincers(seed: int) -> Sequence:
    """Two soft shadows that move slowly over the strip, one after the other, without any contact."""
    rng = np.random.default_rng([21, seed])
    world = draw_world(seed)
    casts = [Cast.drawn(world, rng, "creeping", soft=True) for _ in range(2)]
    sequence = Sequence(world, {"onset": "creeping", **casts[0].about, "count": 2, "columns": world.columns})
    for i in range(SHADOW_FRAMES):
        sequence.add(i, Moment(shadows=[cast.row(i * FRAME_S) for cast in casts]))
    return sequence


@dataclass(slots=True)
class Cast:
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
    def drawn(cls, world: World, rng: np.random.Generator, onset: str, *, soft: bool = False) -> Cast:
        """A shadow of an onset of :func:`shadows`; a soft one has a penumbra of 5 px or more."""
        foam = world.foam
        shape = int(rng.choice([EDGE, BAND, DISC, WEDGE], p=[0.5, 0.2, 0.15, 0.15]))
        along = rng.random() < 1 / 3
        angle = (
            float(rng.choice([0.0, np.pi]) + rng.normal(0, 0.06))
            if along
            else float(rng.uniform(-np.pi, np.pi))
        )
        penumbra_px = 0.0 if rng.random() < 0.3 else float(np.exp(rng.uniform(np.log(0.5), np.log(40.0))))
        if soft:
            penumbra_px = float(np.exp(rng.uniform(np.log(5.0), np.log(40.0))))
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
