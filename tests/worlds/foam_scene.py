"""One foam strip, its surroundings and its webcam, generated from a seed, with images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .foam_mechanics import Foam, Press, Shape
from .foam_optics import BASE, BODY, FLOOR, FOAM, SKIN, Sensor, hammersley, point_spread, render_light

__all__ = ["FRAME_S", "Moment", "World", "shadow_row"]

FRAME_S = 1.0 / 30
#: Image sizes of webcams [px]; the strip fills most of the width.
SIZES = ((640, 480), (800, 600), (1280, 720), (1600, 896), (1920, 1080))
_SIZE_SHARE = (0.35, 0.15, 0.3, 0.1, 0.1)
_STEP_M = 1e-4  #: of the tables over y
_POINTS = hammersley()
_NO_ROWS = np.zeros((0, 11))


def shadow_row(
    shape: int,
    at_m: tuple[float, float],
    angle_rad: float,
    *,
    penumbra_m: float,
    dark: float,
    half_m: float = 0.0,
    floor_shift_m: tuple[float, float] = (0.0, 0.0),
    smooth: bool = False,
) -> np.ndarray:
    """One shadow for :class:`Moment`; its normal is turned by ``angle_rad`` from x towards y.

    ``dark`` is the fraction of linear light that it takes; ``floor_shift_m`` how far it is displaced on the
    floor, which lies lower than the top of the foam.
    """
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([shape, *at_m, cos, sin, half_m, penumbra_m, *floor_shift_m, dark, float(smooth)])


@dataclass(slots=True)
class Moment:
    """Objects in front of the camera at one time; only the strip by default."""

    press: Press | None = None
    body: Shape | None = None  #: seen even before it touches
    body_low_m: float = 0.0  #: lowest point of the body below the undeformed front
    body_side_m: tuple[float, float] = (-1.0, 1.0)  #: first and last y of the body
    shadows: list[np.ndarray] = field(default_factory=list)
    capsules: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))  #: fingers before the strip
    floor_m: tuple[float, float] = (0.0, 0.0)  #: how far the floor has moved
    camera: tuple[float, float, float] = (
        0.0,
        0.0,
        0.0,
    )  #: shift of the image [px] and turn about its centre [rad]
    gain: float = 1.0  #: exposure
    flicker: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: modulation, frequency [Hz], time [s]
    spread: np.ndarray | None = None  #: point spread; None: that of the lens


class World:
    """A strip and a camera; everything is drawn from ``seed`` and the named fields.

    Parameters
    ----------
    seed
        Any integer.
    size
        Image (columns, rows); ``None`` draws one of a webcam.
    region
        Whether the image is cut to the surroundings of the strip, which is faster.
    """

    def __init__(
        self, seed: int, *, size: tuple[int, int] | None = None, region: bool = True, **fixed
    ) -> None:
        self.rng = np.random.default_rng([17, seed])
        draw = self.rng.uniform
        self.foam = fixed.get("foam", Foam())
        columns, rows = size or SIZES[self.rng.choice(len(SIZES), p=_SIZE_SHARE)]
        tilt = fixed.get("angle_rad", float(draw(-0.07, 0.07)))
        self.px_m = self.foam.length_m * float(draw(1.06, 1.2)) / columns * (1 + 0.3 * abs(tilt))
        if region:
            high = (0.075 + self.foam.length_m * abs(tilt)) / self.px_m
            rows = int(min(rows, 8 * np.ceil(high / 8)))
        self.columns, self.rows, self.angle_rad = columns, rows, tilt
        self.colour = bool(fixed.get("colour", self.rng.random() < 0.3))
        gamma = float(self.rng.choice([1.0, 2.2]))
        self.sensor = Sensor(
            fixed.get("gamma", gamma),
            float(draw(0.5, 2.5)),
            float(draw(0.0, 0.03)),
            float(draw(0, 0.6) * (self.rng.random() < 0.4)),
            int(self.rng.choice([0, 0, 0, 60, 75, 90])),
        )
        self.lens_px = float(draw(0.45, 1.0))
        self.spread = point_spread(self.lens_px)
        self._place()
        self._colours()
        self._textures()
        self._lens()
        cut = cv2.GaussianBlur(self.rng.standard_normal((1, self._front0.size)), (0, 0), 0.01 / _STEP_M)
        self._front0 += float(draw(0.0, 1e-4)) * (cut / cut.std())[0]

    def _place(self) -> None:
        """The camera looks straight down; pixels to metres, tables, and the pose known to the user."""
        draw = self.rng.uniform
        self.middle_m = (float(draw(0.013, 0.02)), float(draw(-0.002, 0.002)))  # seen by the image's centre
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        # u to the right is -y, v down is -x, then turned by the angle.
        turn = np.array([[-sin, -cos], [-cos, sin]])
        centre = 0.5 * (np.array([self.columns, self.rows]) - 1)
        linear = turn * self.px_m
        self.inverse = np.column_stack([linear, np.array(self.middle_m) - linear @ centre])
        half = 0.5 * self.foam.length_m + 0.06
        self.y_m = np.arange(-half, half, _STEP_M)
        self._front0 = np.full(self.y_m.size, self.foam.width_m)
        self._heights = np.linspace(0, 1.1 * self.foam.width_m, 45)
        #: Error of the user's pose: along x and y [px], and in the plane [rad].
        self.pose_error = (float(draw(-1, 1)), float(draw(-1, 1)), float(draw(-1e-3, 1e-3)))

    def _colours(self) -> None:
        """Linear albedo of the surfaces for each channel; the foam is the brightest."""
        draw = self.rng.uniform
        grey = np.array([draw(20, 50), draw(140, 205), draw(45, 95), draw(30, 100), draw(110, 200)])
        self.grey = grey
        if self.colour:
            cast = 1 + self.rng.uniform(-0.12, 0.12, (5, 3))
            cast[SKIN] *= [0.75, 0.9, 1.15]
            grey = np.clip(grey[:, None] * cast, 5, 235)
        self.albedo = (grey.reshape(5, -1) / 255.0) ** self.sensor.gamma
        self.tint = np.array([0.8, 1.0, 1.15]) if self.colour else np.ones(1)

    def _textures(self) -> None:
        """Relative brightness of each surface, mean 1, texel as large as a pixel; specks and scratches."""
        rng, shape = self.rng, (256, 1024)
        contrast = {
            BASE: (0.0, 0.06),
            FOAM: (0.01, 0.045),
            FLOOR: (0.02, 0.15),
            BODY: (0.01, 0.15),
            SKIN: (0.02, 0.06),
        }
        stack = np.empty((5, *shape))
        for surface, (low, high) in contrast.items():
            fine, coarse = (
                _noise(shape, sigma, rng) for sigma in (rng.uniform(0.8, 2.0), rng.uniform(4, 12))
            )
            mixed = 0.8 * fine + 0.6 * coarse
            stack[surface] = 1 + rng.uniform(low, high) * self.sensor.gamma * np.clip(mixed, -3, 3)
        self.specks = int(rng.integers(0, 12) * (rng.random() < 0.5))
        rows = self.foam.width_m / self.px_m
        for _ in range(self.specks):
            at = (int(rng.uniform(0, shape[1])), int(rng.uniform(0.1, 0.97) * rows))
            end = (at[0] + int(rng.normal(0, 8)), at[1] + int(rng.normal(0, 8)))
            blot = np.zeros(shape)
            cv2.line(blot, at, end if rng.random() < 0.4 else at, 1.0, int(rng.integers(1, 5)), cv2.LINE_AA)
            stack[FOAM] *= 1 - rng.uniform(0.1, 0.5) * cv2.GaussianBlur(blot, (0, 0), 0.8)
        self.textures = np.maximum(stack, 0.05).astype(np.float32)

    def _lens(self) -> None:
        """Fixed light of the scene and dirt of the lens, (rows, columns, 1)."""
        u, v = np.meshgrid(np.linspace(-1, 1, self.columns), np.linspace(-1, 1, self.rows))
        a, b, c = self.rng.uniform(-0.15, 0.15, 3)
        light = 1 + a * u + 0.5 * b * v - 0.5 * abs(c) * u**2
        for _ in range(int(self.rng.integers(1, 6)) * (self.rng.random() < 0.4)):
            at = self.rng.uniform([0, 0], [self.columns, self.rows])
            pu, pv = (u + 1) * 0.5 * self.columns - at[0], (v + 1) * 0.5 * self.rows - at[1]
            radius = self.rng.uniform(3, 15)
            light *= 1 - self.rng.uniform(0.02, 0.12) / (
                1 + np.exp(np.minimum((np.hypot(pu, pv) - radius) / 2.0, 50.0))
            )
        self.light = light[..., None].astype(np.float32)

    # -- data known to the user ------------------------------------------------------------------------------

    def write(self, folder: Path, stress_Pa=None, *, encoding_known: bool = False) -> Path:
        """Camera, calibration recording and ``sensor.yaml`` as a user would have them; the path of the last.

        Few users know how their camera encodes light; ``encoding_known`` is one who does.
        """
        distance, (du, dv, turned) = 0.3, self.pose_error
        focal = distance / self.px_m
        centre = ((self.columns - 1) / 2, (self.rows - 1) / 2)
        known = "linear" if self.sensor.gamma == 1.0 else "srgb"
        (folder / "camera.yaml").write_text(
            f"image_width: {self.columns}\nimage_height: {self.rows}\ncamera_name: webcam\n"
            f"camera_matrix: {{rows: 3, cols: 3, data: [{focal!r}, 0, {centre[0]}, 0, {focal!r}, {centre[1]}, 0, 0, 1]}}\n"
            "distortion_model: plumb_bob\n"
            "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
            f"transfer_function: {known if encoding_known else 'unknown'}\n",
            encoding="utf-8",
        )
        strain = np.linspace(0, 0.6, 61)
        stress = self.foam.plate_stress_Pa(strain) if stress_Pa is None else stress_Pa(strain)
        rows = [f"{e:.4f},{p:.3f},loading" for e, p in zip(strain, stress, strict=True)]
        (folder / "strain_stress.csv").write_text(
            "\n".join(["strain,stress_Pa,direction", *rows, ""]), encoding="utf-8"
        )
        angle = self.angle_rad + turned
        cos, sin = np.cos(angle), np.sin(angle)
        # Camera axes in F: columns of R_camera_foam are F's x and y in camera coordinates.
        to_camera = np.array([[-sin, -cos, 0.0], [-cos, sin, 0.0], [0.0, 0.0, -1.0]])
        a, b = -to_camera[:2, :2] @ self.middle_m + np.array([du, dv]) * self.px_m
        quaternion = [float(q) for q in Rotation.from_matrix(to_camera).as_quat()]
        (folder / "sensor.yaml").write_text(
            "kind: foam\ncamera: camera.yaml\nfoam: foam.yaml\n"
            f"strip: {{length_m: {self.foam.length_m}}}\nT_camera_foam:\n"
            f"  translation_m: [{float(a)!r}, {float(b)!r}, {distance}]\n"
            f"  quaternion_xyzw: {quaternion}\n"
            "tracking: {foam_is: brighter, base_is: darker}\n",
            encoding="utf-8",
        )
        return folder / "sensor.yaml"

    # -- images -------------------------------------------------------------------------------------------

    def darkness(self, grey_fraction: float) -> float:
        """Fraction of linear light that lowers grey levels by a given fraction."""
        return 1.0 - (1.0 - grey_fraction) ** self.sensor.gamma

    def tables(self, moment: Moment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Front and body over y, ends over x [m].

        The mechanics are those of a strip of even width. A column that is wider or narrower is shortened in proportion: it has
        the same strain, hence the same stress, and the body meets the foam wherever it presses, with no floor between them.
        """
        press, cut = moment.press, self._front0 / self.foam.width_m
        half = 0.5 * self.foam.length_m
        delta, ends = 0.0, np.array([np.full(45, -half), np.full(45, half)])
        if press is not None:
            delta = np.interp(self.y_m, press.y_m, press.delta_m)
            ends = np.array([press.end_low_m, press.end_high_m])
        body = np.full(self.y_m.size, 10.0)
        if moment.body is not None:
            outline = self.foam.width_m - moment.body_low_m + moment.body(self.y_m)[0]
            inside = (self.y_m >= moment.body_side_m[0]) & (self.y_m <= moment.body_side_m[1])
            body = np.where(inside, cut * outline, 10.0)
        return self._front0 - cut * delta, body, ends

    def _seen_from(self, camera: tuple[float, float, float]) -> np.ndarray:
        """Pixels to metres of a camera that has moved."""
        du, dv, turned = camera
        cos, sin = np.cos(turned), np.sin(turned)
        centre = 0.5 * (np.array([self.columns, self.rows]) - 1)
        turn = np.array([[cos, sin], [-sin, cos]])
        shift = centre - turn @ (centre + np.array([du, dv]))
        linear = self.inverse[:, :2]
        return np.column_stack([linear @ turn, linear @ shift + self.inverse[:, 2]])

    def light_of(self, moment: Moment) -> np.ndarray:
        """Linear light before the lens, (rows, columns, channels)."""
        front, body, ends = self.tables(moment)
        out = np.empty((self.rows, self.columns, len(self.tint)), np.float32)
        offsets = np.zeros((5, 2))
        offsets[FLOOR] = moment.floor_m
        offsets[BODY, 0] = -moment.body_low_m
        if len(moment.capsules):
            offsets[SKIN] = moment.capsules[0, :2]
        render_light(
            out,
            self._seen_from(moment.camera),
            np.array([self.y_m[0], _STEP_M, self._heights[1], self.foam.width_m, front.max()]),
            front,
            body,
            self.foam.width_m - moment.body_low_m + 0.03 if moment.body is not None else -1.0,
            ends,
            np.ascontiguousarray(moment.capsules),
            np.array(moment.shadows) if moment.shadows else _NO_ROWS,
            self.tint,
            self.albedo,
            self.textures,
            self.px_m,
            offsets,
            _POINTS,
        )
        return out

    def image(self, *moments: Moment) -> np.ndarray:
        """One image, the mean over the moments of its exposure."""
        light = np.mean([self.light_of(one) for one in moments], axis=0, dtype=np.float32)
        first = moments[0]
        light *= self.light * np.float32(first.gain**self.sensor.gamma)
        depth, frequency, time = first.flicker
        if depth:
            rows = time + np.arange(self.rows) * (0.8 * FRAME_S / self.rows)
            light *= (1 + depth * np.cos(2 * np.pi * frequency * rows)).astype(np.float32)[:, None, None]
        spread = self.spread if first.spread is None else first.spread
        return self.sensor.image(light, spread, self.rng)


def _noise(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Random field of unit variance with grains of ``sigma`` texels."""
    pad = int(4 * sigma) + 1
    wide = np.pad(rng.standard_normal(shape, dtype=np.float32), pad, mode="wrap")
    grains = cv2.GaussianBlur(wide, (0, 0), sigma)[pad:-pad, pad:-pad]
    return grains / grains.std()
