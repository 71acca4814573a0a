"""Shadows and beams of one to three lamps on a strip that nothing touches, in small pictures.

Another light than that of ``foam_scene.py``: lamps are discs with colours, things before them cast one edge for each lamp, nearly
parallel, which the floor shows elsewhere than the foam; edges stop on the strip, cross, are beams, and the floor may have stripes
and move. Surfaces are painted at thirds of a pixel. Every sequence is generated from one seed; even seeds are open.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .foam import Sequence, draw_world
from .foam_optics import BASE, FLOOR, FOAM
from .foam_scene import FRAME_S, World

__all__ = ["LAMP_FRAMES", "lamps"]

#: Frames of a sequence after those at rest.
LAMP_FRAMES = 5
#: Image [px], and parts of a pixel to either side.
_SIZE, _PARTS = (480, 360), 3


@dataclass(slots=True)
class Edge:
    """Straight edge of a thing before a lamp, as its shadow is seen on the foam at time 0."""

    at_m: np.ndarray
    normal: np.ndarray  #: into the shadow
    speed_m_s: float  #: along the normal
    penumbra_m: float
    long_m: float  #: thickness of the thing, infinite for a half plane
    side_m: float  #: the shadow ends there along the edge, infinite if it does not

    def hidden(self, x: np.ndarray, y: np.ndarray, shift_m: np.ndarray, t_s: float) -> np.ndarray:
        """Fraction of a disc that the thing hides, seen from places of which the shadow is displaced by ``shift_m``."""
        u, v = x - np.float32(self.at_m[0] + shift_m[0]), y - np.float32(self.at_m[1] + shift_m[1])
        ahead = u * np.float32(self.normal[0]) + v * np.float32(self.normal[1])
        ahead -= np.float32(self.speed_m_s * t_s)
        part = _disc(ahead, self.penumbra_m)
        if np.isfinite(self.long_m):
            part = part - _disc(ahead - np.float32(self.long_m), self.penumbra_m)
        if np.isfinite(self.side_m):
            along = v * np.float32(self.normal[0]) - u * np.float32(self.normal[1])
            part = part * _disc(np.float32(self.side_m) - along, self.penumbra_m)
        return part


def _disc(ahead: np.ndarray, width: float) -> np.ndarray:
    """Part of a disc of this diameter that lies below a straight edge."""
    t = np.clip(ahead / np.float32(0.5 * max(width, 1e-9)), -1.0, 1.0)
    return (np.arccos(-t) + t * np.sqrt(1.0 - t * t)) / np.float32(np.pi)


@dataclass(slots=True)
class Lit:
    """One time of a sequence; before the shadows come at rest."""

    time_s: float | None = None
    flicker: tuple[float, float, float] = (0.0, 0.0, 0.0)


class LampWorld(World):
    """A strip, its camera, and the lamps above it."""

    def __init__(self, seed: int) -> None:
        drawn = draw_world(seed, size=_SIZE)
        self.__dict__.update(drawn.__dict__)
        self.rng = np.random.default_rng([31, seed])
        rows, columns = self.rows * _PARTS, self.columns * _PARTS
        u, v = np.meshgrid(np.arange(columns), np.arange(rows))
        u, v = ((w + 0.5) / _PARTS - 0.5 for w in (u, v))
        self._x, self._y = ((row[0] * u + row[1] * v + row[2]).astype(np.float32) for row in self.inverse)
        front = np.interp(self._y, self.y_m, self._front0)
        foam = (self._x >= 0) & (self._x <= front) & (np.abs(self._y) <= 0.5 * self.foam.length_m)
        self._part = np.stack([(self._x < 0), foam]).astype(np.float32)
        self._grain = [self._noise(surface) for surface in (BASE, FOAM, FLOOR)]
        self._draw_lamps()
        self._draw_floor()

    def _noise(self, surface: int) -> np.ndarray:
        """Texture of a surface over the whole image, with the contrast of the world's own."""
        shape, own = self._x.shape, float(self.textures[surface].std())
        fine = cv2.GaussianBlur(
            self.rng.standard_normal(shape, dtype=np.float32), (0, 0), float(self.rng.uniform(2, 9))
        )
        return np.maximum(1 + own * fine / fine.std(), 0.05).astype(np.float32)

    def _draw_lamps(self) -> None:
        rng, width = self.rng, self.foam.width_m
        count = int(rng.choice([1, 2, 3], p=[0.3, 0.4, 0.3]))
        self.power = rng.uniform(0.1, 0.5, count)[:, None] * np.ones(len(self.tint))
        if self.colour:
            self.power = self.power * rng.uniform(0.6, 1.3, self.power.shape)
        self.power *= min(1.0, 0.75 / self.power.sum(axis=0).max())
        self.beam = np.array([rng.random() < 0.15 for _ in range(count)])
        angle = float(rng.choice([0.0, np.pi]) + rng.uniform(-0.09, 0.09))
        if rng.random() < 0.4:
            angle = float(rng.uniform(-np.pi, np.pi))
        speed = float(rng.choice([0.0, rng.uniform(0, 5), rng.uniform(5, 40)])) * self.px_m / FRAME_S
        at = np.array([rng.uniform(0.2, 1.3) * width, rng.uniform(-0.4, 0.4) * self.foam.length_m])
        self.edges, self.apart = [], rng.random() < 0.3
        floor = rng.uniform(0, 0.6) * self.foam.height_m
        self.floor_shift = []
        for _ in range(count):
            turned = angle + rng.uniform(-0.09, 0.09) * (rng.random() < 0.5)
            if rng.random() < 0.15:
                turned = rng.uniform(-np.pi, np.pi)
            normal = np.array([np.cos(turned), np.sin(turned)])
            soft = 0.0 if rng.random() < 0.6 else float(np.exp(rng.uniform(np.log(0.5), np.log(12.0))))
            aside = normal * rng.uniform(-0.008, 0.008) + rng.normal(0, 0.001, 2)
            self.edges.append(
                Edge(
                    at + aside - normal * speed * 2 * FRAME_S, normal, speed, soft * self.px_m,
                    float(rng.uniform(0.002, 0.03)) if rng.random() < 0.3 else np.inf,
                    float(rng.uniform(-0.03, 0.03)) if rng.random() < 0.25 else np.inf,
                )
            )  # fmt: skip
            away = rng.uniform(-np.pi, np.pi)
            self.floor_shift.append(floor * np.array([np.cos(away), np.sin(away)]))

    def _draw_floor(self) -> None:
        """Stripes of the floor, and how far it moves per second."""
        rng, width = self.rng, self.foam.width_m
        self.stripes, self.drift = [], np.zeros(2)
        if rng.random() < 0.4:
            turned = rng.uniform(-0.09, 0.09) if rng.random() < 0.6 else rng.uniform(-np.pi, np.pi)
            for _ in range(int(rng.integers(1, 4))):
                place, half = width + rng.uniform(-0.002, 0.012), rng.uniform(0.0005, 0.004)
                self.stripes.append((place, turned, half, rng.choice([-0.6, 0.6]) * rng.uniform(0.3, 1)))
            if rng.random() < 0.6:
                self.drift = rng.uniform(-0.03, 0.03, 2)

    def light_at(self, t_s: float | None, *, floor: bool) -> np.ndarray:
        """Light relative to that of all lamps, on the floor or as high as the foam."""
        light = np.ones((*self._x.shape, len(self.tint)), np.float32)
        if t_s is None:
            return light
        for i, edge in enumerate(self.edges):
            shift = self.floor_shift[i] if floor else np.zeros(2)
            part = edge.hidden(self._x, self._y, shift, t_s)[..., None] * self.power[i].astype(np.float32)
            light += 0.5 * part if self.beam[i] else -part
        return light

    def image(self, *moments: Lit) -> np.ndarray:
        """One image."""
        (moment,) = moments
        t_s = moment.time_s
        base, foam, floor = self._grain
        away = np.zeros(2) if t_s is None else self.drift * t_s
        if away.any():
            pixel = np.linalg.solve(self.inverse[:, :2], away) * _PARTS
            move = np.array([[1, 0, pixel[0]], [0, 1, pixel[1]]], np.float32)
            floor = cv2.warpAffine(
                floor, move, floor.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
            )
        for place, turned, half, more in self.stripes:
            across = (self._x - place - away[0]) * np.cos(turned) + (self._y - away[1]) * np.sin(turned)
            floor = floor * np.where(np.abs(across) < half, 1 + more, 1).astype(np.float32)
        top = base * self._part[0], foam * self._part[1]
        low = floor * (1 - self._part.sum(axis=0))
        albedo = self.albedo.astype(np.float32)
        high, deep = self.light_at(t_s, floor=False), self.light_at(t_s, floor=True)
        out = high * (top[0][..., None] * albedo[BASE] + top[1][..., None] * albedo[FOAM])
        out += deep * low[..., None] * albedo[FLOOR]
        light = cv2.resize(out, (self.columns, self.rows), interpolation=cv2.INTER_AREA)
        light = light.reshape(self.rows, self.columns, -1) * self.light
        return self.sensor.image(light, self.spread, self.rng)


def lamps(seed: int) -> Sequence:
    """Shadows and beams of some lamps that come within one frame, or move on; nothing touches the strip.

    Parameters
    ----------
    seed
        Any integer.
    """
    world = LampWorld(seed)
    began = world.rng.random() < 0.2
    rest = Lit(0.0) if began else Lit()
    about = {
        "lamps": len(world.edges),
        "began": bool(began),
        "stripes": len(world.stripes),
        "columns": world.columns,
    }
    sequence = Sequence(world, about, rest)
    for i in range(LAMP_FRAMES):
        sequence.add(i, Lit(i * FRAME_S))
    return sequence
