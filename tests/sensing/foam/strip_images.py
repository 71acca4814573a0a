"""Instrument of the tests: images of a foam strip under shadows and bodies, written apart from the library.

A camera looks straight down from 0.3 m at a straight strip; all lengths in metres, in the plane of the foam's
top: x away from the robot (up in the image), s along the strip (to the left). Every pixel is the mean of
sub-samples, so that an edge without penumbra is as sharp as the optics allow. A shadow multiplies what it
falls upon; the foam's texture is fixed to its material and moves with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

LENGTH_M, WIDTH_M, HEIGHT_M = 0.25, 0.02, 0.01
COLUMNS, ROWS, FOCAL_PX, DISTANCE_M, AHEAD_M = 1120, 260, 1280.0, 0.3, 0.012
PX_M = DISTANCE_M / FOCAL_PX  #: side of a pixel on the foam
BASE_GREY = 40.0
SUB = (4, 2)  #: sub-samples of a pixel, rows and columns

CAMERA_YAML = f"""\
image_width: {COLUMNS}
image_height: {ROWS}
camera_name: straight_down
camera_matrix: {{rows: 3, cols: 3, data: [{FOCAL_PX}, 0, {(COLUMNS - 1) / 2}, 0, {FOCAL_PX}, {(ROWS - 1) / 2}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""
#: F to camera: x_camera = -s, y_camera = AHEAD_M - x, z_camera = DISTANCE_M - z (half a turn about (1, -1, 0)).
SENSOR_YAML = f"""\
kind: foam
camera: camera.yaml
foam: foam.yaml
strip: {{length_m: {LENGTH_M}}}
T_camera_foam:
  translation_m: [0.0, {AHEAD_M}, {DISTANCE_M}]
  quaternion_xyzw: [{0.5**0.5!r}, {-(0.5**0.5)!r}, 0.0, 0.0]
tracking: {{foam_is: brighter, base_is: darker}}
"""

#: A factor of the light at each place (x, s), and whether (x, s) is inside a body.
Field = Callable[[np.ndarray, np.ndarray], np.ndarray]


def grid(sub: tuple[int, int] = SUB) -> tuple[np.ndarray, np.ndarray]:
    """Places x, s [m] of all sub-samples, (ROWS * sub, COLUMNS * sub)."""
    rows = (np.arange(ROWS * sub[0]) + 0.5) / sub[0] - 0.5
    columns = (np.arange(COLUMNS * sub[1]) + 0.5) / sub[1] - 0.5
    x = AHEAD_M - (rows - 0.5 * (ROWS - 1)) * PX_M
    s = -(columns - 0.5 * (COLUMNS - 1)) * PX_M
    return np.broadcast_to(x[:, None], (len(x), len(s))), np.broadcast_to(s[None], (len(x), len(s)))


def smooth_noise(shape: tuple[int, int], size_px: float, rng: np.random.Generator) -> np.ndarray:
    """A random field of unit variance whose grains are ``size_px`` wide."""
    noise = gaussian_filter(rng.standard_normal(shape), size_px, mode="wrap")
    return noise / noise.std()


@dataclass
class World:
    """One strip, floor, camera and its noise, drawn from a seed."""

    seed: int
    width_m: float = WIDTH_M
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([2024, self.seed])
        draw = self.rng.uniform
        self.foam, self.floor, self.body = draw(150, 205), draw(50, 90), draw(45, 90)
        self.blur_px, self.noise = draw(0.5, 1.2), draw(1.5, 4.0)
        self._x, self._s = grid()
        shape = (int(self.width_m / PX_M) + 2, COLUMNS)
        self._texture = draw(2.0, 8.0) * smooth_noise(shape, draw(0.7, 2.0), self.rng)
        self._ground = draw(1.0, 8.0) * smooth_noise((ROWS, COLUMNS), draw(0.8, 3.0), self.rng)
        self._skin = draw(1.0, 6.0) * smooth_noise((ROWS, COLUMNS), draw(0.8, 3.0), self.rng)

    def image(
        self,
        *,
        shadow: Field | None = None,
        delta: Callable[[np.ndarray], np.ndarray] | None = None,
        body: Field | None = None,
        floor_in_shadow: bool = True,
    ) -> np.ndarray:
        """One grey image, (ROWS, COLUMNS) uint8: ``delta`` [m] by s, ``body`` True inside of it."""
        free = delta is None and body is None
        if free and shadow is None:
            small = self._at_rest
        else:
            layers = self._bare_strip if free else self._layers(delta, body)
            light = 1.0 if shadow is None else shadow(self._x, self._s)
            small = self._seen(*layers, light, light if floor_in_shadow else 1.0)
        small = small + self.noise * self.rng.standard_normal(small.shape)
        return np.clip(np.rint(small), 0, 255).astype(np.uint8)

    @cached_property
    def _bare_strip(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._layers(None, None)

    @cached_property
    def _at_rest(self) -> np.ndarray:
        """What is seen without shadows and bodies, without noise."""
        return self._seen(*self._bare_strip, 1.0, 1.0)

    def _layers(
        self, delta: Callable[[np.ndarray], np.ndarray] | None, body: Field | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Part of each sub-sample that is foam, its grey, and that of the rest."""
        x, s = self._x, self._s
        pressed = np.zeros(s.shape[1]) if delta is None else delta(s[0])
        front = self.width_m - pressed[None]
        # The front covers its sub-sample in part: a quarter of a pixel would be 0.06 mm.
        bare = (
            np.clip((front - x) / (PX_M / SUB[0]) + 0.5, 0.0, 1.0) * (x >= 0) * (np.abs(s) <= 0.5 * LENGTH_M)
        )
        depth = np.clip(x / np.maximum(front, 1e-6), 0.0, 1.0) * (len(self._texture) - 1)
        grey = _repeated(self.floor + self._ground)
        if body is not None:
            grey = np.where(body(x, s), _repeated(self.body + self._skin), grey)
        grey = np.where(x < 0, BASE_GREY, grey)
        column = np.arange(x.shape[1]) // SUB[1]
        return bare, self.foam + self._texture[np.rint(depth).astype(np.intp), column], grey

    def _seen(
        self,
        bare: np.ndarray,
        foam: np.ndarray,
        rest: np.ndarray,
        light: np.ndarray | float,
        floor_light: np.ndarray | float,
    ) -> np.ndarray:
        """Mean over the sub-samples of each pixel, blurred by the lens."""
        grey = bare * foam * light + (1.0 - bare) * rest * floor_light
        return gaussian_filter(grey.reshape(ROWS, SUB[0], COLUMNS, SUB[1]).mean(axis=(1, 3)), self.blur_px)


def _repeated(pixels: np.ndarray) -> np.ndarray:
    """Each pixel for all of its sub-samples."""
    return np.repeat(np.repeat(pixels, SUB[0], axis=0), SUB[1], axis=1)


def edge_shadow(x_m: float, s_m: float, angle_rad: float, dark: float, penumbra_px: float = 0.0) -> Field:
    """Shadow beyond a straight edge through (x_m, s_m); its normal is turned by ``angle_rad`` from x to s."""

    def factor(x: np.ndarray, s: np.ndarray) -> np.ndarray:
        away = (x - x_m) * np.cos(angle_rad) + (s - s_m) * np.sin(angle_rad)
        wide = max(penumbra_px, 1e-6) * PX_M
        return 1.0 - dark * np.clip(away / wide + 0.5, 0.0, 1.0)

    return factor
