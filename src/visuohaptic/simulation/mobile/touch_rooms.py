"""A small office for mapping by touch (Alt 2016, Fig. 3.11): walls, a column, a cabinet, a chair leg; a bin and bottles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .obstacles import ObstacleKind, SimulatedObstacle, box, cylinder, wall

WALL_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TouchRoom:
    """The room with its objects, and ground truth at any point."""

    size_m: tuple[float, float]  #: free space between the walls, corner at (0, 0)
    obstacles: tuple[SimulatedObstacle, ...]
    start: tuple[float, float, float]  #: of the platform (x [m], y [m], heading [rad])

    def occupied(
        self, points_m: Float[np.ndarray, "*n 2"], *, movable: bool = False, grow_m: float = 0.0
    ) -> Bool[np.ndarray, "*n"]:
        """Whether points are inside fixed, or movable, objects at their initial poses.

        Parameters
        ----------
        points_m
            Points (..., 2) [m].
        movable
            Whether the movable objects are meant, else the fixed ones.
        grow_m
            Growth of the objects [m].
        """
        inside = np.zeros(points_m.shape[:-1], dtype=bool)
        for o in self.obstacles:
            if o.movable != movable:
                continue
            c, s = math.cos(o.yaw_rad), math.sin(o.yaw_rad)
            dx, dy = points_m[..., 0] - o.x_m, points_m[..., 1] - o.y_m
            u, v = c * dx + s * dy, c * dy - s * dx
            if o.kind is ObstacleKind.CYLINDER:
                inside |= np.hypot(u, v) <= 0.5 * o.length_m + grow_m
            else:
                inside |= (np.abs(u) <= 0.5 * o.length_m + grow_m) & (np.abs(v) <= 0.5 * o.width_m + grow_m)
        return inside


def touch_room(seed: int) -> TouchRoom:
    """A room of about 3.4 m x 2.6 m whose size and objects depend on the seed.

    Parameters
    ----------
    seed
        Seed of the room.
    """
    rng = np.random.default_rng(seed)
    wide, deep = float(rng.uniform(3.2, 3.8)), float(rng.uniform(2.4, 3.0))
    t = WALL_M
    fixed = [
        wall("south wall", 0.5 * wide, -0.5 * t, wide + 2 * t, t),
        wall("north wall", 0.5 * wide, deep + 0.5 * t, wide + 2 * t, t),
        wall("west wall", -0.5 * t, 0.5 * deep, deep, t, yaw_rad=0.5 * math.pi),
        wall("east wall", wide + 0.5 * t, 0.5 * deep, deep, t, yaw_rad=0.5 * math.pi),
    ]
    column = float(rng.uniform(0.3, 0.45))
    fixed.append(box("column", wide - 0.5 * column, deep - 0.5 * column, (column, column, 1.0), fixed=True))
    cabinet = float(rng.uniform(0.5, 0.8))
    fixed.append(box("cabinet", 0.5 * cabinet, deep - 0.2, (cabinet, 0.4, 0.8), fixed=True))
    movables = [
        cylinder(
            "paper bin", wide - float(rng.uniform(0.22, 0.3)), float(rng.uniform(0.9, 1.3)), 0.11, 0.3,
            mass_kg=0.6, friction=0.35,
        ),
        cylinder("bottle 1", float(rng.uniform(0.9, 1.3)), float(rng.uniform(0.2, 0.3)), 0.045, 0.25, mass_kg=0.5, friction=0.3),
        cylinder("bottle 2", float(rng.uniform(0.2, 0.3)), float(rng.uniform(1.1, 1.5)), 0.045, 0.25, mass_kg=0.5, friction=0.3),
    ]  # fmt: skip
    start = (0.55 * wide, 0.5 * deep, -0.5 * math.pi)
    return TouchRoom((wide, deep), (*fixed, *movables), start)
