"""Floors seen by a low camera on a driving robot: tiles, brick, parquet, grass, with a moving shadow and a box.

The camera looks ahead and down. Floor and faces of the box are textures on planes, rendered by their homographies
at twice the size; a soft disc of shadow moves over the floor. Even seeds are open, odd ones closed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

__all__ = ["FLOORS", "FRAME_S", "HEIGHT", "WIDTH", "Drive", "View", "drive"]

FLOORS = ("tiles", "brick", "parquet", "grass")
WIDTH, HEIGHT, FOCAL_PX, FRAME_S = 800, 448, 700.0, 1.0 / 30
#: Camera above the floor and behind the origin of its axes [m], and its downward tilt [rad].
_ABOVE_M, _BEHIND_M, _DOWN_RAD = 0.30, 0.05, np.deg2rad(45.0)
#: Side of the texture [m] and of its pixels [m].
_SIDE_M, _PIXEL_M = 1.4, 1e-3
_SUPER = 2


@dataclass(frozen=True)
class View:
    """A pinhole camera that looks at the floor; plane axes: x ahead, y to the left, z up."""

    @property
    def matrix(self) -> np.ndarray:
        """Intrinsic matrix."""
        return np.array([[FOCAL_PX, 0, WIDTH / 2 - 0.5], [0, FOCAL_PX, HEIGHT / 2 - 0.5], [0, 0, 1.0]])

    @property
    def rotation(self) -> np.ndarray:
        """Columns: axes of the plane in those of the camera (x right, y down, z along the view)."""
        s, c = np.sin(_DOWN_RAD), np.cos(_DOWN_RAD)
        return np.array([[0, -1.0, 0], [-s, 0, -c], [c, 0, -s]])

    @property
    def origin_m(self) -> np.ndarray:
        """Origin of the plane in the camera's axes."""
        return -self.rotation @ np.array([-_BEHIND_M, 0.0, _ABOVE_M])

    def plane(self, corner: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Homography from (metres along, metres across, 1) on a plane to the image."""
        r = self.rotation
        return self.matrix @ np.column_stack([r @ along, r @ across, r @ corner + self.origin_m])


@dataclass
class Drive:
    """A floor with its objects, and the motion of the camera; poses are (x, y, theta) of the plane's axes."""

    floor: np.ndarray  #: texture, BGR, linear light 0 to 1
    poses: np.ndarray  #: (frames, 3) [m, rad]
    rng: np.random.Generator
    box: np.ndarray | None = None  #: x of its near face, y of its middle, side [m]
    skin: np.ndarray | None = None  #: texture of its faces
    shadow: np.ndarray | None = None  #: x, y, speed x, speed y, radius, penumbra [m], part of the light

    def images(self) -> Iterator[np.ndarray]:
        """Frames, BGR."""
        for i, pose in enumerate(self.poses):
            yield self.image(pose, i * FRAME_S)

    def image(self, pose: np.ndarray, t_s: float) -> np.ndarray:
        """One frame."""
        view, size = View(), (WIDTH * _SUPER, HEIGHT * _SUPER)
        up = np.array([[_SUPER, 0, 0.5 * (_SUPER - 1)], [0, _SUPER, 0.5 * (_SUPER - 1)], [0, 0, 1.0]])
        c, s = np.cos(pose[2]), np.sin(pose[2])
        to_robot = np.array(
            [[c, s, -c * pose[0] - s * pose[1]], [-s, c, s * pose[0] - c * pose[1]], [0, 0, 1]]
        )
        to_metres = np.array([[_PIXEL_M, 0, 0], [0, _PIXEL_M, -_SIDE_M / 2], [0, 0, 1.0]])
        ground = view.plane(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
        world = up @ ground @ to_robot
        flags = cv2.INTER_LINEAR
        picture = cv2.warpPerspective(
            self.floor, world @ to_metres, size, flags=flags, borderMode=cv2.BORDER_REFLECT
        )
        if self.shadow is not None:
            picture *= self._light(np.linalg.inv(world), t_s)[..., None]
        if self.box is not None:
            self._draw_box(picture, view, up, to_robot)
        small = cv2.resize(
            cv2.GaussianBlur(picture, (0, 0), 0.8 * _SUPER), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
        )
        grey = 255.0 * np.power(np.clip(small, 1e-4, 1.0), 1 / 2.2)
        return np.clip(grey + self.rng.normal(0.0, 2.0, grey.shape), 0, 255).astype(np.uint8)

    def _light(self, to_floor: np.ndarray, t_s: float) -> np.ndarray:
        """Fraction of the light that reaches the floor at each pixel."""
        assert self.shadow is not None
        x, y, speed_x, speed_y, radius, penumbra, part = self.shadow
        v, u = np.mgrid[0 : HEIGHT * _SUPER, 0 : WIDTH * _SUPER].astype(np.float32)
        q = [row[0] * u + row[1] * v + row[2] for row in to_floor]
        away = np.hypot(q[0] / q[2] - x - speed_x * t_s, q[1] / q[2] - y - speed_y * t_s)
        return (1.0 - part * np.clip(0.5 - (away - radius) / penumbra, 0, 1)).astype(np.float32)

    def _draw_box(self, picture: np.ndarray, view: View, up: np.ndarray, to_robot: np.ndarray) -> None:
        """Sides, near face and top over the floor."""
        assert self.box is not None
        assert self.skin is not None
        x, y, side = self.box
        turn = to_robot[:2, :2]
        corners = [(x, y - side / 2), (x, y + side / 2), (x + side, y + side / 2), (x + side, y - side / 2)]
        place = [np.array([*(turn @ np.array(p) + to_robot[:2, 2]), 0.0]) for p in corners]
        tall = np.array([0, 0, 1.0])
        faces = [(place[1], place[2] - place[1], tall, 0.75), (place[0], place[3] - place[0], tall, 0.65),
                 (place[0], place[1] - place[0], tall, 0.85), (place[0] + side * tall, place[1] - place[0],
                                                               (place[3] - place[0]) / side, 1.0)]  # fmt: skip
        eye = np.array([-_BEHIND_M, 0.0, _ABOVE_M])
        outward = [place[2] - place[3], place[3] - place[2], place[0] - place[3], tall]
        for (corner, along, across, light), out in zip(faces, outward, strict=True):
            if (eye - corner) @ out <= 0:
                continue
            plane = up @ view.plane(corner, along / np.linalg.norm(along), across)
            scale = np.diag([side / self.skin.shape[1], side / self.skin.shape[0], 1.0])
            size = picture.shape[1::-1]
            drawn = cv2.warpPerspective(light * self.skin, plane @ scale, size)
            inside = cv2.warpPerspective(np.ones(self.skin.shape[:2], np.float32), plane @ scale, size)[
                ..., None
            ]
            picture[:] = picture * (1 - inside) + drawn * inside


def _noise(
    rng: np.random.Generator, shape: tuple[int, int], sizes: dict[tuple[float, float], float]
) -> np.ndarray:
    """Sum of smoothed noise: standard deviation by its sizes along both axes [texture pixels]."""
    total = np.zeros(shape, np.float32)
    for (along, across), sigma in sizes.items():
        layer = cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), sigmaX=across, sigmaY=along)
        total += sigma * layer / layer.std()
    return total


def _floor(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Texture: columns run ahead, rows to the left; BGR."""
    n = round(_SIDE_M / _PIXEL_M)
    y, x = np.mgrid[0:n, 0:n] * _PIXEL_M
    if kind == "grass":
        blades = np.exp(_noise(rng, (n, n), {(1.5, 1.5): 0.35, (4, 1.2): 0.3, (25, 25): 0.2}))
        return np.clip(blades[..., None] * np.array([0.05, 0.16, 0.09]), 0, 1).astype(np.float32)
    length, width, joint = {
        "tiles": (0.15, 0.15, 0.004),
        "brick": (0.2, 0.065, 0.009),
        "parquet": (0.4, 0.07, 0.001),
    }[kind]
    turn = rng.uniform(-0.4, 0.4)
    a, b = np.cos(turn) * x + np.sin(turn) * y + 10.0, np.cos(turn) * y - np.sin(turn) * x + 10.0
    row = np.floor(b / width)
    a = a + (0.0 if kind == "tiles" else 0.5 * length) * (row % 2)
    column = np.floor(a / length)
    edge = np.minimum(np.minimum(a % length, length - a % length), np.minimum(b % width, width - b % width))
    gap = np.clip((0.5 * joint - edge) / _PIXEL_M + 0.5, 0, 1)[..., None]
    shade = rng.normal(0, {"tiles": 0.04, "brick": 0.15, "parquet": 0.12}[kind], (400, 400))
    piece = np.exp(shade[row.astype(int) % 400, column.astype(int) % 400])
    grain = {
        "tiles": {(2, 2): 0.015, (20, 20): 0.02},
        "brick": {(1.5, 1.5): 0.08, (8, 8): 0.08},
        "parquet": {(1.5, 40): 0.08, (6, 60): 0.06},
    }
    body = np.array(
        {"tiles": [0.5, 0.53, 0.55], "brick": [0.1, 0.14, 0.3], "parquet": [0.14, 0.24, 0.38]}[kind]
    )
    mortar = np.array(
        {"tiles": [0.18, 0.18, 0.18], "brick": [0.4, 0.42, 0.43], "parquet": [0.05, 0.06, 0.08]}[kind]
    )
    colour = (piece * np.exp(_noise(rng, (n, n), grain[kind])))[..., None] * body
    return np.clip(colour * (1 - gap) + mortar * gap, 0, 1).astype(np.float32)


def drive(
    floor: str, seed: int, *, frames: int = 60, shadow: bool = False, box: bool = False, plain: bool = False
) -> Drive:
    """A drive of 0.1 m/s over a floor of :data:`FLOORS`, with a walking shadow or towards a box of 12 cm.

    A ``plain`` box has one colour: no print, no grain.
    """
    rng = np.random.default_rng([31, seed, *floor.encode()])
    speed, turn = rng.uniform(0.08, 0.14), rng.normal(0, 0.04)
    t = FRAME_S * np.arange(frames)
    theta = turn * t
    poses = np.column_stack([speed * t, 0.5 * speed * turn * t**2, theta])
    world = Drive(_floor(floor, rng), poses, rng)
    if shadow:
        angle, pace = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 1.0)
        meets = np.array([0.3 + speed * t[-1] / 2, 0.0]) - 0.5 * t[-1] * pace * np.array(
            [np.cos(angle), np.sin(angle)]
        )
        penumbra = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
        world.shadow = np.array(
            [
                *meets,
                pace * np.cos(angle),
                pace * np.sin(angle),
                rng.uniform(0.05, 0.3),
                penumbra,
                rng.uniform(0.2, 0.6),
            ]
        )
    if box:
        world.box = np.array([0.42 + rng.uniform(0, 0.03), rng.uniform(-0.03, 0.03), 0.12])
        tint = np.exp(rng.normal(-1.2, 0.5)) * np.exp(rng.normal(0, 0.15, 3))
        print_ = np.exp((not plain) * _noise(rng, (150, 150), {(3, 3): 0.06, (20, 20): 0.15}))
        world.skin = np.clip(print_[..., None] * tint, 0, 1).astype(np.float32)
    return world
