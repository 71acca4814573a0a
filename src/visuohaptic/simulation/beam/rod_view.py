"""Camera images of the beam sensor: prints on a bending rod above a table.

Every print is a plane. A pixel is the mean of ``fine`` x ``fine`` rays, each
traced through the lens to the print; blur of the lens, light and noise are added
as for all simulated cameras.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core import Camera, InputError, Pose
from ..rendering import TILE_MEAN, CameraEffects, texture_tile
from ..rendering._coverage import coverage
from .rod import RodState
from .rod_prints import Print
from .rod_rig import RodRig

_FINE = 3
#: Rows computed together: the arrays of 900 numbers of 4 bytes in a row, the rays through a print, fit the processor's cache.
_BAND_ROWS = 64
_ROD_LEVEL, _BASE_LEVEL, _TABLE_LEVEL = 45.0, 70.0, 120.0
#: The table below the rod, as a distance along -Z of the sensor, and the size of its texture [m].
_TABLE_M, _TABLE_TILE_M = 0.06, 0.3
#: Ends of the base along X and across it, in the sensor frame [m].
_BASE_M = (-0.075, 0.0, 0.02)

#: Rows and columns of the image, fraction of each pixel that a print covers, and its levels times that.
_Patch = tuple[tuple[slice, slice], np.ndarray, np.ndarray]


class RodRenderer:
    """Renders a rod with prints as seen by a camera.

    Parameters
    ----------
    rig
        Poses of prints and camera.
    camera
        Size, matrix and distortion.
    prints
        Prints on the reference and on the rod, by the names of the rig.
    effects
        Blur, light and noise.
    """

    def __init__(
        self,
        rig: RodRig,
        camera: Camera,
        prints: Mapping[str, Print],
        effects: CameraEffects | None = None,
    ) -> None:
        expected = {rig.reference, *rig.mounts}
        if set(prints) != expected:
            raise InputError(
                "RodRenderer", f"found prints {sorted(prints)}, expected {sorted(expected)}", field="prints"
            )
        self.rig, self.camera, self.prints = rig, camera, dict(prints)
        self.effects = effects or CameraEffects()
        self._coarser: dict[tuple[int, int], np.ndarray] = {}
        #: What did not move since the last image: table and base under one view, prints at one pose.
        self._ground: tuple[bytes, np.ndarray] | None = None
        self._patches: dict[str, tuple[bytes, _Patch | None]] = {}
        self._slopes = _slopes(camera, np.arange(camera.width), np.arange(camera.height))

    def render(
        self,
        state: RodState,
        *,
        rng: np.random.Generator,
        T_camera_sensor: Pose | None = None,
        t_s: float = 0.0,
    ) -> UInt8[np.ndarray, "rows columns"]:
        """Image of the rod under a load.

        Parameters
        ----------
        state
            Shape of the rod.
        rng
            Source of the noise.
        T_camera_sensor
            Pose of the sensor in the camera frame; that of the rig by default.
        t_s
            Time of the frame [s].
        """
        exact = self.exact(state, T_camera_sensor)
        times = np.full(self.camera.height, t_s)
        return self.effects.developed(exact[..., None], times, rng)[..., 0]

    def exact(
        self, state: RodState, T_camera_sensor: Pose | None = None
    ) -> Float32[np.ndarray, "rows columns"]:
        """The image before light, noise and rounding.

        Parameters
        ----------
        state, T_camera_sensor
            As of :meth:`.RodRig.poses`.
        """
        view = self.rig.T_camera_sensor if T_camera_sensor is None else T_camera_sensor
        if self._ground is None or self._ground[0] != _key(view):
            ground = self._table(view)
            low, high, half = _BASE_M
            base = np.array([[low, -half, 0.0], [high, -half, 0.0], [high, half, 0.0], [low, half, 0.0]])
            self._fill(ground, view.apply(base), _BASE_LEVEL)
            self._ground = _key(view), ground
        image = self._ground[1].copy()
        self._fill(image, _ribbon(view.apply(state.points_m), state.rod.diameter_m), _ROD_LEVEL)
        for name, pose in self.rig.poses(state, view).items():
            if name not in self._patches or self._patches[name][0] != _key(pose):
                self._patches[name] = _key(pose), self._patch(self.prints[name], pose)
            if patch := self._patches[name][1]:
                window, fraction, paint = patch
                image[window] *= 1.0 - fraction
                image[window] += paint
        return image

    def _table(self, view: Pose) -> Float32[np.ndarray, "rows columns"]:
        import cv2

        tile = _table_tile()
        normal = view.rotation[:, 2]
        origin = view.translation_m - _TABLE_M * normal
        scale = len(tile) / _TABLE_TILE_M
        texture = np.zeros((self.camera.height, self.camera.width), np.float32)
        seen = np.zeros(texture.shape, bool)
        for at in _bands(len(texture)):
            slopes = _rows_of(self._slopes, at)
            depth = np.float32(origin @ normal) / _along(slopes, normal.astype(np.float32))
            # Affine in the ray: the two in-plane coordinates of depth * ray - origin.
            place = [
                _along(slopes, (axis * scale).astype(np.float32)) * depth
                - np.float32(scale * (origin @ axis))
                for axis in view.rotation[:, :2].T
            ]
            texture[at] = cv2.remap(tile, place[0], place[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            seen[at] = np.isfinite(depth) & (depth > 0)
        texture = cv2.GaussianBlur(texture, (0, 0), max(self.effects.blur_px, 0.3))
        return np.where(seen, np.float32(_TABLE_LEVEL) + 0.5 * texture, _TABLE_LEVEL)

    def _fill(self, image: np.ndarray, outline_camera_m: np.ndarray, level: float) -> None:
        polygon = self.camera.project(outline_camera_m)
        if not np.isfinite(polygon).all():
            return
        rows, columns = image.shape
        found = coverage(polygon, rows, columns, self.effects.blur_px)
        if found is not None:
            image[found.window] += found.fraction.astype(np.float32) * (
                np.float32(level) - image[found.window]
            )

    def _patch(self, drawn: Print, pose: Pose) -> _Patch | None:
        """A print in the image; ``None`` where it is not seen."""
        import cv2

        rows, columns = drawn.levels.shape
        half = 0.5 * drawn.pixel_m * np.array([columns, rows])
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0]
        seen = self.camera.project(pose.apply(corners))
        sight = pose.rotation[:, 2] @ pose.translation_m
        if not np.isfinite(seen).all() or sight <= 0:  # behind the camera, or seen from the back
            return None
        reach = math.ceil(4 * self.effects.blur_px) + 2
        height, width = self.camera.height, self.camera.width
        left, top = np.maximum(np.floor(seen.min(axis=0)).astype(int) - reach, 0)
        right, bottom = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + reach + 1, [width, height])
        if right - left < 1 or bottom - top < 1:
            return None
        offset = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        x = (np.arange(left, right)[:, None] + offset).ravel()
        y = (np.arange(top, bottom)[:, None] + offset).ravel()
        # Rays further apart than the pixels of the print would alias at its edges.
        apart_m = pose.translation_m[2] / (_FINE * self.camera.focal_px)
        shown = self._shown(drawn, max(1, math.ceil(apart_m / drawn.pixel_m)))
        pitch_m = 2 * half / shown.shape[::-1]
        parts = [np.zeros((len(y), len(x)), np.float32) for _ in range(2)]
        every = _slopes(self.camera, x, y)
        # Places in pixels of the print: 1e-4 of one is lost with half of the digits.
        axes = (pose.rotation[:, :2] / pitch_m).T.astype(np.float32)
        origin = (pose.translation_m @ pose.rotation[:, :2] / pitch_m).astype(np.float32)
        ends = 0.5 * np.array(shown.shape[::-1], np.float32)
        for at in _bands(len(y)):
            slopes = _rows_of(every, at)
            depth = np.float32(sight) / _along(slopes, pose.rotation[:, 2].astype(np.float32))
            across, down = (
                depth * _along(slopes, axis) - place for axis, place in zip(axes, origin, strict=True)
            )
            parts[0][at] = (np.abs(across) <= ends[0]) & (np.abs(down) <= ends[1])
            across += ends[0] - np.float32(0.5)
            down += ends[1] - np.float32(0.5)
            levels = cv2.remap(shown, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            np.multiply(levels, parts[0][at], out=parts[1][at])
        # The lens blurs before the pixels sample: otherwise there would be aliasing along the edges.
        if self.effects.blur_px > 0:
            # The patch is wider than the print by the radius of the blur: nothing is cut off.
            parts = [cv2.GaussianBlur(part, (0, 0), _FINE * self.effects.blur_px) for part in parts]
        size = int(right - left), int(bottom - top)
        # Average over whole blocks of rays.
        fraction, paint = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in parts)
        return (slice(top, bottom), slice(left, right)), fraction, paint

    def _shown(self, drawn: Print, block: int) -> Float32[np.ndarray, "r c"]:
        """The print's levels, means of ``block`` x ``block`` pixels."""
        if block == 1:
            return drawn.levels
        key = (id(drawn), block)
        if key not in self._coarser:
            import cv2

            rows, columns = drawn.levels.shape
            size = (max(2, round(columns / block)), max(2, round(rows / block)))
            self._coarser[key] = np.asarray(cv2.resize(drawn.levels, size, interpolation=cv2.INTER_AREA))
        return self._coarser[key]


@lru_cache(maxsize=1)
def _table_tile() -> Float32[np.ndarray, "side side"]:
    """Texture of the table, of mean 0."""
    return texture_tile("concrete").astype(np.float32) - np.float32(TILE_MEAN)


def _bands(rows: int) -> Iterator[slice]:
    """Rows of an image in bands whose arrays stay in the processor's cache."""
    return (slice(low, low + _BAND_ROWS) for low in range(0, rows, _BAND_ROWS))


def _key(pose: Pose) -> bytes:
    return pose.rotation.tobytes() + pose.translation_m.tobytes()


def _slopes(
    camera: Camera, x: Float[np.ndarray, "w"], y: Float[np.ndarray, "h"]
) -> tuple[Float32[np.ndarray, "*a"], Float32[np.ndarray, "*b"]]:
    """x / z and y / z of the rays through a grid of pixels; without distortion, one row and one column."""
    if camera.distortion.any() or camera.matrix[0, 1]:
        rays = camera.rays(np.stack(np.meshgrid(x, y), axis=-1)).astype(np.float32)
        return rays[..., 0], rays[..., 1]
    row = camera.rays(np.column_stack([x, np.zeros(len(x))]))[:, 0]
    column = camera.rays(np.column_stack([np.zeros(len(y)), y]))[:, 1:2]
    return row.astype(np.float32), column.astype(np.float32)


def _rows_of(slopes: tuple[np.ndarray, np.ndarray], at: slice) -> tuple[np.ndarray, np.ndarray]:
    """The slopes of some rows of a grid of pixels."""
    return slopes[0] if slopes[0].ndim == 1 else slopes[0][at], slopes[1][at]


def _along(slopes: tuple[np.ndarray, np.ndarray], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w"]:
    """Component of the rays along an axis, per length along z."""
    found: np.ndarray = slopes[0] * axis[0] + (slopes[1] * axis[1] + axis[2])
    return found


def _ribbon(points_camera_m: Float[np.ndarray, "n 3"], width_m: float) -> Float[np.ndarray, "m 3"]:
    """Outline of a round rod as the camera sees it: half its width to both sides of its axis."""
    points = points_camera_m[:: max(1, len(points_camera_m) // 24)]
    along = np.gradient(points, axis=0)
    side = np.cross(along, points)
    side *= 0.5 * width_m / np.linalg.norm(side, axis=1, keepdims=True)
    return np.vstack([points + side, (points - side)[::-1]])


def hand_held(rig: RodRig, t_s: float) -> Pose:
    """``T_camera_sensor`` of a hand-held camera: slow oscillations about the view of the rig.

    Sines with different periods of 2 to 5 s, of 1 cm and 0.04 rad, in every direction.

    Parameters
    ----------
    rig
        Rod and camera.
    t_s
        Time [s].
    """
    periods_s = np.array([2.9, 3.7, 4.9, 3.1, 4.3, 2.3])
    swing = np.sin(2 * np.pi * t_s / periods_s + np.arange(6))
    turn = 0.04 * swing[:3] * [1.0, 1.0, 1.5]
    view = rig.T_camera_sensor
    # About the point that the camera looks at, so that the prints stay in the image.
    middle = view.apply(np.array([0.5 * rig.rod.length_m, 0.0, 0.0]))
    moved = Pose.from_rotation_vector(turn, middle + 0.01 * swing[3:])
    return moved @ Pose(np.eye(3), -middle) @ view
