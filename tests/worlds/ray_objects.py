"""Thin clear vessels, and opaque objects beside them, as profiles of revolution."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator

from .ray_optics import CLEAR, Box, Revolved

__all__ = ["BLACK", "KINDS", "METAL", "PLAIN", "Vessel", "can", "carton", "random_vessel", "ring_handle"]

#: Opaque materials: bright and diffuse, hardly any light back, shiny.
PLAIN, BLACK, METAL = 0, 1, 2
AIR, GLASS, WATER = 1.0, 1.52, 1.333
#: Air between the foot of a vessel and the table [m].
_GAP_M = 2e-4
#: Kinds of vessels.
KINDS = ("bottle", "glass", "wine glass", "jar", "bowl")


@dataclass(frozen=True, slots=True)
class Vessel:
    """A thin vessel of revolution that stands upright, fully clear."""

    kind: str
    outer: np.ndarray  #: profile (n, 2) of radius and height [m], from the axis at the bottom to the rim
    inner: np.ndarray  #: profile (m, 2) of the cavity, from the axis at its bottom to the rim
    wall_m: float
    position_m: np.ndarray  #: of the middle of its foot in the world, (3,)
    fill_m: float = 0.0  #: height of the water above the bottom of the cavity; 0: empty
    bounds_m: np.ndarray = field(init=False)  #: lowest and highest corner of its axis-aligned box, (2, 3)

    def __post_init__(self) -> None:
        r, h = self.outer[:, 0].max(), self.outer[:, 1].max()
        corners = np.array([[-r, -r, 0.0], [r, r, h]]) + self.position_m
        object.__setattr__(self, "bounds_m", corners)

    def solid(self, material: int = CLEAR) -> Revolved:
        """The vessel of glass, or its opaque copy."""
        level = self.inner[0, 1] + self.fill_m
        inside = self.inner
        if self.fill_m > 0:
            r = np.interp(level, inside[:, 1], inside[:, 0])
            below = inside[inside[:, 1] < level - 1e-6]
            above = inside[inside[:, 1] > level + 1e-6]
            inside = np.concatenate([below, [[r, level]], above])
        path = np.concatenate([self.outer, inside[::-1]])
        pieces = _pieces(path)
        wet = (np.arange(len(pieces)) >= len(self.outer)) & (pieces[:, 1] <= level + 1e-9)
        pieces[wet & (self.fill_m > 0), 4] = WATER
        if self.fill_m > 0:
            pieces = np.concatenate([pieces, [[0.0, level, r, level, WATER, AIR]]])
        return Revolved(pieces, self.position_m, material)

    def surface(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Points (count, 3) of the outer surface in the world [m], uniform in area."""
        lengths = np.hypot(*np.diff(self.outer, axis=0).T)
        area = lengths * (self.outer[1:, 0] + self.outer[:-1, 0])
        piece = rng.choice(len(area), count, p=area / area.sum())
        # The radius of a frustum grows along it: inversion of its area by the square root.
        r0, r1 = self.outer[piece, 0], self.outer[piece + 1, 0]
        u = rng.random(count)
        with np.errstate(invalid="ignore", divide="ignore"):
            s = np.where(abs(r1 - r0) < 1e-9, u, (np.sqrt(r0**2 + u * (r1**2 - r0**2)) - r0) / (r1 - r0))
        profile = self.outer[piece] + s[:, None] * (self.outer[piece + 1] - self.outer[piece])
        angle = rng.uniform(0, 2 * np.pi, count)
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        return np.column_stack([profile[:, :1] * circle, profile[:, 1]]) + self.position_m

    def distance(self, points_m: np.ndarray) -> np.ndarray:
        """Distance of points (n, 3) of the world from the outer surface [m]."""
        local = np.asarray(points_m) - self.position_m
        flat = np.column_stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]])
        a, b = self.outer[:-1], self.outer[1:]
        along = b - a
        s = np.einsum("nkd,kd->nk", flat[:, None] - a, along) / np.maximum((along**2).sum(axis=1), 1e-18)
        nearest = a + np.clip(s, 0, 1)[..., None] * along
        return np.linalg.norm(flat[:, None] - nearest, axis=2).min(axis=1)


def _pieces(path: np.ndarray) -> np.ndarray:
    """Pieces of a profile, glass inside and air outside."""
    media = np.broadcast_to([AIR, GLASS], (len(path) - 1, 2))
    return np.concatenate([path[:-1], path[1:], media], axis=1)


def _smooth(controls: list[tuple[float, float]], count: int) -> np.ndarray:
    """A profile through control points (r, z), as many points at equal arc length."""
    points = np.array(controls)
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    fine = np.linspace(0, arc[-1], 400)
    curve = np.column_stack([PchipInterpolator(arc, points[:, k])(fine) for k in (0, 1)])
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    at = np.linspace(0, length[-1], count)
    return np.column_stack([np.interp(at, length, curve[:, k]) for k in (0, 1)])


def _cavity(side: np.ndarray, wall: float, floor: float) -> np.ndarray:
    """The inside of a wall: the outer side moved inward, above the floor."""
    tangent = np.gradient(side, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    inner = side + wall * np.column_stack([-tangent[:, 1], tangent[:, 0]])
    # The rim is level, so that wall and cavity end in one plane.
    inner = inner[(inner[:, 1] > floor + 1e-4) & (inner[:, 0] > 1e-4) & (inner[:, 1] < side[-1, 1] - 1e-4)]
    inner = inner[np.concatenate([[True], np.diff(np.maximum.accumulate(inner[:, 1])) > 1e-6])]
    first = [[0.0, floor], [max(inner[0, 0] - 1e-4, 1e-4), floor]]
    return np.concatenate([first, inner, [[side[-1, 0] - wall, side[-1, 1]]]])


def _side(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Outer side of a vessel from its foot's edge to the rim, and the height of the cavity's floor [m]."""
    u = rng.uniform
    if kind == "bottle":
        r, h, n = u(0.030, 0.042), u(0.18, 0.28), u(0.011, 0.015)
        s = u(0.55, 0.68) * h
        side = [(r - 0.003, 0), (r, 0.004), (r, 0.5 * s), (r, s), (n, s + 0.2 * h), (n, s + 0.25 * h), (n, h)]
        return _smooth(side, 44), u(0.003, 0.006)
    if kind == "glass":
        r, h = u(0.024, 0.034), u(0.09, 0.16)
        top = r + u(0.003, 0.010)
        return _smooth([(r, 0), (0.5 * (r + top), 0.5 * h), (top, h)], 24), u(0.005, 0.010)
    if kind == "wine glass":
        foot, stem, r, bowl = u(0.030, 0.037), u(0.06, 0.09), u(0.034, 0.043), u(0.08, 0.11)
        side = [(foot, 0), (foot, 0.003), (0.012, 0.006), (0.0045, 0.018), (0.0045, stem - 0.008)]
        side += [
            (0.014, stem + 0.002),
            (0.8 * r, stem + 0.02),
            (r, stem + 0.4 * bowl),
            (0.85 * r, stem + bowl),
        ]
        return _smooth(side, 64), stem + 0.005
    if kind == "jar":
        r, h = u(0.038, 0.050), u(0.09, 0.14)
        side = [(r - 0.004, 0), (r, 0.005), (r, 0.4 * h), (r, 0.75 * h), (0.84 * r, 0.87 * h), (0.84 * r, h)]
        return _smooth(side, 40), u(0.004, 0.007)
    r, h = u(0.060, 0.090), u(0.050, 0.075)
    side = [(0.45 * r, 0), (0.62 * r, 0.1 * h), (0.85 * r, 0.42 * h), (r, h)]
    return _smooth(side, 30), u(0.004, 0.006)


def random_vessel(
    kind: str, rng: np.random.Generator, position_m: tuple[float, float], *, filled: bool = False
) -> Vessel:
    """A vessel of a kind with walls of 2.5 to 3 mm, on the table at z = 0."""
    wall = rng.uniform(0.0025, 0.003)
    side, floor = _side(kind, rng)
    bowl = side[side[:, 1] > floor - 0.003] if kind == "wine glass" else side
    inner = _cavity(bowl, wall, floor)
    fill = rng.uniform(0.45, 0.8) * (inner[-1, 1] - floor) if filled else 0.0
    outer = np.concatenate([[[0.0, 0.0]], side])
    return Vessel(kind, outer, inner, wall, np.array([*position_m, _GAP_M]), fill)


def can(radius_m: float, height_m: float, position_m: tuple[float, float, float], material: int) -> Revolved:
    """An opaque cylinder on its foot."""
    path = np.array([[0, 0], [radius_m, 0], [radius_m, height_m], [0, height_m]])
    return Revolved(_pieces(path), np.array(position_m, dtype=float), material)


def ring_handle(vessel: Vessel, turn_rad: float, rng: np.random.Generator) -> Revolved:
    """A handle of glass: an upright ring that touches the wall of a vessel in half of its height, on the side of an angle."""
    ring, thick = rng.uniform(0.018, 0.024), rng.uniform(0.004, 0.006)
    z = 0.5 * vessel.outer[-1, 1]
    way = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    # Its own axis is level, across the way to it; its inner side has no piece in the wall.
    away = float(np.interp(z, vessel.outer[:, 1], vessel.outer[:, 0])) + ring + thick + _GAP_M
    angle = np.linspace(-np.pi / 2, 1.5 * np.pi, 25)
    path = np.column_stack([ring + thick * np.cos(angle), thick * np.sin(angle)])
    axes = np.column_stack([way, [0.0, 0.0, 1.0], np.cross(way, [0.0, 0.0, 1.0])])
    return Revolved(_pieces(path), vessel.position_m + away * way + [0.0, 0.0, z], CLEAR, axes)


def carton(edges_m: np.ndarray, position_m: tuple[float, float], yaw_rad: float, material: int) -> Box:
    """An opaque box on the table."""
    half = 0.5 * np.asarray(edges_m)
    return Box(np.array([*position_m, half[2]]), half, yaw_rad, material)
