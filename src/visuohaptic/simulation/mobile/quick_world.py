"""A fast push world for long campaigns: no masses, no MuJoCo, one equilibrium of the strip per frame.

Platform and obstacles move quasi-statically: a movable object slides along the
foam's force once that exceeds its friction, and never rotates. For the
full dynamics of a push use :class:`~visuohaptic.simulation.mobile.push_world.FoamPushWorld`, which
takes twenty times longer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import BaseState, InputError, rotation_2d
from ..foam import SOFT_FOAM, FoamStrip, FoamStripGeometry, Outline, StripLaw, StripState
from .obstacles import ObstacleKind, SimulatedObstacle
from .platform import CommandedBase, PlatformConfig, towards


@dataclass(frozen=True, slots=True, eq=False)
class QuickTruth:
    """State at one time."""

    t_s: float
    strip: StripState
    touching: tuple[str, ...]  #: obstacles in contact with the foam


@dataclass
class QuickWorld(CommandedBase):
    """Platform with a foam bumper among obstacles; a ``robots.MobileBase`` with exact odometry."""

    obstacles: Sequence[SimulatedObstacle]
    config: PlatformConfig = field(
        default_factory=lambda: PlatformConfig(strip=FoamStripGeometry(spacing_m=0.002))
    )
    law: StripLaw = SOFT_FOAM

    def __post_init__(self) -> None:
        names = [o.name for o in self.obstacles]
        if len(set(names)) != len(names):
            raise InputError("QuickWorld", f"found obstacles {names}, expected different names")
        c = self.config
        self.pose = (c.x_m, c.y_m, c.heading_rad)
        self.places = {o.name: (o.x_m, o.y_m) for o in self.obstacles}
        self.t_s = 0.0
        self.last_touched = ""  #: the obstacle with the largest force at the last contact
        self._strip = FoamStrip(c.strip, self.law)
        self._speed = (0.0, 0.0)
        self._sliding: set[str] = set()
        # The hull except its front, which is the foam: it ends slightly behind.
        self._hull_m = (-c.radius_m, 0.9 * c.radius_m)
        self.truth = QuickTruth(0.0, self._strip.press([]), ())

    @property
    def base(self) -> QuickWorld:
        """The platform's drive: this world itself."""
        return self

    def state(self) -> BaseState:
        """Exact odometry."""
        return BaseState(self.t_s, *self.pose, *self._speed)

    def platform_pose(self) -> tuple[float, float, float]:
        """(x [m], y [m], heading [rad])."""
        return self.pose

    def step(self, dt_s: float) -> QuickTruth:
        """Advance the simulation.

        Parameters
        ----------
        dt_s
            Simulated time [s].
        """
        c, (x, y, heading) = self.config, self.pose
        speed = towards(self._speed[0], self.target_speed_m_s, c.max_acceleration_m_s2 * dt_s)
        turn = towards(self._speed[1], self.target_turn_rate_rad_s, c.max_turn_acceleration_rad_s2 * dt_s)
        if speed > 0 and -self.truth.strip.body_force_N[:, 0].sum() < -c.max_force_N:
            speed = 0.0  # the wheels stand still
        middle = heading + 0.5 * turn * dt_s
        way = speed * dt_s * np.array([math.cos(middle), math.sin(middle)])
        goal = (x + float(way[0]), y + float(way[1]), heading + turn * dt_s)
        if self._hits(goal):
            speed = turn = 0.0
            goal, way = self.pose, np.zeros(2)
        self.pose, self._speed = goal, (speed, turn)
        self.t_s += dt_s
        if speed > 0:  # a sliding object moves with the platform; nothing is pulled
            for name in self._sliding:
                self._move(name, way)
        self._brush()
        self._press(dt_s)
        return self.truth

    def _press(self, dt_s: float) -> None:
        """Balance of foam and friction; an object that is pushed with more force slides along the push."""
        near = self._near()
        sliding: set[str] = set()
        heading = self.pose[2]
        turn = rotation_2d(heading)
        for repeat in range(4):
            state = self._strip.press([cut for _, cut in near], dt_s if repeat == 0 else 0.0)
            settled = True
            for (obstacle, _), force in zip(near, state.body_force_N, strict=True):
                size = float(np.hypot(*force))
                kinetic = obstacle.name in self._sliding or obstacle.name in sliding
                limit = obstacle.dynamic_friction_N if kinetic else obstacle.static_friction_N
                if obstacle.movable and size > 1.02 * limit:
                    over = (size - obstacle.dynamic_friction_N) / max(self._strip.stiffness_N_per_m(), 1.0)
                    self._move(obstacle.name, turn @ force / size * min(over, 0.003))
                    sliding.add(obstacle.name)
                    settled = False
                elif kinetic and obstacle.movable and size > 0.8 * limit:
                    sliding.add(obstacle.name)
            if settled or repeat == 3:
                break
            near = self._near()
        self._sliding = sliding
        touching = tuple(o.name for (o, _), f in zip(near, state.body_force_N, strict=True) if f.any())
        self.truth = QuickTruth(self.t_s, state, touching)
        if touching:
            loads = np.hypot(*state.body_force_N.T)
            self.last_touched = near[int(np.argmax(loads))][0].name

    def _near(self) -> list[tuple[SimulatedObstacle, Outline]]:
        """Sections of all objects in front of the foam, frame F."""
        x, y, heading = self.pose
        c, s = math.cos(heading), math.sin(heading)
        fx, fy = x + c * self.config.radius_m, y + s * self.config.radius_m
        half = 0.5 * self.config.strip.length_m
        reach = half + 2 * self.config.strip.width_m
        found = []
        for o in self.obstacles:
            px, py = self.places[o.name]
            if math.hypot(px - fx, py - fy) < reach + o.reach_m:
                for outline in o.outlines:
                    placed = outline.moved(px, py, o.yaw_rad)
                    cut = placed.moved(-c * fx - s * fy, s * fx - c * fy, -heading)
                    # Objects behind the strip's back or beyond its ends cannot be touched.
                    if _reach_in_band(cut.polygon_m(), half) > 0.0:
                        found.append((o, cut))
        return found

    def _move(self, name: str, step_m: Float[np.ndarray, "2"]) -> None:
        px, py = self.places[name]
        self.places[name] = (px + float(step_m[0]), py + float(step_m[1]))

    def _overlaps(self, o: SimulatedObstacle, pose: tuple[float, float, float]) -> bool:
        """Whether the hull, a rectangle, and an object overlap."""
        (x, y, heading), (px, py) = pose, self.places[o.name]
        (back, front), v = self._hull_m, 0.5 * self.config.width_m
        c, s = math.cos(heading), math.sin(heading)
        mid, half = 0.5 * (front + back), 0.5 * (front - back)
        # The object's centre in the axes of the hull, from the hull's middle.
        dx, dy = px - x - c * mid, py - y - s * mid
        a, b = c * dx + s * dy, c * dy - s * dx
        if o.kind is ObstacleKind.CYLINDER:
            return math.hypot(max(abs(a) - half, 0.0), max(abs(b) - v, 0.0)) < 0.5 * o.length_m
        # Separating axes of two rectangles.
        ct, st = math.cos(o.yaw_rad - heading), math.sin(o.yaw_rad - heading)
        hu, hv = 0.5 * o.length_m, 0.5 * o.width_m
        return (
            abs(a) < half + hu * abs(ct) + hv * abs(st)
            and abs(b) < v + hu * abs(st) + hv * abs(ct)
            and abs(a * ct + b * st) < hu + half * abs(ct) + v * abs(st)
            and abs(b * ct - a * st) < hv + half * abs(st) + v * abs(ct)
        )

    def _hits(self, pose: tuple[float, float, float]) -> bool:
        """Whether the hull would penetrate a fixed object."""
        return any(not o.movable and self._overlaps(o, pose) for o in self.obstacles)

    def _brush(self) -> None:
        """The hull displaces movable objects."""
        for o in self.obstacles:
            if o.movable and self._overlaps(o, self.pose):
                away = np.array(self.places[o.name]) - np.array(self.pose[:2])
                self._move(o.name, 0.005 * away / max(float(np.hypot(*away)), 1e-6))


def _reach_in_band(polygon: Float[np.ndarray, "k 2"], half: float) -> float:
    """Largest u of a polygon (u, v) within -half < v < half; -inf if there is no intersection."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    rise = b[:, 1] - a[:, 1]
    inside = polygon[np.abs(polygon[:, 1]) < half, 0]
    cuts = []
    for level in (-half, half):
        crosses = (a[:, 1] - level) * (b[:, 1] - level) < 0
        fraction = (level - a[crosses, 1]) / rise[crosses]
        cuts.append(a[crosses, 0] + fraction * (b[crosses, 0] - a[crosses, 0]))
    return float(np.concatenate([inside, *cuts]).max(initial=-math.inf))
